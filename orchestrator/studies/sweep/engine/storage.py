"""The folder of a sweep: on this machine, or on any file system that fsspec knows (s3://, sftp://, ...)."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ....errors import OrchError, StoreError

PART = ".part-"  # begins the name of a record that is being written
MISSING = 'sweeps need dask, distributed, fsspec and scipy; pip install "orch[sweep]"'


def is_local(address: str) -> bool:
    return "://" not in address


class Storage:
    """A folder of files.  address: a path, or an fsspec URL.  Raises StoreError where it cannot be reached."""

    def __init__(self, address: str):
        self.address = address.rstrip("/")
        if is_local(address):
            self._system: Any = None
            self._root = str(Path(address).resolve())
            return
        try:
            from fsspec.core import url_to_fs
        except ImportError:
            raise OrchError(MISSING) from None
        try:
            self._system, self._root = url_to_fs(self.address)
        except (ImportError, ValueError) as error:  # a protocol that is unknown, or whose package is missing
            raise StoreError(f"{address} cannot be reached: {error}") from None

    @property
    def local(self) -> Path | None:
        """The folder, if it lies on this machine."""
        return Path(self._root) if self._system is None else None

    def place(self, name: str) -> str:
        """The path of a file, as the file system knows it."""
        return f"{self._root}/{name}"

    def exists(self, name: str) -> bool:
        place = self.place(name)
        return os.path.exists(place) if self._system is None else bool(self._system.exists(place))

    def names(self, pattern: str) -> list[str]:
        """Paths below the folder that fit a glob, sorted."""
        if self._system is None:
            return sorted(path.relative_to(self._root).as_posix() for path in Path(self._root).glob(pattern))
        paths = self._system.glob(self.place(pattern))
        return sorted(str(path)[len(self._root) :].lstrip("/") for path in paths)

    def read(self, name: str) -> bytes:
        """Raises StoreError where it cannot be read."""
        try:
            place = self.place(name)
            return Path(place).read_bytes() if self._system is None else bytes(self._system.cat_file(place))
        except OSError as error:
            raise StoreError(f"{self.address}/{name} cannot be read: {_reason(error)}") from None

    def write(self, name: str, content: bytes) -> None:
        """Write a file atomically: a reader sees the old content or the new.  Raises StoreError."""
        with self._writing(name):
            if self._system is None:
                target = Path(self.place(name))
                target.parent.mkdir(parents=True, exist_ok=True)
                beside = target.with_name(f".{target.name}.{os.getpid()}")
                beside.write_bytes(content)
                os.replace(beside, target)
            else:
                self._system.makedirs(os.path.dirname(self.place(name)), exist_ok=True)
                self._system.pipe_file(self.place(name), content)

    def put(self, source: Path, name: str) -> None:
        """Move a file here, atomically.  Raises StoreError."""
        with self._writing(name):
            if self._system is None:
                os.replace(source, self.place(name))
            else:
                self._system.put_file(str(source), self.place(name))
                source.unlink()

    def remove(self, name: str) -> None:
        """Raises StoreError."""
        with self._writing(name):
            if self._system is None:
                os.unlink(self.place(name))
            else:
                self._system.rm_file(self.place(name))

    @contextmanager
    def opened(self, name: str) -> Iterator[Any]:
        """What h5py can open: a path, or a file-like object.  Raises OSError."""
        if self._system is None:
            yield self.place(name)
        else:
            with self._system.open(self.place(name), "rb") as file:
                yield file

    @contextmanager
    def scratch(self, name: str) -> Iterator[Path]:
        """Where a file is written before `put` moves it here; nothing of it is left at the end."""
        if self._system is None:  # on the same file system, so that moving is renaming
            place = Path(self.place(f"{PART}{os.getpid()}-{Path(name).stem}"))
            try:
                yield place
            finally:
                place.unlink(missing_ok=True)
        else:
            with tempfile.TemporaryDirectory(prefix="orch-") as folder:
                yield Path(folder) / name

    @contextmanager
    def _writing(self, name: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise StoreError(f"{self.address}/{name} cannot be written: {_reason(error)}") from None


def _reason(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
