"""All that differs between two records: what made them, and what came of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ...metrics import METRICS, unit_of
from ...names import split_axis
from ..file.run import Run
from .settings import Setting, differing, flat, settings

MADE = ("versions", "git_commit", "platform")  # beside the settings
ENDED = ("status", "error", "stopped_at", "failed_at", "interrupted_at")


@dataclass(frozen=True, kw_only=True)
class Change:
    """One thing that differs; None where a record lacks it.  `decides`: whether the numbers depend on it."""

    name: str
    before: Any
    after: Any
    decides: bool


def changes(a: Run, b: Run) -> list[Change]:
    """All that differs but clocks: what decides the numbers first, then what may, then results."""
    before, after = a.attributes, b.attributes
    deciding = _changes(_deciding(before, after), _deciding(after, before), True)
    deciding = [replace(c, decides=False) if _renames(c, deciding) else c for c in deciding]
    return [
        *deciding,
        *_changes(_circumstances(before), _circumstances(after), False),
        *_changes(_ended(a, b), _ended(b, a), False),
    ]


def _changes(before: Mapping[Setting, Any], after: Mapping[Setting, Any], decides: bool) -> list[Change]:
    return [
        Change(name=".".join(setting), before=before.get(setting), after=after.get(setting), decides=decides)
        for setting in differing([before, after])
    ]


def _renames(change: Change, others: Iterable[Change]) -> bool:
    """Whether it is but another name of the same FMU."""
    _, _, key = change.name.partition("components.")
    return key.count(".") == 1 and key.endswith(".fmu") and f"{change.name}_sha256" not in {c.name for c in others}


def _circumstances(facts: Mapping[str, Any]) -> dict[Setting, Any]:
    return dict(flat({name: facts[name] for name in MADE}))


def _ended(run: Run, other: Run) -> dict[Setting, Any]:
    """How a run ended; metrics whose units are not those of the other run are told apart by them."""
    facts, units, others = run.attributes, _units(run), _units(other)
    told = {name: f"{name} [{unit}]" for name, unit in units.items() if others.get(name, unit) != unit}
    metrics = {told.get(name, name): value for name, value in facts["metrics"].items()}
    return dict(flat({**{name: facts.get(name) for name in ENDED if facts.get(name)}, "metrics": metrics}))


def _units(run: Run) -> dict[str, str]:
    specs, units = run.resolved.get("metrics", {}), run.metric_units
    return {name: unit_of(spec, units) for name, spec in specs.items() if spec["of"] in METRICS}


def _deciding(facts: Mapping[str, Any], other: Mapping[str, Any]) -> dict[Setting, Any]:
    """What decides the numbers; of a component that the other record lacks, only which FMU it is."""
    mine, theirs = settings(facts["experiment_resolved"]), settings(other["experiment_resolved"])
    common = [setting[1] for setting in mine if setting[2:] == ("fmu",) and setting in theirs]
    result: dict[Setting, Any] = {("order",): " ".join(common)}
    for setting, value in mine.items():
        match setting:
            case ("components", name, key, *_) if name not in common:
                if key == "fmu":
                    result["components", name] = value
            case ("connections", _):
                pass
            case _:
                result[setting] = value
    for sink, source in _connections(_connected(mine), _connected(theirs)).items():
        if sink.partition(".")[0] in common:
            result["connections", sink] = source
    return result


def _connected(made: Mapping[Setting, Any]) -> dict[str, str]:
    return {setting[1]: source for setting, source in made.items() if setting[0] == "connections"}


def _connections(pairs: Mapping[str, str], others: Mapping[str, str]) -> dict[str, str]:
    """{input: output} of the vectors that are connected otherwise in the other record.

    One entry a vector, "controller.eta": "vehicle.eta", where that tells all and the difference; else one a scalar.
    """
    mine, theirs = _by_vector(pairs), _by_vector(others)
    result: dict[str, str] = {}
    for vector, axes in mine.items():
        if axes == theirs.get(vector):
            continue
        whole, other = _whole(axes), _whole(theirs.get(vector, {}))
        same_axes = vector not in theirs or _axes(axes) == _axes(theirs[vector])
        result |= {vector: whole} if whole and same_axes and (other or vector not in theirs) else axes
    return result


def _by_vector(pairs: Mapping[str, str]) -> dict[str, dict[str, str]]:
    result: dict[str, dict[str, str]] = {}
    for sink, source in pairs.items():
        result.setdefault(split_axis(sink)[0], {})[sink] = source
    return result


def _axes(sinks: Iterable[str]) -> set[str]:
    return {split_axis(sink)[1] for sink in sinks}


def _whole(axes: Mapping[str, str]) -> str:
    """The vector that several axes come from, each from the one of its own name; "" where it is not so simple."""
    origins = {split_axis(source)[0] for source in axes.values()}
    straight = all(split_axis(sink)[1] == split_axis(source)[1] for sink, source in axes.items())
    return origins.pop() if len(origins) == 1 and len(axes) > 1 and straight else ""


def rows(changes: list[Change]) -> list[tuple[str, str, str, str]]:
    """As a table: name, before, after, and of numbers by how much."""
    return [(change.name, _shown(change.before), _shown(change.after), _by(change)) for change in changes]


def _by(change: Change) -> str:
    a, b = change.before, change.after
    numbers = all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in (a, b))
    return f"{(b - a) / abs(a):+.3g}" if numbers and a else ""


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    text = f"{value:.8g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 20 else f"{text[:17]}..."
