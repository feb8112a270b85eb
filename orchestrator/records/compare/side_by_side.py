"""Runs side by side: their metrics, what tells them apart, which is the best.  Only attributes of records are read."""

from __future__ import annotations

import fnmatch
import glob
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Column:
    """A metric.  of: its kind, a key of METRICS; unit: "" where it has none; ranked: whether the smallest is best."""

    name: str
    of: str
    unit: str
    ranked: bool

    @property
    def head(self) -> str:
        """rmse_x [m], as in the first line of CSV files."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Entry:
    """A run.  label: what tells it from the others; metrics: nan where there is no number (no sample, never)."""

    name: str
    path: Path
    label: str
    status: str
    attributes: Mapping[str, Any]
    metrics: Mapping[Column, float]

    @property
    def title(self) -> str:
        """How the run ended where it did not complete, then the label: a table may cut the end of it."""
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
        """The completed runs whose number is nearest to zero, at DIGITS; none where there is nothing to choose."""
        numbers = {i: e.metrics.get(column, math.nan) for i, e in enumerate(self.entries)}
        finite_ones = {i: abs(float(digits(v))) for i, v in numbers.items() if math.isfinite(v)}
        ranked = {i: v for i, v in finite_ones.items() if self.entries[i].is_completed}
        if not column.ranked or len(finite_ones) < 2 or not ranked:
            return []
        found = [i for i, value in ranked.items() if value == min(ranked.values())]
        return [] if 1 < len(found) == len(finite_ones) else [self.entries[i] for i in found]


def digits(value: float) -> str:
    """A number as tables show it."""
    return f"{value:#.{DIGITS}g}".rstrip(".")


def find(store: Store, runs: Sequence[str]) -> list[Path]:
    """The records that are meant, each once: by glob over files or run ids, or as `Store.find` finds one.

    Raises StoreError where one of them means none.
    """
    paths = [path for run in runs for path in _meant(store, run)]
    return list({path.resolve(): path for path in reversed(paths)}.values())[::-1]


def _meant(store: Store, run: str) -> list[Path]:
    if not glob.has_magic(run) or Path(run).is_file():
        return [store.find(run)]
    files = [Path(name) for name in sorted(glob.glob(run, recursive=True)) if name.endswith(".h5")]
    records = store.records()
    found = files or [p for p in records if any(fnmatch.fnmatch(n, run) for n in (p.stem, f"{p.parent.name}/{p.stem}"))]
    if not found:
        near = did_you_mean(run, [f"{p.parent.name}/{p.stem}" for p in records], "there are")
        raise StoreError(f"no record fits {run!r}, neither a .h5 file here nor a run id in {store.folder}{near}")
    return found


def compare(paths: Iterable[Path], globs: Sequence[str] = ()) -> Comparison:
    """Read records.  globs: over names of metrics; none chooses all.  Raises StoreError where a glob fits no metric."""
    units: dict[tuple[str, str], str] = {}
    found = [_read(path, units) for path in paths]
    names = list(dict.fromkeys(column.name for entry in found for column in entry.metrics))
    for pattern in globs:
        if not fnmatch.filter(names, pattern):
            raise StoreError(f"no metric of these runs fits {pattern!r}{did_you_mean(pattern, names, 'there are')}")
    columns = dict.fromkeys(column for entry in found for column in entry.metrics)
    chosen = [c for c in columns if not globs or any(fnmatch.fnmatchcase(c.name, pattern) for pattern in globs)]
    entries = [
        Entry(name, e.path, label, e.status, e.attributes, e.metrics)
        for e, name, label in zip(found, _names(found), _labels(found), strict=True)
    ]
    return Comparison(entries, chosen, list(_notes(entries, chosen)))


def _read(path: Path, units: dict[tuple[str, str], str]) -> Entry:
    """A record as an entry without a label.  units: {(digest of an FMU, variable): unit}, those known already."""
    with Run(path) as run:
        attributes, status = run.attributes, run.status
        resolved = attributes["experiment_resolved"]
        digests = {c["name"]: c["fmu_sha256"] for c in resolved["components"]}
        values = {}
        for name, value in attributes["metrics"].items():
            spec = resolved["metrics"][name]
            values[_column(run, name, spec, digests, units)] = math.nan if value is None else float(value)
    kept = ("run_id", "experiment", "title", "error", "experiment_resolved")
    return Entry("", path, "", status, {name: attributes[name] for name in kept}, values)


def _column(
    run: Run, name: str, spec: Mapping[str, Any], digests: Mapping[str, str], units: dict[tuple[str, str], str]
) -> Column:
    if spec["of"] not in METRICS:  # a record of another version of orch
        return Column(name, spec["of"], spec.get("unit", ""), ranked=False)
    signal, of_signal = spec["signal"], {}
    if "{}" in METRICS[spec["of"]].unit and "unit" not in spec:
        component, _, variable = signal.partition(".")
        key = digests[component], variable
        units[key] = of_signal[signal] = units.get(key) or run.units(signal)
    unit = unit_of(spec, of_signal)
    return Column(name, spec["of"], "" if unit == "1" else unit, smaller_is_better(spec))


def _names(entries: Sequence[Entry]) -> list[str]:
    """Run ids; of records that share one, the names of their files or, where these are the same too, the paths."""
    ways = [(str(e.attributes["run_id"]), e.path.stem, str(e.path)) for e in entries]
    count = Counter(name for way in ways for name in set(way))
    return [next((name for name in way if count[name] == 1), way[-1]) for way in ways]


def _labels(entries: Sequence[Entry]) -> list[str]:
    """The experiment, where there are several, and what differs among the runs of one."""
    experiments: dict[str, list[int]] = {}
    for i, entry in enumerate(entries):
        experiments.setdefault(entry.attributes["experiment"], []).append(i)
    result = [""] * len(entries)
    for experiment, members in experiments.items():
        for i, words in zip(members, _differing([entries[i] for i in members]), strict=True):
            result[i] = ", ".join([experiment, *words] if len(experiments) > 1 else words)
    return result


def _differing(entries: Sequence[Entry]) -> list[list[str]]:
    """What differs; of runs that differ in FMUs, what differs among those with the same ones, too."""
    words = labels_of([entry.attributes["experiment_resolved"] for entry in entries])
    result = [[word] if word else [] for word in words]
    groups = {word: [i for i, other in enumerate(words) if other == word] for word in words}
    for members in groups.values():
        if 1 < len(members) < len(entries):
            for i, more in zip(members, _differing([entries[i] for i in members]), strict=True):
                result[i] += more
    return result


def _notes(entries: Sequence[Entry], columns: Sequence[Column]) -> Iterator[str]:
    """Metrics that share a name, and are not the same thing in all runs."""
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
    """Numbers by their size, before words."""
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
