"""Statistics of a sweep: of each contender, and of every pair of them on the draws that both have.

A draw counts once, however often it was drawn.  A number that `records.file.marks` speaks against is none: the draw is
lost to its contender, and counted.  `never` (inf) is no number for means, and the worst rank in tests.  What a metric
is ranked by is its magnitude; angles are taken on the circle.  docs/sweeps.md states the rules.

Means have 95 % bootstrap intervals (BCa; Efron, 1987), shares of draws Wilson's (1927).  Pairs are compared draw by
draw with Wilcoxon's signed-rank test (differences of zero as in Pratt, 1959), and the p-values of all comparisons of
the table are corrected together (Holm, 1979).  The effect size is the matched-pairs rank-biserial correlation (Kerby,
2014): +1 where the first is larger in every draw, -1 where it is smaller in every one.
"""

from __future__ import annotations

import fnmatch
import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....arrays import Reals
from ....errors import StoreError, did_you_mean
from ....metrics import on_circle
from ....records.compare.side_by_side import Column, digits
from ..engine.table import SweepTable, standing_of
from ..engine.worker import COMPLETED, FAILED, MISSING
from . import statistics
from .outcomes import NEVER, NO_VALUE, Draw, DrawOutcome, cells, distinct, outcome, unlike

LEVEL = 0.05  # of significance
FEW = 10  # draws, below which a bootstrap interval covers much less than it says


@dataclass(frozen=True, kw_only=True)
class ContenderSummary:
    """One contender and one metric, in its unit, on the n draws in which it has a number.

    low, high: the 95 % interval of the mean; draws: distinct ones that were run; lost: {why: draws without a number};
    share: Wilson's 95 % interval of n / draws; common: draws in which every contender that competes has a number, nan
    of this one where it does not; common_mean: the mean on those, of magnitudes where the metric ranks by them.
    """

    contender: str
    metric: Column
    n: int
    mean: float
    std: float
    median: float
    low: float
    high: float
    draws: int
    lost: Mapping[str, int]
    share: tuple[float, float]
    common: int
    common_mean: float

    @property
    def marks(self) -> dict[str, int]:
        """{what speaks against runs that completed: how many draws}"""
        return {why: n for why, n in self.lost.items() if why not in (NEVER, NO_VALUE, FAILED)}

    @property
    def competes(self) -> bool:
        """Whether it has a number in at least half of its draws; else its few would leave the others none."""
        return self.n > 0 and 2 * self.n >= self.draws


@dataclass(frozen=True, kw_only=True)
class PairComparison:
    """Two contenders and one metric, on the n draws in which each has a number or `never`.

    numbers: of these, those in which both have a number; difference: the mean of first - second on them; low, high: its
    95 % interval; p: of Wilcoxon's test on all n; p_holm: corrected; effect: the rank-biserial correlation, -1 .. 1;
    fewer: the contender that has a number in fewer draws, or "".
    """

    first: str
    second: str
    metric: Column
    n: int
    numbers: int
    difference: float
    low: float
    high: float
    p: float
    p_holm: float
    effect: float
    fewer: str

    @property
    def smaller(self) -> str:
        """The contender whose metric is smaller, where the difference is significant at LEVEL; else ""."""
        if not self.p_holm < LEVEL or self.effect == 0.0:
            return ""
        return self.first if self.effect < 0 else self.second


