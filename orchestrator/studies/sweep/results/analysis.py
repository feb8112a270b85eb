"""Statistics of a sweep: of each contender, and of every pair of them on the draws that both completed.

Means have 95 % bootstrap intervals (BCa; Efron, 1987).  Pairs are compared draw by draw with Wilcoxon's signed-rank
test (differences of zero as in Pratt, 1959), and the p-values of all comparisons of the table are corrected
together (Holm, 1979).  The effect size is the matched-pairs rank-biserial correlation (Kerby, 2014): +1 where the first
is larger in every draw, -1 where it is smaller in every one.
"""

from __future__ import annotations

import fnmatch
import itertools
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....arrays import Reals
from ....errors import OrchError, StoreError, did_you_mean
from ....records.compare.side_by_side import Column
from ..engine.storage import MISSING
from ..engine.table import SweepTable

RESAMPLES = 2000
SEED = 20_191_104  # of the resampling, so that the same table gives the same intervals
LEVEL = 0.05  # of significance


@dataclass(frozen=True, kw_only=True)
class ContenderSummary:
    """One contender and one metric, in its unit.

    n: completed runs with a number; low, high: the 95 % interval of the mean.
    """

    contender: str
    metric: Column
    n: int
    mean: float
    std: float
    median: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class PairComparison:
    """Two contenders and one metric, on the n draws that both completed.

    difference: the mean of first - second; low, high: its 95 % interval; p: of Wilcoxon's test; p_holm: corrected;
    effect: the rank-biserial correlation, -1 .. 1.
    """

    first: str
    second: str
    metric: Column
    n: int
    difference: float
    low: float
    high: float
    p: float
    p_holm: float
    effect: float

    @property
    def smaller(self) -> str:
        """The contender whose metric is smaller, where the difference is significant at LEVEL; else ""."""
        if not self.p_holm < LEVEL or self.effect == 0.0:
            return ""
        return self.first if self.effect < 0 else self.second


@dataclass(frozen=True, kw_only=True)
class SweepAnalysis:
    """The statistics of one table.

    by: what tells the contenders apart; keys: the columns that hold it; contenders: their names, in the order of the
    file; failures: of each, the runs without a completed record; names: of the contenders, by their cells.
    """

    table: SweepTable
    by: str
    keys: list[str]
    contenders: list[str]
    columns: list[Column]
    summaries: list[ContenderSummary]
    pairs: list[PairComparison]
    failures: dict[str, int]
    notes: list[str]
    names: dict[tuple[str, ...], str]

    def contender_of(self, row: dict[str, Any]) -> str:
        return self.names[_cells(row, self.keys)]

    def of(self, metric: Column) -> list[ContenderSummary]:
        return [s for s in self.summaries if s.metric == metric]

    def best(self, metric: Column) -> str:
        """The contender whose mean is nearest to zero; "" where the metric has no best value, or no two have one."""
        numbers = [s for s in self.of(metric) if math.isfinite(s.mean)]
        return min(numbers, key=lambda s: abs(s.mean)).contender if metric.ranked and len(numbers) > 1 else ""


def analyse(table: SweepTable, globs: Sequence[str] = (), by: str = "") -> SweepAnalysis:
    """The statistics of a sweep's table.

    globs: over names of metrics; none chooses all.  by: the list whose values compete, by default the first one.
    Raises StoreError where a glob or `by` matches nothing, OrchError where scipy is not installed.
    """
    columns = _columns(table, globs)
    group = _group(table, by)
    names = _names(table, group)
    values: dict[tuple[str, Column], dict[Any, float]] = {}
    failures = dict.fromkeys(names.values(), 0)
    others = [keys for keys in table.groups if keys != group]
    for row in table.rows:
        contender = names[_cells(row, group)]
        if row["status"] != "completed":
            failures[contender] += 1
            continue
        pair = (row["draw"], *(_cells(row, keys) for keys in others))
        for column in columns:
            if math.isfinite(row[column.name]):
                values.setdefault((contender, column), {})[pair] = row[column.name]
    contenders = list(names.values())
    summaries = [_summary(c, column, values.get((c, column), {})) for column in columns for c in contenders]
    pairs = [
        _pair(one, other, column, values.get((one, column), {}), values.get((other, column), {}))
        for column in columns
        for one, other in itertools.combinations(contenders, 2)
    ]
    short = len({cells[:1] for cells in names}) == len(names)  # the first key of a zipped group may be enough
    by = " + ".join(table.labels[key] for key in group[: 1 if short else None]) or "runs"
    notes = _notes(failures, table)
    return SweepAnalysis(
        table=table,
        by=by,
        keys=group,
        contenders=contenders,
        columns=columns,
        summaries=summaries,
        pairs=_corrected(pairs),
        failures=failures,
        notes=notes,
        names=names,
    )


def _columns(table: SweepTable, globs: Sequence[str]) -> list[Column]:
    names = [column.name for column in table.columns]
    for pattern in globs:
        if not fnmatch.filter(names, pattern):
            raise StoreError(f"no metric of this sweep matches {pattern!r}{did_you_mean(pattern, names, 'there are')}")
    return [c for c in table.columns if not globs or any(fnmatch.fnmatchcase(c.name, pattern) for pattern in globs)]


