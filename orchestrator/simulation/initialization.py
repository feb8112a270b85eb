"""Consistent initial values: outputs that agree with the inputs, in initialization mode.

Components exchange values in the order in which they depend on each other, then all in turn until nothing changes any
more.  Where that does not settle, the values that depend on themselves are solved for by Newton's method, with finite
differences and shortened steps where a full one does not help.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..arrays import Reals, Table, Tables
from ..fmu.variables import FLOATS
from ..plan.feedthrough import Cycle, cycles, dependencies
from ..plan.feedthrough import components as components_of
from .stepper import ComponentFailed, Setter, Stepper, failing
from .system import System

SWEEPS = 100
TOLERANCE = 1e-10  # of a value, or of 1 where it is smaller
ITERATIONS = 50
HALVINGS = 20
DIFFERENCE = 6e-6  # the cube root of the rounding error, for central differences


class AlgebraicLoop(Exception):
    """The initial values do not settle."""


def initialize(system: System) -> list[str]:
    """Initialization mode: parameters, start values, and outputs that agree with the inputs.

    Returns warnings.  Raises ComponentFailed, or AlgebraicLoop where neither sweeps nor Newton's method find values
    that agree.
    """
    for stepper in system.steppers:
        set_up(system, stepper)
    warnings = _settle(system)
    for stepper in system.steppers:
        stepper.doing("is initialized")
        with failing(stepper):
            stepper.instance.begin()
    for stepper in system.steppers:
        read(stepper)
        stepper.check_finite()
    return warnings


def set_up(system: System, stepper: Stepper, start_time: float = 0.0) -> None:
    """Enter initialization mode at `start_time` [s] with the component's parameters and start values.

    Raises ComponentFailed.
    """
    plan, component = system.plan, stepper.component
    fits = plan.steps % component.period == 0  # else its last step ends beyond the stop time
    stop_time = plan.experiment.master.stop_time if fits else None
    stepper.doing("is set up")
    with failing(stepper):
        stepper.instance.setup(start_time, stop_time, component.tolerance, {**component.parameters, **component.start})


def _settle(system: System) -> list[str]:
    """Exchange values until they agree; returns warnings.  Raises like `initialize`."""
    loops = cycles(system.plan, initial=True)
    first = [setter.buffer.copy() for stepper in system.steppers for setter in stepper.setters]
    steppers = {stepper.component.name: stepper for stepper in system.steppers}
    for name in _schedule(system):
        exchange(steppers[name])
    for _ in range(SWEEPS):
        before = {kind: table.copy() for kind, table in system.tables.items()}
        for stepper in system.steppers:
            exchange(stepper)
        changes = _changes(system, before)
        if not changes:
            return []
    if all(abs(now - was) <= TOLERANCE * max(1.0, abs(now)) for _, was, now in changes if not isinstance(now, bytes)):
        return []
    for stepper in system.steppers:
        _check_repeats(stepper)
    buffers = [setter.buffer for stepper in system.steppers for setter in stepper.setters]
    for buffer, values in zip(buffers, first, strict=True):
        buffer[:] = values
    return _Newton(system, loops, [name for name, _, _ in changes]).solve()


def _check_repeats(stepper: Stepper) -> None:
    """Raises ComponentFailed where outputs change although the inputs do not: no values would ever agree with them."""

    def outputs() -> list[Any]:
        for call in (*stepper.sets, *stepper.gets):
            stepper.check(call())
        return [value for getter in stepper.getters for value in getter.buffer.tolist()]

    names = [variable.name for getter in stepper.getters for variable in getter.variables]
    for name, before, now in zip(names, outputs(), outputs(), strict=True):
        if now != before and now == now:
            raise ComponentFailed(
                stepper,
                f"its output {name} is {before!r}, then {now!r}, for the same inputs in initialization mode: it draws "
                "random numbers without a seed, or counts how often it is asked; a model draws from a generator of its "
                "own, np.random.default_rng(seed), that it makes in initialize",
            )


def exchange(stepper: Stepper, held: Sequence[tuple[Table, int, float]] = ()) -> None:
    """Give a component its inputs and take its outputs.  held: (buffer, place, value) in place of what is connected.

    Raises ComponentFailed.
    """
    stepper.doing("is initialized")
    for gather in stepper.gathers:
        gather()
    for buffer, place, value in held:
        buffer[place] = value
    for set_ in stepper.sets:
        stepper.check(set_())
    read(stepper)


def read(stepper: Stepper) -> None:
    """Take a component's outputs.  Raises ComponentFailed."""
    stepper.doing("is initialized")
    for get in stepper.gets:
        stepper.check(get())
    for publish in itertools.chain(*stepper.publish):
        publish()