@dataclass(frozen=True, kw_only=True)
class SweepAnalysis:
    """The statistics of one table.

    by: what tells the contenders apart; contenders: their names, in the order of the file; runs: {contender: {draw: its
    row}}, each draw once; outcomes: what these say; failures: of each, the runs without a completed record; unlike:
    the metrics that are not one metric for all contenders.
    """

    table: SweepTable
    by: str
    contenders: list[str]
    columns: list[Column]
    summaries: list[ContenderSummary]
    pairs: list[PairComparison]
    failures: dict[str, int]
    footnotes: list[str]
    notes: list[str]
    runs: Mapping[str, Mapping[Draw, Mapping[str, Any]]]
    outcomes: Mapping[tuple[str, Column], Mapping[Draw, DrawOutcome]]
    unlike: set[str]

    def of(self, metric: Column) -> list[ContenderSummary]:
        return [s for s in self.summaries if s.metric == metric]

    def best(self, metric: Column) -> str:
        """The contender with the least mean magnitude on common draws; "" where that says nothing.

        That is so where the metric has no best value or is not one metric for all, where fewer than two contenders
        compete or have fewer than two draws in common, at a tie of the digits that are shown, where another contender
        has a number in more draws, and where one is better on the draws that these two have in common: a third must
        not take away the draws in which it is.  A contender with marked runs is never the best.
        """
        competing = [s for s in self.of(metric) if s.competes]
        candidates = [s for s in competing if not s.marks]
        if not metric.ranked or metric.name in self.unlike or len(competing) < 2 or not candidates:
            return ""
        least, *others = sorted(candidates, key=lambda s: s.common_mean)
        tied = any(digits(s.common_mean) == digits(least.common_mean) for s in others)
        fewer = any(s.n * least.draws > least.n * s.draws for s in self.of(metric))
        beaten = any(self._difference(least, s) > 0.0 for s in others)
        return "" if least.common < 2 or tied or fewer or beaten else least.contender

    def _difference(self, one: ContenderSummary, other: ContenderSummary) -> float:
        """The mean of one - other on the draws in which both have a number."""
        names = one.contender, other.contender
        pair = next(p for p in self.pairs if p.metric == one.metric and {p.first, p.second} == set(names))
        return pair.difference if pair.first == one.contender else -pair.difference


