"""Runs side by side: their metrics, what tells them apart, which is the best.  Only attributes of records are read."""

from __future__ import annotations

import fnmatch
import glob
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import StoreError, did_you_mean
from ...metrics import METRICS, finite, smaller_is_better, unit_of
from ..file.run import Run
from ..store.folder import Store
from .labels import labels_of, text
from .settings import differing

if TYPE_CHECKING:
    from _typeshed import SupportsRichComparison

DIGITS = 4  # significant ones, of the numbers in tables; the best is judged at them


@dataclass(frozen=True, kw_only=True)
class Column:
    """A metric.  of: its kind, a key of METRICS; unit: "" where it has none; ranked: whether the smallest is best."""

    name: str
    of: str
    unit: str
    ranked: bool

    @classmethod
    def of_spec(cls, name: str, spec: Mapping[str, Any], units: Mapping[str, str]) -> Column:
        """Of an entry of [metrics].  units: {signal: unit}."""
        if spec["of"] not in METRICS:  # in a record of another version of orch
            return cls(name=name, of=spec["of"], unit=spec.get("unit", ""), ranked=False)
        unit = unit_of(spec, units)
        return cls(name=name, of=spec["of"], unit="" if unit == "1" else unit, ranked=smaller_is_better(spec))

    @property
    def head(self) -> str:
        """rmse_x [m], as in the first line of CSV files."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A run.  label: what tells it from the others; metrics: nan where a metric has no value."""

    name: str
    path: Path
    label: str
    status: str
    attributes: Mapping[str, Any]
    metrics: Mapping[Column, float]

    @property
    def title(self) -> str:
        """How the run ended, if it did not complete, then the label: a table may cut off the end."""
        return self.label if self.is_completed else f"({self.status}) {self.label}".rstrip()

    @property
    def is_completed(self) -> bool:
        return self.status == "completed"


@dataclass(frozen=True)
class Comparison:
    """Runs in the order asked for, metrics in the order of their files.  notes: what makes numbers hard to compare."""

    entries: list[Entry]
    columns: list[Column]
    notes: list[str]

    def best(self, column: Column) -> list[Entry]:
        """The completed runs whose value is nearest to zero, at DIGITS; [] where no run is better than another."""
        numbers = {i: e.metrics.get(column, math.nan) for i, e in enumerate(self.entries)}
        finite_ones = {i: abs(float(digits(v))) for i, v in numbers.items() if math.isfinite(v)}
        ranked = {i: v for i, v in finite_ones.items() if self.entries[i].is_completed}
        if not column.ranked or len(finite_ones) < 2 or not ranked:
            return []
        best = [i for i, value in ranked.items() if value == min(ranked.values())]
        return [] if 1 < len(best) == len(finite_ones) else [self.entries[i] for i in best]


def digits(value: float) -> str:
    """A number as tables show it."""
    return f"{value:#.{DIGITS}g}".rstrip(".")


def find(store: Store, runs: Sequence[str]) -> list[Path]:
    """The records that `runs` name, each once: globs over files or run ids, or what `Store.find` takes.

    Raises StoreError where one of them names none.
    """
    paths = [path for run in runs for path in _matches(store, run)]
    return list({path.resolve(): path for path in reversed(paths)}.values())[::-1]


def _matches(store: Store, run: str) -> list[Path]:
    if not glob.has_magic(run) or Path(run).is_file():
        return [store.find(run)]
    files = [Path(name) for name in sorted(glob.glob(run, recursive=True)) if name.endswith(".h5")]
    records = store.records()
    names = {path: (path.stem, f"{path.parent.name}/{path.stem}") for path in records}
    matches = files or [path for path in records if any(fnmatch.fnmatch(name, run) for name in names[path])]
    if not matches:
        near = did_you_mean(run, [f"{p.parent.name}/{p.stem}" for p in records], "there are")
        raise StoreError(f"no record fits {run!r}, neither a .h5 file here nor a run id in {store.folder}{near}")
    return matches


