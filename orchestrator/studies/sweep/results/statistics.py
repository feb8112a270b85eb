"""Means, intervals, shares and tests of numbers, on a line or on the circle.  docs/sweeps.md says which, and why.

turn: a full turn in the unit of the numbers, where they are angles; 0 where they lie on a line.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from ....arrays import Reals, Truths
from ....errors import OrchError
from ....metrics import on_circle
from ..engine.storage import MISSING

RESAMPLES = 2000
SEED = 20_191_104  # of the resampling, so that the same table gives the same intervals


def mean(x: Reals, turn: float = 0.0) -> float:
    """Of numbers (N,), or on the circle, in (-turn/2, turn/2]; nan of none."""
    if not len(x):
        return math.nan
    return float(x.mean()) if not turn else float(_circular(x * (2 * np.pi / turn))) * turn / (2 * np.pi)


def median(x: Reals, turn: float = 0.0) -> float:
    """Of numbers (N,), or on the circle, from their mean; nan of none."""
    if not len(x):
        return math.nan
    center = mean(x, turn) if turn else 0.0
    return float(np.median(on_circle(x - center, turn) if turn else x)) + center


def std(x: Reals, turn: float = 0.0) -> float:
    """Standard deviation of a sample (N,), on the circle around its mean; nan of fewer than two."""
    if len(x) < 2:
        return math.nan
    return float((on_circle(x - mean(x, turn), turn) if turn else x).std(ddof=1))


def _circular(x: Reals, axis: int = -1) -> Reals:
    """The direction of the mean of unit vectors at the angles x [rad] (Fisher, 1993)."""
    direction: Reals = np.arctan2(np.sin(x).mean(axis=axis), np.cos(x).mean(axis=axis))
    return direction


def interval(x: Reals, turn: float = 0.0) -> tuple[float, float]:
    """The 95 % interval of the mean of x (N,), on the circle where there is a turn: low may lie below -turn/2."""
    stats = _stats()
    if len(x) < 2:
        return math.nan, math.nan
    center = mean(x, turn) if turn else 0.0
    x = on_circle(x - center, turn) if turn else x
    if float(np.ptp(x)) == 0.0:
        return float(x[0]) + center, float(x[0]) + center

    def of(sample: Reals, axis: int = -1) -> Reals:
        if turn:
            return _circular(sample * (2 * np.pi / turn), axis) * (turn / (2 * np.pi))
        plain: Reals = np.mean(sample, axis=axis)
        return plain

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a degenerate distribution gives nan, which is shown
        result = stats.bootstrap((x,), of, n_resamples=RESAMPLES, rng=np.random.default_rng(SEED), method="BCa")
    interval = result.confidence_interval
    return float(interval.low) + center, float(interval.high) + center


def share(n: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share, n of so many."""
    if not of:
        return math.nan, math.nan
    low, high = _stats().binomtest(n, of).proportion_ci(method="wilson")
    return float(low), float(high)


def wilcoxon(d: Reals) -> tuple[float, float]:
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


def with_never(a: Reals, b: Reals, numbers: Truths, d: Reals) -> Reals:
    """Paired differences to be ranked, (N,): where one side is never, larger than every other; where both are, none."""
    beyond = 1.0 + 2.0 * float(np.abs(d).max(initial=0.0))
    result: Reals = np.where(np.isinf(a), beyond, 0.0) - np.where(np.isinf(b), beyond, 0.0)
    result[numbers] = d
    return result


def holm(p: Sequence[float]) -> list[float]:
    """Holm's step-down correction of p-values; nan stays nan and counts for nothing."""
    order = sorted((i for i, value in enumerate(p) if math.isfinite(value)), key=lambda i: p[i])
    corrected, largest = list(p), 0.0
    for rank, i in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * p[i]))
        corrected[i] = largest
    return corrected


def _stats() -> Any:
    try:
        from scipy import stats
    except ImportError:
        raise OrchError(MISSING) from None
    return stats
