"""Which models exist, and where their sources and their FMUs lie."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from ..errors import FmuError, did_you_mean

PACKAGE = Path(__file__).resolve().parent.parent
KINDS = ("vehicles", "allocations", "controllers", "references", "disturbances")  # folders of the shipped models
PACKAGINGS = ("native", "python")


def models_folder() -> Path:
    """The models' sources: beside the package in a clone, inside it in an installed wheel."""
    beside = PACKAGE.parent / "fmus"
    return beside if (beside / "packager").is_dir() else PACKAGE / "_shipped" / "fmus"


def experiments_folder() -> Path:
    """The shipped experiments, beside the models' sources."""
    return models_folder().parent / "experiments"


def build_folder() -> Path:
    """Where built FMUs lie: in ORCH_BUILD if the environment sets it, else beside their sources, or in the user's
    cache folder if that folder is not writable."""
    if named := os.environ.get("ORCH_BUILD"):
        return Path(named).resolve()
    folder = models_folder()
    if os.access(folder, os.W_OK):
        return folder / "build"
    cache_home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache_home) / "orch" / "build"


@cache
def shipped() -> dict[str, Path]:
    """{name: source} of the models that come with the project."""
    folder = models_folder()
    return {path.stem: path for kind in KINDS for path in sorted((folder / kind).glob("*.py"))}


def known() -> dict[str, Path | None]:
    """{name: source} of all models: the shipped ones and those that a user has built.

    The source is None where it no longer exists: then the FMU is used as it is.
    """
    sources: dict[str, Path | None] = dict(shipped())
    for packaging in PACKAGINGS:
        for path in sorted((build_folder() / packaging).glob("*.fmu")):
            sources.setdefault(path.stem, _source_of(path))
    return sources


def source_of(name: str) -> Path | None:
    """The file that a model which a user has built was built from; None where neither exists."""
    sources = (_source_of(target(name, packaging)) for packaging in PACKAGINGS)
    return next((source for source in sources if source is not None), None)


def forget_others(name: str, source: Path) -> None:
    """Remove FMUs of this name that were built from another file than `source`: a run must not take one of them."""
    for path in (target(name, packaging) for packaging in PACKAGINGS):
        if path.is_file() and _source_of(path) != source:
            path.unlink()
            stamp_path(path).unlink(missing_ok=True)


def target(name: str, packaging: str) -> Path:
    """Where the FMU of a model lies.  packaging: one of PACKAGINGS."""
    return build_folder() / packaging / f"{name}.fmu"


def stamp_path(fmu: Path) -> Path:
    """The file beside a built FMU that says what it was built from; see `stamps`."""
    return fmu.with_suffix(".json")


def locate(fmu: str, beside: Path, built: Mapping[str, Path]) -> Path:
    """The file that an experiment in the folder `beside` means by `fmu`: a model of `built`, or the path of an .fmu.

    Raises FmuError if there is no such file or model.
    """
    if fmu.endswith(".fmu"):
        path = Path(fmu)
        path = path if path.is_absolute() else beside / path
        if not path.is_file():
            near = sorted(p.name for p in path.parent.glob("*.fmu")) if path.parent.is_dir() else []
            raise FmuError(f"no file {fmu!r}{did_you_mean(path.name, near, f'in {path.parent}')}")
        return path
    if fmu not in built:
        hint = f"; build it first: orch build {fmu}" if fmu.endswith(".py") else did_you_mean(fmu, known())
        raise FmuError(f"no FMU {fmu!r}{hint}")
    return built[fmu]


def _source_of(fmu: Path) -> Path | None:
    try:
        source = Path(json.loads(stamp_path(fmu).read_text())["source"])
    except (OSError, ValueError, KeyError):
        return None
    return source if source.is_file() else None
