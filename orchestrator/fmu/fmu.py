"""One FMU file: what it says about itself, and whether it can run here.  No binary is loaded."""

from __future__ import annotations

import hashlib
import io
import platform
import re
import sys
import zipfile
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import FmuError
from ..names import split_axis
from . import archive as archives
from . import declared, units, variables
from . import description as descriptions
from .units import Unit
from .variables import Variable

DESCRIPTION = "modelDescription.xml"
CAPABILITIES = (
    "canGetAndSetFMUstate",
    "canSerializeFMUstate",
    "providesDirectionalDerivative",
    "needsExecutionTool",
    "hasEventMode",
)
DATA_FILES = "VendorAnnotations/Tool[@name='orch']/File"
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}


@dataclass(frozen=True, kw_only=True)
class Fmu:
    """An FMU for co-simulation, of FMI 2.0 or 3.0."""

    path: Path
    sha256: str
    fmi_version: str
    model_name: str
    description: str
    guid: str = ""
    model_identifier: str
    tool: str
    packaging: str  # "python", "native" or "builtin"
    once_per_process: bool = False
    capabilities: Mapping[str, bool] = field(default_factory=dict)
    variables: Mapping[str, Variable]
    units: Mapping[str, Unit] = field(default_factory=dict)
    python_modules: Mapping[str, str] = field(default_factory=dict)  # {top-level module that it brings: digest}
    description_xml: str = ""  # modelDescription.xml
    initial_dependencies: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    # {output: inputs that it depends on in initialization; None: all}
    internal_step: float | None = None  # s; of FMI 3.0: fixedInternalStepSize
    tolerance: float | None = None  # of its DefaultExperiment
    default_experiment: Mapping[str, str] = field(default_factory=dict)  # as the FMU writes it
    notes: tuple[str, ...] = ()  # what it declares and a run does not do
    data_files: Mapping[str, str] = field(default_factory=dict)  # {name: SHA-256} of those that its model declares

    @property
    def version(self) -> int:
        """2 or 3."""
        return int(self.fmi_version[0])

    @cached_property
    def vectors(self) -> dict[str, dict[str, Variable]]:
        """{name: {axis: variable}}: variables `name.axis`, in the FMU's order, or `name[i]`, by number, that share
        causality."""
        vectors: dict[str, dict[str, Variable]] = {}
        for variable in self.variables.values():
            name, axis = split_axis(variable.name)
            if axis and name not in self.variables:
                vectors.setdefault(name, {})[axis] = variable
        return {n: _in_order(axes) for n, axes in vectors.items() if len({v.causality for v in axes.values()}) == 1}

    def lookup(self, name: str) -> dict[str, Variable]:
        """{axis: variable} of a vector, {"": variable} of a scalar, {} of neither."""
        if name in self.variables:
            return {"": self.variables[name]}
        return self.vectors.get(name, {})

    def elements(self, variable: Variable) -> list[Variable]:
        """Of an element of an array: all elements, in order; of a scalar: itself."""
        if not variable.shape:
            return [variable]
        return self._arrays[variable.reference]

    @cached_property
    def _arrays(self) -> dict[int, list[Variable]]:
        arrays: dict[int, list[Variable]] = {}
        for variable in self.variables.values():
            if variable.shape:
                arrays.setdefault(variable.reference, []).append(variable)
        return arrays

    def names(self, causality: str) -> list[str]:
        """Names of the vectors and scalars of one causality; a vector is named once."""
        names: dict[str, None] = {}
        for variable in self.variables.values():
            if variable.causality == causality:
                vector = split_axis(variable.name)[0]
                names[vector if vector in self.vectors else variable.name] = None
        return list(names)


def _in_order(axes: dict[str, Variable]) -> dict[str, Variable]:
    """Numbered axes by their numbers, whatever the order of their declarations."""
    numbered = [axis for axis in axes if re.fullmatch(r"[0-9]{1,9}(,[0-9]{1,9})*", axis)]
    numbers = {axis: [int(n) for n in axis.split(",")] for axis in numbered}
    return {axis: axes[axis] for axis in sorted(axes, key=numbers.__getitem__)} if len(numbers) == len(axes) else axes


