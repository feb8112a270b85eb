"""An .ssp as it came from somebody: checked before anything is read, nothing unpacked but FMUs that are asked for."""

from __future__ import annotations

import contextlib
import os
import posixpath
import tempfile
import urllib.parse
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import ExperimentError, FmuError, OrchError, Problem
from ..fmu import DAMAGED, _checked_names
from .names import DESCRIPTION

MAX_XML = 64 << 20  # bytes of one XML file, unpacked


class Unreadable(Exception):
    """One file of the archive that cannot be had; the text is a sentence."""


class Archive:
    def __init__(self, path: Path, archive: zipfile.ZipFile, names: set[str]):
        self.path, self._archive, self.names = path, archive, names

    @classmethod
    @contextlib.contextmanager
    def open(cls, path: Path) -> Iterator[Archive]:
        """Raises ExperimentError where it is no archive, a dangerous one, or holds no system."""
        try:
            archive = zipfile.ZipFile(path)
        except zipfile.BadZipFile:
            raise _failure(path, "is no SSP: not a zip file") from None
        except OSError as error:
            raise _failure(path, f"cannot be read: {error.strerror or error}") from None
        except DAMAGED as error:
            raise _failure(path, f"is damaged: {error}") from None
        with archive:
            try:
                names = _checked_names(path, archive)
            except FmuError as error:
                raise _failure(path, str(error)) from None
            if DESCRIPTION not in names:
                raise _failure(path, f"is no SSP: it has no {DESCRIPTION}")
            yield cls(path, archive, names)

    def member(self, source: str) -> str:
        """The archive's name of what a relative URI means.  Raises Unreadable."""
        parts = urllib.parse.urlsplit(source)
        name = posixpath.normpath(urllib.parse.unquote(parts.path))
        if parts.scheme or parts.netloc or name.startswith(("/", "..")):
            raise Unreadable(f"{source!r} lies outside the archive")
        if parts.fragment or parts.query:
            raise Unreadable(f"{source!r} means a part of a file")
        if name not in self.names:
            raise Unreadable(f"the archive has no {source!r}")
        return name

    def read(self, source: str, limit: int | None = None) -> bytes:
        """Raises Unreadable."""
        name = self.member(source)
        if limit is not None and self._archive.getinfo(name).file_size > limit:
            raise Unreadable(f"{name} is larger than {limit >> 20} MB")
        try:
            return self._archive.read(name)
        except (*DAMAGED, OSError) as error:  # OSError: a place in the file that there is not
            raise Unreadable(f"{name} is damaged: {error}") from None

    def xml(self, source: str) -> Any:
        """The root of an XML file: no entity is expanded, nothing else is loaded for it.  Raises Unreadable."""
        from lxml import etree

        content = self.read(source, MAX_XML)
        parser = etree.XMLParser(
            resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False,
            remove_comments=True, remove_pis=True,
        )  # fmt: skip
        try:
            root = etree.fromstring(content, parser)
        except (etree.XMLSyntaxError, ValueError) as error:
            raise Unreadable(f"{source} cannot be read as XML: {error}") from None
        if root.getroottree().docinfo.doctype or root.getroottree().docinfo.internalDTD is not None:
            raise Unreadable(f"{source} declares a document type, which an SSP does not need; not read")
        return root

    def unpack(self, source: str, folder: Path) -> Path:
        """Put a file of the archive into a folder, unless it is there.  Raises Unreadable, OrchError."""
        content = self.read(source)
        target = folder / posixpath.basename(self.member(source))
        try:
            if target.is_file() and target.read_bytes() == content:
                return target
            folder.mkdir(parents=True, exist_ok=True)
            handle, half = tempfile.mkstemp(dir=folder)
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.replace(half, target)
        except OSError as error:
            raise OrchError(f"{target} cannot be written: {error.strerror or error}") from None
        return target


def _failure(path: Path, sentence: str) -> ExperimentError:
    return ExperimentError(path, [Problem("", sentence.removeprefix(f"{path} "))])
