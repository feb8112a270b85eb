"""A system of an SSP as an experiment: the table of its file, with its FMUs unpacked."""

from __future__ import annotations

import dataclasses
import hashlib
import re
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import ExperimentError, FmuError, Problem, StoreError
from ..experiment import toml
from ..experiment.experiment import Experiment
from ..experiment.reader import parse
from ..files import write_text
from ..fmu.fmu import Fmu, read
from ..fmu.variables import Variable
from ..models import catalogue
from . import flatten, structure
from .archive import SspArchive, Unreadable
from .parameters import Value, for_variable

SECTIONS = ("record", "metrics", "mavlink", "sweep")  # that SSP cannot state at all
STATED = ("fmu", "parameters", "start", "step", "values")  # of a component, in SSP itself or read before

Place = Callable[[str, str], Path]


@dataclasses.dataclass
class Imported:
    """table: of an experiment file; problems: what keeps it from being one; notes: what one should know."""

    table: dict[str, Any]
    problems: list[Problem]
    notes: list[str]


def load(path: Path, set: Mapping[str, Any] | None = None, swap: Mapping[str, str] | None = None) -> Experiment:
    """An .ssp as an experiment, as `reader.load` reads a .toml.  Its FMUs lie where built ones do.

    Raises ExperimentError where it cannot be read at all; every other problem is in `.problems`.
    """
    folder = catalogue.build_folder() / "ssp"
    imported = _read(path, lambda source, digest: folder / digest[:16], str)
    text = f"# {path.name}\n{toml.write(imported.table)}"
    experiment = parse(path, text, set, swap)
    problems = (*imported.problems, *experiment.problems)
    return dataclasses.replace(experiment, problems=problems, notes=(*imported.notes, *experiment.notes))


def convert(path: Path, target: Path) -> Imported:
    """Write an experiment file, and its FMUs into a folder beside it.

    Raises ExperimentError, StoreError where they cannot be written; then nothing is.
    """
    folder = target.with_name(f"{target.stem}_fmus")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".orch-", dir=target.parent) as name:
            half = Path(name)

            def place(source: str, _: str) -> Path:
                return half / PurePosixPath(source.removeprefix("resources/")).parent

            imported = _read(path, place, lambda fmu: f"{folder.name}/{fmu.relative_to(half).as_posix()}")
            if imported.problems:
                raise ExperimentError(path, imported.problems)
            for file in sorted(file for file in half.rglob("*") if file.is_file()):
                final = folder / file.relative_to(half)
                final.parent.mkdir(parents=True, exist_ok=True)
                file.replace(final)
            text = f"# Imported from {path.name}\n{toml.write(imported.table)}"
            write_text(target, text)
    except OSError as error:
        raise StoreError(f"{target} cannot be written: {error.strerror or error}") from None
    return imported


def _read(path: Path, place: Place, named: Callable[[Path], str]) -> Imported:
    """place: the folder for an FMU, by its place in the archive and its SHA-256; named: what it is called."""
    with SspArchive.open(path) as archive:
        return _Importer(archive, place, named).imported()


