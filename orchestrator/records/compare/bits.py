"""Whether two records of one plan hold the same rows, bit for bit, and ended alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import warning
from ...warning import Kind
from ..file.run import Run
from .settings import differing

if TYPE_CHECKING:
    from ...arrays import Table, Truths

# Attributes that decide whether two runs ended alike; all others name the clock, the machine or the file.
ENDS = ("status", "error", "failed_at", "stopped_at", "metrics", "warnings", "digest")


@dataclass(frozen=True, kw_only=True)
class Difference:
    """How two records differ.

    facts: sentences on attributes, signals and numbers of rows that differ.  signals: those whose values differ;
    first: the one that differs first, at `time` [s], with its values then and now.
    """

    facts: tuple[str, ...]
    signals: tuple[str, ...] = ()
    first: str = ""
    time: float = 0.0
    then: Any = None
    now: Any = None

    def __str__(self) -> str:
        lines = list(self.facts)
        if self.signals:
            by = "" if isinstance(self.then, str) else f", by {abs(float(self.now) - float(self.then)):.3g}"
            lines.append(
                f"{len(self.signals)} signals differ, {self.first} first, at t = {self.time:.10g} s: "
                f"{self.then!r} then, {self.now!r} now{by}"
            )
        return "\n".join(lines)


def compare(then: Run, now: Run, ends: bool = True) -> Difference | None:
    """What differs between two records; None where nothing does.  ends: also how they ended, and their metrics.

    A record of a sweep may have kept fewer rows, or none: then only these rows and signals are compared.
    """
    kept = "kept" in then.attributes
    chosen = np.isin(now.time, then.time) if kept else np.ones(len(now.time), dtype=bool)
    facts = _ends(then, now) if ends else []
    if len(then.time) != chosen.sum():
        facts.append(f"rows: {len(then.time)} then, {chosen.sum()} now")
    if not kept:
        facts += [f"{name} is in one of the two only" for name in sorted(set(then.signals) ^ set(now.signals))]
    rows = min(len(then.time), int(chosen.sum()))
    first: dict[str, tuple[int, ...]] = {}  # {signal: row, and place in it, of its first value that differs}
    for name in ["time", *(name for name in then.signals if name in now.signals)]:
        unequal = _unequal(*(values[:rows] for values in _pair(then, now, chosen, name)))
        if unequal.any():
            first[name] = tuple(int(i) for i in np.argwhere(unequal)[0])
    if not first:
        return Difference(facts=tuple(facts)) if facts else None
    name = min(first, key=lambda name: first[name][0])
    row, *place = first[name]
    old, new = (values[first[name]] for values in _pair(then, now, chosen, name))
    return Difference(
        facts=tuple(facts),
        signals=tuple(first),
        first=f"{name}[{','.join(str(i + 1) for i in place)}]" if place else name,
        time=float(then.time[row]),
        then=old.item() if isinstance(old, np.generic) else old,
        now=new.item() if isinstance(new, np.generic) else new,
    )


def _ends(then: Run, now: Run) -> list[str]:
    """Sentences on attributes that say how the runs ended, and differ."""
    before, after = then.attributes, now.attributes
    old = "warning_kinds" not in before  # made before loops were judged as they are now
    for attributes in (before, after):  # what is read when a module is imported is seen once in a process
        kept = [text for text in warning.read(attributes) if text.kind != Kind.FILES]
        attributes |= {"warnings": kept, "warning_kinds": warning.kinds_of(kept)}
    if old:
        texts = [text for text in before["warnings"] if text.kind == Kind.OTHER]
        before["warnings"] = texts
        after["warnings"] = [text for text in after["warnings"] if text.kind == Kind.OTHER or text in texts]
    has_metrics = before["metrics"] or then.status == "completed"  # earlier ones kept none of a run that failed
    alike = has_metrics and then.metrics_of == now.metrics_of
    comparable = [name for name in ENDS if name != "metrics" or alike]
    return [
        f"{name}: {_short(before.get(name))} then, {_short(after.get(name))} now"
        for name in differing([{name: of.get(name) for name in comparable} for of in (before, after)])
    ]


def _pair(then: Run, now: Run, chosen: Truths, name: str) -> tuple[Table, Table]:
    """The rows of a signal, or of the time, in both records."""
    if name == "time":
        return then.time, now.time[chosen]
    return then[name], now[name][chosen]


def _unequal(then: Table, now: Table) -> Truths:
    """Which values are not the same; of numbers, in any bit."""
    a, b = (v if v.dtype.kind == "O" else v.view(f"u{v.dtype.itemsize}") for v in (then, now))
    unequal: Truths = a != b
    return unequal


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
