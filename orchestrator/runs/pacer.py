"""Keeps a run at the pace of the clock on the wall, or at a multiple of it."""

from __future__ import annotations

import time
from typing import Any

from ..plan.plan import Plan
from ..simulation.observer import Block, Observer
from ..watch import waits

SLICE = 0.002  # s of wall time between two looks at the clock
TAIL = 0.05  # s of wall time before the end that the run goes ahead: its last rows are written before it is over


class Pacer(Observer):
    """An observer that waits until it is time.  factor: simulated seconds in a second of wall time.

    Each look compares with the beginning of the run, so that being late does not add up: a run that was held up catches
    up.
    """

    def __init__(self, plan: Plan, factor: float = 1.0):
        self._grid, self._factor = plan.experiment.grid, factor
        ticks_per_second = factor / plan.experiment.master.step
        self._slice = max(1, round(SLICE * ticks_per_second))
        self._tail, self._steps = plan.steps - round(TAIL * ticks_per_second), plan.steps
        self._began: float | None = None
        self._looks, self._sum, self._waited = 0, 0.0, 0.0
        self.late = self.latest = 0.0  # s; now, and at worst

    def rows(self, block: Block) -> None:
        if self._began is None:  # with the recorder's clock
            self._began = time.monotonic() - self._grid.time(block.ticks[0]) / self._factor

    def limit(self, tick: int, last: int) -> int:
        return min(last, tick - tick % self._slice + self._slice)

    def due(self, tick: int) -> float:
        """When it is time for a tick (monotonic) [s]."""
        return (self._began or 0.0) + self._grid.time(tick) / self._factor

    def progress(self, tick: int) -> None:
        if self._tail < tick < self._steps:
            return
        due = self.due(tick)
        if (wait := due - time.monotonic()) > 0:
            began = time.monotonic()
            waits(wait)
            self._waited += time.monotonic() - began
        self.late = time.monotonic() - due
        self.latest = max(self.latest, self.late)
        self._looks += 1
        self._sum += self.late

    def facts(self) -> dict[str, Any]:
        """How late the run was, at worst, on average and at its end, and how long it waited for the clock [s]."""
        late = {"late_max": self.latest, "late_mean": self._sum / max(1, self._looks), "late_end": self.late}
        return {"pacing": {"factor": self._factor, **late, "waited": self._waited}}