class _Importer:
    def __init__(self, archive: SspArchive, place: Place, named: Callable[[Path], str]):
        self.archive, self.place, self.named = archive, place, named
        self.structure = structure.read(archive)
        self.problems, self.notes = self.structure.problems, list[str]()
        self.flat = flatten.flatten(self.structure)
        self.names = _names(list(self.flat.components))
        self.fmus: dict[flatten.ElementPath, Fmu] = {}
        self.vectors: dict[str, dict[str, str]] = {}  # by component: {variable: its vector}

    def problem(self, key: str, sentence: str) -> None:
        self.problems.append(Problem(key, sentence))

    def imported(self) -> Imported:
        files = self.unpacked()
        beyond = self.structure.beyond
        table = {
            "title": beyond.get("title", self.structure.name or self.archive.path.stem),
            "master": self.master(beyond),
            "components": self.components(files, _table(beyond, "components")),
            "connections": self.connections(),
        } | {key: beyond[key] for key in SECTIONS if beyond.get(key)}
        self.notes += [f"{'.'.join(path)} is called {name}" for path, name in self.names.items() if path != (name,)]
        if self.flat.unused:
            self.notes.append(f"no variable is named {', '.join(self.flat.unused)}: ignored, as SSP requires")
        return Imported(table, self.problems, self.notes)

    def unpacked(self) -> dict[str, Path]:
        """{place in the archive: the FMU's file}; reads the FMUs that can be read."""
        files: dict[str, Path] = {}
        for path, element in self.flat.components.items():
            if not element.source:
                continue  # a problem already
            try:
                if element.source not in files:
                    files[element.source] = self.unpack(element.source)
                self.fmus[path] = read(files[element.source])
            except Unreadable as error:
                self.problem(".".join(path), str(error))
            except FmuError:
                continue  # reported when the experiment is fitted to its FMUs
        return files

    def components(self, files: Mapping[str, Path], beyond: Mapping[str, Any]) -> dict[str, Any]:
        components = {}
        for path, element in self.flat.components.items():
            if element.source in files:
                more = _table(beyond, self.names[path])
                wide = {n: Value("Integer", v) for n, v in _table(more, "values").items() if type(v) is int}
                table = {"fmu": self.named(files[element.source])} | self.values(path, wide)
                if element.step and element.step != self.structure.step:
                    table["step"] = element.step
                components[self.names[path]] = table | {k: v for k, v in more.items() if k not in STATED}
        return components

    def unpack(self, source: str) -> Path:
        digest = hashlib.sha256(self.archive.read(source)).hexdigest()
        return self.archive.unpack(source, self.place(self.archive.member(source), digest))

    def master(self, beyond: Mapping[str, Any]) -> dict[str, Any]:
        times = {"stop_time": self.structure.stop_time, "step": self.structure.step}
        table: dict[str, Any] = {key: value for key, value in times.items() if value is not None}
        if not beyond:
            self.notes.append('the order of components means nothing in SSP: algorithm = "jacobi"')
            table["algorithm"] = "jacobi"
        return table | _table(beyond, "master")

    def values(self, path: flatten.ElementPath, wide: Mapping[str, Value]) -> dict[str, Any]:
        """The tables `parameters` and `start` of a component.  wide: values that SSP 1.0 cannot hold."""
        fmu, given = self.fmus.get(path), {**wide, **self.flat.values.get(path, {})}
        if fmu is None:
            return {}
        parameters: dict[str, Any] = {}
        start: dict[str, Any] = {}
        structure = {
            n: v.value
            for n, v in given.items()
            if n in fmu.variables and v.type == "Integer" and fmu.variables[n].causality == "structuralParameter"
        }
        if structure:
            fmu = self.fmus[path] = read(fmu.path, structure)
        for name, value in given.items():
            variable = fmu.variables.get(name)
            where = ".".join((*path, name))
            if variable is None:
                self.flat.unused.append(where)
            elif variable.causality in ("parameter", "structuralParameter"):
                self.put(parameters, value, variable, fmu, where)
            elif variable.causality != "input":
                self.problem(where, f"is {variable.causality} of the FMU; orch sets parameters and inputs")
            elif (path, name) not in self.flat.drives:
                self.put(start, value, variable, fmu, where)
        free = [v for v in fmu.variables.values() if v.causality == "input" and (path, v.name) not in self.flat.drives]
        tables = {"parameters": _gathered(fmu, parameters)} if parameters else {}
        if start:
            held = {v.name: self.own(v, path) for v in free if v.name not in start}
            return tables | {"start": _gathered(fmu, held | start)}
        return tables | ({"start": "fmu"} if free else {})

    def own(self, variable: Variable, path: flatten.ElementPath) -> Any:
        """The FMU's own start value, as an experiment file gives it."""
        try:
            value = variable.initial
        except ValueError:
            self.problem(
                ".".join((*path, variable.name)),
                f"starts at {variable.start!r}, which is not a value of type {variable.type}",
            )
            return 0
        return value.hex() if isinstance(value, bytes) else value

    def put(self, table: dict[str, Any], value: Value, variable: Variable, fmu: Fmu, where: str) -> None:
        try:
            table[variable.name] = for_variable(value, variable, fmu)
        except Unreadable as error:
            self.problem(where, str(error))

    def connections(self) -> dict[str, Any]:
        """ "input" = "output", vectors as such where all their axes go together."""
        self.vectors = {self.names[path]: _vectors(fmu) for path, fmu in self.fmus.items()}
        scalars: dict[str, tuple[str, dict[str, Any]]] = {}  # {input: output, what lies between}
        for (path, name), drive in self.flat.drives.items():
            between = {"gain": drive.factor, "offset": drive.offset} if drive.scaled else {}
            between |= {} if drive.convert else {"unit_check": False}
            source = f"{self.names[drive.source[0]]}.{drive.source[1]}"
            scalars[f"{self.names[path]}.{name}"] = source, between
        connections: dict[str, Any] = {}
        for sink, (source, between) in scalars.items():
            to, origin = self.vector(sink), self.vector(source)
            axes = self.axes(to)
            whole = bool(axes) and axes == self.axes(origin)
            if whole and all(scalars.get(to + axis) == (origin + axis, between) for axis in axes):
                sink, source = to, origin
            connections[sink] = {"from": source, **between} if between else source
        return connections

    def vector(self, end: str) -> str:
        """component.vector of component.variable, "" where it is of none."""
        component, _, name = end.partition(".")
        vector = self.vectors.get(component, {}).get(name, "")
        return f"{component}.{vector}" if vector else ""

    def axes(self, whole: str) -> list[str]:
        """What follows component.vector in the names of its variables."""
        component, _, vector = whole.partition(".")
        owners = self.vectors.get(component, {})
        return [name.removeprefix(vector) for name, owner in owners.items() if owner == vector]


def _names(paths: list[flatten.ElementPath]) -> dict[flatten.ElementPath, str]:
    """A name that an experiment can use for each component, its own where that is one."""
    names: dict[flatten.ElementPath, str] = {}
    for path in paths:
        name = re.sub(r"\W", "_", "_".join(path), flags=re.ASCII)
        name = f"_{name}" if not name or name[0].isdigit() or name == "time" else name
        number = 2
        unique = name
        while unique in names.values():
            unique, number = f"{name}_{number}", number + 1
        names[path] = unique
    return names


def _table(beyond: Mapping[str, Any], key: str) -> dict[str, Any]:
    table = beyond.get(key, {})
    return table if isinstance(table, dict) else {}


def _vectors(fmu: Fmu) -> dict[str, str]:
    """{variable: the vector it belongs to}."""
    return {v.name: vector for vector, axes in fmu.vectors.items() for v in axes.values()}


def _gathered(fmu: Fmu, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of FMI variables, those of a whole vector as one list."""
    gathered: dict[str, Any] = {}
    vectors = _vectors(fmu)
    for name, value in values.items():
        vector = vectors.get(name, "")
        axes = fmu.vectors.get(vector, {})
        if axes and all(v.name in values for v in axes.values()) and not any("," in axis for axis in axes):
            gathered[vector] = [values[v.name] for v in axes.values()]
        else:
            gathered[name] = value
    return gathered
