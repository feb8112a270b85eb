"""Going on from a checkpoint: whether an experiment can, and the system as it was then."""

from __future__ import annotations

import contextlib
import json
import os
import signal
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import ExperimentError, FmuError, Problem
from ...instances.instance import CallFailed
from ...simulation.initialization import SWEEPS, AlgebraicLoop, exchange, read, set_up
from ...simulation.stepper import ComponentFailed, Stepper, failing
from .file import Checkpoint, value_of

if TYPE_CHECKING:
    from ...plan.plan import Component, Plan
    from ...simulation.system import System


def attach(plan: Plan, checkpoint: Checkpoint, fresh: Iterable[str]) -> Plan:
    """The plan as it goes on from a checkpoint.  fresh: components that begin anew.

    Raises ExperimentError, with every reason why it cannot.
    """
    names = [component.name for component in plan.components]
    checkpoint = replace(checkpoint, fresh=tuple(sorted(set(fresh))))
    saved, problems = checkpoint.about["master"], []
    master, here = plan.experiment.master, f"{checkpoint.path}"
    for key in ("step", "algorithm"):
        if getattr(master, key) != saved[key]:
            problems.append(
                Problem(
                    f"master.{key}",
                    f"is {getattr(master, key)}, and was {saved[key]} in the run of "
                    f"{here}: a run goes on with what it began with",
                )
            )
    if not problems and plan.steps <= checkpoint.tick:
        problems.append(
            Problem(
                "master.stop_time",
                f"is {master.stop_time:.10g} s, where {here} already is at "
                f"t = {checkpoint.time:.10g} s; --set master.stop_time=... goes further",
            )
        )
    for name in checkpoint.components:
        if name not in names:
            problems.append(Problem(f"components.{name}", f"is missing; {here} has it"))
    driven: dict[str, set[str]] = {name: set() for name in names}
    needed: dict[str, set[str]] = {name: set() for name in names}
    for connection in plan.connections:
        driven[connection.sink].add(connection.input.name)
        needed[connection.source].add(connection.output.name)
    for name, variable in plan.recorded:
        needed[name].add(variable.name)
    for component in plan.components:
        if component.name not in checkpoint.components:
            problems.append(
                Problem(
                    f"components.{component.name}", f"is not in {here}, which has: {', '.join(checkpoint.components)}"
                )
            )
        elif component.name in checkpoint.fresh:
            problems += _unfit_fresh(component, checkpoint, plan)
        else:
            problems += _unfit(component, checkpoint, driven[component.name], needed[component.name])
    if problems:
        raise ExperimentError(plan.experiment.path, problems)
    return replace(plan, origin=checkpoint)


def _unfit_fresh(component: Component, checkpoint: Checkpoint, plan: Plan) -> list[Problem]:
    if checkpoint.tick % component.period == 0:
        return []
    grid = plan.experiment.grid
    return [
        Problem(
            f"components.{component.name}.step",
            f"{checkpoint.time:.10g} s is within a step of {component.name}, of "
            f"{grid.time(component.period):.10g} s, so it cannot begin there",
        )
    ]


def _unfit(component: Component, checkpoint: Checkpoint, driven: set[str], needed: set[str]) -> list[Problem]:
    """Why a component cannot go on from its saved state."""
    was, key = checkpoint.components[component.name], f"components.{component.name}"
    hint = f"--swap {component.name}=FMU begins it anew"
    if component.live or component.fmu.sha256 != was["fmu_sha256"]:
        return [
            Problem(
                f"{key}.fmu",
                f"{component.fmu_name} ({component.fmu.sha256[:10]}) is not the FMU of the checkpoint, "
                f"{was['fmu']} ({was['fmu_sha256'][:10]}); {hint}",
            )
        ]
    problems = []
    if component.period != was["period"]:
        words = f"is {component.period} steps of the master, and was {was['period']}; {hint}"
        problems.append(Problem(f"{key}.step", words))
    for what, now in (("parameters", component.parameters), ("start", component.start)):
        now, then = json.loads(json.dumps(dict(now))), was[what]
        for name in sorted({*now, *then}):
            if now.get(name) != then.get(name):
                words = f"is {_shown(now.get(name))}, and was {_shown(then.get(name))} in the checkpoint; {hint}"
                problems.append(Problem(f"{key}.{what}.{name}", words))
    given = {element.name for name in driven for element in component.fmu.elements(component.fmu.variables[name])}
    for name in sorted(set(was["given"]) - given):
        problems.append(
            Problem(f'connections."{component.name}.{name}"', "is missing: it was connected in the checkpoint")
        )
    if checkpoint.tick % component.period and (unknown := sorted(needed - {*was["values"], *was["computed"]})):
        words = f"the checkpoint lies within a step of it, and was made without its {', '.join(unknown)}"
        problems.append(Problem(key, f"{words}: neither record nor connect them, or make it again with them"))
    return problems


def _shown(value: Any) -> str:
    return "the FMU's own" if value is None else str(value)


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
        _put_back(stepper.inputs, was["given"])
        for set_ in stepper.sets:
            stepper.instance.check(set_())
        stepper.instance.begin()
        state = checkpoint.states[stepper.component.name]
        if name := _kills(stepper, state):
            words = f"its FMU crashes ({name}) when given the state that another process saved; it may hold addresses"
            raise ComponentFailed(
                stepper, f"{words}: let the component begin anew, --swap {stepper.component.name}=FMU"
            )
        try:
            stepper.instance.restore(state)
        except (CallFailed, FmuError) as error:
            raise ComponentFailed(stepper, f"its state cannot be restored: {error}") from None
    read(stepper)  # of what is recorded or connected only now
    _put_back(stepper.inputs, was["given"])
    _put_back(stepper.outputs, was["computed"])
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


def _put_back(exchanges: Sequence[Any], values: Mapping[str, Any]) -> None:
    for e in exchanges:
        for place, variable in enumerate(e.variables):
            if variable.name in values:
                e.buffer[place] = value_of(e.kind, values[variable.name])


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
