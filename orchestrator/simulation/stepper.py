"""A component in the loop: the FMI calls of its step, as data and as calls whose arguments are already built."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import Any

import numpy as np

from ..arrays import Places, Table
from ..fmu.variables import FLOATS, Variable
from ..instances.instance import ERROR, Call, CallFailed, Instance, references_of
from ..plan.plan import Component
from ..watch import doing

Action = Callable[[], object]
EVERY = 127  # ticks; a prime, so that no slower component is missed or favoured
PHASES = ("set", "step", "get")


class Moment(IntEnum):
    """When what a component has computed becomes visible to the others: see `master`."""

    AT_ONCE = 0
    TICK_END = 1
    PERIOD_END = 2


AT_ONCE, TICK_END, PERIOD_END = Moment


@dataclass(frozen=True, kw_only=True)
class Conversion:
    """input = factor * output + offset, from a place in the table of its kind to a place in a buffer."""

    kind: str
    source: int
    target: int
    factor: float
    offset: float


@dataclass(frozen=True, kw_only=True)
class Setter:
    """Inputs of one kind, which one FMI call writes.

    `buffer`: (n,) where they gather: at its `targets` what lies at the `sources` of the table of their kind, and what
    is converted.
    """

    kind: str
    variables: list[Variable]
    buffer: Table
    sources: Places
    targets: Places
    conversions: Sequence[Conversion] = ()


@dataclass(frozen=True, kw_only=True)
class Getter:
    """Outputs of one kind, which one FMI call reads into `buffer`, (n,)."""

    kind: str
    variables: list[Variable]
    buffer: Table


@dataclass(frozen=True, kw_only=True)
class Publication:
    """Values that move from the `chosen` places of a buffer to the `targets` in the table, at a `moment`."""

    kind: str
    moment: Moment
    buffer: Table
    chosen: Places
    targets: Places


@dataclass
class Stepper:
    """A component in the loop.

    Each step: `gathers` (table to buffers), `sets`, `step`, `gets`, `publish[AT_ONCE]`.  `publish[TICK_END]` follows
    when all components of the tick have stepped, `publish[PERIOD_END]` when its own step has ended.  An instance that
    is `batched` does the calls of `sets` and `gets` within its step.  `setters`, `getters` and `publications` say the
    same as data.
    """

    component: Component
    instance: Instance
    h: float  # s, of its steps
    setters: list[Setter] = field(default_factory=list, init=False)
    getters: list[Getter] = field(default_factory=list, init=False)
    publications: list[Publication] = field(default_factory=list, init=False)
    gathers: list[Action] = field(default_factory=list, init=False)
    sets: list[Call] = field(default_factory=list, init=False)
    gets: list[Call] = field(default_factory=list, init=False)
    publish: tuple[list[Action], ...] = field(default_factory=lambda: tuple([] for _ in Moment), init=False)
    reals: list[Variable] = field(default_factory=list, init=False)  # its real outputs, and their places in the table
    places: Sequence[int] = field(default=(), init=False)

    def __post_init__(self) -> None:
        self.step = self.instance.step_call(self.h)

    def add_setter(self, setter: Setter, tables: Mapping[str, Table]) -> None:
        """Before each step the values gather in the setter's buffer, and go into the FMU.  tables: the outputs."""
        self.setters.append(setter)
        buffer, sources = setter.buffer, setter.sources
        if len(sources) == len(buffer):
            # take() copies first where source and target overlap, which they do not.
            self.gathers.append(partial(tables[setter.kind].take, sources, None, buffer, "clip"))
        elif len(sources):
            self.gathers.append(partial(_copy, tables[setter.kind], sources, buffer, setter.targets))
        if setter.conversions:
            self.gathers.append(partial(_convert, tables, setter.conversions, buffer))
        self.sets.append(self.instance.exchange("Set", setter.kind, references_of(setter.variables), buffer))

    def add_getter(self, getter: Getter) -> None:
        """After each step the variables go into the getter's buffer."""
        self.getters.append(getter)
        self.gets.append(self.instance.exchange("Get", getter.kind, references_of(getter.variables), getter.buffer))

    def add_publication(self, publication: Publication, table: Table) -> None:
        self.publications.append(publication)
        self.publish[publication.moment].append(
            partial(_copy, publication.buffer, publication.chosen, table, publication.targets)
        )

    def not_finite(self) -> str:
        """A message that names the first output that is not finite, or ""."""
        for getter in self.getters:
            if getter.kind not in FLOATS:
                continue
            for variable, value in zip(getter.variables, getter.buffer, strict=True):
                if not math.isfinite(value):
                    return f"{variable.causality} {variable.name} is not finite: {value}"
        return ""

    def check_finite(self) -> None:
        """Raises ComponentFailed where an output is not finite."""
        if message := self.not_finite():
            raise ComponentFailed(self, message)

    def doing(self, what: str) -> None:
        """Say what is done with it, such as "is freed", in case that it never returns."""
        doing(f"{self.component.name!r} {what}")

    def check(self, status: int) -> None:
        """Raises ComponentFailed unless a status of FMI is OK or a warning."""
        with failing(self):
            self.instance.check(status)

    def last_inputs(self) -> dict[str, Any]:
        """{input: value} of what it was given last."""
        return {
            variable.name: value.item() if hasattr(value, "item") else str(value)
            for setter in self.setters
            for variable, value in zip(setter.variables, setter.buffer, strict=True)
        }


