"""A line on the terminal while a run goes on."""

from __future__ import annotations

import sys
import time
from typing import TextIO

from ..plan.plan import Plan
from ..simulation.observer import Observer

WIDTH = 24  # of the bar, characters
EVERY = 0.1  # s of wall time


class Progress(Observer):
    """An observer that shows simulated time, real-time factor and time left; nothing unless `stream` is a terminal."""

    def __init__(self, plan: Plan, stream: TextIO = sys.stderr):
        self._grid, self._steps, self._stream = plan.experiment.grid, plan.steps, stream
        self._began = self._shown = time.monotonic()
        self._on = stream.isatty()

    def progress(self, tick: int) -> None:
        now = time.monotonic()
        if not self._on or (now - self._shown < EVERY and tick < self._steps):
            return
        self._shown = now
        done = tick / self._steps
        elapsed = now - self._began
        left = elapsed * (1 - done) / done if done else 0.0
        bar = "█" * int(done * WIDTH) + "·" * (WIDTH - int(done * WIDTH))
        self._stream.write(
            f"\r{bar} {self._grid.time(tick):.2f} / {self._grid.time(self._steps):g} s  "
            f"{self._grid.time(tick) / elapsed:.1f}x real time  {_clock(left)} left \x1b[K"
        )
        self._stream.flush()

    def done(self) -> None:
        """Clear the line."""
        if self._on:
            self._stream.write("\r\x1b[K")
            self._stream.flush()


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes}:{seconds:02d}"
