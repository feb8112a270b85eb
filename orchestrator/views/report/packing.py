"""Numbers on their way into the page: thinned, in single precision, as base64."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...arrays import Places, Reals


MAX_POINTS = 3000  # of a curve; what a screen shows, and few enough for a page of 8 MB
MAX_POSES = 2000  # of a vehicle in the replay; 50 a second over 40 s


def packed(values: Reals) -> dict[str, str]:
    """(N,) or (N, M), row by row, as little-endian float32 in base64; core.js makes a Float32Array of it."""
    return {"f4": base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")}


def thin(values: Reals, most: int = MAX_POINTS) -> Places:
    """Rows of (N,) that draw the same line: the lowest and the highest of each of most/2 stretches, so no peak is lost.

    Rows inside a constant stretch are left out as well.  Returns (K,) with K <= most, ascending.
    """
    rows = np.arange(len(values))
    if len(values) > most:
        edges = np.linspace(0, len(values), most // 2).astype(int)  # most/2 - 1 stretches and the two ends
        first = edges[:-1]
        stretch = np.repeat(np.arange(len(first)), np.diff(edges))
        order = np.lexsort((np.nan_to_num(values), stretch))
        rows = np.unique(np.concatenate([order[first], order[edges[1:] - 1], [0, len(values) - 1]]))
    kept = values[rows]
    same = kept[1:] == kept[:-1]
    inside = np.zeros(len(rows), bool)
    inside[1:-1] = same[:-1] & same[1:]
    return rows[~inside]


def even(count: int, most: int = MAX_POSES) -> Places:
    """At most `most` of `count` rows, evenly spaced, first and last among them."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.intp)
