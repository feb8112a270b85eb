"""Signals over time as lines of few points: no peak is lost, an angle that wraps leaves a gap, a band lies beside.

A band is the range from the least to the greatest value between rows, as the record's envelope has it: without it a
line through rows is flat where the signal oscillates from row to row.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from ..arrays import Places, Reals, Truths

BAND = "least to greatest between rows"  # what a legend calls it
TURN = 360.0  # deg


class Band(NamedTuple):
    """least[k] and greatest[k] hold from edges[k] to edges[k + 1]; nan where there is none.

    edges: (K + 1,) [s]; least, greatest: (K,).
    """

    edges: Reals
    least: Reals
    greatest: Reals


def thin(values: Reals, most: int) -> Places:
    """Rows of (N,) that draw the same line: the lowest and the highest of each of most/2 stretches, so no peak is lost.

    Rows inside a constant stretch are left out as well.  Returns (K,) with K <= most, ascending.
    """
    rows = np.arange(len(values))
    if len(values) > most:
        edges = _edges(len(values), most // 2)  # most/2 - 1 stretches and the two ends
        first = edges[:-1]
        stretch = np.repeat(np.arange(len(first)), np.diff(edges))
        order = np.lexsort((np.nan_to_num(values), stretch))
        rows = np.unique(np.concatenate([order[first], order[edges[1:] - 1], [0, len(values) - 1]]))
    kept = values[rows]
    same = kept[1:] == kept[:-1]
    inside = np.zeros(len(rows), bool)
    inside[1:-1] = same[:-1] & same[1:]
    return rows[~inside]


def line(time: Reals, values: Reals, most: int, turn: float = 0.0) -> tuple[Reals, Reals]:
    """The points of a line through values (N,) over time (N,) [s].

    turn: a full turn of an angle in its unit, 0 of anything else.  Between two rows that are more than half a turn
    apart it wrapped, and there is a point without a value, so that nothing is drawn across the figure.
    """
    rows = thin(values, most)
    points = time[rows], values[rows]
    if not turn:
        return points
    wraps = np.flatnonzero(np.diff(_wraps(values, turn).cumsum()[rows])) + 1
    return np.insert(points[0], wraps, points[0][wraps]), np.insert(points[1], wraps, np.nan)


def band(time: Reals, values: Reals, bounds: Reals, most: int, turn: float = 0.0) -> Band:
    """The band beside a line: of the rows after the first, or of at most `most` stretches of them.

    time, values: (N,), the rows; bounds: (N, 2), the least and the greatest value since the row before; turn: as of
    `line`.  An angle that wraps between two rows has no band there: its values lie at both ends of the turn.
    """
    bounds = bounds.astype(float)
    if turn:
        bounds[_wraps(values, turn) | (bounds[:, 1] - bounds[:, 0] > turn / 2)] = np.nan
    edges = _edges(len(time) - 1, min(most, len(time) - 1) + 1)
    if len(edges) < 2:
        return Band(time[:1], np.empty(0), np.empty(0))
    least, greatest = (extreme.reduceat(bounds[1:, i], edges[:-1]) for i, extreme in enumerate((np.fmin, np.fmax)))
    return Band(time[edges], least, greatest)


def _edges(count: int, edges: int) -> Places:
    return np.linspace(0, count, edges).astype(np.intp)


def _wraps(values: Reals, turn: float) -> Truths:
    """Whether the value wrapped since the row before, (N,)."""
    wraps: Truths = np.r_[False, abs(np.diff(values)) > turn / 2]
    return wraps
