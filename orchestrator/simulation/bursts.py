"""What feedback loops do at their own pace: bursts of consecutive values of every output that is fed back.

Rows of a record may be a hundred steps apart and hide what happens from step to step.  A burst is LENGTH consecutive
steps of a component; bursts lie side by side at first and ever further apart later, so that a run that ends early has
been looked at as closely as a long one, and looking costs little.  `stability` judges them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import Places, Reals, Table, aligned
from ..fmu.variables import FLOATS, NUMBERS, WHOLE, Variable
from ..plan.feedthrough import components as strongly_connected
from ..plan.plan import Plan
from .system import System

LENGTH = 256  # steps of a burst: four periods of the slowest oscillation that is looked for, see stability.LONGEST
FEWEST = 32  # bursts of a long run, about
MEMORY = 1 << 26  # bytes that all bursts may take


class ClockProgram(NamedTuple):
    """What the compiled loop needs of a Clock."""

    ticks: Table  # int64
    chosen: Places
    values: Reals
    done: Table  # (1,) int64


class BurstsProgram(NamedTuple):
    """What the compiled loop needs of Bursts."""

    kinds: Places
    places: Places
    squares: Reals
    squares_of_others: Reals
    clocks: list[ClockProgram]


@dataclass(frozen=True)
class FedBack:
    """An output on a way back to its own component.

    loop: number of the loop, which is all components that are connected in circles with each other.  place: in the
    table of its kind.  period: ticks of its component.  command: whether it depends at once on inputs of other units
    only, as a force on a position: no state, and no measurement of one.
    """

    component: str
    variable: Variable
    loop: int
    place: int
    period: int
    command: bool

    @property
    def name(self) -> str:
        return f"{self.component}.{self.variable.name}"


@dataclass
class Clock:
    """Bursts of what is sampled every `period` ticks.

    starts: (bursts,) ticks after which they begin; length: samples of one.  chosen: (n,) which of Bursts.outputs.
    values: (bursts * length, n).  ticks: when they are taken.  done: how many of them have been.
    """

    period: int
    starts: Table
    length: int
    chosen: Places
    steps: int  # tick at which the run is to end

    def __post_init__(self) -> None:
        taken = self.starts[:, np.newaxis] + self.period * np.arange(1, self.length + 1)
        self.ticks = taken[taken <= self.steps].astype(np.int64)  # only the last burst may be cut off
        self.values = np.empty((len(self.ticks), len(self.chosen)))
        self.done = np.zeros(1, dtype=np.int64)

    @property
    def bursts(self) -> Reals:
        """(bursts, length, n): those that are whole; of a run that is shorter than one, what there is."""
        done = int(self.done[0])
        length = min(done, self.length)
        whole = done // length if length else 0
        return self.values[: whole * length].reshape(whole, length, len(self.chosen))


class Bursts:
    """outputs: all that are fed back.  clocks: at least one for each period of a loop.

    Sums of squares go over the ticks from `first` to `last`, which the master sets at the end.
    """

    def __init__(self, system: System, like: Bursts | None = None, factor: int = 1, kept: bool = False):
        """like: those of a run to compare with, whose steps are `factor` times as long; kept: but for the periods of
        components that have one of their own.  The bursts cover the same time."""
        plan, tables = system.plan, system.tables
        self.outputs = sorted(fed_back(plan, system), key=lambda o: (NUMBERS.index(o.variable.kind), o.place))
        self._tables = [(tables[kind], where, places) for kind, where, places in self._by_kind()]
        self.first = self.last = plan.first
        self._reals = tables["real"]
        self._now = np.zeros(len(self.outputs))
        self._n_real = sum(output.variable.kind == "real" for output in self.outputs)
        self._squares = aligned(len(self._reals))  # in the places of the table
        self._squares_of_others = np.zeros(len(self.outputs) - self._n_real)
        self.clocks = self._like(like, factor, kept, plan) if like else self._own(plan)

    def _own(self, plan: Plan) -> list[Clock]:
        loops: dict[int, set[int]] = {}
        for output in self.outputs:
            loops.setdefault(output.loop, set()).add(output.period)
        chosen: dict[
            int, list[int]
        ] = {}  # outputs, by period: each by its own and by those of slower members of the loop
        for i, output in enumerate(self.outputs):
            for period in loops[output.loop]:
                if period >= output.period:
                    chosen.setdefault(period, []).append(i)
        most = MEMORY // (8 * LENGTH * max(1, sum(map(len, chosen.values()))))
        return [
            Clock(period, starts(plan.first, plan.steps, period, most), LENGTH, np.array(of, dtype=np.intp), plan.steps)
            for period, of in sorted(chosen.items())
        ]

    def _like(self, like: Bursts, factor: int, kept: bool, plan: Plan) -> list[Clock]:
        clocks = []
        for clock in like.clocks:
            slower, more = (factor, 1) if kept and clock.period > 1 else (1, factor)
            begins = clock.starts * factor
            clocks.append(Clock(clock.period * slower, begins, clock.length * more, clock.chosen, plan.steps))
        return clocks

    def _by_kind(self) -> Iterator[tuple[str, Places, Places]]:
        for kind in NUMBERS:
            where = [i for i, output in enumerate(self.outputs) if output.variable.kind == kind]
            if where:
                yield kind, np.array(where, dtype=np.intp), np.array([self.outputs[i].place for i in where], np.intp)

    @property
    def rms(self) -> Reals:
        """(outputs,) over all ticks."""
        of_reals = self._squares[[output.place for output in self.outputs[: self._n_real]]]
        squares = np.concatenate([of_reals, self._squares_of_others])
        return np.asarray(np.sqrt(squares / max(1, self.last - self.first)))

    def look(self, ticks: int) -> None:
        """To be called after each step of the master.  ticks: steps done."""
        now = self._now
        for table, where, places in self._tables:
            now[where] = table[places]
        others = now[self._n_real :]
        with np.errstate(over="ignore"):
            self._squares += self._reals * self._reals
            self._squares_of_others += others * others
        for clock in self.clocks:
            done = clock.done[0]
            if done < len(clock.ticks) and clock.ticks[done] == ticks:
                clock.values[done] = now[clock.chosen]
                clock.done[0] += 1

    def program(self) -> BurstsProgram:
        return BurstsProgram(
            kinds=np.array([NUMBERS.index(output.variable.kind) for output in self.outputs], dtype=np.intp),
            places=np.array([output.place for output in self.outputs], dtype=np.intp),
            squares=self._squares,
            squares_of_others=self._squares_of_others,
            clocks=[ClockProgram(c.ticks, c.chosen, c.values, c.done) for c in self.clocks],
        )


def fed_back(plan: Plan, system: System) -> Iterator[FedBack]:
    """Numbers that are connected to an input from which a way leads back to their own component."""
    sources: dict[str, set[str]] = {component.name: set() for component in plan.components}
    for connection in plan.connections:
        sources[connection.sink].add(connection.source)
    loops = {
        name: number
        for number, names in enumerate(strongly_connected({sink: sorted(of) for sink, of in sources.items()}))
        for name in names
        if len(names) > 1 or name in sources[name]
    }
    periods = {component.name: component.period for component in plan.components}
    outputs = {
        (connection.source, connection.output.name): connection.output
        for connection in plan.connections
        if connection.source in loops and loops[connection.source] == loops.get(connection.sink)
    }
    for (component, name), variable in outputs.items():
        if variable.kind in (*FLOATS, *WHOLE):
            place = system.places[component, name]
            of = {k.input.unit for k in plan.connections if k.sink == component and depends(variable, k.input)}
            command = variable.feedthrough and variable.unit not in of
            yield FedBack(component, variable, loops[component], place, periods[component], command)


def depends(output: Variable, input: Variable) -> bool:
    """Whether an output depends at once on an input of the same component."""
    return output.depends is None or input.array in output.depends


def starts(first: int, steps: int, period: int, most: int) -> Table:
    """(n,) ticks at which bursts begin in a run from tick `first` to `steps`; at most about `most`."""
    begin = -(-first // period)
    n = steps // period - begin
    widest = n // max(1, min(FEWEST, most))
    found: list[int] = []
    start = 0
    while not found or start + LENGTH <= n:
        found.append(start)
        start += max(LENGTH, widest if most < FEWEST else min(start // 8, widest))
    return (np.array(found, dtype=np.int64) + begin) * period
