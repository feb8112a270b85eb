"""A temporary folder that goes with its process: the next process removes what a killed one leaves.

The lock is the system's own: the library filelock, which sweeps use, takes 20 ms to import, a tenth of a short run.
"""

from __future__ import annotations

import contextlib
import functools
import shutil
import tempfile
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

PREFIX = "orch-"
LOCK = "lock"


class Scratch:
    """`path`: an empty folder.  While the process lives, it holds a lock in there."""

    def __init__(self) -> None:
        if fcntl is not None:
            _remove_abandoned_once(Path(tempfile.gettempdir()))
        self.path = Path(tempfile.mkdtemp(prefix=PREFIX))
        if fcntl is not None:
            # Under another name at first: nobody sees it without its lock.
            self._lock = (self.path / f"{LOCK}.new").open("w")
            fcntl.flock(self._lock, fcntl.LOCK_EX)
            (self.path / f"{LOCK}.new").rename(self.path / LOCK)

    def close(self) -> str:
        """Returns that there is nothing to report, for `watch.at_halt`."""
        shutil.rmtree(self.path, ignore_errors=True)
        if fcntl is not None:
            self._lock.close()
        return ""


def remove_abandoned(folder: Path) -> None:
    """Delete what killed processes have left."""
    if fcntl is None:
        return
    for lock in folder.glob(f"{PREFIX}*/{LOCK}"):
        with contextlib.suppress(OSError), lock.open() as file:  # another user's, or gone by now
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(lock.parent, ignore_errors=True)


_remove_abandoned_once = functools.cache(remove_abandoned)  # once a process
