"""Where FMUs come from: finding them by name, and building the stale ones.

Models are built by `fmus/packager`, in a process of its own: nothing here imports a model.
"""

from __future__ import annotations

import errno
import hashlib
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from ..errors import FmuError, OrchError, did_you_mean
from . import compiler as compilers
from .compiler import Compiler

PACKAGE = Path(__file__).resolve().parent.parent
PYTHON_PLATFORMS = (("Linux", "x86_64"), ("Windows", "AMD64"), ("Windows", "x86_64"))  # of pythonfmu's libraries


class BuildError(OrchError):
    """Models that cannot become FMUs.  `.reasons`: {name: sentence}; `.built`: {name: FMU} of the others."""

    def __init__(self, reasons: dict[str, str], built: Mapping[str, Path] | None = None):
        self.reasons, self.built = reasons, dict(built or {})
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


def target(name: str, packaging: str) -> Path:
    """Where the FMU of a model lies.  packaging: native or python."""
    return build_folder() / packaging / f"{name}.fmu"


def known() -> dict[str, Path | None]:
    """{name: source} of all models: the shipped ones and whatever a user has built."""
    found: dict[str, Path | None] = dict(shipped())
    for packaging in ("native", "python"):
        for path in sorted(target("x", packaging).parent.glob("*.fmu")):
            found.setdefault(path.stem, _source_of(path))
    return found


