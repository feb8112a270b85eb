"""Builds FMUs from models, those that are stale.

Models are built by `fmus/packager`, in a process of its own: nothing here imports a model.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import OrchError, did_you_mean
from ..watch import communicate
from . import catalogue, stamps
from . import compiler as compilers
from .catalogue import PACKAGINGS, build_folder, known, models_folder, shipped, target
from .compiler import Compiler
from .stamps import Stamp

PYTHON_PLATFORMS = (("Linux", "x86_64"), ("Windows", "AMD64"), ("Windows", "x86_64"))  # of pythonfmu's libraries


class BuildError(OrchError):
    """Models that cannot become FMUs.  `.reasons`: {name: message}; `.built`: {name: FMU} of the others."""

    def __init__(self, reasons: dict[str, str], built: Mapping[str, Path] | None = None):
        self.reasons, self.built = reasons, dict(built or {})
        super().__init__("\n".join(dict.fromkeys(reasons.values())))


def build(
    names: Iterable[str],
    report: Callable[[str], None] = lambda _: None,
    force: bool = False,
    packaging: str = "auto",
) -> dict[str, Path]:
    """Build those of the named models that are stale, or all of them with `force`.

    names: of models, or paths of a user's .py files.  report: called with what is being done.  packaging: "native",
    "python", or "auto", which is native where there is a C compiler and the model is given as equations.
    Returns {name: FMU} in the order of `names`.  Raises BuildError, naming every model that failed and why; `.built`
    has the others.
    """
    sources = _sources(names)
    compiler = None if packaging == "python" else compilers.find()
    if packaging == "native" and compiler is None:
        raise BuildError(dict.fromkeys(sources, f"{compilers.none()}; for native FMUs {compilers.HOW}"))
    built, stale = {}, {}
    for name, source in sources.items():
        ready = None if force and source is not None else _ready(name, source, packaging, compiler)
        if ready is not None:
            built[name] = ready
        elif source is not None:
            stale[name] = source
    if stale:
        if packaging == "auto" and compiler is None:
            _expect_python_fmus(stale)
            report(f"{compilers.none()}, so the models become Python FMUs; for faster ones {compilers.HOW}")
        for name, source in stale.items():
            report(f"building {name}")
            was = catalogue.source_of(name)
            if was not in (None, source) and name not in shipped():
                report(f"note: {name} was built from {was}; experiments that name {name} run {source} from now on")
        try:
            built |= _package(stale, packaging, compiler, report)
        except BuildError as error:
            error.built |= built
            raise
    return {name: built[name] for name in sources if name in built}


def cross_build(names: Iterable[str], targets: Sequence[str], report: Callable[[str], None]) -> dict[str, Path]:
    """Build FMUs with libraries for other platforms.  Returns {name: FMU}.  Raises OrchError."""
    named = _sources(names)
    sources = {name: source for name, source in named.items() if source is not None}
    if gone := named.keys() - sources.keys():
        raise OrchError(f"the source of {', '.join(sorted(gone))} no longer exists: give the model's .py file")
    for name in sources:
        report(f"building {name} for {' and '.join(targets)}")
    folder = build_folder() / "+".join(sorted(targets))
    requests = [
        _request(source, folder / f"{name}.fmu", None, compilers.of_targets(targets))
        for name, source in sources.items()
    ]
    answers = _ask(sources, requests)
    _raise_problems(sources, answers)
    return {name: Path(answer["target"]) for name, answer in answers.items()}


def _sources(names: Iterable[str]) -> dict[str, Path | None]:
    """{name: source} of models.  Raises BuildError where two files would become one model."""
    sources: dict[str, Path | None] = {}
    for given in names:
        name, source = _source(given)
        if (other := sources.setdefault(name, source)) != source:
            raise BuildError({given: f"{other} and {source} would both be the model {name!r}; rename one of the files"})
    return sources


def _source(name: str) -> tuple[str, Path | None]:
    """The name and the source of a model that is given by its name or by its file."""
    if not name.endswith(".py"):
        sources = known()
        if name not in sources:
            raise BuildError({name: f"no model {name!r}{did_you_mean(name, sources)}"})
        return name, sources[name]
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


def _ready(name: str, source: Path | None, packaging: str, compiler: Compiler | None) -> Path | None:
    """The FMU that exists, if building would give the same again, or if there is no source to build it from."""
    native, python = target(name, "native"), target(name, "python")
    if source is None:
        wanted = PACKAGINGS if packaging == "auto" else (packaging,)
        return next((path for kind in wanted if (path := target(name, kind)).is_file()), None)
    if compiler is not None and stamps.fresh(native, source, compiler):
        return native
    stamp = stamps.fresh(python, source, None)
    if stamp and (packaging == "python" or compiler is None or stamp.plain or stamp.despite == compiler.identity):
        return python if packaging != "native" else None
    return None


def _expect_python_fmus(names: Iterable[str]) -> None:
    """Raises BuildError if pythonfmu has no library for this machine."""
    if (platform.system(), platform.machine()) not in PYTHON_PLATFORMS:
        here = f"{platform.system()} {platform.machine()}"
        message = f"{compilers.none()}, and Python FMUs cannot run on {here}: {compilers.HOW}"
        raise BuildError(dict.fromkeys(names, message))


def _package(
    sources: dict[str, Path], packaging: str, compiler: Compiler | None, report: Callable[[str], None]
) -> dict[str, Path]:
    """Build, and stamp what was built.  If the compiler fails, models become Python FMUs, unless native is demanded."""
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
        reason = next(iter(failed.values()))
        report(f"the C compiler fails ({reason}), so these become Python FMUs: {', '.join(failed)}")
        again = {name: sources[name] for name in failed}
        answers |= _ask(again, [_request(source, None, target(name, "python"), []) for name, source in again.items()])
    for name, answer in answers.items():
        if "error" not in answer:
            fmu = Path(answer["target"])
            for path in answer["reads"]:
                declare = f'File("{Path(path).name}")'
                report(f"note: {name} reads {path} while it is built; to pack it into the FMU, declare it: {declare}")
            stamp = Stamp(
                source=str(sources[name]),
                sources=answer["sources"],
                plain=answer["plain"],
                despite=compiler.identity if compiler and name in failed else "",
            )
            stamps.write(fmu, stamp, compiler if fmu == target(name, "native") else None)
            catalogue.forget_others(name, sources[name])
    _raise_problems(sources, answers)
    return {name: Path(answer["target"]) for name, answer in answers.items()}


def _raise_problems(sources: dict[str, Path], answers: Mapping[str, Any]) -> None:
    reasons = {n: f"{sources[n]} cannot be built: {a['error']}" for n, a in answers.items() if "error" in a}
    if reasons:
        raise BuildError(reasons, {n: Path(a["target"]) for n, a in answers.items() if "target" in a})


def _request(
    source: Path, native: Path | None, python: Path | None, compilers_to_use: Sequence[Compiler]
) -> dict[str, Any]:
    """What the packager is asked; see its __main__."""
    return {
        "source": str(source),
        "native": native and str(native),
        "python": python and str(python),
        "compilers": [{"command": compiler.command, "folder": compiler.folder} for compiler in compilers_to_use],
    }


def _ask(sources: dict[str, Path], requests: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The packager's answers, by name.  Raises BuildError if the folder of built FMUs is not writable."""
    for path in [Path(request[kind]) for request in requests for kind in PACKAGINGS if request[kind]]:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if not os.access(path.parent, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        except OSError as error:
            message = f"the folder of built FMUs, {path.parent}, cannot be written: {error.strerror}"
            raise BuildError(dict.fromkeys(sources, message)) from None
    environment = {
        **os.environ,
        "PYTHONPATH": str(models_folder()),
        "PYTHONSAFEPATH": "1",  # a user's file json.py in this folder does not come before Python's own
        "PYTHONDONTWRITEBYTECODE": "1",  # the sources' folder may be shared or not writable
    }
    pipe = subprocess.PIPE
    command = [sys.executable, "-m", "packager"]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, env=environment) as process:
        try:
            text = "".join(json.dumps(request) + "\n" for request in requests)
            output, errors = communicate(process, text.encode(), lambda output: _under_way(sources, output))
        except BaseException:
            process.kill()
            raise
    answers = _answers(output)
    last_line = errors.decode(errors="replace").strip().splitlines()[-1:] or [f"exit code {process.returncode}"]
    stopped = {"error": f"the build stopped: {last_line[0]}"}
    return {name: answers.get(str(source), stopped) for name, source in sources.items()}


def _answers(output: bytes) -> dict[str, dict[str, Any]]:
    """{source: answer} of the packager's lines, of which the last need not be whole yet."""
    return {answer["source"]: answer for answer in map(json.loads, output.decode().splitlines()[: output.count(b"\n")])}


def _under_way(sources: Mapping[str, Path], output: bytes) -> str:
    answers = _answers(output)
    return f"building {', '.join(name for name, source in sources.items() if str(source) not in answers)}"
