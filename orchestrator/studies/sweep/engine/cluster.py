"""Dask processes: of this machine, or of a cluster whose scheduler is named."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING

from ....errors import OrchError
from ....instances.scratch import remove_abandoned
from ....watch import at_halt, doing
from ...processes import cores
from . import worker
from .storage import MISSING

if TYPE_CHECKING:
    from distributed import Client, Nanny

PATIENCE = 20.0  # s until a scheduler or the first worker answers
SETTLING = 0.2  # s that the system takes to end a process that is killed


@contextlib.contextmanager
def client(scheduler: str | None, workers: int | None) -> Iterator[Client]:
    """A Dask client.  scheduler: its address; None starts `workers` processes here, by default one a core.

    Raises OrchError where Dask is not installed, or no scheduler with a worker answers.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise OrchError(MISSING) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # `scheduler` reports what matters
    # A batch whose worker died runs again on another; what kills the third, too, is a failed run, see `scheduler`.
    dask.config.set(
        {
            "distributed.scheduler.allowed-failures": 2,
            "distributed.comm.timeouts.connect": f"{PATIENCE}s",
            "distributed.worker.daemon": True,
            "distributed.scheduler.worker-saturation": 1.0,
        }
    )
    processes: list[Nanny] = []
    with contextlib.ExitStack() as stack:
        stack.callback(doing, "")  # not before they have ended
        stack.enter_context(at_halt(lambda: _kill(processes)))
        if scheduler is None:
            with _ctrl_c_held_back():
                local = LocalCluster(
                    n_workers=workers or cores(),
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=None,
                    scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # any free port: sweeps may run side by side
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                    host="127.0.0.1",
                )
            cluster = stack.enter_context(local)
            processes += cluster.workers.values()
            connected = stack.enter_context(Client(cluster))
        else:
            try:
                connected = stack.enter_context(Client(scheduler, timeout=PATIENCE))
                connected.wait_for_workers(1, timeout=PATIENCE)
            except (OSError, TimeoutError, ValueError, ImportError) as error:
                raise OrchError(
                    f"--scheduler {scheduler}: {_reason(error)}; start one by: dask scheduler, and workers "
                    "by: dask worker ADDRESS --nthreads 1"
                ) from None
        yield connected


@contextlib.contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Ctrl-C, which reaches all processes of a terminal: those started here ignore it, this one has it after."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # started later, it would let signals through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore_ctrl_c() -> None:
    """In a worker of this machine: Ctrl-C reaches it by `worker.interrupt` alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def end(client: Client, token: str) -> None:
    """Ask the workers to end the runs of a process, see `worker.interrupt`; from now on they may hang."""
    doing("the workers have not ended their runs")
    client.run(worker.interrupt, token)


def _kill(processes: Sequence[Nanny]) -> str:
    """End workers of this machine, whatever they do, and delete the FMUs that they have unpacked."""
    for process in processes:
        with contextlib.suppress(OSError, TypeError):  # it has ended
            os.kill(process.pid, signal.SIGKILL)
    time.sleep(SETTLING)
    remove_abandoned(Path(tempfile.gettempdir()))
    return ""


def mismatch(client: Client) -> str:
    """Why the workers may give other numbers than this process; "" if there is no reason."""
    here = sys.version_info[:2]
    others = {tuple(version) for version in client.run(_version).values()}
    if others - {here}:
        return f"workers run Python {sorted(others)}, this is {here}; use one version everywhere"
    return ""


def _version() -> tuple[int, ...]:
    return sys.version_info[:2]


def token() -> str:
    """Tells this process from others that use the same workers."""
    return f"{os.uname().nodename if hasattr(os, 'uname') else ''}/{os.getpid()}/{os.urandom(4).hex()}"


def _reason(error: BaseException) -> str:
    return " ".join(str(error).split()) or "no answer"