def locate(fmu: str, beside: Path, built: Mapping[str, Path]) -> Path:
    """The file that an experiment in folder `beside` means by `fmu`: a model of `built` or the path of an .fmu.

    Raises FmuError where there is none.
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


def build(
    names: Iterable[str],
    told: Callable[[str], None] = lambda _: None,
    force: bool = False,
    packaging: str = "auto",
) -> dict[str, Path]:
    """Build those of the named models that are stale, or all of them with `force`.

    names: of models, or paths of a user's .py files.  told: called with what is being done.  packaging: "native",
    "python", or "auto", which is native where there is a C compiler and the model is given as equations.
    Returns {name: FMU}.  Raises BuildError, naming every model that failed and why; `.built` has the others.
    """
    sources = dict(map(_source, names))
    compiler = None if packaging == "python" else compilers.find()
    if packaging == "native" and compiler is None:
        raise BuildError(dict.fromkeys(sources, f"{compilers.none()}; for native FMUs {compilers.HOW}"))
    built, stale = {}, {}
    for name, source in sources.items():
        found = None if force and source is not None else _ready(name, source, packaging, compiler)
        if found is not None:
            built[name] = found
        elif source is not None:
            stale[name] = source
    if stale:
        if packaging == "auto" and compiler is None:
            _expect_python_fmus(stale)
            told(f"{compilers.none()}, so the models become Python FMUs; for faster ones {compilers.HOW}")
        for name in stale:
            told(f"building {name}")
        try:
            built |= _package(stale, packaging, compiler, told)
        except BuildError as error:
            error.built |= built
            raise
    return built


def cross_build(names: Iterable[str], targets: Sequence[str], told: Callable[[str], None]) -> dict[str, Path]:
    """Build FMUs with libraries for other platforms.  Raises OrchError."""
    found = dict(map(_source, names))
    sources = {name: source for name, source in found.items() if source is not None}
    if gone := found.keys() - sources.keys():
        raise OrchError(f"the source of {', '.join(sorted(gone))} is gone: give the model's .py file")
    for name in sources:
        told(f"building {name} for {' and '.join(targets)}")
    folder = build_folder() / "+".join(sorted(targets))
    requests = [
        _request(source, folder / f"{name}.fmu", None, compilers.of_targets(targets))
        for name, source in sources.items()
    ]
    answers = _ask(sources, requests)
    _raise_problems(sources, answers)
    return {name: Path(answer["target"]) for name, answer in answers.items()}


def _ready(name: str, source: Path | None, packaging: str, compiler: Compiler | None) -> Path | None:
    """The FMU that is there, where it is what building would give again, or where there is nothing to build it from."""
    native, python = target(name, "native"), target(name, "python")
    if source is None:
        wanted = {"native": (native,), "python": (python,)}.get(packaging, (native, python))
        return next((path for path in wanted if path.is_file()), None)
    if compiler is not None and _fresh(native, source, compiler):
        return native
    stamp = _fresh(python, source, None)
    if stamp and (packaging == "python" or compiler is None or stamp["plain"] or stamp["despite"] == compiler.identity):
        return python if packaging != "native" else None
    return None


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


def _expect_python_fmus(names: Iterable[str]) -> None:
    """Raises BuildError where pythonfmu has no library for this machine."""
    if (platform.system(), platform.machine()) not in PYTHON_PLATFORMS:
        here = f"{platform.system()} {platform.machine()}"
        sentence = f"{compilers.none()}, and Python FMUs cannot run on {here}: {compilers.HOW}"
        raise BuildError(dict.fromkeys(names, sentence))


def _package(
    sources: dict[str, Path], packaging: str, compiler: Compiler | None, told: Callable[[str], None]
) -> dict[str, Path]:
    """Build, and stamp what was built.  A compiler that fails is done without, unless native FMUs are demanded."""
    answers = _ask(
        sources,
        [
            _request(
                source,
                target(name, "native") if compiler else None,
                target(name, "python") if packaging != "native" else None,
                [compiler] if compiler else [],
            )
            for name, source in sources.items()
        ],
    )
    failed = {name: answer["error"] for name, answer in answers.items() if answer.get("compiler")}
    if failed and packaging == "auto":
        _expect_python_fmus(failed)
        told(f"the C compiler fails ({next(iter(failed.values()))}), so these become Python FMUs: {', '.join(failed)}")
        again = {name: sources[name] for name in failed}
        answers |= _ask(again, [_request(source, None, target(name, "python"), []) for name, source in again.items()])
    for name, answer in answers.items():
        if "error" not in answer:
            path = Path(answer["target"])
            native = compiler if path == target(name, "native") else None
            stamp = {
                "fmu": _version(path),
                "source": str(sources[name]),
                "sources": answer["sources"],
                "tools": _tools(native),
                "plain": answer["plain"],
                "despite": compiler.identity if compiler and name in failed else "",
            }
            _stamp(path).write_text(json.dumps(stamp, indent=1))
    _raise_problems(sources, answers)
    return {name: Path(answer["target"]) for name, answer in answers.items()}


def _raise_problems(sources: dict[str, Path], answers: Mapping[str, Any]) -> None:
    reasons = {n: f"{sources[n]} cannot be built: {a['error']}" for n, a in answers.items() if "error" in a}
    if reasons:
        raise BuildError(reasons, {n: Path(a["target"]) for n, a in answers.items() if "target" in a})


def _request(source: Path, native: Path | None, python: Path | None, found: Sequence[Compiler]) -> dict[str, Any]:
    """What the packager is asked; see its __main__."""
    return {
        "source": str(source),
        "native": native and str(native),
        "python": python and str(python),
        "compilers": [{"command": compiler.command, "folder": compiler.folder} for compiler in found],
    }


def _ask(sources: dict[str, Path], requests: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The packager's answers, by name.  Raises BuildError where the folder of FMUs cannot be written."""
    for path in [Path(request[kind]) for request in requests for kind in ("native", "python") if request[kind]]:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if not os.access(path.parent, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        except OSError as error:
            sentence = f"the folder of built FMUs, {path.parent}, cannot be written: {error.strerror}"
            raise BuildError(dict.fromkeys(sources, sentence)) from None
    # Without bytecode files: the sources' folder may be shared or not writable.
    environment = {**os.environ, "PYTHONPATH": str(models_folder()), "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.run(
        [sys.executable, "-m", "packager"],
        input="".join(json.dumps(request) + "\n" for request in requests),
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    answers = {answer["source"]: answer for answer in map(json.loads, process.stdout.splitlines())}
    last_words = process.stderr.strip().splitlines()[-1:] or [f"exit code {process.returncode}"]
    stopped = {"error": f"the build stopped: {last_words[0]}"}
    return {name: answers.get(str(source), stopped) for name, source in sources.items()}


def _fresh(path: Path, source: Path, compiler: Compiler | None) -> dict[str, Any] | None:
    """The stamp of an FMU, if that is what its sources would give again."""
    try:
        stamp: dict[str, Any] = json.loads(_stamp(path).read_text())
    except (OSError, ValueError):
        return None
    fresh = (
        stamp["fmu"] == _version(path)
        and stamp["source"] == str(source)
        and stamp["tools"] == _tools(compiler)
        and all(_digest(Path(file)) == digest for file, digest in stamp["sources"].items())
    )
    return stamp if fresh else None


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""


def _version(path: Path) -> list[int]:
    """Tells one build of a file from another."""
    if not path.is_file():
        return []
    status = path.stat()
    return [status.st_size, status.st_mtime_ns]


@cache
def _tools(compiler: Compiler | None) -> str:
    """What besides the model decides its FMU's bytes: the packager, and the compiler or the library that it packs."""
    maker = compiler.identity if compiler else importlib.metadata.version("pythonfmu")
    digest = hashlib.sha256(maker.encode())
    for file in sorted((models_folder() / "packager").glob("*.[pc]*")):
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
