"""A plan as an SSP 1.0 archive: SystemStructure.ssd and the FMUs as resources.

What SSP cannot state (order of the components, algorithm, step, periods, record, metrics, seed) travels in an
annotation, so that import gives the same experiment back.  The same plan gives the same bytes.
"""

from __future__ import annotations

import dataclasses
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import OrchError
from ..experiment import toml
from ..files import replacing
from ..fmu.fmu import Fmu
from ..fmu.units import BASE, Unit
from ..fmu.variables import FLOATS, OBJECTS, TRUTHS, Variable
from ..plan.plan import Component, Connection, Plan
from ..version import __version__
from .names import DESCRIPTION, FMU, NAMESPACES, OSP, OURS, tag

PARAMETERS = "initialValues"  # the name of every component's parameter set: Ecos applies a set by name


def export(plan: Plan, target: Path) -> Path:
    """Write the .ssp.  Raises OrchError where a text cannot stand in XML, StoreError where it cannot be written."""
    if live := [component.name for component in plan.components if component.hears]:
        names = ", ".join(live)
        raise OrchError(f"{plan.experiment.path} cannot become an SSP: {names} runs inside orch and is not an FMU")
    sources = _sources(plan)
    try:
        description = _Writer(plan, sources).text()
    except ValueError as error:  # of lxml: a control character in a text
        raise OrchError(f"{plan.experiment.path} cannot become an SSP: {error}") from None
    with replacing(target) as half, zipfile.ZipFile(half, "w") as archive:
        archive.writestr(_entry(DESCRIPTION, zipfile.ZIP_DEFLATED), description)
        for fmu in {component.fmu.sha256: component.fmu for component in plan.components}.values():
            archive.writestr(_entry(sources[fmu.sha256], zipfile.ZIP_STORED), fmu.path.read_bytes())
    return target


def limits(plan: Plan) -> list[str]:
    """What other tools will do differently, for the user."""
    differences, master = [], plan.experiment.master
    if master.algorithm != "jacobi":
        differences.append(f"libcosim and Ecos step all components at once, as jacobi does; this is {master.algorithm}")
    if slow := [component.name for component in plan.components if component.period > 1]:
        names = ", ".join(slow)
        differences.append(f"Ecos shows the others at the start of a step what {names} computes for its end")
    named = [f"{k.sink}.{k.input.name}" for k in plan.connections if k.input.type == "Enumeration"]
    named += [
        f"{p.name}.{n}"
        for p in plan.components
        for n in {**p.parameters, **p.start}
        if p.fmu.variables[n].type == "Enumeration"
    ]
    if named:
        differences.append(f"libcosim and Ecos load no SSP with values of enumerations: {', '.join(named)}")
    if modern := [component.name for component in plan.components if component.fmu.version > 2]:
        differences.append(f"SSP 1.0 knows FMI 2.0, libcosim runs nothing else: {', '.join(modern)} is FMI 3.0")
    return differences


def beyond(plan: Plan) -> dict[str, Any]:
    """What of an experiment SSP cannot state, as the table of an experiment file."""
    experiment = plan.experiment
    said = ("name", "fmu", "builtin", "parameters", "start", "step", "swapped")
    components = {c.name: _differing(c, *said) for c in experiment.components}
    for component in plan.components:
        if wide := {
            name: value for name, value in {**component.parameters, **component.start}.items() if _too_wide(value)
        }:
            components[component.name]["values"] = wide
    return {
        "title": experiment.title,
        "master": _differing(experiment.master, "stop_time", "step") | {"algorithm": experiment.master.algorithm},
        "components": {name: table for name, table in components.items() if table},
        "record": _differing(experiment.record),
        "metrics": {name: dict(spec) for name, spec in experiment.metrics.items()},
        "mavlink": dict(experiment.mavlink),
        "sweep": dict(experiment.sweep),
    }


def _too_wide(value: Any) -> bool:
    """For SSP 1.0, whose integers have 32 bits."""
    return type(value) is int and not -(1 << 31) <= value < 1 << 31


