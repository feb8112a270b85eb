"""The pool of processes: plans and other commands run in processes of their own, as many at once as there are cores.

A child that crashes, or that the system kills, is one command that failed; the others go on.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from .. import watch
from ..errors import OrchError, RunError
from ..plan.plan import Plan

POLL = 0.05  # s
GRACE = 10.0  # s that a child has to end in order after an interrupt
LAST = 5.0  # s that it has to close its record after a second one


@dataclass(frozen=True, kw_only=True)
class ChildCommand:
    """What a child runs.  cost: how long it takes beside the others, in any unit; the most costly start first."""

    name: str
    arguments: Sequence[str]  # of this Python
    stdin: bytes = b""
    cost: float = 1.0


@dataclass(frozen=True, kw_only=True)
class ChildResult:
    """A command that ended.  code: its exit code, negative where a signal ended it."""

    command: ChildCommand
    code: int
    stdout: str
    stderr: str
    seconds: float  # of wall time

    @property
    def reason(self) -> str:
        """Why it failed, in its own words where it has some."""
        try:
            return str(json.loads(self.stdout)["error"])
        except (ValueError, KeyError, TypeError):
            text = self.stderr.strip()
            ended = f"the process ended with exit code {self.code}"
            if self.code < 0:  # a crash: what it printed before need not be about that
                return f"{ended}; it last printed: {text.splitlines()[-1]}" if text else ended
            return text or ended


@dataclass
class _Child:
    command: ChildCommand
    process: subprocess.Popen[bytes]
    stdout: IO[bytes]
    stderr: IO[bytes]
    began: float


# Called with the names of the running commands, many times a second, and with each command that has ended.
Watch = Callable[[Sequence[str], ChildResult | None], None]


def cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def command_of(name: str, plan: Plan, results: str | Path) -> ChildCommand:
    """The command that runs a plan into the store `results`, see `runs.__main__`."""
    job = {"plan": plan, "results": str(results), "command": sys.argv}
    cost = (plan.steps - plan.first) * len(plan.components)
    return ChildCommand(name=name, arguments=("-m", "orchestrator.runs"), stdin=pickle.dumps(job), cost=cost)


def run_plans(commands: Sequence[ChildCommand], watch: Watch) -> list[dict[str, Any]]:
    """Run commands of `command_of`; returns their results in the order of `commands`.

    Raises RunError where one failed, OrchError where one could not start, with the reasons of all.
    """
    ended = {id(one.command): one for one in run_all(commands, watch)}
    failed = [one for one in ended.values() if one.code]
    if failed:
        message = "\n".join(f"{one.command.name}: {one.reason}" for one in failed)
        raise (OrchError if all(one.code == OrchError.exit_code for one in failed) else RunError)(message)
    return [json.loads(ended[id(command)].stdout) for command in commands]


def run_all(commands: Iterable[ChildCommand], progress: Watch, at_once: int = 0) -> list[ChildResult]:
    """Run commands, the most costly first.

    at_once: processes; 0 takes one a core.  Returns the commands in the order in which they ended.
    KeyboardInterrupt, and a signal that asks this process to end, interrupts every child and waits for it.
    """
    waiting = sorted(commands, key=lambda command: -command.cost)
    running: list[_Child] = []
    ended: list[ChildResult] = []
    with watch.terminable():
        try:
            while waiting or running:
                while waiting and len(running) < (at_once or cores()):
                    running.append(_start(waiting.pop(0)))
                progress([child.command.name for child in running], None)
                time.sleep(POLL)
                for child in [c for c in running if c.process.poll() is not None]:
                    running.remove(child)
                    ended.append(_end(child))
                    progress([c.command.name for c in running], ended[-1])
        finally:
            _interrupt(running)
    return ended


def _start(command: ChildCommand) -> _Child:
    stdout, stderr = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115 - closed by _end
    arguments = [sys.executable, "-P", *command.arguments]  # a user's file json.py does not come before Python's own
    with tempfile.TemporaryFile() as stdin:
        stdin.write(command.stdin)
        stdin.seek(0)
        # A session of its own: Ctrl-C on the terminal reaches this process alone, which passes it on.
        with _reporting(command.name) as more:
            process = subprocess.Popen(
                arguments, stdin=stdin, stdout=stdout, stderr=stderr, start_new_session=True, **more
            )
    return _Child(command, process, stdout, stderr, time.monotonic())


def _end(child: _Child) -> ChildResult:
    texts = []
    for stream in (child.stdout, child.stderr):
        stream.seek(0)
        texts.append(stream.read().decode(errors="replace"))
        stream.close()
    return ChildResult(
        command=child.command,
        code=child.process.returncode,
        stdout=texts[0],
        stderr=texts[1],
        seconds=time.monotonic() - child.began,
    )


def _interrupt(children: list[_Child]) -> None:
    """Interrupt what still runs; once more where it has not ended within GRACE, or at another Ctrl-C; then kill it."""
    for seconds in (GRACE, LAST):
        for child in [child for child in children if child.process.poll() is None]:
            if sys.platform == "win32":
                child.process.terminate()
            else:
                child.process.send_signal(signal.SIGINT)
        until = time.monotonic() + seconds
        with contextlib.suppress(KeyboardInterrupt):
            while any(child.process.poll() is None for child in children) and time.monotonic() < until:
                time.sleep(POLL)
    for child in children:
        child.process.kill()
        child.process.wait()


@contextlib.contextmanager
def _reporting(name: str) -> Iterator[dict[str, Any]]:
    """Arguments of Popen with which the child reports what hangs to this process's stderr; its own is kept."""
    try:
        descriptor = os.dup(watch.REPORTS)
    except OSError:  # this process has none
        yield {}
        return
    try:
        reports = f"{descriptor}:{watch.LABEL}{name}: "
        yield {} if os.name == "nt" else {"pass_fds": [descriptor], "env": {**os.environ, "ORCH_REPORTS": reports}}
    finally:
        os.close(descriptor)
