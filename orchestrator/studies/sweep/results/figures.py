"""A sweep as a figure: box, violin, empirical distribution, heat map over two factors, parallel coordinates."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ....arrays import Reals
from ....errors import StoreError, did_you_mean
from ....metrics import on_circle
from ....records.compare.side_by_side import Column
from ....records.file.marks import DAGGER
from ....views import figures
from ..engine.table import SweepTable
from . import statistics
from .analysis import SweepAnalysis
from .tables import head_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANEL = 3.6, 2.8  # inches
ACROSS = 3  # panels beside each other
BINS = 6  # of a factor of a heat map that has more values

Bins = tuple[Callable[[str], int], list[str]]  # which bin a cell of the table falls into, and the names of all


def draw(analysis: SweepAnalysis, target: Path, kind: str = "box", over: Sequence[str] = ()) -> None:
    """Write a figure: PNG, PDF or SVG.

    kind: box, violin, ecdf, heatmap or parallel.  over: the two factors of a heat map, by default the first two that
    have a distribution.  Raises StoreError where the file cannot be written, or nothing of a factor's name varies.
    """
    figures.save(figure(analysis, kind, over), target)


@figures.style()
def figure(analysis: SweepAnalysis, kind: str = "box", over: Sequence[str] = ()) -> Figure:
    """The figure of `draw`."""
    from matplotlib.figure import Figure

    if kind == "heatmap":
        return _heatmaps(analysis, *_factors(analysis.table, over))
    if kind == "parallel":
        return _parallel(analysis)
    panel: Callable[[Axes, SweepAnalysis, Column], None] = {"box": _box, "violin": _violin, "ecdf": _ecdf}[kind]
    n = len(analysis.columns)
    across = min(ACROSS, n)
    down = -(-n // across)
    drawn = Figure(figsize=(PANEL[0] * across, PANEL[1] * down), layout="constrained")
    axes = drawn.subplots(down, across, squeeze=False).flat
    for axis, column in zip(axes, analysis.columns, strict=False):
        panel(axis, analysis, column)
    for axis in list(axes)[n:]:
        axis.set_visible(False)
    return drawn


def values(analysis: SweepAnalysis, contender: str, column: Column) -> Reals:
    """The metric of a contender in the draws in which it has a number, (N,); angles without a seam among them."""
    numbers = _numbers(analysis, contender, column)
    return _together(analysis, column, numbers[np.isfinite(numbers)])


def _numbers(analysis: SweepAnalysis, contender: str, column: Column) -> Reals:
    numbers: Reals = np.array([one.value for one in analysis.outcomes[contender, column].values()])
    return numbers


def _together(analysis: SweepAnalysis, column: Column, numbers: Reals) -> Reals:
    """Angles within half a turn of the mean of all contenders, so that -179 lies beside 179; others as they are."""
    if not column.turn:
        return numbers
    everything = np.concatenate([_numbers(analysis, name, column) for name in analysis.contenders])
    center = statistics.mean(everything[np.isfinite(everything)], column.turn)
    return center + on_circle(numbers - center, column.turn)


def _name(analysis: SweepAnalysis, contender: str, column: Column) -> str:
    """A contender; where draws are lost to it, also in how many it has a number, with a dagger if a mark is why."""
    s = next(s for s in analysis.of(column) if s.contender == contender)
    return contender if s.n == s.draws else f"{contender} {s.n}/{s.draws}{DAGGER * bool(s.marks)}"


def _box(axis: Axes, analysis: SweepAnalysis, column: Column) -> None:
    data = [values(analysis, name, column) for name in analysis.contenders]
    axis.boxplot(data, showmeans=True, flierprops={"markersize": 3}, medianprops={"color": "C1"})
    _contenders(axis, analysis, column)


def _violin(axis: Axes, analysis: SweepAnalysis, column: Column) -> None:
    for i, name in enumerate(analysis.contenders, 1):
        data = values(analysis, name, column)
        if len(data) > 1 and np.ptp(data) > 0:  # a density needs a width
            axis.violinplot([data], positions=[i], showmedians=True, widths=0.8)
        else:
            axis.plot([i] * len(data), data, "_", color="C0")
    _contenders(axis, analysis, column)


def _contenders(axis: Axes, analysis: SweepAnalysis, column: Column) -> None:
    places = range(1, len(analysis.contenders) + 1)
    names = [_name(analysis, contender, column) for contender in analysis.contenders]
    axis.set_xticks(list(places), names, rotation=30, ha="right", fontsize=8)
    axis.set_ylabel(head_of(column))
    axis.grid(axis="y", alpha=0.3)


def _ecdf(axis: Axes, analysis: SweepAnalysis, column: Column) -> None:
    """Of all draws that were run: where some have no number, the line ends below 1."""
    for i, name in enumerate(analysis.contenders):
        data = np.sort(values(analysis, name, column))
        if len(data):
            shares = np.arange(len(data) + 1) / len(analysis.outcomes[name, column])
            label = _name(analysis, name, column)
            axis.step(np.r_[data[0], data], shares, where="post", label=label, color=f"C{i}")
    axis.set_ylim(0.0, 1.02)
    axis.set_xlabel(head_of(column))
    axis.set_ylabel("share of the draws")
    axis.grid(alpha=0.3)
    if axis.lines:
        axis.legend(fontsize=7)


def _factors(table: SweepTable, over: Sequence[str]) -> tuple[str, str]:
    """The keys of the two factors of a heat map."""
    known = {name: key for key in table.keys for name in (key, table.labels[key])}
    listed = [key for group in table.groups for key in group]
    for name in over:
        if name not in known:
            raise StoreError(f"--over {name}: nothing of that name varies{did_you_mean(name, known, 'there are')}")
    chosen = [known[name] for name in over]
    chosen += [key for key in table.keys if key not in chosen and key not in listed]
    chosen += [key for key in table.keys if key not in chosen]
    if len(over) > 2 or len(chosen) < 2:
        raise StoreError("a heat map is over two factors: give --over twice, for two keys that vary")
    return chosen[0], chosen[1]


def _heatmaps(analysis: SweepAnalysis, one: str, other: str) -> Figure:
    """Medians in cells: a row of panels for each metric, a panel for each contender."""
    from matplotlib.figure import Figure

    down, across = len(analysis.columns), len(analysis.contenders)
    drawn = Figure(figsize=(1 + 2.4 * across, 0.6 + 2.3 * down), layout="constrained")
    axes = drawn.subplots(down, across, squeeze=False, sharex=True, sharey=True)
    labels, rows = analysis.table.labels, [row for of in analysis.runs.values() for row in of.values()]
    sorts = [_bins([row[key] for row in rows]) for key in (one, other)]
    for i, column in enumerate(analysis.columns):
        cells = [_cells(analysis, name, column, (one, other), sorts) for name in analysis.contenders]
        low, high = _range(np.concatenate([cell.ravel() for cell in cells]))
        for axis, name, cell in zip(axes[i], analysis.contenders, cells, strict=True):
            image = axis.imshow(cell, origin="lower", aspect="auto", vmin=low, vmax=high, cmap="viridis")
            axis.plot(*np.argwhere(np.isposinf(cell)).T[::-1], "x", color="C3", markersize=5)
            axis.set_title(_name(analysis, name, column), fontsize=9)
            axis.set_xticks(range(len(sorts[0][1])), sorts[0][1], rotation=60, fontsize=6)
            axis.set_yticks(range(len(sorts[1][1])), sorts[1][1], fontsize=6)
            if i == down - 1:
                axis.set_xlabel(labels[one], fontsize=8)
        axes[i][0].set_ylabel(labels[other], fontsize=8)
        drawn.colorbar(image, ax=list(axes[i]), label=f"median {head_of(column)}\n(x: none in half of the draws)")
    return drawn


def _bins(texts: Sequence[str]) -> Bins:
    """The bin of each cell of the table, and the names of the bins; of equal width where there are many numbers."""
    different = sorted(set(texts), key=_number)
    if len(different) <= BINS or any(math.isnan(_number(text)) for text in different):
        return different.index, different
    edges = np.linspace(_number(different[0]), _number(different[-1]), BINS + 1)
    names = [f"{(a + b) / 2:.3g}" for a, b in itertools.pairwise(edges)]
    return lambda text: int(np.clip(np.searchsorted(edges, _number(text), "right") - 1, 0, BINS - 1)), names


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _cells(
    analysis: SweepAnalysis, contender: str, column: Column, keys: tuple[str, str], sorts: Sequence[Bins]
) -> Reals:
    """Medians, (bins of the second factor, bins of the first); nan where no run falls into a cell.

    A draw without a number is worse than any, so that inf means that half of those in the cell have none.
    """
    by_cell: dict[tuple[int, int], list[float]] = {}
    for draw, row in analysis.runs[contender].items():
        value = analysis.outcomes[contender, column][draw].value
        place = sorts[1][0](row[keys[1]]), sorts[0][0](row[keys[0]])
        by_cell.setdefault(place, []).append(value if math.isfinite(value) else math.inf)
    cells = np.full((len(sorts[1][1]), len(sorts[0][1])), np.nan)
    for place, numbers in by_cell.items():
        lost = 2 * numbers.count(math.inf) >= len(numbers)
        of = np.array(sorted(n for n in numbers if not column.turn or math.isfinite(n)))  # no angle is worse than any
        cells[place] = math.inf if lost else statistics.median(of, column.turn)
    finite = np.isfinite(cells)
    cells[finite] = _together(analysis, column, cells[finite])
    return cells


def _range(numbers: Reals) -> tuple[float, float]:
    finite = numbers[np.isfinite(numbers)]
    return (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)


def _parallel(analysis: SweepAnalysis) -> Figure:
    """A line for each run through its factors and metrics, each axis scaled to its values; broken where it has none."""
    from matplotlib.figure import Figure

    table = analysis.table
    listed = {key for group in table.groups for key in group}
    factors = [key for key in table.keys if key not in listed and not math.isnan(_number(table.rows[0][key]))]
    names = [*(table.labels[key] for key in factors), *(head_of(column) for column in analysis.columns)]
    data = {
        contender: np.array(
            [
                [
                    *(_number(row[key]) for key in factors),
                    *(analysis.outcomes[contender, column][draw].value for column in analysis.columns),
                ]
                for draw, row in analysis.runs[contender].items()
            ]
        ).reshape(-1, len(names))
        for contender in analysis.contenders
    }
    for lines in data.values():
        for i, column in enumerate(analysis.columns, len(factors)):
            finite = np.isfinite(lines[:, i])
            lines[finite, i] = _together(analysis, column, lines[finite, i])
    everything = np.concatenate(list(data.values()))
    ranges = [_range(everything[:, i]) for i in range(len(names))]
    drawn = Figure(figsize=(max(6.0, 1.1 * len(names)), 4.5), layout="constrained")
    axis = drawn.subplots()
    for i, (contender, lines) in enumerate(data.items()):
        label = contender + DAGGER * any(s.marks for s in analysis.summaries if s.contender == contender)
        for k, line in enumerate(np.where(np.isfinite(lines), lines, np.nan)):
            scaled = [(v - low) / (high - low or 1.0) for v, (low, high) in zip(line, ranges, strict=True)]
            axis.plot(scaled, color=f"C{i}", alpha=0.25, linewidth=0.7, label=label if k == 0 else None)
    shown = [f"{name}\n{low:.3g} .. {high:.3g}" for name, (low, high) in zip(names, ranges, strict=True)]
    axis.set_xticks(range(len(names)), shown, rotation=40, ha="right", fontsize=7)
    axis.set_yticks([])
    for handle in axis.legend(fontsize=8).get_lines():
        handle.set_alpha(1.0)
    return drawn
