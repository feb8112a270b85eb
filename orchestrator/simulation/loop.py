"""The inner loop, twice: compiled, and in Python where that one is not built.  Both give the same rows, bit for bit.

`master` describes what acts when.
"""

from __future__ import annotations

import ctypes
import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Reals, Table, Tables
from ..fmu.variables import FLOATS, NUMBERS, OBJECTS
from ..instances.instance import Call
from ..watch import Interrupt, stepping
from .bursts import Bursts
from .observer import Block
from .program import NOT_FINITE, layout, program_of
from .sampling import Limits, Samples
from .stepper import AT_ONCE, EVERY, PERIOD_END, TICK_END, Stepper, Timing
from .system import System

if TYPE_CHECKING:
    from . import _loop


class Loop(ABC):
    """Steps a system.  `ticks`: how many steps are done; `name`: how a record tells the loops apart."""

    name: str

    def __init__(self, system: System, samples: Samples, limits: Limits):
        self.ticks = system.plan.first
        self._system, self._samples, self._rows = system, samples, _Rows(system, samples)
        self._limits = limits
        names = [stepper.component.name for stepper in system.steppers]
        self._place = stepping(names, system.plan.experiment.master.step)

    @abstractmethod
    def advance(self, last: int, patience: float) -> None:
        """Step until tick `last`, for about `patience` seconds, or until interrupted.

        Raises ComponentFailed; `ticks` is then the start of the failed step.
        """

    @abstractmethod
    def halt(self) -> None:
        """Take what is known of steps that are done while `advance` never returns."""

    def take(self) -> list[Block]:
        """The rows since the last call."""
        return self._rows.take()

    def complete(self, first: int) -> None:
        """Finish a tick in which component number `first` has stepped, and nothing has been done with its results.

        Raises ComponentFailed.
        """
        k, grid = self.ticks, self._system.plan.experiment.grid
        for number, stepper in enumerate(self._system.steppers[first:], first):
            if k % stepper.component.period:
                continue
            if number > first:
                for gather in stepper.gathers:
                    gather()
                sets, _ = _calls(stepper)
                calls: list[Call] = [*sets, partial(stepper.step, ctypes.c_double(grid.time(k)))]
                for call in calls:
                    stepper.check(call())
            for get in stepper.gets:  # of a batched one, too: its step ended before its getters
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
        self._samples.take(self.ticks)
        self._limits.look(self.ticks)
        if self.ticks % self._system.plan.stride == 0:
            self._rows.add(self.ticks)


def choose(
    system: System, bursts: Bursts, samples: Samples, limits: Limits, timing: Timing, interrupt: Interrupt
) -> Loop:
    """The compiled loop, where it is built and every value is a number; ORCH_LOOP=python asks for the other one."""
    loop = compiled()
    objects = any(system.computed[k] < len(system.tables[k]) or len(system.recorded[k]) for k in OBJECTS)
    if loop is None or objects:
        return InterpretedLoop(system, bursts, samples, limits, timing, interrupt)
    return CompiledLoop(loop, system, bursts, samples, limits, timing, interrupt)


def compiled() -> type[_loop.Loop] | None:
    """What CompiledLoop drives; None where it is not built, out of date, or not wanted."""
    extension = _extension()
    if extension is None or out_of_date() or os.environ.get("ORCH_LOOP") == "python":
        return None
    loop: type[_loop.Loop] = extension.Loop
    return loop


def out_of_date() -> str:
    """A message where the compiled loop was built from other sources than this, or ""."""
    extension = _extension()
    if extension is None or getattr(extension, "LAYOUT", None) == layout():
        return ""
    return (
        f"the compiled loop ({extension.__file__}) was built from other sources than this orch: runs take the loop in "
        "Python, which gives the same rows more slowly; install orch again (pip install -e ., or make install)"
    )


def _extension() -> ModuleType | None:
    """The module that `_loop.c` becomes, whatever it was built from."""
    try:
        from . import _loop
    except ImportError:
        return None
    return _loop


class InterpretedLoop(Loop):
    name = "python"

    def __init__(
        self,
        system: System,
        bursts: Bursts,
        samples: Samples,
        limits: Limits,
        timing: Timing,
        interrupt: Interrupt,
    ):
        super().__init__(system, samples, limits)
        self._bursts, self._timing, self._interrupt = bursts, timing, interrupt
        self._steppers = [
            (number, stepper, stepper.component.period, *_calls(stepper), _sums_of_squares(stepper, system))
            for number, stepper in enumerate(system.steppers)
        ]
        self._ending = [
            (s, s.component.period) for s in system.steppers if s.publish[TICK_END] or s.publish[PERIOD_END]
        ]
        self._checked = [system.tables[kind][:n] for kind in FLOATS if (n := system.computed[kind])]

    def advance(self, last: int, patience: float) -> None:
        try:
            self._advance(last, patience)
        finally:
            self._place[0] = 0

    def halt(self) -> None:
        """Nothing is left: `ticks` and rows are those of the steps that are done."""

    def _advance(self, last: int, patience: float) -> None:
        grid, stride = self._system.plan.experiment.grid, self._system.plan.stride
        clock, flag, checked = time.perf_counter, self._interrupt.flag, self._checked
        place, components = memoryview(self._place.data), len(self._steppers)
        deadline = clock() + patience
        for k in range(self.ticks, last):
            timed = k % EVERY == 0
            if flag[0] or (timed and clock() > deadline):
                return
            t = ctypes.c_double(grid.time(k))
            for number, stepper, period, sets, gets, sums_of_squares in self._steppers:
                if period > 1 and k % period:
                    continue
                place[0] = k * components + number + 1
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
            self._bursts.look(self.ticks)
            self._samples.take(self.ticks)
            self._limits.look(self.ticks)
            if self.ticks % stride == 0:
                self._rows.add(self.ticks)


