"""Finds what alternates from step to step: the signature of a controller held beyond its stability limit.

Such a run is wrong even where its position errors look right.  The count is taken in the loop, for a record of every
hundredth step cannot show it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Reals, Table
from ..names import split_axis
from ..warning import Kind, Warned
from .system import System

SHARE = 0.5  # of its component's steps, above which a signal is reported
FEWEST_STEPS = 20  # below that, alternating says nothing
FEWEST_PAIRS = 1000  # of consecutive values that a long run is judged by
SPARSEST = 100  # ticks from pair to pair of a long run
NOISE = 1e-9  # SI; smaller amplitudes are rounding
SMALL = 1e-2  # of the largest value of its vector; smaller amplitudes do no harm


class AlternationsProgram(NamedTuple):
    """What the compiled loop needs to count, too; see `program`."""

    every: int
    before: Reals
    middle: Reals | None
    threshold: Reals
    counts: Table  # int64
    sum: Reals
    sum_abs: Reals
    largest: Reals


class Alternations:
    """Counts for every real output how often it changes sign, or jumps from one of its limits to the other.

    Compared are the values after one step and the next: every pair of a short run, one pair of `every` steps of a
    long one.  All arrays are (real outputs,).
    """

    def __init__(self, system: System):
        self._system = system
        self.every = _stride([component.period for component in system.plan.components], system.plan.steps)
        self._table = system.view.tables["real"][: system.computed["real"]]
        n = len(self._table)
        self._counts = np.zeros(n, dtype=np.int64)
        self._sum = np.zeros(n)  # of the products of consecutive values, and of their magnitudes:
        self._sum_abs = np.zeros(n)  # half the difference comes from the steps that alternate
        self._largest = np.zeros(n)  # of the magnitudes: the square of the peak
        # Limits that do not lie around zero have a middle of their own.
        middle = np.zeros(n)
        self._threshold = np.full(n, -(NOISE**2))
        for stepper in system.steppers:
            for place, variable in zip(stepper.places, stepper.reals, strict=True):
                low, high = variable.limits
                if math.isfinite(high - low) and low * high >= 0.0:
                    middle[place] = (low + high) / 2
                    self._threshold[place] = -(((high - low) / 2 * (1 - 1e-9)) ** 2)
        self._middle = middle if middle.any() else None
        self._before = self._now().copy()

    def look(self, ticks: int) -> None:
        """To be called after each step of the master.  ticks: steps done."""
        phase = ticks % self.every
        if phase == 1 % self.every:
            product = self._now() * self._before
            self._counts += product < self._threshold
            self._sum += product
            np.abs(product, out=product)
            self._sum_abs += product
            np.maximum(self._largest, product, out=self._largest)
        if phase == 0:
            self._before[:] = self._now()

    def program(self) -> AlternationsProgram:
        return AlternationsProgram(
            every=self.every,
            before=self._before,
            middle=self._middle,
            threshold=self._threshold,
            counts=self._counts,
            sum=self._sum,
            sum_abs=self._sum_abs,
            largest=self._largest,
        )

    def _now(self) -> Reals:
        return self._table if self._middle is None else self._table - self._middle

    def warnings(self, ticks: int) -> list[str]:
        """A sentence for each vector that alternated for most of the run.  ticks: how many it looked at."""
        step = self._system.plan.experiment.master.step
        found: list[str] = []
        for stepper in self._system.steppers:
            steps = ticks // self.every // stepper.component.period
            if steps < FEWEST_STEPS:
                continue
            size: dict[tuple[str, str], float] = {}  # of vectors, by unit: square of the peak of the largest axis
            for place, variable in zip(stepper.places, stepper.reals, strict=True):
                key = split_axis(variable.name)[0], variable.unit
                size[key] = max(size.get(key, 0.0), self._largest[place])
            worst: dict[str, dict[str, float]] = {}
            for place, variable in zip(stepper.places, stepper.reals, strict=True):
                vector, axis = split_axis(variable.name)
                share = self._counts[place] / steps
                amplitude = (self._sum_abs[place] - self._sum[place]) / 2 / max(self._counts[place], 1)  # squared
                if share > SHARE and amplitude > SMALL**2 * size[vector, variable.unit]:
                    worst.setdefault(vector, {})[axis] = share
            for vector, shares in worst.items():
                axes = f" ({' '.join(shares)})" if any(shares) else ""
                held = step * stepper.component.period
                text = (
                    f"{stepper.component.name}.{vector}{axes} alternates from step to step in "
                    f"{max(shares.values()):.0%} of the run: held over {held:g} s, "
                    "the loop is beyond its stability limit and the result is wrong "
                    f"even where it looks right; take a smaller step (orch converge shows which)"
                )
                found.append(Warned(text, Kind.UNSTABLE))
        return found


def _stride(periods: Sequence[int], steps: int) -> int:
    """How many ticks lie between two pairs: few enough to see each component's steps often, and alike."""
    least = min(SPARSEST, steps // (FEWEST_PAIRS * max(periods)))
    return next(n for n in itertools.count(max(1, least)) if all(math.gcd(n, period) == 1 for period in periods))
