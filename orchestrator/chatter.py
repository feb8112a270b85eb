"""Finds what alternates from step to step: the signature of a controller held beyond its stability limit.

Such a run is wrong even where its position errors look right.  The count is taken in the loop at every step, for a
record of every hundredth step cannot show it.
"""

from __future__ import annotations

import numpy as np

from .fmu import split_axis
from .system import System

SHARE = 0.5  # of its component's steps, above which a signal is reported
FEWEST_STEPS = 20  # below that, alternating says nothing
NOISE = 1e-9  # SI; smaller amplitudes are rounding
SMALL = 1e-2  # of the largest value of its vector; smaller amplitudes do no harm


class Alternations:
    """Counts for every real output how often it changes sign, or jumps from one of its limits to the other."""

    def __init__(self, system: System):
        self._system = system
        self._table = system.tables["real"][: system.computed["real"]]
        self._before = self._table.copy()
        self._product = np.zeros(len(self._table))
        self._alternates = np.zeros(len(self._table), dtype=bool)
        self._counts = np.zeros(len(self._table), dtype=np.int64)
        self._sum = np.zeros(len(self._table))  # of the products of consecutive values, and of their magnitudes:
        self._sum_abs = np.zeros(len(self._table))  # half the difference comes from the steps that alternate
        self._largest = np.zeros(len(self._table))  # of the magnitudes: the square of the peak
        # Limits that do not lie around zero have a middle of their own.
        self._middle = np.zeros(len(self._table))
        self._threshold = np.full(len(self._table), -(NOISE**2))
        self._has_middle = False
        for member in system.members:
            for place, variable in zip(member.places, member.outputs, strict=True):
                if variable.limits is not None and variable.limits[0] * variable.limits[1] >= 0.0:
                    low, high = variable.limits
                    self._middle[place] = (low + high) / 2
                    self._threshold[place] = -(((high - low) / 2 * (1 - 1e-9)) ** 2)
                    self._has_middle = True
        self._now = np.empty_like(self._before) if self._has_middle else self._table
        self._before -= self._middle

    def count(self) -> None:
        """Compare the values with those of the step before."""
        if self._has_middle:
            np.subtract(self._table, self._middle, out=self._now)
        np.multiply(self._now, self._before, out=self._product)
        np.less(self._product, self._threshold, out=self._alternates)
        self._counts += self._alternates
        self._sum += self._product
        np.abs(self._product, out=self._product)
        self._sum_abs += self._product
        np.maximum(self._largest, self._product, out=self._largest)
        self._before[:] = self._now

    def warnings(self, ticks: int) -> list[str]:
        """A sentence for each vector that alternated for most of the run.  ticks: steps of the master done."""
        step = self._system.plan.experiment.master.step
        found = []
        for member in self._system.members:
            steps = ticks // member.part.period
            if steps < FEWEST_STEPS:
                continue
            size: dict[tuple[str, str], float] = {}  # of vectors, by unit: square of the peak of the largest axis
            for place, variable in zip(member.places, member.outputs, strict=True):
                key = split_axis(variable.name)[0], variable.unit
                size[key] = max(size.get(key, 0.0), self._largest[place])
            worst: dict[str, dict[str, float]] = {}
            for place, variable in zip(member.places, member.outputs, strict=True):
                vector, axis = split_axis(variable.name)
                share = self._counts[place] / steps
                amplitude = (self._sum_abs[place] - self._sum[place]) / 2 / max(self._counts[place], 1)  # squared
                if share > SHARE and amplitude > SMALL**2 * size[vector, variable.unit]:
                    worst.setdefault(vector, {})[axis] = share
            for vector, shares in worst.items():
                axes = f" ({' '.join(shares)})" if any(shares) else ""
                held = step * member.part.period
                found.append(
                    f"{member.part.name}.{vector}{axes} alternates from step to step in {max(shares.values()):.0%} of "
                    f"the run: held over {held:g} s, the loop is beyond its stability limit and the result is wrong "
                    f"even where it looks right; take a smaller step (orch converge shows which)"
                )
        return found
