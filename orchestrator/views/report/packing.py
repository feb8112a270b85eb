"""Numbers on their way into the page: in single precision, as base64."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ...arrays import Places, Reals


MAX_POSES = 2000  # of a vehicle in the replay; 50 a second over 40 s


def packed(values: Reals) -> dict[str, str]:
    """(N,) or (N, M), row by row, as little-endian float32 in base64; core.js makes a Float32Array of it."""
    return {"f4": base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")}


def even(count: int, most: int = MAX_POSES) -> Places:
    """At most `most` of `count` rows, evenly spaced, first and last among them."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.intp)
