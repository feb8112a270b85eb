"""What differs between two records: what made them, and what came out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ...names import split_axis
from ..file.run import Run

MADE = ("versions", "git_commit", "platform")  # beside what the experiment says
ENDED = ("status", "error", "stopped_at", "failed_at")


@dataclass(frozen=True)
class Change:
    """One thing that differs; None where a record lacks it.  `decides`: whether the numbers depend on it."""

    name: str
    before: Any
    after: Any
    decides: bool


def changes(a: Run, b: Run) -> list[Change]:
    """All that differs but clocks: what decides the numbers first, then what may, then results."""
    before, after = a.attributes, b.attributes
    deciding = _differing(_experiment(before, after), _experiment(after, before), True)
    deciding = [replace(c, decides=False) if _renames(c, deciding) else c for c in deciding]
    made = _differing({name: before[name] for name in MADE}, {name: after[name] for name in MADE}, False)
    ended = _differing(_ended(before), _ended(after), False)
    return [*deciding, *made, *ended]


def _renames(change: Change, others: Iterable[Change]) -> bool:
    """Whether it is but another name of the same FMU."""
    _, _, key = change.name.partition("components.")
    return key.count(".") == 1 and key.endswith(".fmu") and f"{change.name}_sha256" not in {c.name for c in others}


def _ended(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {**{name: facts.get(name) for name in ENDED if facts.get(name)}, "metrics": facts["metrics"]}


def _experiment(facts: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """What decides the numbers; of a component that the other record lacks, only which FMU it is."""
    resolved = facts["experiment_resolved"]
    common = {c["name"] for c in other["experiment_resolved"]["components"]}
    components = {
        c["name"]: {k: v for k, v in c.items() if k != "name"} if c["name"] in common else c["fmu"]
        for c in resolved["components"]
    }
    connections = _connections(resolved["connections"], other["experiment_resolved"]["connections"])
    order = " ".join(name for name in components if name in common)
    return {
        "master": resolved["master"],
        "order": order,
        "components": components,
        "connections": {sink: v for sink, v in connections.items() if sink.partition(".")[0] in common},
        "record": resolved["record"],
        "from": resolved.get("from", {}),
    }


def _connections(pairs: Iterable[tuple[str, str]], others: Iterable[tuple[str, str]]) -> dict[str, str]:
    """{input: output} of the vectors that are connected otherwise in the other record.

    One entry a vector, "controller.eta": "vehicle.eta", where that tells all and the difference; else one a scalar.
    """
    mine, theirs = _by_vector(pairs), _by_vector(others)
    found: dict[str, str] = {}
    for vector, axes in mine.items():
        if axes == theirs.get(vector):
            continue
        whole, other = _whole(axes), _whole(theirs.get(vector, {}))
        same_axes = vector not in theirs or _axes(axes) == _axes(theirs[vector])
        found |= {vector: whole} if whole and same_axes and (other or vector not in theirs) else axes
    return found


def _by_vector(pairs: Iterable[tuple[str, str]]) -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    for sink, source in pairs:
        found.setdefault(split_axis(sink)[0], {})[sink] = source
    return found


def _axes(sinks: Iterable[str]) -> set[str]:
    return {split_axis(sink)[1] for sink in sinks}


def _whole(axes: Mapping[str, str]) -> str:
    """The vector that several axes come from, each from the one of its own name; "" where it is not so simple."""
    origins = {split_axis(source)[0] for source in axes.values()}
    straight = all(split_axis(sink)[1] == split_axis(source)[1] for sink, source in axes.items())
    return origins.pop() if len(origins) == 1 and len(axes) > 1 and straight else ""


def _differing(before: Mapping[str, Any], after: Mapping[str, Any], decides: bool) -> list[Change]:
    old, new = dict(_flat(before)), dict(_flat(after))
    return [
        Change(name, old.get(name), new.get(name), decides)
        for name in [*old, *(name for name in new if name not in old)]
        if old.get(name) != new.get(name)
    ]


def _flat(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield above + name, value


def rows(found: list[Change]) -> list[tuple[str, str, str, str]]:
    """As a table: name, before, after, and of numbers by how much."""
    return [(change.name, _shown(change.before), _shown(change.after), _by(change)) for change in found]


def _by(change: Change) -> str:
    a, b = change.before, change.after
    numbers = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in (a, b))
    return f"{(b - a) / abs(a):+.3g}" if numbers and a else ""


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    text = f"{value:.8g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 24 else f"{text[:21]}..."