def _differing(settings: Any, *without: str) -> dict[str, Any]:
    """The fields of a dataclass that are not at their defaults."""
    return {
        f.name: value
        for f in dataclasses.fields(settings)
        if f.name not in without and (value := getattr(settings, f.name)) != f.default
    }


def _sources(plan: Plan) -> dict[str, str]:
    """{SHA-256 of an FMU: its place in the archive}, one place a content, one content a place."""
    places: dict[str, str] = {}
    for component in plan.components:
        stem = re.sub(r"[^A-Za-z0-9_.-]", "_", component.fmu.path.stem)
        place = f"resources/{stem}.fmu"
        if component.fmu.sha256 not in places:
            taken = place in places.values()
            places[component.fmu.sha256] = f"resources/{stem}_{component.fmu.sha256[:10]}.fmu" if taken else place
    return places


def _entry(name: str, compression: int) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
    entry.compress_type, entry.external_attr = compression, 0o644 << 16
    return entry


def _type(variable: Variable) -> str:
    """SSP 1.0's name of an FMI type: it has those of FMI 2.0, and Binary."""
    if variable.type == "Enumeration" or variable.kind in OBJECTS:
        return variable.type
    return "Real" if variable.kind in FLOATS else "Boolean" if variable.kind in TRUTHS else "Integer"


