"""Runs side by side: their metrics, what tells them apart, which is the best.  Only attributes of records are read.

What speaks against comparing a number is said by `records.file.marks` of one run, and by `alike` of several.
"""

from __future__ import annotations

import fnmatch
import glob
import math
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ... import warning
from ...errors import StoreError, did_you_mean
from ...metrics import METRICS, finite, smaller_is_better, turn_of, unit_of
from ...warning import Warned
from ..file.marks import Standing, marked, standing_of
from ..file.run import Run, metrics_in
from ..store.folder import Store
from .alike import in_words, unlike
from .labels import labels_of

DIGITS = 4  # significant ones, of the numbers in tables; the best is judged at them


@dataclass(frozen=True, kw_only=True)
class Column:
    """A metric.

    of: its kind, a key of METRICS; unit: "" where it has none; ranked: whether the smallest magnitude is best; turn: a
    full turn in its unit where the number is an angle, whose means are taken on the circle, else 0.
    """

    name: str
    of: str
    unit: str
    ranked: bool
    turn: float = 0.0

    @classmethod
    def of_spec(
        cls, name: str, spec: Mapping[str, Any], units: Mapping[str, str], angles: Container[str] = ()
    ) -> Column:
        """Of an entry of [metrics].  units: {signal: unit}; angles: the signals that are angles, for means."""
        if spec["of"] not in METRICS:  # in a record of another version of orch
            return cls(name=name, of=spec["of"], unit=spec.get("unit", ""), ranked=False)
        unit = unit_of(spec, units)
        ranked, turn = smaller_is_better(spec), turn_of(spec, units, angles)
        return cls(name=name, of=spec["of"], unit="" if unit == "1" else unit, ranked=ranked, turn=turn)

    @property
    def head(self) -> str:
        """rmse_x [m], as in the first line of CSV files."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A run.  label: what tells it from the others; metrics: inf where it never happens, nan where there is none."""

    name: str
    path: Path
    label: str
    standing: Standing
    warnings: Sequence[Warned]
    attributes: Mapping[str, Any]
    metrics: Mapping[Column, float]

    @property
    def title(self) -> str:
        """What speaks against its numbers, then the label: a table may cut off the end."""
        return marked(self.standing, self.label)

    @property
    def status(self) -> str:
        return self.standing.status

    def marks_of(self, column: Column) -> tuple[str, ...]:
        """Why its number may not be compared; () where nothing speaks against it."""
        return self.standing.marks_of(column.of)


@dataclass(frozen=True)
class Comparison:
    """Runs in the order asked for, metrics in the order of their files.

    footnotes: what the daggers mean; notes: what else makes numbers hard to compare.
    """

    entries: list[Entry]
    columns: list[Column]
    footnotes: list[str]
    notes: list[str]

    def best(self, column: Column) -> list[Entry]:
        """The runs whose value is nearest to zero, at DIGITS, of those that may be compared; [] where none is better.

        That is also so where these runs are not alike, or where the metric has no best value.
        """
        numbers = {i: e.metrics.get(column, math.nan) for i, e in enumerate(self.entries)}
        values = {i: _rounded(v) for i, v in numbers.items() if not math.isnan(v)}
        ranked = {i: v for i, v in values.items() if not self.entries[i].marks_of(column)}
        least = min(ranked.values(), default=math.inf)
        if not column.ranked or len(values) < 2 or least == math.inf or not self._alike(column):
            return []
        best = [i for i, value in ranked.items() if value == least]
        return [] if 1 < len(best) == len(values) else [self.entries[i] for i in best]

    def _alike(self, column: Column) -> bool:
        """Whether these runs have one and the same metric."""
        having = [(e, column) for e in self.entries if column in e.metrics]
        return not unlike(column.name, _to_be_alike(having))


def _to_be_alike(having: Sequence[tuple[Entry, Column]]) -> list[Mapping[str, Any]]:
    """The experiments of the runs that may be compared or, where these are fewer than two, of all.

    having: the runs that have a metric, with its column.
    """
    compared = [e for e, column in having if not e.marks_of(column)]
    chosen = compared if len(compared) > 1 else [e for e, _ in having]
    return [e.attributes["experiment_resolved"] for e in chosen]


def _rounded(value: float) -> float:
    """The magnitude that a table shows; inf of what is never reached, which is later than any time."""
    return abs(float(digits(value))) if math.isfinite(value) else math.inf


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
    return Comparison(entries, chosen, list(_footnotes(entries, chosen)), list(_notes(entries, chosen)))


def _read(path: Path) -> Entry:
    """A record as an entry without name and label."""
    with Run(path) as run:
        attributes, status = run.attributes, run.status
        specs, units = attributes["experiment_resolved"]["metrics"], run.metric_units
    warnings = warning.read(attributes)
    values = {Column.of_spec(name, specs[name], units): float(value) for name, value in metrics_in(attributes).items()}
    kept = ("run_id", "experiment", "title", "error", "experiment_resolved")
    return Entry(
        name="",
        path=path,
        label="",
        standing=standing_of(attributes, status),
        warnings=warnings,
        attributes={name: attributes[name] for name in kept},
        metrics=values,
    )


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


def _footnotes(entries: Sequence[Entry], columns: Sequence[Column]) -> Iterator[str]:
    """What speaks against comparing the numbers of a run, or some of them."""
    for entry in entries:
        marks = entry.standing.marks
        if marks and any(column in entry.metrics for column in columns):
            yield f"{entry.name} {', '.join(marks)}"
        for column in columns:
            if column in entry.metrics and (more := entry.marks_of(column)[len(marks) :]):
                yield f"{column.name} of {entry.name} {', '.join(more)}"


def _notes(entries: Sequence[Entry], columns: Sequence[Column]) -> Iterator[str]:
    """Metrics that share a name but are not one metric in all runs; and warnings that mark no number."""
    names: dict[str, list[str]] = {}  # {what is not the same: metrics}
    for name in dict.fromkeys(column.name for column in columns):
        having = [(e, column) for e in entries for column in e.metrics if column.name == name]
        if differences := unlike(name, _to_be_alike(having)):
            names.setdefault(in_words(differences), []).append(name)
    for words, those in names.items():
        who = f"{', '.join(those)} {'is' if len(those) == 1 else 'are'}"
        yield f"{who} not the same in all runs: {words}; runs that are not alike have no best"
    for entry in entries:
        if entry.warnings and not entry.standing.marks:
            yield f"{entry.name} warned of something ({', '.join(entry.standing.kinds)}): see orch show {entry.name}"
    if entries and not columns:
        yield "no run has metrics: name some under [metrics] in the experiment file"


def as_json(comparison: Comparison) -> dict[str, Any]:
    runs = [
        {
            "name": e.name,
            "file": str(e.path),
            "label": e.label,
            "status": e.status,
            "marks": list(e.standing.marks),
            "stopped_at": e.standing.stopped_at,
            "warnings": list(e.warnings),
            "warning_kinds": warning.kinds_of(e.warnings),
            **{name: e.attributes[name] for name in ("run_id", "experiment", "title", "error")},
            "metrics": finite({c.name: e.metrics[c] for c in comparison.columns if c in e.metrics}),
            "never": [c.name for c in comparison.columns if e.metrics.get(c) == math.inf],
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
            "marked": [e.name for e in comparison.entries if c in e.metrics and e.marks_of(c)],
        }
        for c in comparison.columns
    ]
    return {"runs": runs, "metrics": columns, "footnotes": comparison.footnotes, "notes": comparison.notes}
