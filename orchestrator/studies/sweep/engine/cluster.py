"""Dask processes: of this machine, or of a cluster whose scheduler is named."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sys
from collections.abc import Iterator
from typing import Any

from ....errors import OrchError
from ...processes import cores
from .storage import MISSING

PATIENCE = 20.0  # s until a scheduler or the first worker answers


@contextlib.contextmanager
def client(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """A Dask client.  scheduler: its address; None starts `workers` processes here, one a core by default.

    Raises OrchError without Dask, or where nobody answers.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise OrchError(MISSING) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what ends and begins is told by us
    # One worker that dies is no reason to give up what it ran; `engine` tells a run that kills every worker.
    dask.config.set(
        {
            "distributed.scheduler.allowed-failures": 2,
            "distributed.comm.timeouts.connect": f"{PATIENCE}s",
            "distributed.worker.daemon": True,
            "distributed.scheduler.worker-saturation": 1.0,
        }
    )
    with contextlib.ExitStack() as stack:
        if scheduler is None:
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=workers or cores(),
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address=None,
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                    host="127.0.0.1",
                )
            )
            found = stack.enter_context(Client(cluster))
        else:
            try:
                found = stack.enter_context(Client(scheduler, timeout=PATIENCE))
                found.wait_for_workers(1, timeout=PATIENCE)
            except (OSError, TimeoutError, ValueError, ImportError) as error:
                raise OrchError(
                    f"--scheduler {scheduler}: {_words(error)}; start one by: dask scheduler, and workers "
                    "by: dask worker ADDRESS --nthreads 1"
                ) from None
        yield found


def deaf() -> None:
    """In a worker of this machine: Ctrl-C is told by the process that asked for the runs."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def alike(found: Any) -> str:
    """What keeps the workers from giving the same numbers as this process, as a sentence; "" where nothing does."""
    here = sys.version_info[:2]
    others = {tuple(version) for version in found.run(_version).values()}
    if others - {here}:
        return f"workers run Python {sorted(others)}, this is {here}; use one version everywhere"
    return ""


def _version() -> tuple[int, ...]:
    return sys.version_info[:2]


def token() -> str:
    """Names this process among those that ask the same workers."""
    return f"{os.uname().nodename if hasattr(os, 'uname') else ''}/{os.getpid()}/{os.urandom(4).hex()}"


def _words(error: BaseException) -> str:
    return " ".join(str(error).split()) or "nobody answers"