def _schedule(system: System) -> list[str]:
    """Components in the order in which values flow, one each time that an output needs inputs that are new."""
    graph = dependencies(system.plan, initial=True)
    stale = {stepper.component.name for stepper in system.steppers}
    order = []
    for port in itertools.chain(*components_of(graph)):
        component, _ = port
        is_input = bool(graph[port]) and graph[port][0][0] != component
        if is_input:
            stale.add(component)
        elif component in stale:
            stale.discard(component)
            order.append(component)
    return order


def _changes(system: System, before: Tables) -> list[tuple[str, Any, Any]]:
    """Name, value before and value now of all that changed; nan is reported later, as an output that is not finite."""
    return [
        (name, a, b)
        for kind, table in system.tables.items()
        for name, a, b in zip(system.names[kind], before[kind].tolist(), table.tolist(), strict=True)
        if a != b and a == a
    ]


class _Newton:
    """Solves x = G(x) for the inputs within cycles, (n,): G(x) are the inputs that the outputs give when they are x."""

    def __init__(self, system: System, loops: Sequence[Cycle], changed: Sequence[str]):
        self._system, self._loops, self._changed = system, loops, changed
        ports = {port for loop in loops for port in loop.ports}
        self._places: list[tuple[Stepper, Setter, int]] = [
            (stepper, setter, place)
            for stepper in system.steppers
            for setter in stepper.setters
            if setter.kind in FLOATS
            for place, variable in enumerate(setter.variables)
            if (stepper.component.name, variable.name) in ports
        ]

    def solve(self) -> list[str]:
        if not self._places:
            raise self._failure("nothing in it is a real number to solve for")
        x = np.array([setter.buffer[place] for _, setter, place in self._places], dtype=float)
        residual = self._residual(x)
        for iteration in range(ITERATIONS):
            if (np.abs(residual) <= TOLERANCE * np.maximum(1.0, np.abs(x))).all():
                self._evaluate(x)
                return [
                    f"the initial values of {self._shown()} were found by Newton's method in {iteration} steps: "
                    "there may be other solutions"
                ]
            x, residual = self._step(x, residual)
        raise self._failure(f"a difference of {np.abs(residual).max():.3g} remains after {ITERATIONS} steps")

    def _step(self, x: Reals, residual: Reals) -> tuple[Reals, Reals]:
        try:
            direction = np.linalg.solve(self._jacobian(x), -residual)
        except np.linalg.LinAlgError:
            raise self._failure("its equations are singular") from None
        for halving in range(HALVINGS):
            moved = x + direction / 2**halving
            left = self._residual(moved)
            if np.isfinite(left).all() and np.linalg.norm(left) < np.linalg.norm(residual):
                return moved, left
        raise self._failure(f"a difference of {np.abs(residual).max():.3g} remains, and no step reduces it")

    def _jacobian(self, x: Reals) -> Reals:
        columns = []
        for i, value in enumerate(x):
            step = DIFFERENCE * max(1.0, abs(value))
            ahead, behind = x.copy(), x.copy()
            ahead[i] += step
            behind[i] -= step
            columns.append((self._residual(ahead) - self._residual(behind)) / (ahead[i] - behind[i]))
        return np.column_stack(columns)

    def _residual(self, x: Reals) -> Reals:
        """G(x) - x."""
        self._evaluate(x)
        for stepper in {id(stepper): stepper for stepper, _, _ in self._places}.values():
            for gather in stepper.gathers:
                gather()
        return np.array([setter.buffer[place] for _, setter, place in self._places], dtype=float) - x

    def _evaluate(self, x: Reals) -> None:
        """Exchange all values with those inputs held at x, until what depends on them has followed."""
        for _ in range(SWEEPS):
            before = {kind: table.copy() for kind, table in self._system.tables.items()}
            for stepper in self._system.steppers:
                held = [
                    (setter.buffer, place, value)
                    for (owner, setter, place), value in zip(self._places, x, strict=True)
                    if owner is stepper
                ]
                exchange(stepper, held)
            if not _changes(self._system, before):
                return

    def _failure(self, reason: str) -> AlgebraicLoop:
        return AlgebraicLoop(
            f"the initial values do not settle in {SWEEPS} sweeps, an algebraic loop through "
            f"{self._shown()}; {reason}; break it with a component whose output does not depend on "
            "its input at once"
        )

    def _shown(self) -> str:
        if self._loops:
            return "; ".join(map(str, self._loops))
        return ", ".join(self._changed[:12]) + (", ..." if len(self._changed) > 12 else "")
