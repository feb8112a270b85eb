"""Where FMUs come from: finding them by name, and building the stale ones.

Models are built by `fmus/packager`, in a process of its own: nothing here imports a model.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

from .errors import FmuError, OrchError, did_you_mean

PACKAGE = Path(__file__).resolve().parent


class BuildError(OrchError):
    """Models that cannot become FMUs.  `.reasons`: {name: sentence}."""

    def __init__(self, reasons: dict[str, str]):
        self.reasons = reasons
        super().__init__("\n".join(dict.fromkeys(reasons.values())))


def models_folder() -> Path:
    """The models' sources: beside the package in a clone, inside it in an installed wheel."""
    beside = PACKAGE.parent / "fmus"
    return beside if (beside / "packager").is_dir() else PACKAGE / "_shipped" / "fmus"


def experiments_folder() -> Path:
    return models_folder().parent / "experiments"


def build_folder() -> Path:
    """Where built FMUs lie: in ORCH_BUILD where the environment names it, else beside their sources, or in the user's
    cache where these cannot be written."""
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
    kinds = ("vehicles", "allocations", "controllers", "references", "disturbances")
    return {path.stem: path for kind in kinds for path in sorted((folder / kind).glob("*.py"))}


def target(name: str) -> Path:
    return build_folder() / "python" / f"{name}.fmu"


def known() -> dict[str, Path | None]:
    """{name: source} of all models: the shipped ones and whatever a user has built."""
    found: dict[str, Path | None] = dict(shipped())
    for path in sorted(target("x").parent.glob("*.fmu")):
        found.setdefault(path.stem, _source_of(path))
    return found


def locate(fmu: str, beside: Path) -> Path:
    """The file that an experiment in folder `beside` means by `fmu`: a model's name or the path of an .fmu.

    Raises FmuError where there is none.  A named model may still have to be built.
    """
    if fmu.endswith(".fmu"):
        path = Path(fmu)
        path = path if path.is_absolute() else beside / path
        if not path.is_file():
            near = sorted(p.name for p in path.parent.glob("*.fmu")) if path.parent.is_dir() else []
            raise FmuError(f"no file {fmu!r}{did_you_mean(path.name, near, f'in {path.parent}')}")
        return path
    if fmu not in known():
        hint = f"; build it first: orch build {fmu}" if fmu.endswith(".py") else did_you_mean(fmu, known())
        raise FmuError(f"no FMU {fmu!r}{hint}")
    return target(fmu)


def build(
    names: Iterable[str], told: Callable[[str], None] = lambda _: None, force: bool = False
) -> dict[str, Path]:
    """Build those of the named models that are stale, or all of them with `force`.

    names: of models, or paths of a user's .py files.  told: called with each name as its build begins.
    Returns {name: FMU}.  Raises BuildError, naming every model that failed and why.
    """
    sources = dict(map(_source, names))
    stale = {n: path for n, path in sources.items() if path is not None and (force or not _fresh(target(n), path))}
    if stale:
        for name in stale:
            told(name)
        _package(stale)
    return {name: target(name) for name in sources}


def _source(name: str) -> tuple[str, Path | None]:
    if not name.endswith(".py"):
        if name not in known():
            raise BuildError({name: f"no model {name!r}{did_you_mean(name, known())}"})
        return name, known()[name]
    path = Path(name).resolve()
    if not path.is_file():
        near = sorted(p.name for p in path.parent.glob("*.py"))
        raise BuildError({name: f"no file {name!r}{did_you_mean(path.name, near)}"})
    if not path.stem.isidentifier():
        raise BuildError({name: f"{name}: {path.stem!r} cannot name a model; use letters, digits and _"})
    own = shipped().get(path.stem)
    if own is not None and own != path:
        raise BuildError({name: f"{name}: {path.stem!r} is the name of a model that comes with orch; rename the file"})
    return path.stem, path


def _package(sources: dict[str, Path]) -> None:
    folder = target("x").parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in sources:
            _stamp(target(name)).unlink(missing_ok=True)
    except OSError as error:
        sentence = f"the folder of built FMUs, {folder}, cannot be written: {error.strerror}"
        raise BuildError(dict.fromkeys(sources, sentence)) from None
    requests = "".join(json.dumps({"source": str(s), "target": str(target(n))}) + "\n" for n, s in sources.items())
    # Without bytecode files: the sources' folder may be shared or not writable.
    environment = {**os.environ, "PYTHONPATH": str(models_folder()), "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.run(
        [sys.executable, "-m", "packager"], input=requests, capture_output=True, text=True, env=environment, check=False
    )
    answers = {Path(a["target"]).stem: a for a in map(json.loads, process.stdout.splitlines())}
    reasons = {}
    last_words = process.stderr.strip().splitlines()[-1:] or [f"exit code {process.returncode}"]
    for name, source in sources.items():
        answer = answers.get(name, {"error": f"the build stopped: {last_words[0]}"})
        if "error" in answer:
            reasons[name] = f"{source} cannot be built: {answer['error']}"
        else:
            stamp = {"source": str(source), "sources": answer["sources"], "tools": _tools()}
            _stamp(target(name)).write_text(json.dumps(stamp, indent=1))
    if reasons:
        raise BuildError(reasons)


def _fresh(path: Path, source: Path) -> bool:
    """Whether the FMU is what its sources would give again."""
    try:
        stamp = json.loads(_stamp(path).read_text())
    except (OSError, ValueError):
        return False
    return (
        path.is_file()
        and stamp["source"] == str(source)
        and stamp["tools"] == _tools()
        and all(_digest(Path(file)) == digest for file, digest in stamp["sources"].items())
    )


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""


@cache
def _tools() -> str:
    """What besides the model decides its FMU's bytes: the packager and the library it packs."""
    digest = hashlib.sha256(importlib.metadata.version("pythonfmu").encode())
    for file in sorted((models_folder() / "packager").glob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _stamp(path: Path) -> Path:
    return path.with_suffix(".json")


def _source_of(path: Path) -> Path | None:
    """The source of a built FMU, None where it is gone: then the FMU is used as it is."""
    try:
        source = Path(json.loads(_stamp(path).read_text())["source"])
    except (OSError, ValueError, KeyError):
        return None
    return source if source.is_file() else None
