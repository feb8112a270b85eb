"""A line on the terminal while a sweep goes on."""

from __future__ import annotations

import sys
from typing import TextIO

WIDTH = 24  # of the bar, characters


class SweepProgress:
    """Shows runs done, rate and time left; nothing unless `stream` is a terminal."""

    def __init__(self, quiet: bool = False, stream: TextIO = sys.stderr):
        self._stream = stream
        self._on = stream.isatty() and not quiet
        self._shown = False

    def __call__(self, done: int, runs: int, failed: int, seconds: float) -> None:
        if not self._on:
            return
        rate = done / seconds if seconds else 0.0
        left = _clock((runs - done) / rate) if rate else "?"
        full = done * WIDTH // runs
        bar = "█" * full + "·" * (WIDTH - full)
        failures = f"  {failed} failed" if failed else ""
        self._stream.write(f"\r{bar} {done} / {runs} runs  {rate:.1f} / s  {left} left{failures} \x1b[K")
        self._stream.flush()
        self._shown = True

    def done(self) -> None:
        if self._shown:
            self._stream.write("\r\x1b[K")
            self._stream.flush()


class TrialProgress:
    """Shows the trials of each controller and the best objective so far."""

    def __init__(self, quiet: bool = False, stream: TextIO = sys.stderr):
        self._stream = stream
        self._on = stream.isatty() and not quiet
        self._state: dict[str, str] = {}

    def __call__(self, fmu: str, ended: int, trials: int, best: float) -> None:
        if self._on:
            self._state[fmu] = f"{fmu} {ended}/{trials} {best:.4g}"
            self._stream.write("\r" + "  ".join(self._state.values()) + " \x1b[K")
            self._stream.flush()

    def done(self) -> None:
        if self._state:
            self._stream.write("\r\x1b[K")
            self._stream.flush()
            self._state.clear()


def _clock(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
