"""What this machine has, and what is missing for what."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from ...fmu.fmu import platform_folder
from ...models import compiler as compilers
from ...models.catalogue import build_folder
from ...simulation.loop import compiled, out_of_date
from ...views.tables.terminal import table

NEEDED = ("numpy", "h5py", "fmpy", "pythonfmu", "casadi", "matplotlib", "pandas", "click")
OPTIONAL = {
    "xarray": "opening records with xarray.open_datatree (with h5netcdf): pip install xarray h5netcdf",
    "h5netcdf": "opening records with xarray.open_datatree: pip install xarray h5netcdf",
}


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
    yield Finding("loop", *_loop())
    folder = build_folder()
    yield Finding("built FMUs", "ok" if _writable(folder) else "missing", f"{folder}")
    yield Finding(
        "results",
        *(
            ("ok", "./results can be written")
            if _writable(Path("results"))
            else ("missing", "./results cannot be written here; use --results DIR")
        ),
    )


def _platform() -> tuple[str, str]:
    name = f"{platform.system()} {platform.machine()}"
    if platform.system() == "Linux" and platform.machine() == "x86_64":
        return "ok", f"{name}: tested"
    if platform.system() == "Windows" and platform.machine() in ("AMD64", "x86_64"):
        return "note", f"{name}: expected to work, not tested"
    return "note", f"{name}: expected to work with a C compiler, not tested"


def _packaging() -> tuple[str, str]:
    compiler = compilers.find()
    if compiler is not None:
        return "ok", f"native: models are compiled by {' '.join(compiler.command)}"
    folder, suffix = platform_folder()
    spec = find_spec("pythonfmu")
    libraries = Path(spec.origin).parent / "resources" / "binaries" / folder if spec and spec.origin else Path("none")
    if not list(libraries.glob(f"*{suffix}")):
        return "missing", f"no C compiler was found, and pythonfmu has no library for {folder}: {compilers.HOW}"
    return "note", f"python: no C compiler was found, so models run in Python, slower; {compilers.HOW}"


def _loop() -> tuple[str, str]:
    if compiled() is not None:
        return "ok", "compiled"
    if message := out_of_date():
        return "note", message
    return "note", "python: the compiled one, ten times faster, is built where orch is installed with a C compiler"


def _package(name: str, state: str, otherwise: str) -> Finding:
    if find_spec(name) is None:
        return Finding(name, state, otherwise)
    return Finding(name, "ok", importlib.metadata.version(name))


def _writable(folder: Path) -> bool:
    while not folder.exists():
        folder = folder.absolute().parent
    return os.access(folder, os.W_OK)


def report(findings: Sequence[Finding]) -> str:
    """The findings as a table, and a verdict."""
    mark = {"ok": "ok", "missing": "MISSING", "note": "-"}
    lines = table([(mark[f.state], f.what, f.detail) for f in findings], title=False)
    missing = [f.what for f in findings if f.state == "missing"]
    lines += ["", f"missing: {', '.join(missing)}" if missing else "everything that orch needs is here"]
    return "\n".join(lines)
