"""The inner loop, twice: compiled, and in Python where that one is not built.  Both give the same rows, bit for bit.

What acts when is told in `master`.
"""

from __future__ import annotations

import ctypes
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np

from ..fmu.variables import FLOATS, NUMBERS, OBJECTS, Variable
from ..instances.instance import Verb, references_of
from .chatter import Alternations
from .observer import Block, Interrupt
from .stepper import AT_ONCE, PERIOD_END, TICK_END, Action, Conversion, Stepper
from .system import System
from .timing import EVERY, Timing

NOT_FINITE = -1  # beside the statuses of FMI


class Loop(Protocol):
    """Steps a system.  `ticks`: how many steps are done; `name`: how a record tells the loops apart."""

    name: str
    ticks: int

    def advance(self, last: int, patience: float) -> None:
        """Step until tick `last`, for about `patience` seconds, or until interrupted.

        Raises ComponentFailed; `ticks` then names the start of the failed step.
        """

    def complete(self, first: int) -> None:
        """Finish a tick in which the member number `first` has stepped, and nothing was done with that.

        Raises ComponentFailed.
        """

    def take(self) -> list[Block]:
        """The rows since the last call."""


def choose(system: System, alternations: Alternations, timing: Timing, interrupt: Interrupt) -> Loop:
    """The compiled loop, where it is built and every value is a number; ORCH_LOOP=python asks for the other one."""
    compiled = extension()
    objects = any(system.computed[k] < len(system.tables[k]) or len(system.recorded[k]) for k in OBJECTS)
    kind = InterpretedLoop if compiled is None or objects else CompiledLoop
    return kind(system, alternations, timing, interrupt)


def extension() -> Any:
    """The compiled module, or None."""
    if os.environ.get("ORCH_LOOP") == "python":
        return None
    try:
        from . import _loop  # type: ignore[attr-defined]  # of C, where it is built
    except ImportError:
        return None
    return _loop


class _Completing:
    """How both loops finish a tick that a component ends the simulation with."""

    ticks: int
    _system: System
    _rows: _Rows

    def complete(self, first: int) -> None:
        k, grid = self.ticks, self._system.plan.experiment.grid
        for number, stepper in enumerate(self._system.steppers[first:], first):
            if k % stepper.component.period:
                continue
            if number > first:
                for gather in stepper.gathers:
                    gather()
                sets, _ = _calls(stepper)
                calls: list[Action] = [*sets, partial(stepper.step, ctypes.c_double(grid.time(k)))]
                for call in calls:
                    stepper.check(call())
            for get in stepper.gets:  # of a batched one, too: its step has ended before it came to them
                stepper.check(get())
            stepper.check_finite()
            for publish in stepper.publish[AT_ONCE]:
                publish()
        for stepper in self._system.steppers:
            if k % stepper.component.period == 0:
                for publish in stepper.publish[TICK_END]:
                    publish()
            if (k + 1) % stepper.component.period == 0:
                for publish in stepper.publish[PERIOD_END]:
                    publish()
        self.ticks = k + 1
        if self.ticks % self._system.plan.stride == 0:
            self._rows.add(self.ticks)


class InterpretedLoop(_Completing):
    name = "python"

    def __init__(self, system: System, alternations: Alternations, timing: Timing, interrupt: Interrupt):
        self.ticks = system.plan.first
        self._system, self._alternations, self._timing, self._interrupt = system, alternations, timing, interrupt
        self._members = [
            (number, stepper, stepper.component.period, *_calls(stepper), _sums_of_squares(stepper, system))
            for number, stepper in enumerate(system.steppers)
        ]
        self._ending = [
            (m, m.component.period) for m in system.steppers if m.publish[TICK_END] or m.publish[PERIOD_END]
        ]
        self._checked = [system.tables[kind][:n] for kind in FLOATS if (n := system.computed[kind])]
        self._rows = _Rows(system)
        self.take = self._rows.take

    def advance(self, last: int, patience: float) -> None:
        grid, stride = self._system.plan.experiment.grid, self._system.plan.stride
        clock, flag, checked = time.perf_counter, self._interrupt.flag, self._checked
        deadline = clock() + patience
        for k in range(self.ticks, last):
            timed = k % EVERY == 0
            if flag[0] or (timed and clock() > deadline):
                return
            t = ctypes.c_double(grid.time(k))
            for number, stepper, period, sets, gets, sums_of_squares in self._members:
                if period > 1 and k % period:
                    continue
                marks = [clock()] if timed else None
                for gather in stepper.gathers:
                    gather()
                for set_ in sets:
                    if (status := set_()) != 0:
                        stepper.check(status)
                if marks:
                    marks.append(clock())
                if (status := stepper.step(t)) != 0:
                    stepper.check(status)
                if marks:
                    marks.append(clock())
                for get in gets:
                    if (status := get()) != 0:
                        stepper.check(status)
                for sum_of_squares in sums_of_squares:
                    if not math.isfinite(sum_of_squares()):
                        stepper.check_finite()
                for publish in stepper.publish[AT_ONCE]:
                    publish()
                if marks:
                    self._timing.add(number, [*marks, clock()])
            for stepper, period in self._ending:
                if k % period == 0:
                    for publish in stepper.publish[TICK_END]:
                        publish()
                if (k + 1) % period == 0:
                    for publish in stepper.publish[PERIOD_END]:
                        publish()
            for values in checked:
                if not math.isfinite(values.dot(values)):
                    for stepper in self._system.steppers:
                        stepper.check_finite()
            self.ticks = k + 1
            self._alternations.look(self.ticks)
            if self.ticks % stride == 0:
                self._rows.add(self.ticks)


