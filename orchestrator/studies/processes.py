"""Commands in processes of their own, as many at once as there are cores."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, Any

POLL = 0.05  # s
GRACE = 10.0  # s that a child has to close its record after an interrupt


@dataclass(frozen=True)
class Job:
    """A command.  cost: how long it takes beside the others, in any unit: the longest start first."""

    name: str
    arguments: tuple[str, ...]  # of this Python
    cost: float = 1.0


@dataclass(frozen=True)
class Done:
    """A command that ended."""

    job: Job
    code: int
    output: str
    errors: str
    seconds: float


@dataclass
class _Child:
    job: Job
    process: subprocess.Popen[bytes]
    output: IO[bytes]
    errors: IO[bytes]
    began: float


def cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_all(jobs: Iterable[Job], told: Callable[[list[str], Done | None], None], at_once: int = 0) -> list[Done]:
    """Run the jobs, the most costly first.

    told: called with the names of the running jobs, many times a second, and with each job that has ended.
    at_once: processes; 0 takes one a core.  Returns how the jobs ended, in the order in which they did.
    KeyboardInterrupt, and a signal that asks this process to end, interrupts every child and waits for it.
    """
    waiting = sorted(jobs, key=lambda job: -job.cost)
    running: list[_Child] = []
    ended: list[Done] = []
    try:
        with _terminable():
            while waiting or running:
                while waiting and len(running) < (at_once or cores()):
                    running.append(_start(waiting.pop(0)))
                told([child.job.name for child in running], None)
                time.sleep(POLL)
                for child in [c for c in running if c.process.poll() is not None]:
                    running.remove(child)
                    ended.append(_end(child))
                    told([c.job.name for c in running], ended[-1])
    finally:
        _interrupt(running)
    return ended


def _start(job: Job) -> _Child:
    output, errors = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115 - closed by _end
    # A session of its own: Ctrl-C on the terminal reaches this process alone, which passes it on once.
    process = subprocess.Popen(
        [sys.executable, *job.arguments], stdin=subprocess.DEVNULL, stdout=output, stderr=errors, start_new_session=True
    )
    return _Child(job, process, output, errors, time.monotonic())


def _end(child: _Child) -> Done:
    texts = []
    for stream in (child.output, child.errors):
        stream.seek(0)
        texts.append(stream.read().decode(errors="replace"))
        stream.close()
    return Done(child.job, child.process.returncode, texts[0], texts[1], time.monotonic() - child.began)


def _interrupt(children: list[_Child]) -> None:
    """End what still runs: politely, then not."""
    for child in children:
        if sys.platform == "win32":
            child.process.terminate()
        else:
            child.process.send_signal(signal.SIGINT)
    until = time.monotonic() + GRACE
    for child in children:
        try:
            child.process.wait(max(0.0, until - time.monotonic()))
        except (subprocess.TimeoutExpired, KeyboardInterrupt):
            child.process.kill()
            child.process.wait()


@contextmanager
def _terminable() -> Iterator[None]:
    """Turn what ends a process without a word into KeyboardInterrupt, so that no child is left behind."""

    def interrupt(number: int, frame: Any) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {name: signal.signal(getattr(signal, name), interrupt) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)
