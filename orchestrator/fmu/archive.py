"""The archive that holds an FMU, opened without trust: no path outside, no absurd size, no document type in its XML.

The threat is a file from somebody else: it may write outside its folder, fill the disk, or read files of the user by
entities of XML.  Own bounds, because zipfile has none, and because defusedxml does not bound lxml.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import re
import stat
import struct
import unicodedata
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from xml.parsers import expat

from ..errors import FmuError

MAX_SIZE = 4 << 30  # bytes of all files of an archive together
MAX_RATIO = 200  # unpacked to packed, of one file
MAX_TOTAL_RATIO = 50  # and of all of them
SMALL = 1 << 20  # bytes: what is smaller may have any ratio
MAX_FILES = 20_000
MAX_XML = 64 << 20  # bytes
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # FMI allows no other
LOCAL_HEADER = 30  # bytes, without the name
DIRECTORY_ENTRY = b"PK\1\2"
# Windows writes to a device where a file is so called, whatever the suffix.
DEVICE = re.compile(r"(?i)(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?$")
# What zipfile raises at damaged, encrypted and oddly compressed members.
DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    RuntimeError,
    NotImplementedError,
    EOFError,
    ValueError,
    OverflowError,
)


@dataclass(frozen=True)
class Archive:
    """An archive whose directory is checked.  `names`: of its files; `sha256`: of the whole."""

    path: Path
    sha256: str
    names: frozenset[str]
    _zip: zipfile.ZipFile

    def read(self, name: str) -> bytes:
        """The content of a file.  Raises FmuError if it is damaged."""
        with _reporting(self.path):
            return self._zip.read(name)

    def xml(self, name: str) -> str:
        """An XML file as text: it has no document type, hence no entities, and nothing is fetched for it.

        Raises FmuError if it cannot be read.
        """
        if self._zip.getinfo(name).file_size > MAX_XML:
            raise FmuError(f"{self.path}: {name} is over {MAX_XML >> 20} MB; not read")
        return checked_xml(f"{self.path}: {name}", self.read(name))

    def extract(self, folder: Path) -> None:
        """Unpack everything.  Raises FmuError if a file is damaged or the disk is full."""
        with _reporting(self.path, f" into {folder}"):
            self._zip.extractall(folder)


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Archive]:
    """The archive, read once and checked.  Raises FmuError with the reason."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FmuError(f"{path} cannot be read: {error.strerror or error}") from None
    # Before zipfile reads the directory: it takes 10 us and half a kilobyte a file.
    if content.count(DIRECTORY_ENTRY) > MAX_FILES:
        raise FmuError(f"{path} holds over {MAX_FILES} files; not opened")
    try:
        archive = zipfile.ZipFile(io.BytesIO(content))
    except zipfile.BadZipFile:
        raise FmuError(f"{path} is not an FMU: not a zip file") from None
    except DAMAGED as error:
        raise FmuError(f"{path} is damaged: {error}") from None
    with archive:
        _check(path, archive, len(content))
        names = frozenset(archive.namelist())
        yield Archive(path, hashlib.sha256(content).hexdigest(), names, archive)


@contextlib.contextmanager
def _reporting(path: Path, where: str = "") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise FmuError(f"{path} cannot be unpacked{where}: {error.strerror or error}") from None
    except DAMAGED as error:
        raise FmuError(f"{path} is damaged: {error}") from None


def _check(path: Path, archive: zipfile.ZipFile, size: int) -> None:
    entries = archive.infolist()
    if len(entries) > MAX_FILES:
        raise FmuError(f"{path} holds over {MAX_FILES} files; not opened")
    total = 0
    for entry in entries:
        if problem := _problem(entry):
            raise FmuError(f"{path} {problem}; not opened")
        total += entry.file_size
        absurd = entry.file_size > MAX_RATIO * max(entry.compress_size, SMALL)
        if absurd or total > min(MAX_SIZE, max(MAX_TOTAL_RATIO * size, MAX_RATIO * SMALL)):
            raise FmuError(f"{path} unpacks to an absurd size at {entry.filename!r}; not opened")
    if problem := _overlap(archive, entries) or _ambiguity(entries):
        raise FmuError(f"{path} {problem}; not opened")


