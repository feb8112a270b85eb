"""Runs a sweep: what is missing, in batches, on Dask's processes.

A batch skips runs whose records are verified and complete, so that a sweep that is resumed, a worker that died and a
batch that ran twice are one case.  A few batches are submitted at a time, each sized to last about a second.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from filelock import FileLock, Timeout

from ....errors import OrchError, StoreError
from ....records.file.provenance import git_commit
from ....watch import Interrupt, at_halt, interruptible
from ..design.matrix import DesignPoint
from ..design.prepared import PreparedSweep, SweepJob
from . import cluster, fmu_cache, table, worker
from .storage import PART, Storage
from .worker import COMPLETED, FAILED, PointResult

if TYPE_CHECKING:
    from distributed import Client, Future

BATCH_SECONDS = 1.0  # of wall time that a batch lasts
AHEAD = 2  # batches a worker has: one that runs, one that waits
LOCK, OWNER = ".lock", ".owner"  # files in the folder; OWNER holds the id of the process that has the lock

RunsEnded = Callable[[int, int, int, float], None]  # runs that ended, of how many, failed ones, wall time [s]


@dataclass
class SweepResult:
    """How a sweep ended.  by_index: of each run that ended."""

    prepared: PreparedSweep
    storage: Storage
    by_index: dict[int, PointResult] = field(default_factory=dict)
    wall_time: float = 0.0  # s, from the first run to the last record
    interrupted: bool = False
    stopped: bool = False  # by the first failure

    def count(self, status: str) -> int:
        return sum(result.status == status for result in self.by_index.values())

    @property
    def marked(self) -> dict[str, int]:
        """{what speaks against the numbers of completed runs: how many}"""
        completed = [result.standing for result in self.by_index.values() if result.status == COMPLETED]
        return dict(Counter(reason for standing in completed for reason in standing.reasons_of("")))

    @property
    def reused(self) -> int:
        return sum(not result.fresh for result in self.by_index.values())

    @property
    def missing(self) -> int:
        return len(self.prepared.points) - len(self.by_index)


def sweep(
    prepared: PreparedSweep,
    results: str = "results",
    scheduler: str | None = None,
    workers: int | None = None,
    fail_fast: bool = False,
    runs_ended: RunsEnded = lambda *_: None,
) -> SweepResult:
    """Run what is missing of a sweep, and write its table.

    runs_ended: called whenever runs have ended.  Ctrl-C ends it in order: runs that had not ended are lost, the others
    are kept.  Raises OrchError where it cannot start: another process runs this sweep, Dask is not installed, no
    scheduler answers.
    """
    facts = {"git_commit": git_commit(prepared.experiment.path.parent), "command": json.dumps(sys.argv)}
    address = results if "://" in results else os.path.abspath(results)
    job = prepared.job(address, facts)
    storage = Storage(job.folder)
    result = SweepResult(prepared, storage)

    def tabulate() -> str:
        text = table.text(prepared.points, result.by_index, [column.name for column in prepared.columns])
        storage.write(table.TABLE, text.encode())
        return ""

    with locked(storage), interruptible() as pressed, at_halt(tabulate):
        lay_out(prepared, storage)
        try:
            with cluster.client(scheduler, workers) as client:
                if scheduler is None:
                    client.run(cluster.ignore_ctrl_c)
                elif words := cluster.mismatch(client):
                    raise OrchError(f"--scheduler {scheduler}: {words}")
                _run(client, job, result, fail_fast, pressed, runs_ended)
            _clear(storage)
        finally:
            result.interrupted = pressed.is_set()
            tabulate()
    return result


def _run(
    client: Client, job: SweepJob, result: SweepResult, fail_fast: bool, pressed: Interrupt, runs_ended: RunsEnded
) -> None:
    """Keep every worker busy until all runs have ended."""
    from distributed import wait
    from distributed.scheduler import KilledWorker

    token = cluster.token()
    points = result.prepared.points
    waiting = deque(points)
    alone: deque[DesignPoint] = deque()  # of batches whose workers died: each runs by itself, to find the cause
    submitted: dict[Future[list[PointResult]], list[DesignPoint]] = {}
    spent, measured, began, stopping = 0.0, 0, time.monotonic(), False
    while waiting or alone or submitted:
        threads = max(1, len(client.nthreads()))
        while (waiting or alone) and len(submitted) < AHEAD * threads and not result.stopped:
            size = _size(spent / measured if measured else BATCH_SECONDS, len(waiting), threads)
            batch = [waiting.popleft() for _ in range(size)] if waiting else [alone.popleft()]
            submitted[client.submit(worker.batch, token, job, batch, fail_fast, pure=False)] = batch
        if pressed.is_set() or result.stopped:
            waiting.clear()
            alone.clear()
            if not stopping:
                cluster.end(client, token)  # batches that wait come back empty
                stopping = True
        if not submitted:
            break
        with contextlib.suppress(TimeoutError):
            wait(list(submitted), timeout=0.2 if not pressed.is_set() else 5.0, return_when="FIRST_COMPLETED")
        done = [future for future in submitted if future.done()]
        for future in done:
            batch = submitted.pop(future)
            ended: list[PointResult] = []
            try:
                ended = future.result()
            except KilledWorker:
                if len(batch) == 1:
                    ended = [PointResult(batch[0].index, status=FAILED, error="every process that ran it died")]
                else:
                    alone += batch
            except CancelledError:
                pass
            for one in ended:
                result.by_index[one.index] = one
                spent, measured = spent + one.seconds, measured + 1
            result.stopped = result.stopped or (fail_fast and any(one.status == FAILED for one in ended))
        if done:
            result.wall_time = time.monotonic() - began
            runs_ended(len(result.by_index), len(points), result.count(FAILED), result.wall_time)


def _size(seconds: float, waiting: int, threads: int) -> int:
    """How many runs the next batch has: about BATCH_SECONDS of them, fewer towards the end.

    seconds: of wall time that a run takes; waiting: runs; threads: of all workers.
    """
    return max(1, min(int(BATCH_SECONDS / max(seconds, 1e-3)), waiting // (AHEAD * threads), waiting))


def lay_out(prepared: PreparedSweep, storage: Storage) -> None:
    """Write the sweep's description and FMUs into its folder, and delete what killed processes have left there."""
    _clear(storage)
    for digest, path in prepared.files.items():
        if not storage.exists(fmu_cache.fmu_place(digest)):
            storage.write(fmu_cache.fmu_place(digest), path.read_bytes())
    storage.write(table.DESCRIPTION, (json.dumps(prepared.describe(), indent=1) + "\n").encode())


def _clear(storage: Storage) -> None:
    """Delete what killed processes have left."""
    if storage.local is not None:
        for rest in storage.local.glob(f"{PART}*"):
            rest.unlink(missing_ok=True)


@contextlib.contextmanager
def locked(storage: Storage) -> Iterator[None]:
    """Holds a sweep's folder, so that one process at a time runs it.  Remote folders are not locked.

    Raises StoreError where another process holds it, or it cannot be written.
    """
    folder = storage.local
    if folder is None:
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK).acquire(timeout=0)
    except Timeout:
        owner = (folder / OWNER).read_text() if (folder / OWNER).exists() else "?"
        raise StoreError(f"{folder}: process {owner} runs this sweep; wait for it") from None
    except OSError as error:
        raise StoreError(f"{folder} cannot be written: {error.strerror}") from None
    with lock:
        (folder / OWNER).write_text(str(os.getpid()))
        yield
