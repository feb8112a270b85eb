"""What is made of the values of a run while it goes on: metrics, the envelope of the rows, limits that were left.

Both loops put the values of each tick into a buffer, from which the metrics are taken a block at a time.  Blocks are
counted from the first tick, not from where the loop happened to pause: the same run gives the same bits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import Places, Reals, Table
from ..fmu.variables import NUMBERS
from ..metrics import Meter
from .observer import Block, Observer
from .system import System

BLOCK = 1 << 13  # ticks
BEYOND = 1e-9  # of a limit: less is rounding


class SamplesProgram(NamedTuple):
    """What the compiled loop needs to take samples, too; see `Samples`."""

    kinds: Table  # (n,) int64, as places in NUMBERS
    places: Places  # (n,)
    values: Reals  # (n, block)
    block: int
    first: int  # tick of the run
    bounded: Places  # (m,) in the table of reals
    least: Reals  # (m,)
    largest: Reals


class Samples:
    """Samples of a run, and the metrics that are taken of them; begins with the initial values.

    The values at tick k are column (k - first) % BLOCK of the buffer; a chunk of steps ends where a block does.
    """

    def __init__(self, system: System):
        plan = system.plan
        self._system, self._first, self._done = system, plan.first, plan.first
        self._reached = plan.first
        self._names = [f"{component}.{variable.name}" for component, variable in plan.measured]
        self._kinds = np.array([NUMBERS.index(v.kind) for _, v in plan.measured], dtype=np.int64)
        self._places = np.array([system.places[c, v.name] for c, v in plan.measured], dtype=np.intp)
        self._values = np.zeros((len(self._names), BLOCK))
        self._of_kind = [
            (system.tables[kind], *(np.ascontiguousarray(a) for a in (chosen, self._places[chosen])))
            for number, kind in enumerate(NUMBERS)
            if len(chosen := (self._kinds == number).nonzero()[0])
        ]
        self._bounded = np.array([system.places[c, v.name] for c, v in plan.bounded], dtype=np.intp)
        self._least = np.full(len(self._bounded), math.inf)
        self._largest = np.full(len(self._bounded), -math.inf)
        grid = plan.experiment.grid
        self._meters = {
            name: Meter(spec, plan.units, plan.angles, grid.ticks(spec["every"]) or 1 if "every" in spec else 1)
            for name, spec in plan.experiment.metrics.items()
        }
        self.take(plan.first)

    def take(self, tick: int) -> None:
        """The values at `tick`, as they are now."""
        column = (tick - self._first) % BLOCK
        for table, chosen, places in self._of_kind:
            self._values[chosen, column] = table[places]
        if len(self._bounded):
            values = self._system.tables["real"][self._bounded]
            np.minimum(self._least, values, out=self._least)
            np.maximum(self._largest, values, out=self._largest)

    def close_bounds(self) -> Reals:
        """(2, m): the least and the largest of each bounded signal since the last call."""
        bounds = np.array([self._least, self._largest])
        self._least.fill(math.inf)
        self._largest.fill(-math.inf)
        return bounds

    def empty(self, n: int) -> Reals:
        """Room for the bounds of n rows."""
        return np.empty((n, 2, len(self._bounded)))

    def limit(self, tick: int, last: int) -> int:
        """Where a chunk of steps from `tick` ends that would go on to `last`: at the end of a block."""
        if not self._names:
            return last
        return min(last, self._first + ((tick + 1 - self._first) // BLOCK + 1) * BLOCK - 1)

    def evaluate(self, tick: int) -> None:
        """All steps until `tick` are done."""
        self._reached = tick
        if (tick + 1 - self._first) % BLOCK == 0:
            self._update()

    def results(self) -> dict[str, float]:
        """The metrics of the steps that are done."""
        self._update()
        return {name: meter.result() for name, meter in self._meters.items()}

    def warnings(self) -> list[str]:
        """Messages on metrics that have no value although there are samples."""
        return [f"metrics.{name} {text}" for name, meter in self._meters.items() if (text := meter.warning())]

    def program(self) -> SamplesProgram:
        return SamplesProgram(
            kinds=self._kinds,
            places=self._places,
            values=self._values,
            block=BLOCK,
            first=self._first,
            bounded=self._bounded,
            least=self._least,
            largest=self._largest,
        )

    def _update(self) -> None:
        """Take the metrics of what has come since the last time."""
        n = self._reached + 1 - self._done
        if not self._names or n <= 0:
            return
        time = self._system.plan.experiment.grid.times(self._done, self._done + n)
        samples = dict(zip(self._names, self._values[:, :n], strict=True))
        for meter in self._meters.values():
            meter.update(self._done, time, samples)
        self._done += n


class Limits(Observer):
    """Watches what a model is valid for: every recorded real output in every row, against its own min and max and those
    of the inputs that it drives.

    A start value and a parameter are looked at by the plan.
    """

    def __init__(self, system: System):
        plan = system.plan
        self._grid = plan.experiment.grid
        limits = {(c, v.name): [(v.limits, f"{c}.{v.name}", 1.0, 0.0)] for c, v in plan.recorded if v.kind == "real"}
        for k in plan.connections:
            if (k.source, k.output.name) in limits:
                entry = k.input.limits, f"{k.sink}.{k.input.name}", k.factor, k.offset
                limits[k.source, k.output.name].append(entry)
        self._watched: list[tuple[int, str, str, float, float]] = []  # column, signal, whose limit, factor, offset
        low, high = [], []
        for column, (port, entries) in enumerate(limits.items()):
            seen = set()
            for (least, largest), owner, factor, offset in entries:
                bounds = least, largest, factor, offset
                if bounds not in seen and (math.isfinite(least) or math.isfinite(largest)):
                    seen.add(bounds)
                    self._watched.append((column, ".".join(port), owner, factor, offset))
                    low.append(least - BEYOND * abs(least) if math.isfinite(least) else least)
                    high.append(largest + BEYOND * abs(largest) if math.isfinite(largest) else largest)
        self._low, self._high = np.array(low), np.array(high)
        self._columns = np.array([entry[0] for entry in self._watched], dtype=np.intp)
        self._factors = np.array([entry[3] for entry in self._watched])
        self._offsets = np.array([entry[4] for entry in self._watched])
        self._first: dict[int, tuple[int, float]] = {}  # {place in _watched: tick and value}
        self._farthest: dict[int, float] = {}

    def rows(self, block: Block) -> None:
        if not self._watched:
            return
        values = block.values["real"][:, self._columns] * self._factors + self._offsets
        least, largest = values.min(axis=0), values.max(axis=0)
        for i in np.flatnonzero((least < self._low) | (largest > self._high)):
            column = values[:, i]
            row = int(np.flatnonzero((column < self._low[i]) | (column > self._high[i]))[0])
            self._first.setdefault(int(i), (block.ticks[row], float(column[row])))
            low, high = float(self._low[i]), float(self._high[i])
            ends = (self._farthest.get(int(i), float(column[row])), float(least[i]), float(largest[i]))
            self._farthest[int(i)] = max((max(low - end, end - high), end) for end in ends)[1]

    def warnings(self) -> list[str]:
        """A sentence for each limit that was left."""
        sentences: list[str] = []
        for i, (tick, value) in sorted(self._first.items()):
            _, signal, owner, _, _ = self._watched[i]
            which, limit = ("min", self._low[i]) if value < self._low[i] else ("max", self._high[i])
            at = "" if owner == signal else f" of {owner}"
            time = self._grid.time(tick)
            sentences.append(
                f"{signal} = {value:.6g} at t = {time:.10g} s is beyond {limit:.6g}, the {which}{at} that its FMU "
                f"declares, and {self._farthest[i]:.6g} at its farthest: the model is not valid there"
            )
        return sentences