def read(path: Path, structure: Mapping[str, int] | None = None) -> Fmu:
    """Read and check an FMU.  structure: {structural parameter: value}, for the shapes of its arrays.

    Raises FmuError, with the reason, for anything that cannot run here.
    """
    with archives.opened(path) as archive:
        if DESCRIPTION not in archive.names:
            raise FmuError(f"{path} is not an FMU: it has no {DESCRIPTION}")
        text = archive.xml(DESCRIPTION)
        modules = dict(_python_modules(archive))
        names, sha256 = archive.names, archive.sha256
    root = descriptions.check(path, text)
    description = _description(path, text)
    version = str(description.fmiVersion)
    if version[:2] not in ("2.", "3."):
        raise FmuError(f"{path} is FMI {version}; orch runs FMI 2.0 and 3.0")
    slave = description.coSimulation
    if slave is None:
        raise FmuError(
            f"{path} has no co-simulation interface, only {_interfaces(description)}; export it for Co-Simulation"
        )
    _check_binary(path, names, slave.modelIdentifier, int(version[0]))
    try:
        scalars = {variable.name: variable for variable in variables.read(description, root, structure or {})}
    except ValueError as error:
        raise FmuError(f"{path}: {error}") from None
    return Fmu(
        path=path,
        sha256=sha256,
        fmi_version=version,
        model_name=description.modelName,
        description=description.description or "",
        guid=description.guid or description.instantiationToken,
        model_identifier=slave.modelIdentifier,
        tool=description.generationTool or "",
        packaging="python" if "resources/slavemodule.txt" in names else "native",
        once_per_process=bool(slave.canBeInstantiatedOnlyOncePerProcess),
        capabilities={name: bool(getattr(slave, name)) for name in CAPABILITIES},
        variables=scalars,
        units=units.defined(description),
        python_modules=modules,
        description_xml=text,
        initial_dependencies=_initial_dependencies(description),
        internal_step=float(slave.fixedInternalStepSize) if slave.fixedInternalStepSize else None,
        tolerance=_tolerance(description),
        default_experiment={name: text for e in root.iterfind("DefaultExperiment") for name, text in e.attrib.items()},
        notes=tuple(declared.notes(root)),
        data_files={file.get("name"): file.get("sha256") for file in root.iterfind(DATA_FILES)},
    )


def unpack(fmu: Fmu, folder: Path) -> None:
    """Unpack what was read.  Raises FmuError if the file has changed, is damaged, or the disk is full."""
    with archives.opened(fmu.path) as archive:
        if archive.sha256 != fmu.sha256:
            raise FmuError(f"{fmu.path} has changed since it was checked; start again")
        archive.extract(folder)


def platform_folder(version: int = 2) -> tuple[str, str]:
    """FMI's name of this platform, and the suffix of its shared libraries."""
    system, suffix = ("windows", ".dll") if sys.platform.startswith("win") else ("linux", ".so")
    if sys.platform == "darwin":
        system, suffix = "darwin", ".dylib"
    if version == 2:
        return {"windows": "win64", "linux": "linux64", "darwin": "darwin64"}[system], suffix
    machine = platform.machine().lower()
    return f"{MACHINES.get(machine, machine)}-{system}", suffix


def _description(path: Path, text: str) -> Any:
    """The checked text as FMPy reads it; FMPy never sees the archive."""
    from fmpy import read_model_description

    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(DESCRIPTION, text)
    try:
        return read_model_description(file, validate=False)
    except Exception as error:  # FMPy raises whatever its XML reader meets
        text = " ".join(str(error).split())
        raise FmuError(f"{path}: {DESCRIPTION} cannot be read: {text or type(error).__name__}") from None


def _tolerance(description: Any) -> float | None:
    experiment = description.defaultExperiment
    return None if experiment is None or experiment.tolerance is None else float(experiment.tolerance)


def _interfaces(description: Any) -> str:
    if description.modelExchange is not None:
        return "Model Exchange"
    return "Scheduled Execution" if description.scheduledExecution is not None else "none"


def _initial_dependencies(description: Any) -> dict[str, tuple[str, ...] | None]:
    dependencies: dict[str, tuple[str, ...] | None] = {}
    for unknown in description.initialUnknowns:
        if unknown.variable is not None and unknown.variable.causality == "output":
            depends = unknown.dependencies
            inputs = None if depends is None else tuple(d.name for d in depends if d.causality == "input")
            dependencies[unknown.variable.name] = inputs
    return dependencies


def _check_binary(path: Path, names: Collection[str], identifier: str, version: int) -> None:
    folder, suffix = platform_folder(version)
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
