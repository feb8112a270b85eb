"""A temporary folder that goes with its process: the next process removes what a killed one leaves."""

from __future__ import annotations

import contextlib
import functools
import shutil
import tempfile
from pathlib import Path

from filelock import FileLock, Timeout

PREFIX = "orch-"
LOCK = "lock"


class Scratch:
    """`path`: an empty folder.  While the process lives, it holds a lock in there, which a kill releases."""

    def __init__(self) -> None:
        _remove_abandoned(Path(tempfile.gettempdir()))
        self.path, self._lock = _locked_folder()

    def close(self) -> None:
        self._lock.release()
        shutil.rmtree(self.path, ignore_errors=True)


def _locked_folder() -> tuple[Path, FileLock]:
    """A new folder and its lock."""
    while True:
        path = Path(tempfile.mkdtemp(prefix=PREFIX))
        lock = FileLock(path / LOCK, thread_local=False)  # whichever thread closes
        with contextlib.suppress(FileNotFoundError):  # another process saw the file before it was locked
            lock.acquire()
            return path, lock


@functools.cache  # once a process
def _remove_abandoned(folder: Path) -> None:
    for lock in folder.glob(f"{PREFIX}*/{LOCK}"):
        with contextlib.suppress(OSError, Timeout), FileLock(lock, timeout=0):  # another user's, alive, or gone by now
            shutil.rmtree(lock.parent, ignore_errors=True)
