"""The system as it was when a checkpoint was made."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import FmuError
from ...instances.instance import CallFailed
from ...simulation.initialization import SWEEPS, AlgebraicLoop, exchange, read, set_up
from ...simulation.stepper import ComponentFailed, Getter, Setter, Stepper, failing
from .file import Checkpoint, value_of

if TYPE_CHECKING:
    from ...simulation.system import System


def resume(checkpoint: Checkpoint, system: System) -> list[str]:
    """Initialize an opened system from a checkpoint, in place of `initialization.initialize`.

    Components go on from their saved states; fresh ones are initialized at the time of the checkpoint with the values
    of the others.  Returns warnings: none.  Raises ComponentFailed, or AlgebraicLoop.
    """
    fresh = [stepper for stepper in system.steppers if stepper.component.name in checkpoint.fresh]
    for stepper in system.steppers:
        if stepper.component.name not in checkpoint.fresh:
            _go_on(system, stepper, checkpoint)
    for stepper in fresh:
        set_up(system, stepper, checkpoint.time)
    _settle(system, fresh)
    for stepper in fresh:
        with failing(stepper):
            stepper.instance.begin()
        read(stepper)
    for stepper in system.steppers:
        stepper.check_finite()
    return []


def _go_on(system: System, stepper: Stepper, checkpoint: Checkpoint) -> None:
    """Initialize a component as it began, with its last inputs, then put its state and its values back."""
    was = checkpoint.components[stepper.component.name]
    set_up(system, stepper)
    with failing(stepper):
        _put_back(stepper.setters, was["given"])
        for set_ in stepper.sets:
            stepper.instance.check(set_())
        stepper.instance.begin()
        state = checkpoint.states[stepper.component.name]
        if name := _kills(stepper, state):
            words = f"its FMU crashes ({name}) when given the state that another process saved; it may hold addresses"
            raise ComponentFailed(
                stepper, f"{words}: let the component be reinitialized, --swap {stepper.component.name}=FMU"
            )
        try:
            stepper.instance.restore(state)
        except (CallFailed, FmuError) as error:
            raise ComponentFailed(stepper, f"its state cannot be restored: {error}") from None
    read(stepper)  # of what is recorded or connected only now
    _put_back(stepper.setters, was["given"])
    _put_back(stepper.getters, was["computed"])
    for name, value in was["values"].items():
        if (place := system.places.get((stepper.component.name, name))) is not None:
            kind = stepper.component.fmu.variables[name].kind
            system.tables[kind][place] = value_of(kind, value)


def _kills(stepper: Stepper, state: bytes) -> str:
    """The signal that ends a process, forked from this one, in which the state is restored; "" where none does."""
    if stepper.instance.batched or not hasattr(os, "fork"):  # in a process of its own it costs nothing but that
        return ""
    process = os.fork()
    if process == 0:
        with contextlib.suppress(BaseException):
            stepper.instance.restore(state)
        os._exit(0)
    _, status = os.waitpid(process, 0)
    return signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else ""


def _put_back(calls: Sequence[Setter] | Sequence[Getter], values: Mapping[str, Any]) -> None:
    for call in calls:
        for place, variable in enumerate(call.variables):
            if variable.name in values:
                call.buffer[place] = value_of(call.kind, values[variable.name])


def _settle(system: System, fresh: Sequence[Stepper]) -> None:
    """Give fresh components their inputs until their outputs agree."""
    for _ in range(SWEEPS):
        before = {kind: table.copy() for kind, table in system.tables.items()}
        for stepper in fresh:
            exchange(stepper)
        if all(np.array_equal(before[kind], table) for kind, table in system.tables.items()):
            return
    names = ", ".join(stepper.component.name for stepper in fresh)
    raise AlgebraicLoop(f"the initial values of {names} do not settle in {SWEEPS} sweeps: they depend on each other")
