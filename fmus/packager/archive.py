"""FMUs as zip files with the same bytes for the same content."""

from __future__ import annotations

import hashlib
import os
import pathlib
import zipfile
from collections.abc import Mapping

DATA = "resources/files"  # folder of data files in an FMU
EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest date that zip knows


def write_archive(target: pathlib.Path, files: Mapping[str, bytes]) -> None:
    """Write {path in the archive: content} to `target`, whole or not at all.

    Stored, not compressed: compressed bytes depend on the version of zlib.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_STORED) as archive:
            for path in sorted(files):
                info = zipfile.ZipInfo(path, EPOCH)
                info.external_attr = 0o644 << 16
                archive.writestr(info, files[path])
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)


def digest_of(files: Mapping[str, bytes]) -> str:
    """SHA-256 of names and contents."""
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(f"{path}\0{len(files[path])}\0".encode() + files[path])
    return digest.hexdigest()
