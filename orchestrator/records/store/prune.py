"""Deleting a record, and only the one that was meant: what a list says of a file may be out of date."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ..file.access import is_locked, is_taken
from . import index

YOUNG = 60.0  # s; a younger file without attributes may be one that a run has just created


class NotDeleted(Exception):
    """A record is not deleted; the text says why."""


def delete(path: Path, passes: Callable[[Mapping[str, Any]], bool]) -> None:
    """Delete a record if it still `passes`, judged by its facts as they are now; a file that no longer exists is none.

    Raises NotDeleted if it does not pass, if a process is writing it, or if it cannot be deleted.
    """
    with contextlib.suppress(FileNotFoundError):
        # Before the lock is taken, which would hinder a run that has just created the file.
        if abs(time.time() - path.stat().st_mtime) < YOUNG and is_taken(path):
            raise NotDeleted("a process writes it")
        with _unwritten(path) as opened:
            facts = index.read(str(path))
            if facts and facts["status"] == "running":
                facts["status"] = "interrupted (killed)"  # nobody writes it
            if facts and not passes({**facts, "file": str(path), "bytes": opened.st_size}):
                raise NotDeleted(f"it has changed since it was listed, and is {facts['status']} now")
            if _identity(path.stat()) != _identity(opened):
                raise NotDeleted("it has just been replaced")
            _unlink(path)


def _unlink(path: Path) -> None:
    try:
        path.unlink()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise NotDeleted(f"it cannot be deleted: {error.strerror}") from None


def _identity(status: os.stat_result) -> tuple[int, ...]:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


@contextlib.contextmanager
def _unwritten(path: Path) -> Iterator[os.stat_result]:
    """Hold the lock that a writer would need; gives the file's stat.  Raises NotDeleted if a writer has the lock."""
    try:
        import fcntl
    except ImportError:  # Windows deletes no file that another process has open
        if is_locked(path):
            raise NotDeleted("a process writes it") from None
        yield path.stat()
        return
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise NotDeleted(f"it cannot be opened: {error.strerror}") from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise NotDeleted("a process writes it") from None
        except OSError:  # a file system without locks
            pass
        yield os.fstat(descriptor)
    finally:
        os.close(descriptor)
