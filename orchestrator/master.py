"""The co-simulation master: the only loop.

At tick k, time t = k * step, every component that is due steps from t to the end of its own period, in the order of the
experiment.  When its results become visible to the others:

    gauss-seidel, period of one tick     at once: components listed later use them in the same tick
    jacobi, period of one tick           when all components have stepped
    a longer period                      what depends on an input at once (a control law): as above, and it is held;
                                         the rest (a state, a reference) belongs to the end of the period and is
                                         visible from then on

So a command computed from the state at t acts from t, and nothing is seen before its time.
"""

from __future__ import annotations

import ctypes
import math
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from .chatter import Alternations
from .instance import DISCARD
from .system import AlgebraicLoop, Member, MemberFailed, System

CHUNK_SECONDS = 0.02  # of wall time between two looks at the outside world


@dataclass
class Block:
    """Consecutive rows of the record.  `ticks`: (N,) of the rows; `values`: {kind: (N, signals of that kind)}."""

    ticks: list[int]
    values: dict[str, Any]


@dataclass
class Outcome:
    """How a run ended.  `ticks`: communication steps done; times in s."""

    status: str  # completed, failed or interrupted
    ticks: int = 0
    error: str = ""
    failed_at: float | None = None
    stopped_at: float | None = None
    warnings: list[str] = field(default_factory=list)


class Observer(Protocol):
    """Sees every row, in order, and changes nothing."""

    def rows(self, block: Block) -> None: ...

    def progress(self, tick: int) -> None: ...


def run(system: System, observers: Sequence[Observer], interrupted: threading.Event | None = None) -> Outcome:
    """Run the opened system to its end, to a failure, or until `interrupted` is set."""
    outcome = Outcome("completed")
    try:
        system.initialize()
        _loop(system, observers, outcome, interrupted or threading.Event())
    except MemberFailed as failure:
        _fail(system, outcome, _cause(system, failure))
    except AlgebraicLoop as loop:
        outcome.status, outcome.error, outcome.failed_at = "failed", str(loop), 0.0
    outcome.warnings += [
        f"{member.part.name}: {words}" for member in system.members for words in member.instance.take_messages()
    ]
    return outcome


def _cause(system: System, failure: MemberFailed) -> MemberFailed:
    """What gave a value that is not finite failed before what choked on it in the same step."""
    for member in system.members:
        if member is not failure.member and (words := member.not_finite()):
            return MemberFailed(member, words)
    return failure


def _fail(system: System, outcome: Outcome, failure: MemberFailed) -> None:
    grid = system.plan.experiment.grid
    if failure.status == DISCARD and failure.member.instance.wants_to_end():
        outcome.stopped_at = grid.time(outcome.ticks)
        return
    outcome.status = "failed"
    outcome.failed_at = grid.time(outcome.ticks)
    outcome.error = f"{failure.name!r} failed at t = {outcome.failed_at:.10g} s: {failure}"


def _loop(system: System, observers: Sequence[Observer], outcome: Outcome, interrupted: threading.Event) -> None:
    rows, alternations = _Rows(system), Alternations(system)
    rows.add(0)
    rows.hand_to(observers)
    steps, chunk = system.plan.steps, 1
    try:
        while outcome.ticks < steps and not interrupted.is_set():
            began = time.perf_counter()
            last = min(steps, outcome.ticks + chunk)
            try:
                _advance(system, rows, alternations, outcome, last, interrupted)
            finally:
                rows.hand_to(observers)
            elapsed = time.perf_counter() - began
            chunk = max(1, min(2 * chunk, int(chunk * CHUNK_SECONDS / max(elapsed, 1e-6))))
            for observer in observers:
                observer.progress(outcome.ticks)
    finally:  # a run that fails, or that an FMU ends, is judged too
        outcome.warnings += alternations.warnings(outcome.ticks)
    if outcome.ticks < steps:
        outcome.status = "interrupted"
        outcome.error = f"interrupted at t = {system.plan.experiment.grid.time(outcome.ticks):.10g} s"


def _advance(
    system: System, rows: _Rows, alternations: Alternations, outcome: Outcome, last: int, interrupted: threading.Event
) -> None:
    """Step until tick `last`.  Raises MemberFailed; `outcome.ticks` then names the start of the failed step."""
    grid, stride = system.plan.experiment.grid, system.plan.stride
    members = [(member, member.part.period) for member in system.members]
    ending = [(m, p) for m, p in members if m.at_tick_end or m.at_period_end]
    checked = system.tables["real"][: system.computed["real"]]
    for k in range(outcome.ticks, last):
        if interrupted.is_set():
            return
        t = ctypes.c_double(grid.time(k))
        for member, period in members:
            if period > 1 and k % period:
                continue
            for gather in member.gathers:
                gather()
            for set_ in member.sets:
                if (status := set_()) != 0:
                    _check(member, status)
            if (status := member.step(t, member.h, 1)) != 0:
                _check(member, status)
            for get in member.gets:
                if (status := get()) != 0:
                    _check(member, status)
            for sum_of_squares in member.sums:
                if not math.isfinite(sum_of_squares()):
                    _check_finite(member)
            for publish in member.at_once:
                publish()
        for member, period in ending:
            if k % period == 0:
                for publish in member.at_tick_end:
                    publish()
            if (k + 1) % period == 0:
                for publish in member.at_period_end:
                    publish()
        if not math.isfinite(checked.dot(checked)):
            for member, _ in members:
                _check_finite(member)
        alternations.count()
        outcome.ticks = k + 1
        if outcome.ticks % stride == 0:
            rows.add(outcome.ticks)


def _check(member: Member, status: int) -> None:
    try:
        member.instance.check(status)
    except Exception as error:
        raise MemberFailed(member, str(error), status) from None


def _check_finite(member: Member) -> None:
    if words := member.not_finite():
        raise MemberFailed(member, words)


class _Rows:
    """Gathers rows until somebody takes them."""

    def __init__(self, system: System):
        self._system = system
        self._clear()

    def _clear(self) -> None:
        self._ticks: list[int] = []
        self._values: dict[str, list[Any]] = {kind: [] for kind in self._system.recorded}

    def add(self, tick: int) -> None:
        self._ticks.append(tick)
        for kind, places in self._system.recorded.items():
            if len(places):
                self._values[kind].append(self._system.tables[kind][places])

    def hand_to(self, observers: Sequence[Observer]) -> None:
        if self._ticks:
            block = Block(self._ticks, {kind: np.array(rows) for kind, rows in self._values.items() if rows})
            self._clear()
            for observer in observers:
                observer.rows(block)


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """Ctrl-C sets a flag: a KeyboardInterrupt raised inside a Python FMU would be a fatal error of that FMU."""
    flag = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield flag
        return
    before = signal.signal(signal.SIGINT, lambda *_: flag.set())
    try:
        yield flag
    finally:
        signal.signal(signal.SIGINT, before)
