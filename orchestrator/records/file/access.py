"""Whether a process is writing a record, and how to read a record that is being written.

HDF5 locks the files that it has open (https://github.com/h5py/h5py/issues/712).  The writer keeps its lock, which shows
that the run goes on; readers open without one (https://github.com/h5py/h5py/issues/1722), and read again where they met
the file between two of its states.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import h5py

from ...errors import StoreError
from .foreign import root_attributes, text_of
from .format import FORMAT

PATIENCE = 1.0  # s; a file that is being written may not be readable at every instant

# What h5py raises where a file is damaged, or is being written.
UNREADABLE = (OSError, KeyError, RuntimeError, ValueError)

T = TypeVar("T")


def patiently(action: Callable[[], T], while_: Callable[[], bool] = lambda: True) -> T:
    """Repeat an action that raises one of UNREADABLE, for a while and as long as `while_` holds; then let it raise."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            return action()
        except UNREADABLE:
            if time.monotonic() > deadline or not while_():
                raise
            time.sleep(0.01)


def opened(path: Path) -> h5py.File:
    """A record, opened.  Raises OSError where the file has not, or not yet, the attributes of one."""
    file = h5py.File(path, "r", locking=False)
    if "hostname" not in file.attrs or text_of(file, "format") != FORMAT:
        file.close()
        raise OSError("it does not have the attributes of one")
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
    except OSError:  # it was deleted, or is on a file system without locks
        pass
    return False


def is_taken(path: Path) -> bool:
    """Whether a process is writing the file, or is about to: a writer creates a file an instant before it locks it."""
    deadline = time.monotonic() + PATIENCE
    while not is_locked(path):
        if not path.exists() or _is_left(path) or time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def _is_left(path: Path) -> bool:
    """Whether an unlocked file is a record that its writer has ended, or left by dying; else it may yet be locked."""
    try:
        with opened(path) as file:
            facts = root_attributes(file, without=("model_descriptions",))
            running = facts["status"] == "running" and facts["hostname"] == socket.gethostname()
            return not (running and _lives(facts["pid"]))
    except UNREADABLE:
        return False


def _lives(process: int) -> bool:
    """Whether another process of this machine has that number."""
    if process == os.getpid() or os.name == "nt":  # on Windows, signal 0 is no question
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        pass
    return True


def _is_locked_for_hdf5(path: Path) -> bool:
    """The same through HDF5, which sees no lock of this process."""
    try:
        with h5py.File(path, "r", locking=True):
            return False
    except BlockingIOError:
        return True
    except OSError:
        return False


def being_written(path: Path) -> StoreError:
    """The error for a record that another process is writing."""
    try:
        with patiently(lambda: opened(path)) as file:
            facts = root_attributes(file, without=("model_descriptions",))
            writer = f"process {facts['pid']} on {facts['hostname']}"
    except UNREADABLE:
        writer = "another process"
    return StoreError(f"{path} is being written by {writer}; wait for it, or write to another file with --output")


def first_line(error: BaseException) -> str:
    return str(error).partition("\n")[0]
