"""What a terminal shows while a run goes on: one line that is written again and again, and cleared at the end."""

from __future__ import annotations

import shutil
import sys
import time
from types import TracebackType
from typing import TextIO

from ..plan.plan import Plan
from ..simulation.observer import Observer

WIDTH = 24  # of the bar, characters
EVERY = 0.1  # s of wall time


class ProgressLine:
    """The line.  Nothing is written where `quiet`, or where the stream is no terminal."""

    def __init__(self, quiet: bool = False, stream: TextIO = sys.stderr):
        self._stream = stream
        self.on = stream.isatty() and not quiet
        self._shown = False

    def __enter__(self) -> ProgressLine:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.clear()

    def show(self, text: str) -> None:
        """Put a text in place of what stands there, cut to the width of the terminal."""
        if self.on:
            self._write(f"\r{text[: shutil.get_terminal_size().columns - 1]}\x1b[K")
            self._shown = True

    def clear(self) -> None:
        if self._shown:
            self._write("\r\x1b[K")
            self._shown = False

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()


def bar(share: float) -> str:
    """share: what is done of the whole, 0 .. 1."""
    full = int(share * WIDTH)
    return "█" * full + "·" * (WIDTH - full)


def time_left(share: float, elapsed: float) -> str:
    """What is left of the wall time, as minutes and seconds.  share: what was done in `elapsed` seconds, 0 .. 1."""
    if not share:
        return "? left"
    minutes, seconds = divmod(round(elapsed * (1 - share) / share), 60)
    return f"{minutes}:{seconds:02d} left"


class RunProgress(Observer):
    """An observer that shows simulated time, real-time factor and time left."""

    def __init__(self, plan: Plan, line: ProgressLine):
        self._grid, self._first, self._last, self._line = plan.experiment.grid, plan.first, plan.steps, line
        self._began = self._shown = time.monotonic()

    def progress(self, tick: int) -> None:
        now = time.monotonic()
        if not self._line.on or (now - self._shown < EVERY and tick < self._last):
            return
        self._shown = now
        share, elapsed = (tick - self._first) / max(1, self._last - self._first), now - self._began
        factor = (self._grid.time(tick) - self._grid.time(self._first)) / elapsed
        self._line.show(
            f"{bar(share)} {self._grid.time(tick):.2f} / {self._grid.time(self._last):g} s  "
            f"{factor:.1f}x real time  {time_left(share, elapsed)}"
        )
