"""SystemStructure.ssd as plain data: elements, connectors, connections, parameter sources.  Nothing is resolved here.

What the standard allows and orch does not run is gathered as problems, all of them, with where they stand.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from typing import Any

from ..errors import Problem
from .archive import SspArchive, Unreadable
from .names import DESCRIPTION, FMU, OSP, OURS, tag
from .parameters import Binding, read_binding
from .units import Units, read_units

MAPPINGS = (
    "ssc:BooleanMappingTransformation",
    "ssc:IntegerMappingTransformation",
    "ssc:EnumerationMappingTransformation",
)


@dataclass(frozen=True)
class Connector:
    kind: str  # input, output, parameter, calculatedParameter, ...
    unit: str


@dataclass(frozen=True, kw_only=True)
class SsdConnection:
    """One connection of a system.  start, end: element ("" for the system itself) and connector."""

    start: tuple[str, str]
    end: tuple[str, str]
    factor: float = 1.0
    offset: float = 0.0
    scaled: bool = False  # factor and offset are given
    convert: bool = True  # units


@dataclass
class Element:
    """A component or a system.  source: of its FMU, "" where there is none that orch runs."""

    name: str
    leaf: bool = False  # a component
    source: str = ""
    step: float | None = None  # s, of libcosim's annotation
    connectors: dict[str, Connector] = field(default_factory=dict)
    bindings: list[Binding] = field(default_factory=list)
    elements: list[Element] = field(default_factory=list)
    connections: list[SsdConnection] = field(default_factory=list)


@dataclass(kw_only=True)
class Structure:
    """beyond: the table of our annotation, {} without."""

    name: str
    system: Element
    units: Units
    stop_time: float | None
    step: float | None  # s, of libcosim's annotation
    beyond: dict[str, Any]
    problems: list[Problem]


def read(archive: SspArchive) -> Structure:
    """Read the description of a system; `.problems` has what cannot be run."""
    return _Reader(archive).structure()


class _Reader:
    def __init__(self, archive: SspArchive):
        self.archive = archive
        self.problems: list[Problem] = []

    def problem(self, key: str, sentence: str) -> None:
        self.problems.append(Problem(key, sentence))

    def structure(self) -> Structure:
        empty = Structure(
            name="", system=Element(""), units={}, stop_time=None, step=None, beyond={}, problems=self.problems
        )
        try:
            root = self.archive.xml(DESCRIPTION)
        except Unreadable as error:
            self.problem("", str(error))
            return empty
        if root.tag != tag("ssd:SystemStructureDescription"):
            self.problem(DESCRIPTION, "is not a system structure of SSP 1.0")
            return empty
        version = root.get("version", "")
        if not version.startswith("1."):
            self.problem(DESCRIPTION, f"is of SSP {version or '(no version)'}; orch reads SSP 1.0")
        system = root.find(tag("ssd:System"))
        if system is None:
            self.problem(DESCRIPTION, "has no System")
            return empty
        units = read_units(root.find(tag("ssd:Units")))
        default = root.find(tag("ssd:DefaultExperiment"))
        stop_time, step, beyond = None, None, {}
        if default is not None:
            start = self.number(default, "startTime", "DefaultExperiment")
            if start:
                self.problem("DefaultExperiment", f"starts at {start:g} s; orch starts at 0")
            stop_time = self.number(default, "stopTime", "DefaultExperiment")
            algorithm = default.find(f"{annotation(OSP)}/{tag('osp:Algorithm')}/{tag('osp:FixedStepAlgorithm')}")
            step = self.number(algorithm, "baseStepSize", "DefaultExperiment")
            beyond = self.beyond(default.find(f"{annotation(OURS)}/{tag('orch:experiment')}"))
        element = self.element(system, system.get("name") or "system", units)
        return Structure(
            name=root.get("name") or "",
            system=element,
            units=units,
            stop_time=stop_time,
            step=step,
            beyond=beyond,
            problems=self.problems,
        )

    def beyond(self, element: Any) -> dict[str, Any]:
        try:
            return tomllib.loads(element.text or "") if element is not None else {}
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            self.problem(f"annotation {OURS}", f"cannot be read as TOML: {error}")
            return {}

    def element(self, node: Any, path: str, units: Units) -> Element:
        """A component or a system, with all below it.  path: of names, for messages."""
        element = Element(node.get("name") or "")
        if not element.name:
            self.problem(path, "has no name")
        for connector in node.iterfind(f"{tag('ssd:Connectors')}/{tag('ssd:Connector')}"):
            types = [child for child in connector if isinstance(child.tag, str)]
            unit = next((child.get("unit") for child in types if child.get("unit")), "")
            element.connectors[connector.get("name") or ""] = Connector(connector.get("kind") or "", unit)
        for binding in node.iterfind(f"{tag('ssd:ParameterBindings')}/{tag('ssd:ParameterBinding')}"):
            try:
                element.bindings.append(read_binding(self.archive, binding, units))
            except Unreadable as error:
                self.problem(path, f"its parameters: {error}")
        if node.tag == tag("ssd:Component"):
            self.component(node, path, element)
        else:
            self.system(node, path, element, units)
        return element

    def component(self, node: Any, path: str, element: Element) -> None:
        kind, source = node.get("type") or FMU, node.get("source") or ""
        element.leaf, element.source = True, source if kind == FMU else ""
        if kind != FMU:
            self.problem(path, f"is {kind}, not an FMU; orch runs no SSP inside another, import that one by itself")
        elif not source:
            self.problem(path, "names no FMU as its source")
        elif node.get("implementation") == "ModelExchange":
            self.problem(path, "asks for Model Exchange; orch runs FMUs for Co-Simulation")
        element.step = self.number(node.find(f"{annotation(OSP)}/{tag('osp:StepSizeHint')}"), "value", path)

    def system(self, node: Any, path: str, element: Element, units: Units) -> None:
        for child in node.iterfind(f"{tag('ssd:Elements')}/*"):
            below = f"{path}.{child.get('name')}"
            if child.tag in (tag("ssd:Component"), tag("ssd:System")):
                element.elements.append(self.element(child, below, units))
            else:
                self.problem(below, "is a signal dictionary, which orch does not read")
        for child in node.iterfind(f"{tag('ssd:Connections')}/{tag('ssd:Connection')}"):
            ends = [(child.get(f"{end}Element") or "", child.get(f"{end}Connector") or "") for end in ("start", "end")]
            where = f"{path}, connection {'.'.join(filter(None, ends[0]))} to {'.'.join(filter(None, ends[1]))}"
            factor, offset = 1.0, 0.0
            if any(child.find(tag(name)) is not None for name in MAPPINGS):
                self.problem(where, "maps values one by one, which orch does not do")
            linear = child.find(tag("ssc:LinearTransformation"))
            if linear is not None:
                factor = self.number(linear, "factor", where, 1.0)
                offset = self.number(linear, "offset", where, 0.0)
            convert = child.get("suppressUnitConversion", "false") not in ("true", "1")
            element.connections.append(
                SsdConnection(
                    start=ends[0],
                    end=ends[1],
                    factor=factor,
                    offset=offset,
                    scaled=linear is not None,
                    convert=convert,
                )
            )

    def number(self, node: Any, name: str, where: str, default: Any = None) -> Any:
        text = node.get(name) if node is not None else None
        if text is None:
            return default
        try:
            return float(text)
        except ValueError:
            self.problem(where, f"{name} is {text!r}, not a number")
            return default


def annotation(type: str) -> str:
    """The path from an element to an annotation of it."""
    return f"{tag('ssd:Annotations')}/{tag('ssc:Annotation')}[@type='{type}']"
