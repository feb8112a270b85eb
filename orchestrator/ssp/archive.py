"""An .ssp as it came from somebody: checked before anything is read, nothing unpacked but FMUs that are asked for."""

from __future__ import annotations

import contextlib
import os
import posixpath
import re
import tempfile
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import ExperimentError, FmuError, OrchError, Problem, no_such_file
from ..fmu import archive as archives
from .names import DESCRIPTION


class Unreadable(Exception):
    """One file of the archive that cannot be read; the text says why."""


class SspArchive:
    """An .ssp whose directory is checked, as that of an FMU is."""

    def __init__(self, archive: archives.Archive):
        self.path, self._archive = archive.path, archive

    @classmethod
    @contextlib.contextmanager
    def open(cls, path: Path) -> Iterator[SspArchive]:
        """Raises ExperimentError where it is not an archive, not a safe one, or has no system."""
        if not path.exists():
            raise _failure(path, no_such_file(path, ".ssp"))
        with contextlib.ExitStack() as stack:
            try:
                archive = stack.enter_context(archives.opened(path))
            except FmuError as error:
                raise _failure(path, re.sub("is (no|not an) FMU", "is not an SSP", str(error))) from None
            if DESCRIPTION not in archive.names:
                raise _failure(path, f"is not an SSP: it has no {DESCRIPTION}")
            yield cls(archive)

    def member(self, source: str) -> str:
        """The archive's name of what a relative URI means.  Raises Unreadable."""
        try:
            parts = urllib.parse.urlsplit(source)
        except ValueError:
            raise Unreadable(f"{source!r} is not a URI") from None
        name = posixpath.normpath(urllib.parse.unquote(parts.path))
        if parts.scheme or parts.netloc or name.startswith(("/", "..")):
            raise Unreadable(f"{source!r} lies outside the archive")
        if parts.fragment or parts.query:
            raise Unreadable(f"{source!r} means a part of a file")
        if name not in self._archive.names:
            raise Unreadable(f"the archive has no {source!r}")
        return name

    def read(self, source: str) -> bytes:
        """Raises Unreadable."""
        name = self.member(source)
        try:
            return self._archive.read(name)
        except FmuError as error:
            raise Unreadable(f"{name}: {str(error).removeprefix(f'{self.path} ')}") from None

    def xml(self, source: str) -> Any:
        """The root of an XML file that declares no document type, hence no entities.  Raises Unreadable."""
        from lxml import etree

        try:
            text = self._archive.xml(self.member(source))
        except FmuError as error:
            raise Unreadable(str(error).removeprefix(f"{self.path}: ")) from None
        try:
            return etree.fromstring(text.encode(), etree.XMLParser(remove_comments=True, remove_pis=True))
        except (etree.XMLSyntaxError, ValueError) as error:
            raise Unreadable(f"{source} cannot be read: {error}") from None

    def unpack(self, source: str, folder: Path) -> Path:
        """Put a file of the archive into a folder that does not have it.  Raises Unreadable, OrchError."""
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