def _group(table: SweepTable, by: str) -> list[str]:
    """The keys whose values tell the contenders apart; none where the sweep has no list."""
    if not by:
        return table.groups[0] if table.groups else []
    known = {name: keys for keys in table.groups for key in keys for name in (key, table.labels[key])}
    if by not in known:
        raise StoreError(f"--by {by}: no list of this sweep{did_you_mean(by, known, 'there are')}")
    return known[by]


def _cells(row: dict[str, Any], keys: Sequence[str]) -> tuple[str, ...]:
    return tuple(row[key] for key in keys)


def _names(table: SweepTable, group: list[str]) -> dict[tuple[str, ...], str]:
    """{cells of the group: name of the contender}, the first cell, or all where two contenders share the first one."""
    different = list(dict.fromkeys(_cells(row, group) for row in table.rows))
    if not group:
        return {(): table.description["experiment"]}
    short = [cells[0] for cells in different]
    names = short if len(set(short)) == len(short) else [", ".join(cells) for cells in different]
    return dict(zip(different, names, strict=True))


def _summary(contender: str, metric: Column, values: dict[Any, float]) -> ContenderSummary:
    x: Reals = np.array([values[pair] for pair in sorted(values, key=repr)])
    n, (low, high) = len(x), _interval(x)
    return ContenderSummary(
        contender=contender,
        metric=metric,
        n=n,
        mean=float(x.mean()) if n else math.nan,
        std=float(x.std(ddof=1)) if n > 1 else math.nan,
        median=float(np.median(x)) if n else math.nan,
        low=low,
        high=high,
    )


def _pair(first: str, second: str, metric: Column, one: dict[Any, float], other: dict[Any, float]) -> PairComparison:
    shared = sorted(one.keys() & other.keys(), key=repr)
    d: Reals = np.array([one[pair] - other[pair] for pair in shared])
    n, (low, high) = len(d), _interval(d)
    p, effect = _wilcoxon(d) if n else (math.nan, math.nan)
    return PairComparison(
        first=first,
        second=second,
        metric=metric,
        n=n,
        difference=float(d.mean()) if n else math.nan,
        low=low,
        high=high,
        p=p,
        p_holm=math.nan,
        effect=effect,
    )


def _interval(x: Reals) -> tuple[float, float]:
    """The 95 % interval of the mean of x (N,)."""
    stats = _stats()
    if len(x) < 2:
        return math.nan, math.nan
    if float(np.ptp(x)) == 0.0:
        return float(x[0]), float(x[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a degenerate distribution gives nan, which is shown
        result = stats.bootstrap((x,), np.mean, n_resamples=RESAMPLES, rng=np.random.default_rng(SEED), method="BCa")
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def _wilcoxon(d: Reals) -> tuple[float, float]:
    """The two-sided p-value and the rank-biserial correlation of paired differences d (N,)."""
    stats = _stats()
    if not d.any():
        return 1.0, 0.0
    ranks = stats.rankdata(abs(d))
    above, below = float(ranks[d > 0].sum()), float(ranks[d < 0].sum())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # few draws: the p-value is approximate
        p = float(stats.wilcoxon(d, zero_method="pratt").pvalue)
    return p, (above - below) / (above + below)


def _corrected(pairs: Sequence[PairComparison]) -> list[PairComparison]:
    """Holm's step-down correction over all comparisons that have a p-value."""
    order = sorted((i for i, pair in enumerate(pairs) if math.isfinite(pair.p)), key=lambda i: pairs[i].p)
    corrected, largest = list(pairs), 0.0
    for rank, i in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * pairs[i].p))
        corrected[i] = replace(pairs[i], p_holm=largest)
    return corrected


def _notes(failures: dict[str, int], table: SweepTable) -> list[str]:
    missing = sum(row["status"] == "missing" for row in table.rows)
    notes = [f"{missing} of {len(table.rows)} runs are missing: run the sweep again to complete it"] if missing else []
    if table.unsampled:
        empty = ", ".join(sorted({metric for _, metric in table.unsampled}))
        notes.append(f"no sample falls into the window of {empty} in {len({run for run, _ in table.unsampled})} runs")
    if counts := ", ".join(f"{name} {n}" for name, n in failures.items() if n):
        notes.append(f"runs without a completed record, left out of the statistics: {counts}")
    return notes


def _stats() -> Any:
    try:
        from scipy import stats
    except ImportError:
        raise OrchError(MISSING) from None
    return stats


def as_json(analysis: SweepAnalysis) -> dict[str, Any]:
    """The statistics, as JSON can hold them."""

    def number(value: float) -> float | None:
        return value if math.isfinite(value) else None

    summaries = [
        {
            "contender": s.contender,
            "metric": s.metric.name,
            "unit": s.metric.unit,
            "n": s.n,
            "mean": number(s.mean),
            "std": number(s.std),
            "median": number(s.median),
            "ci95": [number(s.low), number(s.high)],
        }
        for s in analysis.summaries
    ]
    pairs = [
        {
            "first": p.first,
            "second": p.second,
            "metric": p.metric.name,
            "n": p.n,
            "difference": number(p.difference),
            "ci95": [number(p.low), number(p.high)],
            "p": number(p.p),
            "p_holm": number(p.p_holm),
            "effect": number(p.effect),
            "smaller": p.smaller or None,
        }
        for p in analysis.pairs
    ]
    return {
        "sweep_id": analysis.table.sweep_id,
        "by": analysis.by,
        "contenders": analysis.contenders,
        "failures": analysis.failures,
        "summaries": summaries,
        "pairs": pairs,
        "notes": analysis.notes,
    }
