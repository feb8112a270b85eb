"""Runs a sweep: what is missing, in batches, on Dask's processes.

A record is there when it is verified and complete; a batch looks for itself, so that resuming, a worker that died and a
worker that came too late are one case.  Batches are handed out a few at a time, each sized to last about a second.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import Any

from ....errors import OrchError, StoreError
from ....records.file.provenance import git_commit
from ....simulation.loop import Interrupt
from ....simulation.master import interruptible
from ..design.matrix import Run
from ..design.study import Job, Study
from . import cluster, fmu_cache, table, worker
from .storage import PART, Storage
from .worker import FAILED, Line

BATCH_SECONDS = 1.0  # of wall time that a batch lasts
AHEAD = 2  # batches a worker has: one that runs, one that waits
LOCK = ".lock"

Told = Callable[[int, int, int, float], None]  # runs that ended, of how many, failed ones, wall time [s]


@dataclass
class Ended:
    """How a sweep ended.  lines: {index: how the run ended}; wall_time [s]: from the first run to the last record."""

    study: Study
    runs: Sequence[Run]
    storage: Storage
    lines: dict[int, Line] = field(default_factory=dict)
    wall_time: float = 0.0
    interrupted: bool = False
    stopped: bool = False  # by the first failure

    def count(self, status: str) -> int:
        return sum(line.status == status for line in self.lines.values())

    @property
    def reused(self) -> int:
        return sum(not line.fresh for line in self.lines.values())

    @property
    def missing(self) -> int:
        return len(self.runs) - len(self.lines)


def sweep(
    study: Study,
    results: str = "results",
    scheduler: str | None = None,
    workers: int | None = None,
    fail_fast: bool = False,
    told: Told = lambda *_: None,
) -> Ended:
    """Run what is missing of a sweep, and write its table.

    told: called whenever runs have ended.  Ctrl-C ends it in order: what was running is lost, the rest is there.
    Raises OrchError where it cannot start: another process runs this sweep, no Dask, nobody at `scheduler`.
    """
    facts = {"git_commit": git_commit(study.experiment.path.parent), "command": json.dumps(sys.argv)}
    address = results if "://" in results else os.path.abspath(results)
    job = study.job(address, facts)
    storage = Storage(job.folder)
    runs = study.design.runs()
    ended = Ended(study, runs, storage)
    with locked(storage), interruptible() as pressed:
        lay_out(study, storage)
        try:
            with cluster.client(scheduler, workers) as client:
                if scheduler is None:
                    client.run(cluster.deaf)
                elif words := cluster.alike(client):
                    raise OrchError(f"--scheduler {scheduler}: {words}")
                _run(client, job, ended, fail_fast, pressed, told)
            _clear(storage)
        finally:
            ended.interrupted = pressed.is_set()
            lines = table.text(runs, ended.lines, [column.name for column in study.columns])
            storage.write(table.TABLE, lines.encode())
    return ended


def _run(client: Any, job: Job, ended: Ended, fail_fast: bool, pressed: Interrupt, told: Told) -> None:
    """Keep every worker busy until all runs have ended."""
    from distributed import wait
    from distributed.scheduler import KilledWorker

    token = cluster.token()
    waiting = deque(ended.runs)
    alone: deque[Run] = deque()  # runs of batches that killed their workers: which of them is it?
    flying: dict[Any, list[Run]] = {}
    spent, measured, began, told_to_stop = 0.0, 0, time.monotonic(), False
    while waiting or alone or flying:
        hands = max(1, len(client.nthreads()))
        while (waiting or alone) and len(flying) < AHEAD * hands and not ended.stopped:
            size = _size(spent / measured if measured else BATCH_SECONDS, len(waiting), hands)
            chosen = [waiting.popleft() for _ in range(size)] if waiting else [alone.popleft()]
            flying[client.submit(worker.batch, token, job, chosen, fail_fast, pure=False)] = chosen
        if pressed.is_set() or ended.stopped:
            waiting.clear()
            alone.clear()
            if not told_to_stop:
                client.run(worker.interrupt, token)  # batches that wait come back empty
                told_to_stop = True
        if not flying:
            break
        with contextlib.suppress(TimeoutError):
            wait(list(flying), timeout=0.2 if not pressed.is_set() else 5.0, return_when="FIRST_COMPLETED")
        done = [future for future in flying if future.done()]
        for future in done:
            asked = flying.pop(future)
            try:
                lines = future.result()
            except KilledWorker:
                lines = []
                if len(asked) == 1:
                    lines = [Line(asked[0].index, status=FAILED, error="every process that ran it died")]
                else:
                    alone += asked
            except CancelledError:
                lines = []
            for line in lines:
                ended.lines[line.index] = line
                spent, measured = spent + line.seconds, measured + 1
            ended.stopped = ended.stopped or (fail_fast and any(line.status == FAILED for line in lines))
        if done:
            ended.wall_time = time.monotonic() - began
            told(len(ended.lines), len(ended.runs), ended.count(FAILED), ended.wall_time)


def _size(seconds: float, waiting: int, hands: int) -> int:
    """Runs of the next batch: about BATCH_SECONDS of them, fewer towards the end."""
    return max(1, min(int(BATCH_SECONDS / max(seconds, 1e-3)), waiting // (AHEAD * hands), waiting))


def lay_out(study: Study, storage: Storage) -> None:
    """The sweep's folder: what it is, the FMUs, and nothing left of processes that were killed."""
    _clear(storage)
    for digest, path in study.files.items():
        if not storage.exists(fmu_cache.fmu_place(digest)):
            storage.write(fmu_cache.fmu_place(digest), path.read_bytes())
    storage.write(table.DESCRIPTION, (json.dumps(study.describe(), indent=1) + "\n").encode())


def _clear(storage: Storage) -> None:
    """Delete what processes that were killed have left."""
    if storage.local is not None:
        for rest in storage.local.glob(f"{PART}*"):
            rest.unlink(missing_ok=True)


@contextlib.contextmanager
def locked(storage: Storage) -> Iterator[None]:
    """One process at a time runs a sweep; a remote folder is left to whoever shares it.  Raises StoreError."""
    folder = storage.local
    if folder is None:
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / LOCK).open("a+")
    except OSError as error:
        raise StoreError(f"{folder} cannot be written: {error.strerror}") from None
    with file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # Windows: Dask's local processes, and no second sweep by mistake
            pass
        except OSError:
            file.seek(0)
            raise StoreError(f"{folder}: process {file.read().strip()} runs this sweep; wait for it") from None
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield
