"""What is made of the values of a run while it goes on: metrics, the envelope of the rows, limits that were left.

Both loops put the values of each tick into a buffer, from which the metrics are taken a block at a time.  Blocks are
counted from the first tick, not from where the loop happened to pause: the same run gives the same bits.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..arrays import Places, Reals, Table, aligned
from ..fmu.variables import NUMBERS
from ..metrics import Meter
from ..plan.limits import Limit, Reference, limits_of, references_of
from ..warning import Kind, Warned
from .system import System

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

BLOCK = 1 << 13  # ticks
ROOM = 2 * BLOCK  # ticks: while the loop fills one block, the metrics of the other are taken
STRIDE = ROOM + 8  # from signal to signal in the buffer: powers of two would share the lines of a cache
LIMIT = np.dtype([("kind", "i8"), ("place", "i8"), ("low", "f8"), ("high", "f8")])  # kind: its place in NUMBERS
ANGLE = np.dtype([("place", "i8"), ("turn", "f8"), ("before", "f8")])


class SamplesProgram(NamedTuple):
    """What the compiled loop needs to take samples, too; see `Samples`."""

    kinds: Table  # (n,) int64, as places in NUMBERS
    places: Places  # (n,)
    values: Reals  # (n, stride)
    stride: int
    block: int
    first: int  # tick of the run
    bounded: Places  # (m,) in the table of reals
    least: Reals  # (reals,)
    largest: Reals


class WatchedProgram(NamedTuple):
    """What the compiled loop needs to watch, too; see `Limits`."""

    limits: Table  # (n,) of LIMIT, those of reals first
    angles: Table  # (m,) of ANGLE, in the table of reals
    ticks: Table  # (n + m,) int64
    first: Reals  # (n + m,)
    farthest: Reals  # (n,)


class Samples:
    """Samples of a run, and the metrics that are taken of them; begins with the initial values.

    The values at tick k are column (k - first) % ROOM of the buffer; a chunk of steps ends where a block does.
    """

    def __init__(self, system: System):
        plan = system.plan
        self._system, self._first, self._done = system, plan.first, plan.first
        self._reached = plan.first
        self._pool: ThreadPoolExecutor | None = None
        self._block: Future[None] | None = None
        self._names = [f"{component}.{variable.name}" for component, variable in plan.measured]
        self._kinds = np.array([NUMBERS.index(v.kind) for _, v in plan.measured], dtype=np.int64)
        self._places = np.array([system.places[c, v.name] for c, v in plan.measured], dtype=np.intp)
        self._values = np.zeros((len(self._names), STRIDE))
        self._of_kind = [
            (system.tables[kind], *(np.ascontiguousarray(a) for a in (chosen, self._places[chosen])))
            for number, kind in enumerate(NUMBERS)
            if len(chosen := (self._kinds == number).nonzero()[0])
        ]
        self._bounded = np.array([system.places[c, v.name] for c, v in plan.bounded], dtype=np.intp)
        self._reals = system.tables["real"]
        self._least = aligned(len(self._reals), math.inf)
        self._largest = aligned(len(self._reals), -math.inf)
        grid = plan.experiment.grid
        self._meters = {
            name: Meter(spec, plan.units, plan.angles, grid.ticks(spec["every"]) or 1 if "every" in spec else 1)
            for name, spec in plan.experiment.metrics.items()
        }
        self.take(plan.first)

    def take(self, tick: int) -> None:
        """The values at `tick`, as they are now."""
        column = (tick - self._first) % ROOM
        for table, chosen, places in self._of_kind:
            self._values[chosen, column] = table[places]
        if len(self._bounded):
            np.copyto(self._least, self._reals, where=self._reals < self._least)
            np.copyto(self._largest, self._reals, where=self._reals > self._largest)

    def close_bounds(self) -> Reals:
        """(2, m): the least and the largest of each bounded signal since the last call."""
        bounds = np.array([self._least[self._bounded], self._largest[self._bounded]])
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
        if self._names and (tick + 1 - self._first) % BLOCK == 0:
            self._begin(tick)

    def results(self) -> dict[str, float]:
        """The metrics of the steps that are done; the run has ended."""
        self._end()
        if self._pool is not None:
            self._pool.shutdown()
        self._update(self._reached)
        return {name: meter.result() for name, meter in self._meters.items()}

    def warnings(self) -> list[str]:
        """Messages on metrics that have no value although there are samples."""
        return [f"metrics.{name} {text}" for name, meter in self._meters.items() if (text := meter.warning())]

    def program(self) -> SamplesProgram:
        return SamplesProgram(
            kinds=self._kinds,
            places=self._places,
            values=self._values,
            stride=STRIDE,
            block=ROOM,
            first=self._first,
            bounded=self._bounded,
            least=self._least,
            largest=self._largest,
        )

    def _begin(self, reached: int) -> None:
        """Take the metrics of a block that ends with this tick, beside the loop, which fills the other one."""
        if self._pool is None:
            from concurrent.futures import ThreadPoolExecutor  # most runs have less than a block

            self._pool = ThreadPoolExecutor(1)
        self._end()
        self._block = self._pool.submit(self._update, reached)

    def _end(self) -> None:
        """Wait until the metrics of the last block are taken."""
        if self._block is not None:
            self._block.result()
            self._block = None

    def _update(self, reached: int) -> None:
        """Take the metrics of what has come since the last time, until this tick."""
        n = reached + 1 - self._done
        if not self._names or n <= 0:
            return
        time = self._system.plan.experiment.grid.times(self._done, self._done + n)
        column = (self._done - self._first) % ROOM
        samples = dict(zip(self._names, self._values[:, column : column + n], strict=True))
        for meter in self._meters.values():
            meter.update(self._done, time, samples)
        self._done += n


class Limits:
    """Watches in every step what `plan.limits` names; begins with the initial values.

    There are n limits and m references.  `ticks`: when a value first left its limits, or jumped; -1 before that.
    `first`: the value then, or the jump; `farthest`: the value that was farthest beyond.
    """

    def __init__(self, system: System):
        plan = system.plan
        self._grid, self._reals = plan.experiment.grid, system.tables["real"]
        self._limits = sorted(limits_of(plan), key=lambda limit: NUMBERS.index(limit.kind))
        self._references = list(references_of(plan))
        n, m = len(self._limits), len(self._references)
        rows = [(NUMBERS.index(of.kind), system.places[of.output], *of.range) for of in self._limits]
        self._bounds = np.array(rows, LIMIT)
        self._of_kind = [
            (system.tables[kind], chosen, self._bounds["place"][chosen])
            for number, kind in enumerate(NUMBERS)
            if len(chosen := np.flatnonzero(self._bounds["kind"] == number))
        ]
        places = [system.places[of.output] for of in self._references]
        turns = [(place, of.turn, self._reals[place]) for place, of in zip(places, self._references, strict=True)]
        self._angles = np.array(turns, ANGLE)
        self._now = np.zeros(n)
        self._ticks = np.full(n + m, -1, dtype=np.int64)
        self._first, self._farthest = np.zeros(n + m), np.zeros(n)
        self.look(plan.first)

    def look(self, tick: int) -> None:
        """The values at `tick`, as they are now."""
        n, values = len(self._limits), self._now
        low, high = self._bounds["low"], self._bounds["high"]
        for table, chosen, places in self._of_kind:
            values[chosen] = table[places]
        for i in np.flatnonzero((values < low) | (values > high)).tolist():
            if self._ticks[i] < 0:
                self._ticks[i], self._first[i], self._farthest[i] = tick, values[i], values[i]
            elif _beyond(values[i], low[i], high[i]) > _beyond(self._farthest[i], low[i], high[i]):
                self._farthest[i] = values[i]
        now = self._reals[self._angles["place"]]
        jumps = now - self._angles["before"]
        for j in np.flatnonzero((abs(jumps) > self._angles["turn"]) & (self._ticks[n:] < 0)).tolist():
            self._ticks[n + j], self._first[n + j] = tick, jumps[j]
        self._angles["before"] = now

    def program(self) -> WatchedProgram:
        return WatchedProgram(self._bounds, self._angles, self._ticks, self._first, self._farthest)

    def warnings(self) -> list[Warned]:
        """A message for each limit that was left, and a note for each reference that jumped."""
        n = len(self._limits)
        return [
            *(self._left(i, limit) for i, limit in enumerate(self._limits) if self._ticks[i] >= 0),
            *(self._jumped(n + j, of) for j, of in enumerate(self._references) if self._ticks[n + j] >= 0),
        ]

    def _left(self, i: int, limit: Limit) -> Warned:
        value, farthest = (limit.factor * float(of[i]) + limit.offset for of in (self._first, self._farthest))
        low, high = limit.bounds
        side, bound, which = ("below", low, "min") if value < low else ("above", high, "max")
        unit = f" {limit.unit}" if limit.unit not in ("", "1") else ""
        output = ".".join(limit.output)
        source = "" if output == limit.variable else f", driven by {output},"
        text = (
            f"{limit.variable}{source} is {value:.6g}{unit} at t = {self._time(i)} s, {side} {bound:.6g}, the {which} "
            f"that its FMU declares, and {farthest:.6g} at its farthest: the model is not valid there"
        )
        return Warned(text, Kind.LIMIT)

    def _jumped(self, i: int, reference: Reference) -> Warned:
        text = (
            f"{'.'.join(reference.output)} jumps by {self._first[i]:.6g} {reference.unit} at t = {self._time(i)} s, by "
            "more than half a turn: the shipped controllers take the short way round, a controller that subtracts "
            "angles as numbers turns back"
        )
        return Warned(text, Kind.JUMP)

    def _time(self, i: int) -> str:
        return f"{self._grid.time(int(self._ticks[i])):.10g}"


def _beyond(value: float, low: float, high: float) -> float:
    return max(low - value, value - high)
