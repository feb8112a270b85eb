"""What a worker keeps between runs: FMUs fetched by digest, unpacked and loaded once.

Besides the time it saves, a library that is loaded from the same file again is the same one to the system's loader;
unpacked for every run, each run's libraries would stay in memory.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from pathlib import Path
from typing import Any

from .. import system, wiring
from ..errors import StoreError
from ..fmu import Fmu
from ..instance import Library
from .storage import Storage


class Shelf:
    """The FMUs of this process, in a folder that is gone when the process ends orderly."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="orch-worker-", ignore_cleanup_errors=True)
        self._read: dict[tuple[Any, ...], Fmu] = {}
        self._libraries: dict[str, Library] = {}
        self._fetch, self._unpack = wiring.read, system.unpack

    def fmu(self, storage: Storage, digest: str) -> Path:
        """The FMU of that digest, from the sweep's folder.  Raises StoreError where it is not what it should be."""
        path = Path(self._folder.name) / f"{digest}.fmu"
        if not path.exists():
            content = storage.read(fmu_place(digest))
            if hashlib.sha256(content).hexdigest() != digest:
                raise StoreError(f"{storage.address}/{fmu_place(digest)} is damaged; delete it and begin the sweep again")
            beside = path.with_suffix(".part")
            beside.write_bytes(content)
            os.replace(beside, path)
        return path

    def read(self, path: Path, *more: Any) -> Fmu:
        """`fmu.read`, once a file of this folder."""
        if path.parent != Path(self._folder.name):
            return self._fetch(path, *more)
        key = (path, *map(repr, more))
        if key not in self._read:
            self._read[key] = self._fetch(path, *more)
        return self._read[key]

    def unpack(self, fmu: Fmu, folder: Path) -> None:
        """`fmu.unpack` as a link to what has been unpacked before."""
        target = self._unpacked(fmu)
        folder.parent.mkdir(parents=True, exist_ok=True)
        try:
            folder.symlink_to(target, target_is_directory=True)
        except OSError:  # Windows allows links to some users only
            self._unpack(fmu, folder)

    def library(self, fmu: Fmu, folder: Path) -> Library:
        """A native FMU's library, loaded once; a Python FMU's lives with the run, for its folder joins Python's path."""
        if fmu.packaging == "python":
            return Library(fmu, folder)
        if fmu.sha256 not in self._libraries:
            self._libraries[fmu.sha256] = Library(fmu, self._unpacked(fmu))
        return self._libraries[fmu.sha256]

    def _unpacked(self, fmu: Fmu) -> Path:
        folder = Path(self._folder.name) / fmu.sha256 / fmu.model_identifier
        if not folder.exists():
            self._unpack(fmu, folder)
        return folder


def fmu_place(digest: str) -> str:
    """Where a sweep's folder has an FMU."""
    return f"fmus/{digest}.fmu"


_shelves: list[Shelf] = []


def shelf() -> Shelf:
    """The shelf of this process, made at the first call; from then on runs of this process take their FMUs from it."""
    if not _shelves:
        mine = Shelf()
        _shelves.append(mine)
        wiring.read, system.unpack = mine.read, mine.unpack
        with contextlib.suppress(AttributeError):
            system.Library = mine.library  # type: ignore[assignment,misc]
    return _shelves[0]
