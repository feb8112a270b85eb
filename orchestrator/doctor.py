"""What this machine has, and what is missing for what."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from .build import build_folder
from .fmu import platform_folder

NEEDED = ("numpy", "h5py", "fmpy", "pythonfmu", "casadi", "matplotlib", "pandas", "click")
OPTIONAL = {
    "xarray": "opening records with xarray.open_datatree (with h5netcdf): pip install xarray h5netcdf",
    "h5netcdf": "opening records with xarray.open_datatree: pip install xarray h5netcdf",
}
COMPILERS = ("cc", "gcc", "clang")


@dataclass(frozen=True)
class Finding:
    """One line of the report.  `state`: ok, missing or note."""

    what: str
    state: str
    detail: str


def examine() -> list[Finding]:
    return list(_findings())


def _findings() -> Iterator[Finding]:
    version = platform.python_version()
    yield Finding("Python", "ok" if sys.version_info >= (3, 11) else "missing", f"{version}, orch needs 3.11")
    yield Finding("platform", *_platform())
    for name in NEEDED:
        yield _package(name, "missing", "orch does not run without it; install orch again: pip install -e .")
    for name, purpose in OPTIONAL.items():
        yield _package(name, "note", f"not installed; needed for {purpose}")
    yield Finding("packaging", *_packaging())
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    yield Finding("C compiler", "ok" if compiler else "note", compiler or "none; models run as Python FMUs without one")
    folder = build_folder()
    yield Finding("built FMUs", "ok" if _writable(folder) else "missing", f"{folder}")
    yield Finding("results", *(("ok", "./results can be written") if _writable(Path("results")) else
                               ("missing", "./results cannot be written here; use --results DIR")))  # fmt: skip


def _platform() -> tuple[str, str]:
    name = f"{platform.system()} {platform.machine()}"
    if platform.system() == "Linux" and platform.machine() == "x86_64":
        return "ok", f"{name}: tested"
    if platform.system() == "Windows" and platform.machine() in ("AMD64", "x86_64"):
        return "note", f"{name}: expected to work, not tested"
    return "missing", f"{name}: pythonfmu has libraries for 64-bit x86 Linux and Windows only; the models cannot run"


def _packaging() -> tuple[str, str]:
    folder, suffix = platform_folder()
    spec = find_spec("pythonfmu")
    if spec is None or spec.origin is None:
        return "missing", "pythonfmu is not installed"
    libraries = list((Path(spec.origin).parent / "resources" / "binaries" / folder).glob(f"*{suffix}"))
    if not libraries:
        return "missing", f"pythonfmu has no library for {folder}"
    return "ok", "python: models run in this Python through pythonfmu"


def _package(name: str, state: str, otherwise: str) -> Finding:
    if find_spec(name) is None:
        return Finding(name, state, otherwise)
    return Finding(name, "ok", importlib.metadata.version(name))


def _writable(folder: Path) -> bool:
    while not folder.exists():
        folder = folder.absolute().parent
    return os.access(folder, os.W_OK)


def report(findings: Sequence[Finding]) -> str:
    """The findings as lines, and what they mean together."""
    width = max(len(f.what) for f in findings)
    mark = {"ok": "ok     ", "missing": "MISSING", "note": "-      "}
    lines = [f"{mark[f.state]}  {f.what.ljust(width)}  {f.detail}" for f in findings]
    missing = [f.what for f in findings if f.state == "missing"]
    lines += ["", f"missing: {', '.join(missing)}" if missing else "everything that orch needs is here"]
    return "\n".join(lines)
