"""Panels of curves over time, and the colours and line styles that every figure of orch shares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from .. import lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ...arrays import Reals


OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")  # safe for the colour-blind
GREY = "#606060"
DESIRED: dict[str, Any] = {"color": "#1a1a1a", "linewidth": 0.8, "linestyle": (0, (4, 3)), "zorder": 3}
DENSE: dict[str, Any] = {"linewidth": 0.8, "alpha": 0.8}  # for commands that chatter
STYLE: Any = {
    "font.size": 9,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#999999",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.xmargin": 0,
    "xtick.color": "#999999",
    "ytick.color": "#999999",
    "xtick.labelcolor": "#333333",
    "ytick.labelcolor": "#333333",
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "lines.linewidth": 1.5,
    "svg.hashsalt": "orch",
    "pdf.fonttype": 42,
}
MAX_POINTS = 5000  # of a line; a longer signal is thinned to the extremes of each stretch
MAX_STEPS = 1500  # of a band: more than a panel has pixels across
BAND: dict[str, Any] = {"alpha": 0.3, "linewidth": 0.7}  # with an edge, so that one row among thousands is seen
SYMBOLS = {"phi": r"\phi", "theta": r"\theta", "psi": r"\psi"}


@dataclass(frozen=True)
class Curve:
    """values over time, both (N,), in the panel's unit.

    style: of matplotlib's plot.  bounds: (N, 2), the least and the greatest value since the row before, where they are
    recorded.  turn: of an angle, 360 in degrees; 0 of anything else.
    """

    time: Reals
    values: Reals
    style: dict[str, Any]
    bounds: Reals | None = None
    turn: float = 0.0


@dataclass(frozen=True)
class Panel:
    """Curves on one pair of axes.

    down: the vertical axis points down; span: its least extent; share: panels of one name get the same extent.
    """

    label: str
    curves: list[Curve]
    title: str = ""
    down: bool = False
    span: float = 0.0
    share: str = ""


def draw_rows(figure: Figure, rows: Sequence[Sequence[Panel]]) -> list[Axes]:
    """Draw panels below each other with one time axis."""
    grid = figure.subplots(len(rows), max(map(len, rows)), squeeze=False, sharex=True)
    drawn: list[tuple[Axes, Panel]] = []
    for row, places in zip(rows, grid, strict=True):
        drawn += zip(places, row, strict=False)
        for ax in places[len(row) :]:
            ax.remove()
    for ax, panel in drawn:
        _draw(ax, panel)
    for share in {panel.share for _, panel in drawn} - {""}:
        members = [ax for ax, panel in drawn if panel.share == share]
        limits = np.array([ax.get_ylim() for ax in members])
        for ax in members:
            ax.set_ylim(limits[:, 0].min(), limits[:, 1].max())
    curves = [curve for _, panel in drawn for curve in panel.curves]
    start, stop = min(curve.time[0] for curve in curves), max(curve.time[-1] for curve in curves)
    if stop > start:
        drawn[0][0].set_xlim(start, stop)
    for ax, panel in drawn:
        if panel.down:
            ax.invert_yaxis()
        if ax.get_subplotspec().is_last_row():  # type: ignore[union-attr]
            ax.set_xlabel("$t$ [s]")
        else:
            ax.tick_params(bottom=False)
    figure.align_ylabels()
    return [ax for ax, _ in drawn]


def _draw(ax: Axes, panel: Panel) -> None:
    for curve in panel.curves:
        marker: dict[str, Any] = {"marker": "."} if len(curve.time) == 1 else {}
        ax.plot(*lines.line(curve.time, curve.values, MAX_POINTS, curve.turn), **curve.style, **marker)
        if curve.bounds is not None:
            _draw_band(ax, lines.band(curve.time, curve.values, curve.bounds, MAX_STEPS, curve.turn), curve.style)
    low, high = ax.get_ylim()
    if high - low < panel.span:
        middle = (low + high) / 2
        ax.set_ylim(middle - panel.span / 2, middle + panel.span / 2)
    ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    ax.set_ylabel(panel.label)
    ax.set_title(panel.title)
    labelled = ax.get_legend_handles_labels()[1]
    if labelled:
        ax.legend(
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            ncols=1 + (len(labelled) - 1) // 7,
            fontsize=8,
            handlelength=1.2,
            labelspacing=0.2,
            columnspacing=1.0,
        )


def _draw_band(ax: Axes, band: lines.Band, style: dict[str, Any]) -> None:
    """Fill a band below all lines, each stretch without a gap as a shape of its own."""
    for first, end in np.flatnonzero(np.diff(np.r_[False, ~np.isnan(band.least), False])).reshape(-1, 2):
        x = np.repeat(band.edges[first : end + 1], 2)[1:-1]
        y = np.r_[np.repeat(band.greatest[first:end], 2), np.repeat(band.least[first:end], 2)[::-1]]
        ax.fill(np.r_[x, x[::-1]], y, color=style["color"], **BAND)


def band_key() -> Patch:
    """What the legend says of bands, once for all."""
    return Patch(color=GREY, label=lines.BAND, **BAND)


def colour(k: int, lightness: int = 0) -> Any:
    """The k-th colour, lightened `lightness` times, and once more each time that the palette is used up."""
    return tint(OKABE_ITO[k % len(OKABE_ITO)], lightness + k // len(OKABE_ITO))


def tint(name: str, lightness: int) -> Any:
    """The colour half way to white, `lightness` times."""
    return tuple(1 - 0.5**lightness * (1 - part) for part in to_rgb(name))


def symbol(axis: str) -> str:
    """How an axis of a vector is printed: phi as the letter, T1 with an index; a longer name as it is."""
    if axis in SYMBOLS:
        return f"${SYMBOLS[axis]}$"
    if axis[:1].isalpha() and axis.isascii() and (len(axis) == 1 or axis[1:].isdigit()):
        return f"${axis[0]}_{{{axis[1:]}}}$" if axis[1:] else f"${axis}$"
    return plain(axis)


def plain(text: str) -> str:
    """Text that matplotlib does not read as mathematics."""
    return text.replace("$", r"\$")
