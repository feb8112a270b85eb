"""One FMU file: what it says of itself, and whether it can run here.  No binary is loaded."""

from __future__ import annotations

import hashlib
import io
import re
import sys
import zipfile
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from . import archive as archives
from . import description as descriptions
from .errors import FmuError

DESCRIPTION = "modelDescription.xml"
KINDS = {"Real": "real", "Integer": "integer", "Enumeration": "integer", "Boolean": "boolean", "String": "string"}


@dataclass(frozen=True)
class Variable:
    """One FMI variable."""

    name: str
    reference: int
    type: str  # FMI's: Real, Integer, Boolean, String, Enumeration
    causality: str
    unit: str
    start: Any
    description: str
    feedthrough: bool  # an output that depends on an input of the same instant, as far as the FMU says
    items: tuple[tuple[str, int], ...] = ()  # of an enumeration: name and value
    limits: tuple[float, float] | None = None  # of a Real: min and max

    @property
    def kind(self) -> str:
        """Which of FMI 2.0's getters and setters it takes: real, integer, boolean or string."""
        return KINDS[self.type]

    @property
    def initial(self) -> Any:
        """Its start value as a number, a truth or a text; 0, False or "" where the FMU gives none."""
        if self.type == "String":
            return self.start or ""
        if self.type == "Boolean":
            return self.start in ("true", "1")
        return float(self.start or 0) if self.type == "Real" else int(self.start or 0)


@dataclass(frozen=True)
class Fmu:
    """An FMU 2.0 for co-simulation."""

    path: Path
    sha256: str
    fmi_version: str
    model_name: str
    description: str
    guid: str
    model_identifier: str
    tool: str
    packaging: str  # "python" or "native"
    once_per_process: bool
    capabilities: Mapping[str, bool]
    variables: Mapping[str, Variable]
    units: Mapping[str, Any]  # {unit: exponents, factor, offset}
    python_modules: Mapping[str, str]  # {top-level module a Python FMU brings: digest}
    description_xml: str  # modelDescription.xml

    @cached_property
    def vectors(self) -> dict[str, dict[str, Variable]]:
        """{name: {axis: variable}}: variables `name.axis`, in the FMU's order, or `name[i]`, by number, that share
        causality."""
        found: dict[str, dict[str, Variable]] = {}
        for variable in self.variables.values():
            name, axis = split_axis(variable.name)
            if axis and name not in self.variables:
                found.setdefault(name, {})[axis] = variable
        return {n: _in_order(axes) for n, axes in found.items() if len({v.causality for v in axes.values()}) == 1}

    def lookup(self, name: str) -> dict[str, Variable]:
        """{axis: variable} of a vector, {"": variable} of a scalar, {} of neither."""
        if name in self.variables:
            return {"": self.variables[name]}
        return self.vectors.get(name, {})

    def names(self, causality: str) -> list[str]:
        """Vectors and scalars of one causality, a vector once."""
        found: dict[str, None] = {}
        for variable in self.variables.values():
            if variable.causality == causality:
                vector = split_axis(variable.name)[0]
                found[vector if vector in self.vectors else variable.name] = None
        return list(found)


def _in_order(axes: dict[str, Variable]) -> dict[str, Variable]:
    """Numbered axes by their numbers, whatever the order of their declarations."""
    numbers = {axis: [int(n) for n in axis.split(",")] for axis in axes if re.fullmatch(r"[0-9]{1,9}(,[0-9]{1,9})*", axis)}
    return {axis: axes[axis] for axis in sorted(axes, key=numbers.__getitem__)} if len(numbers) == len(axes) else axes


def split_axis(name: str) -> tuple[str, str]:
    """("eta", "x") of "eta.x", ("K", "1,2") of "K[1,2]", (name, "") of a scalar."""
    if name.endswith("]"):
        head, _, axis = name[:-1].rpartition("[")
        return head, axis
    head, _, axis = name.rpartition(".")
    return (head, axis) if head else (name, "")