class _Writer:
    """Builds the description.  The order of elements is that of the standard's schema."""

    def __init__(self, plan: Plan, sources: Mapping[str, str]):
        from lxml import etree

        self.etree, self.plan, self.sources = etree, plan, sources
        self.connected = {(k.sink, k.input.name) for k in plan.connections} | {
            (k.source, k.output.name) for k in plan.connections
        }
        self.units: dict[str, Unit] = {}  # by their names in the SSD
        self.enumerations: dict[tuple[tuple[str, int], ...], str] = {}  # {items: name}

    def text(self) -> bytes:
        experiment = self.plan.experiment
        name = experiment.path.stem
        root = self.etree.Element(
            tag("ssd:SystemStructureDescription"),
            nsmap=NAMESPACES,
            version="1.0",
            name=name,
            generationTool=f"orch {__version__}",
        )
        system = self.add(root, "ssd:System", name=name, description=experiment.title)
        elements = self.add(system, "ssd:Elements")
        for component in self.plan.components:
            self.component(elements, component)
        if self.plan.connections:
            connections = self.add(system, "ssd:Connections")
            for connection in self.plan.connections:
                self.connection(connections, connection)
        self.definitions(root)
        self.default_experiment(root)
        text: bytes = self.etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
        return text

    def add(self, parent: Any, element: str, /, **attributes: str) -> Any:
        return self.etree.SubElement(parent, tag(element), **attributes)

    def component(self, elements: Any, component: Component) -> None:
        element = self.add(
            elements,
            "ssd:Component",
            name=component.name,
            type=FMU,
            source=self.sources[component.fmu.sha256],
            implementation="CoSimulation",
        )
        # libcosim stops at an Enumeration: those that nothing connects may as well be left out.
        ports = [
            v
            for v in component.fmu.variables.values()
            if v.causality in ("input", "output")
            and (v.type != "Enumeration" or (component.name, v.name) in self.connected)
        ]
        if ports:
            connectors = self.add(element, "ssd:Connectors")
            for variable in ports:
                connector = self.add(connectors, "ssd:Connector", name=variable.name, kind=variable.causality)
                self.type(connector, component.fmu, variable)
        values = {name: v for name, v in {**component.parameters, **component.start}.items() if not _too_wide(v)}
        if values:
            binding = self.add(self.add(element, "ssd:ParameterBindings"), "ssd:ParameterBinding")
            set_ = self.add(
                self.add(binding, "ssd:ParameterValues"), "ssv:ParameterSet", version="1.0", name=PARAMETERS
            )
            parameters = self.add(set_, "ssv:Parameters")
            for name, value in values.items():
                self.value(self.add(parameters, "ssv:Parameter", name=name), component.fmu.variables[name], value)
        if component.period > 1:
            annotation = self.annotation(element, OSP)
            period = self.plan.experiment.grid.time(component.period)
            self.add(annotation, "osp:StepSizeHint", value=repr(period))

    def type(self, connector: Any, fmu: Fmu, variable: Variable) -> None:
        if variable.type == "Enumeration":
            self.add(connector, "ssc:Enumeration", name=self.enumeration(fmu, variable))
        elif variable.kind in FLOATS and variable.unit in fmu.units:
            self.add(connector, "ssc:Real", unit=self.unit(fmu, variable.unit))
        else:
            self.add(connector, f"ssc:{_type(variable)}")

    def value(self, parameter: Any, variable: Variable, value: Any) -> None:
        if variable.kind in TRUTHS:
            text = "true" if value else "false"
        elif variable.type == "Enumeration":
            text = next((name for name, number in variable.items if number == value), str(value))
        else:
            text = value if isinstance(value, str) else repr(value)
        self.add(parameter, f"ssv:{_type(variable)}", value=text)

    def connection(self, elements: Any, connection: Connection) -> None:
        """Units are converted by factor and offset here: libcosim and Ecos know nothing of units."""
        scaled = (connection.factor, connection.offset) != (1.0, 0.0) or (
            connection.input.kind in FLOATS and connection.output.kind not in FLOATS
        )
        other = connection.input.unit and connection.output.unit and connection.input.unit != connection.output.unit
        settled = {"suppressUnitConversion": "true"} if scaled or other else {}
        element = self.add(
            elements,
            "ssd:Connection",
            startElement=connection.source,
            startConnector=connection.output.name,
            endElement=connection.sink,
            endConnector=connection.input.name,
            **settled,
        )
        if scaled:
            self.add(
                element, "ssc:LinearTransformation", factor=repr(connection.factor), offset=repr(connection.offset)
            )

    def unit(self, fmu: Fmu, unit: str) -> str:
        """Its name in the SSD: another one where two FMUs mean different things by it."""
        meaning, name = fmu.units[unit], unit
        while self.units.setdefault(name, meaning) != meaning:
            name += "'"
        return name

    def enumeration(self, fmu: Fmu, variable: Variable) -> str:
        name = f"{fmu.model_name}.{variable.name}"
        while variable.items not in self.enumerations and name in self.enumerations.values():
            name += "'"
        return self.enumerations.setdefault(variable.items, name)

    def definitions(self, root: Any) -> None:
        if self.enumerations:
            enumerations = self.add(root, "ssd:Enumerations")
            for items, name in self.enumerations.items():
                enumeration = self.add(enumerations, "ssc:Enumeration", name=name)
                for item, value in items:
                    self.add(enumeration, "ssc:Item", name=item, value=str(value))
        if self.units:
            units = self.add(root, "ssd:Units")
            for name, unit in self.units.items():
                base = {u: str(e) for u, e in zip(BASE, unit.exponents, strict=True) if e}
                scale = {"factor": repr(unit.factor)} if unit.factor != 1.0 else {}
                scale |= {"offset": repr(unit.offset)} if unit.offset else {}
                self.add(self.add(units, "ssc:Unit", name=name), "ssc:BaseUnit", **base, **scale)

    def default_experiment(self, root: Any) -> None:
        master = self.plan.experiment.master
        default = self.add(root, "ssd:DefaultExperiment", startTime="0.0", stopTime=repr(master.stop_time))
        algorithm = self.add(self.annotation(default, OSP), "osp:Algorithm")
        self.add(algorithm, "osp:FixedStepAlgorithm", baseStepSize=repr(master.step))
        self.add(self.annotation(default, OURS), "orch:experiment").text = "\n" + toml.write(beyond(self.plan))

    def annotation(self, parent: Any, type: str) -> Any:
        annotations = parent.find(tag("ssd:Annotations"))
        if annotations is None:
            annotations = self.add(parent, "ssd:Annotations")
        return self.add(annotations, "ssc:Annotation", type=type)
