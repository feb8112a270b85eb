"""A component in the loop: the FMI calls of its step, as data and as calls whose arguments are already built."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from ..fmu.variables import FLOATS, Variable
from ..instances.instance import CallFailed, Instance, references_of
from ..plan.plan import Component

AT_ONCE, TICK_END, PERIOD_END = range(3)  # when what a component has computed becomes visible: see `master`

Action = Callable[[], Any]


@dataclass(frozen=True)
class Conversion:
    """input = factor * output + offset, from a place in the table of its kind to a place in a buffer."""

    kind: str
    source: int
    target: int
    factor: float
    offset: float


@dataclass(frozen=True)
class Input:
    """Values of one kind that one FMI call writes.

    `buffer`: where they gather: at its `targets` what lies at the `sources` of the table of their kind, and what is
    converted.
    """

    kind: str
    variables: list[Variable]
    buffer: Any
    sources: Any
    targets: Any
    conversions: Sequence[Conversion] = ()


@dataclass(frozen=True)
class Output:
    """Values of one kind that one FMI call reads into `buffer`."""

    kind: str
    variables: list[Variable]
    buffer: Any


@dataclass(frozen=True)
class Publication:
    """Values that move from the `chosen` places of a buffer to the `targets` in the table, at a `moment`."""

    kind: str
    moment: int
    buffer: Any
    chosen: Any
    targets: Any


@dataclass
class Stepper:
    """A component in the loop.

    Each step: `gathers` (table to buffers), `sets`, `step`, `gets`, `publish[AT_ONCE]`.  `publish[TICK_END]` follows
    when all components of the tick have stepped, `publish[PERIOD_END]` when its own step has ended.  An instance that
    is `batched` does the calls of `sets` and `gets` within its step.
    """

    component: Component
    instance: Instance
    h: float  # s, of its steps
    inputs: list[Input] = field(default_factory=list)
    outputs: list[Output] = field(default_factory=list)
    publications: list[Publication] = field(default_factory=list)
    gathers: list[Action] = field(default_factory=list)
    sets: list[Action] = field(default_factory=list)
    gets: list[Action] = field(default_factory=list)
    publish: tuple[list[Action], ...] = field(default_factory=lambda: ([], [], []))
    floats: list[tuple[list[Variable], Any]] = field(default_factory=list)  # outputs, and where `gets` write them
    reals: list[Variable] = field(default_factory=list)  # its real outputs, and their places in the table
    places: Sequence[int] = ()

    def __post_init__(self) -> None:
        self.step = self.instance.step_call(self.h)

    def reads(self, input: Input, tables: Mapping[str, Any]) -> None:
        """Before each step the values gather in the input's buffer, and go into the FMU.  tables: the outputs."""
        self.inputs.append(input)
        buffer, sources = input.buffer, input.sources
        if len(input.sources) == len(buffer):
            # take() copies first where source and target overlap, which they do not.
            self.gathers.append(partial(tables[input.kind].take, sources, None, buffer, "clip"))
        elif len(input.sources):
            self.gathers.append(partial(_copy, tables[input.kind], sources, buffer, input.targets))
        if input.conversions:
            self.gathers.append(partial(_convert, tables, input.conversions, buffer))
        self.sets.append(self.instance.exchange("Set", input.kind, references_of(input.variables), buffer))

    def gives(self, kind: str, variables: list[Variable], buffer: Any) -> None:
        """After each step the variables go into the buffer."""
        if kind in FLOATS:
            self.floats.append((variables, buffer))
        self.outputs.append(Output(kind, variables, buffer))
        self.gets.append(self.instance.exchange("Get", kind, references_of(variables), buffer))

    def publishes(self, publication: Publication, table: Any) -> None:
        self.publications.append(publication)
        self.publish[publication.moment].append(
            partial(_copy, publication.buffer, publication.chosen, table, publication.targets)
        )

    def not_finite(self) -> str:
        """The first output that is not finite, as a sentence, or ""."""
        for variables, values in self.floats:
            for variable, value in zip(variables, values, strict=True):
                if not math.isfinite(value):
                    return f"{variable.causality} {variable.name} is not finite: {value}"
        return ""

    def check_finite(self) -> None:
        """Raises ComponentFailed where an output is not finite."""
        if message := self.not_finite():
            raise ComponentFailed(self, message)

    def check(self, status: int) -> None:
        """Raises ComponentFailed unless a status of FMI is OK or a warning."""
        with failing(self):
            self.instance.check(status)

    def last_inputs(self) -> dict[str, Any]:
        """{input: value} of what it was given last."""
        found: dict[str, Any] = {}
        for input in self.inputs:
            values = zip(input.variables, input.buffer, strict=True)
            found |= {v.name: value.item() if hasattr(value, "item") else str(value) for v, value in values}
        return found


def _copy(source: Any, chosen: Any, target: Any, places: Any) -> None:
    target[places] = source[chosen]


def _convert(tables: Mapping[str, Any], conversions: Sequence[Conversion], buffer: Any) -> None:
    for c in conversions:
        buffer[c.target] = c.factor * float(tables[c.kind][c.source]) + c.offset


class ComponentFailed(Exception):
    """A component failed.  `.name`: its name; the text: its words."""

    def __init__(self, stepper: Stepper, words: str, status: int = 3):
        super().__init__(words)
        self.stepper, self.name, self.status = stepper, stepper.component.name, status


@contextlib.contextmanager
def failing(stepper: Stepper) -> Iterator[None]:
    """Turn a failed FMI call into ComponentFailed."""
    try:
        yield
    except CallFailed as error:
        raise ComponentFailed(stepper, str(error), error.status) from None
