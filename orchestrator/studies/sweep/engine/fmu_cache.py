"""What a worker keeps between runs: FMUs fetched by digest, unpacked and loaded once.

This saves time, and memory: loaded again from the same file, a library is the same one to the system's loader, whereas
libraries that are unpacked for every run would stay in memory.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import os
from pathlib import Path
from typing import Any

from ....errors import StoreError
from ....fmu import fmu as fmus
from ....fmu.fmu import Fmu
from ....instances.library import Library
from ....instances.scratch import Scratch
from ....simulation.system import FmuSource
from .storage import Storage


class FmuCache(FmuSource):
    """The FMUs of this process, in a folder that is deleted when the process ends."""

    def __init__(self) -> None:
        self._folder = Scratch()
        atexit.register(self._folder.close)
        self._read: dict[tuple[Any, ...], Fmu] = {}
        self._libraries: dict[str, Library] = {}

    def fmu(self, storage: Storage, digest: str) -> Path:
        """The file of the FMU with that digest, from the sweep's folder.  Raises StoreError where it is damaged."""
        path = self._folder.path / f"{digest}.fmu"
        if not path.exists():
            content = storage.read(fmu_place(digest))
            if hashlib.sha256(content).hexdigest() != digest:
                raise StoreError(f"{storage.address}/{fmu_place(digest)} is damaged; delete it, then sweep again")
            beside = path.with_suffix(".part")
            beside.write_bytes(content)
            os.replace(beside, path)
        return path

    def read(self, path: Path, *more: Any) -> Fmu:
        """`fmu.read`, once for each file of this folder."""
        if path.parent != self._folder.path:
            return fmus.read(path, *more)
        key = (path, *map(repr, more))
        if key not in self._read:
            self._read[key] = fmus.read(path, *more)
        return self._read[key]

    def unpack(self, fmu: Fmu, folder: Path) -> None:
        """`fmu.unpack` as a link to what has been unpacked before."""
        target = self._unpacked(fmu)
        try:
            if not folder.parent.exists():
                folder.parent.symlink_to(target.parent, target_is_directory=True)
            else:
                folder.symlink_to(target, target_is_directory=True)
        except OSError:  # Windows allows links to some users only
            fmus.unpack(fmu, folder)

    def library(self, fmu: Fmu, folder: Path) -> Library:
        """A native FMU's library, loaded once; a Python FMU's each time, for its folder joins Python's path."""
        if fmu.packaging == "python":
            return Library(fmu, folder)
        if fmu.sha256 not in self._libraries:
            self._libraries[fmu.sha256] = Library(fmu, self._unpacked(fmu))
        return self._libraries[fmu.sha256]

    def _unpacked(self, fmu: Fmu) -> Path:
        folder = self._folder.path / fmu.sha256 / fmu.model_identifier
        if not folder.exists():
            fmus.unpack(fmu, folder)
        return folder


def fmu_place(digest: str) -> str:
    """The name of an FMU in the sweep's folder."""
    return f"fmus/{digest}.fmu"


@functools.cache
def of_this_process() -> FmuCache:
    """The cache of this process, made at the first call."""
    return FmuCache()