class CompiledLoop(Loop):
    """Drives `_loop.c`."""

    name = "compiled"

    def __init__(
        self,
        loop: type[_loop.Loop],
        system: System,
        bursts: Bursts,
        samples: Samples,
        limits: Limits,
        timing: Timing,
        interrupt: Interrupt,
    ):
        super().__init__(system, samples, limits)
        self._loop = loop(program_of(system, bursts, samples, limits, timing, interrupt, self._place))
        self._chunk: tuple[int, Tables, Reals] = self.ticks, {}, np.empty(0)

    def advance(self, last: int, patience: float) -> None:
        first, stride = self.ticks, self._system.plan.stride
        n = last // stride - first // stride
        rows, bounds = self._rows.empty(n), self._samples.empty(n)
        times = self._system.plan.experiment.grid.times(first, last)
        self._chunk = first, rows, bounds
        try:
            ticks, failed, status = self._loop.advance(first, last, times, patience, tuple(rows.values()), bounds)
        finally:
            self._place[0] = 0
        self._complete(ticks)
        if failed >= 0:
            stepper = self._system.steppers[failed]
            if status == NOT_FINITE:
                stepper.check_finite()
            stepper.check(status)

    def halt(self) -> None:
        if place := int(self._place[0]):
            self._complete((place - 1) // len(self._system.steppers))

    def _complete(self, tick: int) -> None:
        """All steps of the chunk until `tick` are done."""
        (first, rows, bounds), stride = self._chunk, self._system.plan.stride
        self.ticks = tick
        self._rows.extend(range(first - first % stride + stride, tick + 1, stride), rows, bounds)


class _Rows:
    """Gathers rows until they are taken; begins with the initial values."""

    def __init__(self, system: System, samples: Samples):
        self._system, self._samples = system, samples
        self._kinds = [kind for kind in system.recorded if len(system.recorded[kind])]
        self._blocks: list[Block] = []
        self._clear()
        self.add(system.plan.first)

    def _clear(self) -> None:
        self._ticks: list[int] = []
        self._bounds: list[Reals] = []
        self._values: dict[str, list[Table]] = {kind: [] for kind in self._kinds}

    def add(self, tick: int) -> None:
        """A row of the current values."""
        self._ticks.append(tick)
        self._bounds.append(self._samples.close_bounds())
        for kind, rows in self._values.items():
            rows.append(self._system.tables[kind][self._system.recorded[kind]])

    def empty(self, n: int) -> Tables:
        """Room for n rows of numbers."""
        recorded, tables = self._system.recorded, self._system.tables
        return {kind: np.empty((n, len(recorded[kind])), tables[kind].dtype) for kind in NUMBERS}

    def extend(self, ticks: Sequence[int], rows: Mapping[str, Table], bounds: Reals) -> None:
        """The first of `rows` and `bounds`, one for each of `ticks`."""
        if ticks:
            self._flush()
            values = {kind: rows[kind][: len(ticks)] for kind in self._kinds}
            self._blocks.append(Block(ticks, values, bounds[: len(ticks)]))

    def take(self) -> list[Block]:
        self._flush()
        blocks, self._blocks = self._blocks, []
        return blocks

    def _flush(self) -> None:
        if self._ticks:
            values = {kind: np.array(rows) for kind, rows in self._values.items()}
            self._blocks.append(Block(tuple(self._ticks), values, np.array(self._bounds)))
            self._clear()


def _calls(stepper: Stepper) -> tuple[list[Call], list[Call]]:
    """The setters and getters that the loop calls itself."""
    return ([], []) if stepper.instance.batched else (stepper.sets, stepper.gets)


def _sums_of_squares(stepper: Stepper, system: System) -> list[Callable[[], Any]]:
    """Of floats that are not yet in the table when the component has stepped: not finite where one of them is not."""
    tables = [system.tables[kind] for kind in FLOATS]
    buffers = [getter.buffer for getter in stepper.getters if getter.kind in FLOATS]
    return [partial(b.dot, b) for b in buffers if not any(np.shares_memory(b, table) for table in tables)]