def read(path: Path) -> Fmu:
    """Read and check an FMU.  Raises FmuError, with a sentence, for anything that cannot run here."""
    with archives.opened(path) as archive:
        if DESCRIPTION not in archive.names:
            raise FmuError(f"{path} is no FMU: it has no {DESCRIPTION}")
        text = archive.xml(DESCRIPTION)
        modules = dict(_python_modules(archive))
        names, sha256 = archive.names, archive.sha256
    descriptions.check(path, text)
    description = _description(path, text)
    version = str(description.fmiVersion)
    if not version.startswith("2."):
        raise FmuError(f"{path} is FMI {version}; orch runs FMI 2.0")
    slave = description.coSimulation
    if slave is None:
        raise FmuError(f"{path} has no co-simulation interface, only Model Exchange; export it for Co-Simulation")
    _check_binary(path, names, slave.modelIdentifier)
    return Fmu(
        path, sha256, version, description.modelName, description.description or "",
        description.guid, slave.modelIdentifier, description.generationTool or "",
        "python" if "resources/slavemodule.txt" in names else "native",
        bool(slave.canBeInstantiatedOnlyOncePerProcess),
        {name: bool(getattr(slave, name)) for name in ("canGetAndSetFMUstate", "canSerializeFMUstate",
                                                        "providesDirectionalDerivative", "needsExecutionTool")},
        dict(_variables(description)), dict(_units(description)), modules, text,
    )  # fmt: skip


def unpack(fmu: Fmu, folder: Path) -> None:
    """Unpack what was read.  Raises FmuError where the file is another by now, is damaged, or the disk is full."""
    with archives.opened(fmu.path) as archive:
        if archive.sha256 != fmu.sha256:
            raise FmuError(f"{fmu.path} has changed since it was checked; start again")
        archive.extract(folder)


def platform_folder() -> tuple[str, str]:
    """FMI 2.0's name of this platform, and the suffix of its shared libraries."""
    if sys.platform.startswith("win"):
        return "win64", ".dll"
    return ("darwin64", ".dylib") if sys.platform == "darwin" else ("linux64", ".so")


def _description(path: Path, text: str) -> Any:
    """What FMPy makes of the text that has been checked; it never sees the archive."""
    from fmpy import read_model_description

    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(DESCRIPTION, text)
    try:
        return read_model_description(file, validate=False)
    except Exception as error:  # FMPy raises whatever its XML reader meets
        text = " ".join(str(error).split())
        raise FmuError(f"{path}: {DESCRIPTION} cannot be read: {text or type(error).__name__}") from None


def _check_binary(path: Path, names: Collection[str], identifier: str) -> None:
    folder, suffix = platform_folder()
    if f"binaries/{folder}/{identifier}{suffix}" in names:
        return
    has = sorted({PurePosixPath(n).parts[1] for n in names if n.startswith("binaries/") and n.count("/") > 1})
    raise FmuError(f"{path} has no binary for this platform ({folder}); it has {', '.join(has) or 'none'}")


def _python_modules(archive: archives.Archive) -> Iterator[tuple[str, str]]:
    """Top-level modules that a Python FMU puts on the path of the process, with a digest of their source."""
    if "resources/slavemodule.txt" not in archive.names:
        return
    digests: dict[str, Any] = {}
    for name in sorted(archive.names):
        parts = PurePosixPath(name).parts
        if len(parts) > 1 and parts[0] == "resources" and name.endswith(".py"):
            module = parts[1].removesuffix(".py")
            digests.setdefault(module, hashlib.sha256()).update(name.encode() + archive.read(name))
    for module, digest in digests.items():
        yield module, digest.hexdigest()


def _variables(description: Any) -> Iterator[tuple[str, Variable]]:
    unknowns = {id(u.variable): u for u in description.outputs}
    has_inputs = any(v.causality == "input" for v in description.modelVariables)
    for v in description.modelVariables:
        unknown = unknowns.get(id(v))
        dependencies = unknown.dependencies if unknown is not None else None
        # FMI 2.0, 2.2.8: without a list of dependencies, an unknown depends on all inputs.
        feedthrough = has_inputs if dependencies is None else any(d.causality == "input" for d in dependencies)
        declared = v.declaredType
        items = tuple((i.name, int(i.value)) for i in declared.items or ()) if declared is not None else ()
        unit = v.unit or (declared.unit if declared is not None else None) or ""
        yield v.name, Variable(v.name, v.valueReference, v.type, v.causality or "local", unit, v.start,
                               v.description or "", v.causality == "output" and feedthrough, items,
                               _limits(v))  # fmt: skip


def _limits(variable: Any) -> tuple[float, float] | None:
    if variable.type != "Real" or variable.min is None or variable.max is None:
        return None
    return float(variable.min), float(variable.max)


def _units(description: Any) -> Iterator[tuple[str, Any]]:
    for unit in description.unitDefinitions or ():
        base = unit.baseUnit
        if base is not None:
            exponents = tuple(getattr(base, n) or 0 for n in ("kg", "m", "s", "A", "K", "mol", "cd", "rad"))
            yield unit.name, (exponents, float(base.factor), float(base.offset))