def compare(paths: Iterable[Path], globs: Sequence[str] = ()) -> Comparison:
    """Read records.  globs: over names of metrics; none chooses all.  Raises StoreError where a glob fits no metric."""
    read = [_read(path) for path in paths]
    names = list(dict.fromkeys(column.name for entry in read for column in entry.metrics))
    for pattern in globs:
        if not fnmatch.filter(names, pattern):
            raise StoreError(f"no metric of these runs fits {pattern!r}{did_you_mean(pattern, names, 'there are')}")
    columns = dict.fromkeys(column for entry in read for column in entry.metrics)
    chosen = [c for c in columns if not globs or any(fnmatch.fnmatchcase(c.name, pattern) for pattern in globs)]
    entries = [
        replace(entry, name=name, label=label)
        for entry, name, label in zip(read, _names(read), _labels(read), strict=True)
    ]
    return Comparison(entries, chosen, list(_notes(entries, chosen)))


def _read(path: Path) -> Entry:
    """A record as an entry without name and label."""
    with Run(path) as run:
        attributes, status = run.attributes, run.status
        resolved = attributes["experiment_resolved"]
        units, values = run.metric_units, {}
        for name, value in attributes["metrics"].items():
            spec = resolved["metrics"][name]
            column = Column.of_spec(name, spec, units)
            values[column] = math.nan if value is None else float(value)
    kept = ("run_id", "experiment", "title", "error", "experiment_resolved")
    facts = {name: attributes[name] for name in kept}
    return Entry(name="", path=path, label="", status=status, attributes=facts, metrics=values)


def _names(entries: Sequence[Entry]) -> list[str]:
    """Run ids; of records that share one, the names of their files or, where these are the same too, the paths."""
    ways = [(str(e.attributes["run_id"]), e.path.stem, str(e.path)) for e in entries]
    count = Counter(name for way in ways for name in set(way))
    return [next((name for name in way if count[name] == 1), way[-1]) for way in ways]


def _labels(entries: Sequence[Entry]) -> list[str]:
    """The experiment, if there are several, and what differs among the runs of one."""
    experiments: dict[str, list[int]] = {}
    for i, entry in enumerate(entries):
        experiments.setdefault(entry.attributes["experiment"], []).append(i)
    result = [""] * len(entries)
    for experiment, members in experiments.items():
        for i, words in zip(members, _differing([entries[i] for i in members]), strict=True):
            result[i] = ", ".join([experiment, *words] if len(experiments) > 1 else words)
    return result


def _differing(entries: Sequence[Entry]) -> list[list[str]]:
    """What differs; if runs differ in FMUs, also what differs among those with the same FMUs."""
    words = labels_of([entry.attributes["experiment_resolved"] for entry in entries])
    result = [[word] if word else [] for word in words]
    groups = {word: [i for i, other in enumerate(words) if other == word] for word in words}
    for members in groups.values():
        if 1 < len(members) < len(entries):
            for i, more in zip(members, _differing([entries[i] for i in members]), strict=True):
                result[i] += more
    return result


def _notes(entries: Sequence[Entry], columns: Sequence[Column]) -> Iterator[str]:
    """Metrics that share a name but are not defined alike in all runs."""
    for name in dict.fromkeys(column.name for column in columns):
        metrics = [e.attributes["experiment_resolved"]["metrics"] for e in entries]
        specs = [of[name] for of in metrics if name in of]
        texts = {
            key: sorted({"none" if key not in spec else text(spec[key]) for spec in specs}, key=_in_order)
            for key in differing(specs)
        }
        if texts:
            words = ", ".join(f"{key} = {' or '.join(values)}" for key, values in texts.items())
            yield f"{name} is not the same in all runs: {words}"
    if entries and not columns:
        yield "no run has metrics: name some under [metrics] in the experiment file"


def _in_order(text: str) -> SupportsRichComparison:
    """Key that sorts numbers by their size, before words."""
    try:
        return 0, float(text), text
    except ValueError:
        return 1, 0.0, text


def as_json(comparison: Comparison) -> dict[str, Any]:
    runs = [
        {
            "name": e.name,
            "file": str(e.path),
            "label": e.label,
            "status": e.status,
            **{name: e.attributes[name] for name in ("run_id", "experiment", "title", "error")},
            "metrics": finite({c.name: e.metrics[c] for c in comparison.columns if c in e.metrics}),
        }
        for e in comparison.entries
    ]
    columns = [
        {
            "name": c.name,
            "of": c.of,
            "unit": c.unit or "1",
            "better": "smaller" if c.ranked else None,
            "best": [e.name for e in comparison.best(c)],
        }
        for c in comparison.columns
    ]
    return {"runs": runs, "metrics": columns, "notes": comparison.notes}