def analyse(table: SweepTable, globs: Sequence[str] = (), by: str = "") -> SweepAnalysis:
    """The statistics of a sweep's table.

    globs: over names of metrics; none chooses all.  by: the list whose values compete, by default the first one.
    Raises StoreError where a glob or `by` matches nothing, OrchError where scipy is not installed.
    """
    columns = _columns(table, globs)
    group = _group(table, by)
    names = _names(table, group)
    contenders = list(names.values())
    runs = distinct(table, group, names)
    outcomes = {
        (contender, column): {draw: outcome(row, column) for draw, row in runs[contender].items()}
        for contender in contenders
        for column in columns
    }
    differs = unlike(table, group, columns)
    summaries = [
        s for column in columns for s in _summaries([outcomes[c, column] for c in contenders], contenders, column)
    ]
    pairs = [
        _pair(one, other, column, outcomes[one, column], outcomes[other, column])
        for column in columns
        for one, other in itertools.combinations(contenders, 2)
    ]
    short = len({cells[:1] for cells in names}) == len(names)  # the first key of a zipped group may be enough
    by = " + ".join(table.labels[key] for key in group[: 1 if short else None]) or "runs"
    failures = dict.fromkeys(contenders, 0)
    for row in table.rows:
        failures[names[cells(row, group)]] += row["status"] != COMPLETED
    return SweepAnalysis(
        table=table,
        by=by,
        contenders=contenders,
        columns=columns,
        summaries=summaries,
        pairs=[
            replace(pair, p_holm=p) for pair, p in zip(pairs, statistics.holm([pair.p for pair in pairs]), strict=True)
        ],
        failures=failures,
        footnotes=_footnotes(summaries),
        notes=[
            *_notes(failures, table),
            *_counts(table, group, runs, summaries, columns, differs),
        ],
        runs=runs,
        outcomes=outcomes,
        unlike=set(differs),
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


def _names(table: SweepTable, group: list[str]) -> dict[tuple[str, ...], str]:
    """{cells of the group: name of the contender}, the first cell, or all where two contenders share the first one."""
    different = list(dict.fromkeys(cells(row, group) for row in table.rows))
    if not group:
        return {(): table.description["experiment"]}
    short = [cells[0] for cells in different]
    names = short if len(set(short)) == len(short) else [", ".join(cells) for cells in different]
    return dict(zip(different, names, strict=True))


def _summaries(
    outcomes: Sequence[Mapping[Draw, DrawOutcome]], contenders: Sequence[str], metric: Column
) -> list[ContenderSummary]:
    """Of all contenders and one metric; outcomes: of each."""
    summaries = [_summary(name, metric, of) for name, of in zip(contenders, outcomes, strict=True)]
    numbers = [_numbers(of) for of in outcomes]
    competing = [set(x) for x, s in zip(numbers, summaries, strict=True) if s.competes]
    common = sorted(set.intersection(*competing)) if competing else []
    means = [
        statistics.mean(np.array([x[draw] for draw in common]), metric.turn) if s.competes else math.nan
        for x, s in zip(numbers, summaries, strict=True)
    ]
    return [replace(s, common=len(common), common_mean=mean) for s, mean in zip(summaries, means, strict=True)]


def _numbers(outcomes: Mapping[Draw, DrawOutcome]) -> dict[Draw, float]:
    return {draw: one.value for draw, one in outcomes.items() if math.isfinite(one.value)}


def _summary(contender: str, metric: Column, outcomes: Mapping[Draw, DrawOutcome]) -> ContenderSummary:
    """Without what needs the other contenders."""
    numbers = _numbers(outcomes)
    x: Reals = np.array([numbers[draw] for draw in sorted(numbers)])
    n, draws, (low, high) = len(x), len(outcomes), statistics.interval(x, metric.turn)
    return ContenderSummary(
        contender=contender,
        metric=metric,
        n=n,
        mean=statistics.mean(x, metric.turn),
        std=statistics.std(x, metric.turn),
        median=statistics.median(x, metric.turn),
        low=low,
        high=high,
        draws=draws,
        lost=Counter(one.why for one in outcomes.values() if one.why),
        share=statistics.share(n, draws),
        common=0,
        common_mean=math.nan,
    )


def _pair(
    first: str, second: str, metric: Column, one: Mapping[Draw, DrawOutcome], other: Mapping[Draw, DrawOutcome]
) -> PairComparison:
    ran = one.keys() & other.keys()
    shared = sorted(draw for draw in ran if not (math.isnan(one[draw].value) or math.isnan(other[draw].value)))
    a, b = (np.array([of[draw].value for draw in shared]) for of in (one, other))
    numbers = np.isfinite(a) & np.isfinite(b)
    d: Reals = a[numbers] - b[numbers]
    d = on_circle(d, metric.turn) if metric.turn else d
    low, high = statistics.interval(d, metric.turn)
    p, effect = statistics.wilcoxon(statistics.with_never(a, b, numbers, d)) if len(shared) else (math.nan, math.nan)
    has = [sum(math.isfinite(of[draw].value) for draw in ran) for of in (one, other)]
    return PairComparison(
        first=first,
        second=second,
        metric=metric,
        n=len(shared),
        numbers=len(d),
        difference=statistics.mean(d, metric.turn),
        low=low,
        high=high,
        p=p,
        p_holm=math.nan,
        effect=effect,
        fewer=first if has[0] < has[1] else second if has[1] < has[0] else "",
    )


def _notes(failures: dict[str, int], table: SweepTable) -> list[str]:
    missing = sum(row["status"] == "missing" for row in table.rows)
    notes = [f"{missing} of {len(table.rows)} runs are missing: run the sweep again to complete it"] if missing else []
    if table.unsampled:
        empty = ", ".join(sorted({metric for _, metric in table.unsampled}))
        notes.append(f"no sample falls into the window of {empty} in {len({run for run, _ in table.unsampled})} runs")
    if counts := ", ".join(f"{name} {n}" for name, n in failures.items() if n):
        notes.append(f"runs without a completed record, left out of the statistics: {counts}")
    return notes


def _footnotes(summaries: Sequence[ContenderSummary]) -> list[str]:
    """What the daggers mean: completed runs of a contender whose numbers are not taken, by metrics that share it."""
    metrics: dict[str, list[str]] = {}
    for s in summaries:
        for why, n in s.marks.items():
            metrics.setdefault(f"{n} of the {s.draws} draws of {s.contender} {why}", []).append(s.metric.name)
    every = len({s.metric.name for s in summaries})
    return [words if len(names) == every else f"{', '.join(names)}: {words}" for words, names in metrics.items()]


def _counts(
    table: SweepTable,
    group: Sequence[str],
    runs: Mapping[str, Mapping[Draw, Mapping[str, Any]]],
    summaries: Sequence[ContenderSummary],
    columns: Sequence[Column],
    unlike: Mapping[str, str],
) -> list[str]:
    """Draws that count less, or for nothing, and metrics that are not one metric."""
    notes = []
    crossed = [keys for keys in table.groups if keys != group and len({cells(row, keys) for row in table.rows}) > 1]
    if crossed and len({row["draw"] for row in table.rows}) > 1:
        words = "runs that share a draw are not independent, and intervals and p-values are too small"
        notes.append(
            f"each draw counts once for every value of {', '.join(table.labels[keys[0]] for keys in crossed)}: {words}"
        )
    ended = sum(row["status"] != MISSING for row in table.rows)
    distinct = sum(map(len, runs.values()))
    if distinct < ended:
        notes.append(f"{ended} runs are {distinct} distinct ones: values that were drawn again count once")
    never = [
        f"{s.metric.name} of {s.contender} in {s.lost[NEVER]} of {s.draws} draws"
        for s in summaries
        if s.lost.get(NEVER)
    ]
    if never:
        notes.append(f"never, the worst rank in tests and in no mean: {', '.join(never)}")
    if unlike:
        keys = ", ".join(dict.fromkeys(table.labels[key] for key in unlike.values()))
        notes.append(f"{', '.join(unlike)}: not one metric for all, since {keys} differs; it has no best")
    draws = [[tuple(row[c.name] for c in columns) for row in of.values()] for of in runs.values()]
    if all(len(numbers) > 1 and len(set(numbers)) == 1 for numbers in draws) and columns:
        notes.append(
            "all draws of a contender give the same numbers: what varies in them does not matter to these metrics"
        )
    if not table.knows_marks:
        notes.append(
            "the table does not say which runs ended early or warned; orch sweep writes it anew from its records"
        )
    warned = Counter(
        contender
        for contender, of in runs.items()
        for row in of.values()
        if (standing := standing_of(row)).kinds and not standing.marks
    )
    if warned:
        notes.append(
            f"runs with other warnings: {', '.join(f'{name} {n}' for name, n in warned.items())}; see orch show"
        )
    return notes


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
            "ci95_reliable": s.n >= FEW,
            "draws": s.draws,
            "lost": dict(s.lost),
            "success_ci95": [number(bound) for bound in s.share],
            "common": {"n": s.common, "mean": number(s.common_mean)},
            "best": analysis.best(s.metric) == s.contender,
            "marked": bool(s.marks),
        }
        for s in analysis.summaries
    ]
    pairs = [
        {
            "first": p.first,
            "second": p.second,
            "metric": p.metric.name,
            "n": p.n,
            "numbers": p.numbers,
            "difference": number(p.difference),
            "ci95": [number(p.low), number(p.high)],
            "p": number(p.p),
            "p_holm": number(p.p_holm),
            "effect": number(p.effect),
            "ci95_reliable": p.numbers >= FEW,
            "smaller": p.smaller or None,
            "fewer": p.fewer or None,
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
        "footnotes": analysis.footnotes,
        "notes": analysis.notes,
    }