def _copy(source: Table, chosen: Places, target: Table, places: Places) -> None:
    target[places] = source[chosen]


def _convert(tables: Mapping[str, Table], conversions: Sequence[Conversion], buffer: Table) -> None:
    for c in conversions:
        buffer[c.target] = c.factor * float(tables[c.kind][c.source]) + c.offset


class ComponentFailed(Exception):
    """A component failed.  `.name`: its name; `.status`: of FMI; `.traceback`: of a Python model, or ""."""

    def __init__(self, stepper: Stepper, message: str, status: int = ERROR, traceback: str = ""):
        super().__init__(message)
        self.stepper, self.name, self.status, self.traceback = stepper, stepper.component.name, status, traceback


@contextlib.contextmanager
def failing(stepper: Stepper) -> Iterator[None]:
    """Turn a failed FMI call into ComponentFailed."""
    try:
        yield
    except CallFailed as error:
        raise ComponentFailed(stepper, str(error), error.status, error.traceback) from None


class Timing:
    """Where the time of a run goes: in some steps, the calls of each component are timed.

    `seconds`: (components, 3) of the timed steps; `samples`: (components,) how many those were; `overhead`: s, of
    looking at the clock.
    """

    def __init__(self, periods: Sequence[int]):
        self._periods = periods
        self.seconds = np.zeros((len(periods), len(PHASES)))
        self.samples = np.zeros(len(periods), dtype=np.int64)
        self.overhead = min(-(time.perf_counter() - time.perf_counter()) for _ in range(100))
        self.stepping = 0.0  # s, of all stepping: the components and the loop itself

    def add(self, component: int, marks: Sequence[float]) -> None:
        """A timed step.  marks: the times before set, step, get and after it."""
        for phase in range(len(PHASES)):
            self.seconds[component, phase] += max(0.0, marks[phase + 1] - marks[phase] - self.overhead)
        self.samples[component] += 1

    def summary(
        self, names: Sequence[str], ticks: int, loop: str, live: Mapping[str, tuple[float, float]]
    ) -> dict[str, Any]:
        """As the record keeps it: seconds of each component, estimated for all its steps; together at most what
        stepping took.

        ticks: done.  live: {component: seconds in its steps, and of these waited for what is outside}, of every step:
        a timed step that waits would count 127 times.
        """
        components: dict[str, dict[str, float]] = {}
        for i, name in enumerate(names):
            steps = -(-ticks // self._periods[i])
            share = steps / max(1, int(self.samples[i]))
            seconds = {phase: float(self.seconds[i, k]) * share for k, phase in enumerate(PHASES)}
            components[name] = {**seconds, "steps": steps}
        estimated = sum(of[phase] for name, of in components.items() if name not in live for phase in PHASES)
        left = max(0.0, self.stepping - sum(seconds for seconds, _ in live.values()))
        for name, of in components.items():
            if name in live:
                seconds_of, waited = live[name]
                of.update({"set": 0.0, "step": seconds_of - waited, "get": 0.0, "waited": waited})
            elif estimated > left:
                of.update({phase: of[phase] * left / estimated for phase in PHASES})
        return {"loop": loop, "stepping": self.stepping, "components": components}
