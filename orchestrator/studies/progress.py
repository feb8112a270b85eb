"""What a terminal shows while many runs go on, in one line."""

from __future__ import annotations

from collections.abc import Sequence

from ..runs.prepare import Report
from ..runs.progress import ProgressLine, bar, time_left
from .processes import ChildResult


def show_runs(line: ProgressLine, done: int, runs: int, failed: int, seconds: float) -> None:
    """Runs done of a sweep, their rate and the time left.  seconds: of wall time."""
    rate = done / seconds if seconds else 0.0
    failures = f"  {failed} failed" if failed else ""
    share = done / runs
    line.show(f"{bar(share)} {done} / {runs} runs  {rate:.1f} / s  {time_left(share, seconds)}{failures}")


class TrialProgress:
    """The trials of each controller and the best objective so far."""

    def __init__(self, line: ProgressLine):
        self._line = line
        self._states: dict[str, str] = {}

    def __call__(self, fmu: str, ended: int, trials: int, best: float) -> None:
        self._states[fmu] = f"{fmu} {ended}/{trials} {best:.4g}"
        self._line.show("  ".join(self._states.values()))


class CommandProgress:
    """The names of the commands that run.  Each one that has ended is reported, with `quiet` only if it failed."""

    def __init__(self, commands: int, report: Report, quiet: bool = False):
        self._commands, self._report, self._quiet, self._ended = commands, report, quiet, 0
        self._line = ProgressLine()

    def __call__(self, running: Sequence[str], result: ChildResult | None) -> None:
        if result is not None:
            self._ended += 1
            self._line.clear()
            if not self._quiet or result.code:
                how = f"{result.seconds:.1f} s" if not result.code else f"failed with exit code {result.code}"
                self._report(f"[{self._ended}/{self._commands}] {result.command.name}: {how}")
        if running:
            self._line.show(f"[{self._ended}/{self._commands}] running: {', '.join(running)}")
        else:
            self._line.clear()
