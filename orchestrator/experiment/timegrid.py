"""Simulated time on an integer grid: exact ratios, no running sums."""

from __future__ import annotations

import bisect
import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from ..arrays import Reals

EXACT = 1 << 53  # integers up to here are floats


class TimeGrid:
    """Communication points k * step.  `step`: s, taken as the decimal number it is written as."""

    def __init__(self, step: float):
        self.step = step
        self._exact = Fraction(repr(step))

    def ticks(self, duration: float) -> int | None:
        """How many steps `duration` [s] is, or None where that is not a whole number."""
        ratio = Fraction(repr(duration)) / self._exact
        return int(ratio) if ratio.denominator == 1 else None

    def nearest(self, duration: float) -> list[float]:
        """The multiples of the step around `duration` [s], at least one step each."""
        below = max(1, int(Fraction(repr(duration)) / self._exact))
        return [self.time(below), self.time(below + 1)]

    def time(self, k: int) -> float:
        """k * step [s], rounded once."""
        return k * self._exact.numerator / self._exact.denominator

    def has_sample(self, spec: Mapping[str, Any], first: int, last: int) -> bool:
        """Whether one of the ticks from `first` to `last` is a sample of a metric.  spec: its entry in [metrics]."""
        every = (self.ticks(spec["every"]) or 1) if "every" in spec else 1
        tick = first + bisect.bisect_left(range(first, last + 1), spec.get("after", 0.0), key=self.time)
        tick += -tick % every
        return tick <= last and self.time(tick) <= spec.get("before", math.inf)

    def times(self, first: int, last: int) -> Reals:
        """`time` of the ticks from `first` until before `last`, (last - first,)."""
        numerator, denominator = self._exact.numerator, self._exact.denominator
        if last * numerator < EXACT and denominator < EXACT:  # then a quotient of floats is rounded once, too
            return np.arange(first, last, dtype=np.float64) * numerator / denominator
        return np.array([self.time(k) for k in range(first, last)])
