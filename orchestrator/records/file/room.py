"""Room on the disk for a file that HDF5 writes.

HDF5 does not survive a write that fails, as on a full disk: the file no longer opens
(https://github.com/PyTables/PyTables/issues/695), and the process may crash when it ends
(https://github.com/h5py/h5py/issues/914).  So room is reserved before anything is written, and a little of it is always
left for the attributes that say why a run ended.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import h5py

from ...errors import StoreError
from .access import being_written, first_line, patiently
from .hdf5 import LIBVER

ROOM = 1 << 16  # bytes kept free in the file for its last attributes
SIGNATURE = 8  # bytes
# Place of the end-of-file address, 8 bytes, in a superblock of version 0:
# https://support.hdfgroup.org/documentation/hdf5/latest/_f_m_t11.html#subsec_fmt11_boot_super
STATED_END = 40
STATES = hasattr(os, "pwrite")  # not on Windows, where HDF5 would lose its position in the file


class ReservedFile:
    """A new HDF5 file, of which this process is the only writer.  `file`: open for writing.

    Raises StoreError where the path exists, or cannot be written.
    """

    def __init__(self, path: Path, content: bytes):
        """content: of the file, without a row."""
        self.path, self._end = path, len(content)
        _claim(path, content)
        try:
            self.file = patiently(lambda: h5py.File(path, "r+", libver=LIBVER))
            with self._reporting():
                _reserve(self._descriptor, path, self._end + ROOM)
        except BaseException:
            self.abandon()
            path.unlink(missing_ok=True)
            raise

    @contextlib.contextmanager
    def writing(self, size: int) -> Iterator[None]:
        """Reserve room for `size` bytes and ROOM more; then what the body writes is flushed, and ROOM stays.

        A reader refuses a file that is shorter than its superblock states, and reads nothing beyond the stated end;
        HDF5 states the end last of all (https://github.com/h5py/h5py/issues/1179).  Here the end of the room is stated
        first, so that a kill in the middle of a flush costs no row of the flush before.  Raises StoreError.
        """
        with self._reporting():
            if size:
                _reserve(self._descriptor, self.path, self._end + size + ROOM)
            stated = os.fstat(self._descriptor).st_size
            self._state_end(stated)
            yield
            self.file.flush()
            end = self._stated_end()
            self._end = end if end != stated else self._end  # HDF5 states it only where it has changed
            self._state_end(self._end)
            if size:
                os.ftruncate(self._descriptor, self._end + ROOM)

    def close(self) -> None:
        """Close the file, and give back what is left of the room.  Raises StoreError."""
        with self._reporting():
            self.file.close()
            with self.path.open("r+b") as file:
                file.seek(STATED_END)
                file.truncate(int.from_bytes(file.read(8), "little"))

    def abandon(self) -> None:
        """Let go of a file that can no longer be written; what was flushed stays readable."""
        with contextlib.suppress(Exception):
            self.file.close()

    @property
    def _descriptor(self) -> int:
        return int(self.file.id.get_vfd_handle())

    def _stated_end(self) -> int:
        if not STATES:
            return int(self.file.id.get_filesize())
        return int.from_bytes(os.pread(self._descriptor, 8, STATED_END), "little")

    def _state_end(self, end: int) -> None:
        if STATES:
            os.pwrite(self._descriptor, end.to_bytes(8, "little"), STATED_END)

    @contextlib.contextmanager
    def _reporting(self) -> Iterator[None]:
        """Turn errors of the system and of HDF5 into StoreError; h5py raises RuntimeError from a flush that fails."""
        try:
            yield
        except (OSError, RuntimeError) as error:
            raise _cannot_write(self.path, error) from None


def _claim(path: Path, content: bytes) -> None:
    """Create the file, which nobody else may have created, if there is ROOM after the content.  Raises StoreError.

    HDF5's signature, the first bytes, is written last: until then no reader takes it for a record.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            file = path.open("xb")
        except FileExistsError:
            raise being_written(path) from None
        try:
            with file:
                _reserve(file.fileno(), path, len(content) + ROOM)
                file.seek(SIGNATURE)
                file.write(content[SIGNATURE:])
                file.seek(0)
                file.write(content[:SIGNATURE])
                file.truncate(len(content))  # HDF5 would do that, and later
        except OSError:
            path.unlink()
            raise
    except OSError as error:
        raise _cannot_write(path, error) from None


def _reserve(descriptor: int, path: Path, size: int) -> None:
    """Make the file `size` bytes long, with blocks behind them.  Raises OSError where the disk is full.

    Not every file system can: ZFS answers EINVAL or EOPNOTSUPP (https://github.com/ClusterLabs/libqb/pull/509).
    """
    if hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(descriptor, 0, size)
            return
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
                raise
    if shutil.disk_usage(path.parent).free < size - os.fstat(descriptor).st_size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.ftruncate(descriptor, size)


def _cannot_write(path: Path, error: BaseException) -> StoreError:
    number = getattr(error, "errno", None)
    reason = os.strerror(number) if number else first_line(error)
    return StoreError(f"{path} cannot be written: {reason}")