class CompiledLoop(_Completing):
    """Drives `_loop.c`."""

    name = "compiled"

    def __init__(self, system: System, alternations: Alternations, timing: Timing, interrupt: Interrupt):
        self.ticks = system.plan.first
        self._system = system
        self._rows = _Rows(system)
        self.take = self._rows.take
        # Python FMUs take the interpreter's lock at each call: that costs more than holding it.
        holds_lock = any(m.instance.batched or m.component.fmu.packaging == "python" for m in system.steppers)
        self._loop = extension().Loop(
            [_program(stepper) for stepper in system.steppers],
            tuple(system.tables[kind] for kind in NUMBERS),
            tuple(system.computed[kind] for kind in FLOATS),
            tuple(system.recorded[kind] for kind in NUMBERS),
            alternations.arrays(),
            (timing.seconds, timing.samples, EVERY),
            interrupt.flag,
            system.plan.stride,
            holds_lock,
            system.plan.experiment.record.inputs,
        )

    def advance(self, last: int, patience: float) -> None:
        first, stride = self.ticks, self._system.plan.stride
        ticks = range(first - first % stride + stride, last + 1, stride)
        rows = self._rows.empty(len(ticks))
        times = self._system.plan.experiment.grid.times(first, last)
        self.ticks, failed, status = self._loop.advance(first, last, times, patience, tuple(rows.values()))
        self._rows.extend(ticks[: self.ticks // stride - first // stride], rows)
        if failed >= 0:
            stepper = self._system.steppers[failed]
            if status == NOT_FINITE:
                stepper.check_finite()
            stepper.check(status)


def _program(stepper: Stepper) -> tuple[Any, ...]:
    """A component as `_loop.c` takes it."""
    instance = stepper.instance

    def call(verb: Verb, kind: str, variables: list[Variable], buffer: Any) -> tuple[Any, ...]:
        return NUMBERS.index(kind), instance.address(verb, kind), references_of(variables), buffer

    sets = [
        (*call("Set", i.kind, i.variables, i.buffer), (i.sources, i.targets), _conversions(i.conversions))
        for i in stepper.inputs
    ]
    gets = [(*call("Get", o.kind, o.variables, o.buffer), None, None) for o in stepper.outputs]
    published = tuple(
        [(NUMBERS.index(p.kind), p.buffer, p.chosen, p.targets) for p in stepper.publications if p.moment == moment]
        for moment in (AT_ONCE, TICK_END, PERIOD_END)
    )
    return (*instance.step_function(), stepper.h, stepper.component.period, sets, gets, published)


def _conversions(conversions: Sequence[Conversion]) -> Any:
    """As `_loop.c` has them in a struct; None where there are none."""
    rows = [(NUMBERS.index(c.kind), c.source, c.target, c.factor, c.offset) for c in conversions]
    return np.array(rows, dtype="i8,i8,i8,f8,f8") if rows else None


class _Rows:
    """Gathers rows until somebody takes them; begins with the initial values."""

    def __init__(self, system: System):
        self._system = system
        self._kinds = [kind for kind in system.recorded if len(system.recorded[kind])]
        self._blocks: list[Block] = []
        self._clear()
        self.add(system.plan.first)

    def _clear(self) -> None:
        self._ticks: list[int] = []
        self._values: dict[str, list[Any]] = {kind: [] for kind in self._kinds}

    def add(self, tick: int) -> None:
        """A row of the present values."""
        self._ticks.append(tick)
        for kind, rows in self._values.items():
            rows.append(self._system.tables[kind][self._system.recorded[kind]])

    def empty(self, n: int) -> dict[str, Any]:
        """Room for n rows of numbers."""
        recorded, tables = self._system.recorded, self._system.tables
        return {kind: np.empty((n, len(recorded[kind])), tables[kind].dtype) for kind in NUMBERS}

    def extend(self, ticks: Sequence[int], rows: Mapping[str, Any]) -> None:
        """The first of `rows`, one for each of `ticks`."""
        if ticks:
            self._flush()
            self._blocks.append(Block(ticks, {kind: rows[kind][: len(ticks)] for kind in self._kinds}))

    def take(self) -> list[Block]:
        self._flush()
        blocks, self._blocks = self._blocks, []
        return blocks

    def _flush(self) -> None:
        if self._ticks:
            self._blocks.append(
                Block(tuple(self._ticks), {kind: np.array(rows) for kind, rows in self._values.items()})
            )
            self._clear()


def _calls(stepper: Stepper) -> tuple[list[Action], list[Action]]:
    """The setters and getters that the loop calls itself."""
    return ([], []) if stepper.instance.batched else (stepper.sets, stepper.gets)


def _sums_of_squares(stepper: Stepper, system: System) -> list[Callable[[], Any]]:
    """Of floats that do not lie in the table yet when the component has stepped: not finite where one is not."""
    tables = [system.tables[kind] for kind in FLOATS]
    buffers = [buffer for _, buffer in stepper.floats]
    return [partial(b.dot, b) for b in buffers if not any(np.shares_memory(b, table) for table in tables)]