def _problem(entry: zipfile.ZipInfo) -> str:
    """What is wrong with one entry by itself; "" if nothing is."""
    name = entry.orig_filename  # zipfile cuts `filename` at a NUL
    if any(ord(letter) < 32 or ord(letter) == 127 for letter in name):
        return f"has a file with a control character in its name: {name!r}"
    path = PurePosixPath(name.replace("\\", "/"))
    if not name or path.is_absolute() or ".." in path.parts or ":" in name or "\\" in name:
        return f"would write outside its folder: {name!r}"
    for part in path.parts:
        if DEVICE.match(part) or part.endswith((".", " ")):
            return f"has a file whose name means another file on Windows: {name!r}"
    if stat.S_ISLNK(entry.external_attr >> 16):
        return f"contains a link, {name!r}"
    if entry.flag_bits & 1:
        return f"has an encrypted file: {name!r}"
    if entry.compress_type not in METHODS:
        return f"is compressed in a way that FMI does not allow, at {name!r}"
    return ""


def _overlap(archive: zipfile.ZipFile, entries: list[zipfile.ZipInfo]) -> str:
    """Files that share bytes, so that few bytes unpack to many (Fifield, A better zip bomb, 2019)."""
    end = -1
    for entry in sorted(entries, key=lambda entry: entry.header_offset):
        if entry.header_offset < end:
            return f"has files that overlap: {entry.filename!r}"
        end = entry.header_offset + LOCAL_HEADER + len(entry.orig_filename) + entry.compress_size
    return "has files that overlap its directory" if end > archive.start_dir else ""


def _ambiguity(entries: list[zipfile.ZipInfo]) -> str:
    """Files that are the same file on some systems: no tool can tell which one an FMU means."""
    known: dict[str, str] = {}
    files: dict[str, str] = {}
    for entry in entries:
        path = entry.filename.rstrip("/")
        folders = [str(folder) for folder in PurePosixPath(path).parents][:-1]
        if not entry.is_dir():
            if path in files:
                return f"holds {path!r} twice"
            files[path] = path
        for name in (path, *folders):
            other = known.setdefault(unicodedata.normalize("NFC", name).casefold(), name)
            if other != name:
                return f"holds {other!r} and {name!r}, which are the same file on some systems"
    for path in known.values():
        for folder in PurePosixPath(path).parents:
            if str(folder) in files:
                return f"holds {str(folder)!r} as a file and as a folder"
    return ""


class _HasDoctype(Exception):
    pass


class _HasRoot(Exception):
    pass


def checked_xml(what: str, content: bytes) -> str:
    """XML without a document type, as text.  what: it is, for the message.  Raises FmuError."""
    from lxml import etree

    try:
        _look_for_doctype(content)
        # libxml2 itself bounds depth and sizes, unless huge_tree is set.
        parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
        tree = etree.fromstring(content, parser).getroottree()
        if tree.docinfo.doctype:  # in an encoding that expat does not know
            raise _HasDoctype
        return str(etree.tostring(tree, encoding=str))  # not the bytes, which another reader might decode differently
    except _HasDoctype:
        raise FmuError(f"{what} has a document type, which can hide anything; not read") from None
    except (etree.LxmlError, ValueError, LookupError, MemoryError) as error:
        raise FmuError(f"{what} cannot be read: {' '.join(str(error).split()) or 'it is not XML'}") from None


def _look_for_doctype(content: bytes) -> None:
    """Raises _HasDoctype at a document type, before anything that it declares can be used."""

    def doctype(*_: object) -> None:
        raise _HasDoctype

    def root(*_: object) -> None:
        raise _HasRoot

    reader = expat.ParserCreate()
    reader.StartDoctypeDeclHandler = doctype
    reader.StartElementHandler = root
    with contextlib.suppress(_HasRoot, expat.ExpatError, ValueError, LookupError):  # lxml has the better message
        reader.Parse(content, True)
