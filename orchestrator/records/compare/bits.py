"""Whether two records hold the same rows, bit for bit, and ended alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ... import warning
from ...warning import Kind
from ..file.run import Run

# Attributes that decide whether two runs ended alike; all others name the clock, the machine or the file.
COMPARED = ("status", "error", "failed_at", "stopped_at", "metrics", "warnings", "digest")


@dataclass(frozen=True)
class Difference:
    """signals: that differ; first: the one that differs first, at `time` [s], with its values then and now; facts:
    attributes that differ, sentences."""

    signals: tuple[str, ...]
    first: str
    time: float
    then: Any
    now: Any
    facts: tuple[str, ...]

    def __str__(self) -> str:
        lines = list(self.facts)
        if self.signals:
            by = "" if isinstance(self.then, str) else f", by {abs(float(self.now) - float(self.then)):.3g}"
            lines.append(
                f"{len(self.signals)} signals differ, {self.first} first, at t = {self.time:.10g} s: "
                f"{self.then!r} then, {self.now!r} now{by}"
            )
        return "\n".join(lines)


class Kept:
    """A whole record as one of a sweep that has kept fewer rows, or none."""

    def __init__(self, whole: Run, record: Run):
        self.attributes, self._whole, self._rows = whole.attributes, whole, np.isin(whole.time, record.time)
        self.time, self.signals = whole.time[self._rows], record.signals

    def __getitem__(self, name: str) -> Any:
        return self._whole[name][self._rows]


def compare(then: Run, now: Run) -> Difference | None:
    """What differs between two records in their rows, bit for bit, and in how they ended."""
    before, after = then.attributes, now.attributes
    if "warning_kinds" not in before:  # made before loops were judged as they are now
        for attributes in (before, after):
            attributes["warnings"] = [text for text in warning.read(attributes) if text.kind == Kind.OTHER]
    facts = [
        f"{name}: {_short(before.get(name))} then, {_short(after.get(name))} now"
        for name in COMPARED
        if before.get(name) != after.get(name)
    ]
    times = then.time, now.time
    rows = min(map(len, times))
    if len(times[0]) != len(times[1]):
        facts.append(f"rows: {len(times[0])} then, {len(times[1])} now")
    facts += [f"{name} is in one of the two only" for name in sorted(set(then.signals) ^ set(now.signals))]
    found: dict[str, int] = {}
    for name in ["time", *(name for name in then.signals if name in now.signals)]:
        pair = times if name == "time" else (then[name], now[name])
        if not rows:
            continue
        unequal = _bits(pair[0][:rows]) != _bits(pair[1][:rows])
        differing = np.flatnonzero(unequal.reshape(rows, -1).any(axis=1))
        if len(differing):
            found[name] = int(differing[0])
    if not found:
        return Difference((), "", 0.0, None, None, tuple(facts)) if facts else None
    first = min(found, key=lambda name: found[name])
    row = found[first]
    if then.signals and first != "time" and then[first].ndim > 1:
        place = tuple(np.argwhere(then[first][row] != now[first][row])[0])
        index = ",".join(str(i + 1) for i in place)
        return Difference(
            tuple(found),
            f"{first}[{index}]",
            float(times[0][row]),
            then[first][(row, *place)].item(),
            now[first][(row, *place)].item(),
            tuple(facts),
        )
    old, new = (pair.tolist()[row] for pair in (times if first == "time" else (then[first], now[first])))
    return Difference(tuple(found), first, float(times[0][row]), old, new, tuple(facts))


def _bits(values: Any) -> Any:
    """Numbers as integers of their size: equal where every bit is, and only there."""
    return values if values.dtype.kind == "O" else values.view(f"u{values.dtype.itemsize}")


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
