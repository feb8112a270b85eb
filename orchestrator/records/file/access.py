"""Who is writing a record, and how to read one meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import h5py

from ...errors import StoreError
from .format import FORMAT

PATIENCE = 1.0  # s; a file that is being written may not be readable at every instant

# What h5py raises at a file that is damaged, or being written.
UNREADABLE = (OSError, KeyError, RuntimeError, ValueError)

T = TypeVar("T")


def patiently(action: Callable[[], T], while_: Callable[[], bool] = lambda: True) -> T:
    """Try again for a while where a file cannot be opened, or lacks an attribute.  Raises the last error."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            return action()
        except UNREADABLE:
            if time.monotonic() > deadline or not while_():
                raise
            time.sleep(0.01)


def opened(path: Path) -> h5py.File:
    """The file, with its attributes.  Raises OSError where it has none, or none yet."""
    file = h5py.File(path, "r", locking=False)
    if "hostname" not in file.attrs or file.attrs["format"] != FORMAT:
        file.close()
        raise OSError("it says nothing of one")
    return file


def is_locked(path: Path) -> bool:
    """Whether a process is writing the file: HDF5 holds a lock on it."""
    try:
        import fcntl
    except ImportError:  # Windows
        return _is_locked_for_hdf5(path)
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # it is gone, or on a file system without locks
        pass
    return False


def is_taken(path: Path) -> bool:
    """Whether a process is writing the file, or is about to: between creating and locking it there is an instant."""
    deadline = time.monotonic() + PATIENCE
    while not is_locked(path):
        if not path.exists() or _is_record(path) or time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def _is_record(path: Path) -> bool:
    try:
        opened(path).close()
    except UNREADABLE:
        return False
    return True


def _is_locked_for_hdf5(path: Path) -> bool:
    """The same through HDF5, which says nothing of a file that this process has open."""
    try:
        with h5py.File(path, "r", locking=True):
            return False
    except BlockingIOError:
        return True
    except OSError:
        return False


def being_written(path: Path) -> StoreError:
    """What to say of a record that another process writes."""
    try:
        with patiently(lambda: opened(path)) as file:
            writer = f"process {file.attrs['pid']} on {file.attrs['hostname']}"
    except UNREADABLE:
        writer = "another process"
    return StoreError(f"{path} is being written by {writer}; wait for it, or write to another file with --output")


def first_line(error: BaseException) -> str:
    return str(error).partition("\n")[0]
