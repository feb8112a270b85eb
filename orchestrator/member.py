"""A component in the loop: the FMI calls of its step, as data and as calls whose arguments are already built."""

from __future__ import annotations

import contextlib
import ctypes
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from .fmu import Variable
from .instance import CallFailed, Instance
from .plan import Part

AT_ONCE, TICK_END, PERIOD_END = range(3)  # when what a component has computed becomes visible: see `master`

Action = Callable[[], Any]


@dataclass(frozen=True)
class Input:
    """Values of one kind that one FMI call writes.  `sources`: places in the table; `buffer`: where they gather."""

    kind: str
    references: Any
    sources: Any
    buffer: Any


@dataclass(frozen=True)
class Output:
    """Values of one kind that one FMI call reads into `buffer`."""

    kind: str
    references: Any
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
class Member:
    """A component in the loop.

    Each step: `gathers` (table to buffers), `sets`, `step`, `gets`, `publish[AT_ONCE]`.  `publish[TICK_END]` follows
    when all components of the tick have stepped, `publish[PERIOD_END]` when its own step has ended.
    """

    part: Part
    instance: Instance
    h: float  # s, of its steps
    inputs: list[Input] = field(default_factory=list)
    outputs: list[Output] = field(default_factory=list)
    publications: list[Publication] = field(default_factory=list)
    gathers: list[Action] = field(default_factory=list)
    sets: list[Action] = field(default_factory=list)
    gets: list[Action] = field(default_factory=list)
    publish: tuple[list[Action], ...] = field(default_factory=lambda: ([], [], []))
    reals: list[Variable] = field(default_factory=list)  # its real outputs, where `gets` write them, their places
    values: Any = ()
    places: Sequence[int] = ()

    def __post_init__(self) -> None:
        component, h = ctypes.c_void_p(self.instance.component), ctypes.c_double(self.h)
        do_step = self.instance.function("fmi2DoStep")
        self.step: Callable[[ctypes.c_double], Any] = lambda t: do_step(component, t, h, 1)

    def reads(self, kind: str, variables: list[Variable], table: Any, buffer: Any, sources: Any) -> None:
        """Before each step the values at `sources` of the table go into `variables`."""
        # take() copies first where source and target overlap: these two views do not.
        self.inputs.append(Input(kind, _references(variables), sources, buffer))
        self.gathers.append(partial(table.take, sources, None, buffer, "clip"))
        self.sets.append(self._call("Set", self.inputs[-1], reads=False))

    def gives(self, kind: str, variables: list[Variable], buffer: Any) -> None:
        """After each step `variables` go into the buffer."""
        self.outputs.append(Output(kind, _references(variables), buffer))
        self.gets.append(self._call("Get", self.outputs[-1], reads=True))

    def publishes(self, kind: str, moment: int, buffer: Any, chosen: Any, table: Any, targets: Any) -> None:
        def publish() -> None:
            table[targets] = buffer[chosen]

        self.publications.append(Publication(kind, moment, buffer, chosen, targets))
        self.publish[moment].append(publish)

    def not_finite(self) -> str:
        """The first real output that is not finite, as a sentence, or ""."""
        for variable, value in zip(self.reals, self.values, strict=True):
            if not math.isfinite(value):
                return f"{variable.causality} {variable.name} is not finite: {value}"
        return ""

    def address(self, function: str) -> int:
        return ctypes.cast(self.instance.function(function), ctypes.c_void_p).value or 0

    def _call(self, verb: str, exchange: Input | Output, reads: bool) -> Action:
        """The FMI getter or setter without arguments; returns the status."""
        n, buffer = len(exchange.references), exchange.buffer
        call = partial(
            self.instance.function(function_name(verb, exchange.kind)), ctypes.c_void_p(self.instance.component),
            ctypes.c_void_p(exchange.references.ctypes.data), ctypes.c_size_t(n),
        )  # fmt: skip
        if exchange.kind != "string":
            return partial(call, ctypes.c_void_p(buffer.ctypes.data))
        strings = (ctypes.c_char_p * n)()

        def exchange_strings() -> Any:
            if not reads:
                strings[:] = list(buffer)
            status = call(strings)
            if reads:
                buffer[:] = [text or b"" for text in strings]  # valid only until the next call
            return status

        return exchange_strings


def function_name(verb: str, kind: str) -> str:
    return f"fmi2{verb}{kind.capitalize()}"


def _references(variables: list[Variable]) -> Any:
    return np.array([v.reference for v in variables], dtype=np.uint32)


class MemberFailed(Exception):
    """A component failed.  `.name`: its name; the text: its words."""

    def __init__(self, member: Member, words: str, status: int = 3):
        super().__init__(words)
        self.member, self.name, self.status = member, member.part.name, status


@contextlib.contextmanager
def failing(member: Member) -> Iterator[None]:
    """Turn a failed FMI call into MemberFailed."""
    try:
        yield
    except CallFailed as error:
        raise MemberFailed(member, str(error), error.status) from None
