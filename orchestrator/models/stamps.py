"""Stamps: what a built FMU was built from, so that it is built again only where that would give other bytes."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from .catalogue import PACKAGE, models_folder, stamp_path
from .compiler import Compiler


@dataclass(frozen=True, kw_only=True)
class Stamp:
    """source: the model's file.  sources: {file: SHA-256} of all that went in.  plain: whether it is plain Python.

    despite: identity of a compiler that failed, so that the FMU became a Python one; "" otherwise.
    """

    source: str
    sources: Mapping[str, str]
    plain: bool
    despite: str = ""


def write(fmu: Path, stamp: Stamp, compiler: Compiler | None) -> None:
    """Stamp a built FMU.  compiler: of a native FMU."""
    content = {"fmu": _version(fmu), "tools": tools(compiler), **asdict(stamp)}
    stamp_path(fmu).write_text(json.dumps(content, indent=1))


def fresh(fmu: Path, source: Path, compiler: Compiler | None) -> Stamp | None:
    """The stamp of an FMU if building it again from `source` would give the same bytes, else None."""
    try:
        content = json.loads(stamp_path(fmu).read_text())
        version, built_with, stamp = content.pop("fmu"), content.pop("tools"), Stamp(**content)
        sources = dict(stamp.sources)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # no stamp, or one of another form
        return None
    is_fresh = (
        version == _version(fmu)
        and built_with == tools(compiler)
        and stamp.source == str(source)
        and all(_digest(Path(file)) == digest for file, digest in sources.items())
    )
    return stamp if is_fresh else None


@cache
def tools(compiler: Compiler | None) -> str:
    """Digest of what besides the model decides its FMU's bytes: packager, units, and the compiler or pythonfmu."""
    maker = compiler.identity if compiler else importlib.metadata.version("pythonfmu")
    digest = hashlib.sha256(maker.encode())
    for file in (*sorted((models_folder() / "packager").glob("*.[pc]*")), PACKAGE / "fmu" / "units.py"):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""


def _version(fmu: Path) -> list[int]:
    """Size and time of modification, which differ between two builds of a file."""
    if not fmu.is_file():
        return []
    status = fmu.stat()
    return [status.st_size, status.st_mtime_ns]
