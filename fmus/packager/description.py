"""modelDescription.xml (FMI 2.0) of a model, the same for every packaging."""

from __future__ import annotations

import hashlib
import inspect
import math
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree as ET

from uuv.modelling.declare import Declared, Scalar
from uuv.modelling.equations import Equations

from orchestrator.fmu.units import BASE, parse

TYPES = {float: "Real", int: "Integer", bool: "Boolean"}
LOG_CATEGORIES = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll")


def model_description(
    model: type[Declared],
    name: str,
    guid: str,
    tool: str,
    equations: Equations | None,
    capabilities: dict[str, bool],
    sources: Sequence[str] = (),
    data: Mapping[str, bytes] = {},
) -> bytes:
    """The XML file.  `equations`: None for a plain Python model, whose outputs may depend on all inputs.

    sources: the C files to compile.  data: {name: content} of its data files, whose digests it states.
    """
    scalars = model.layout().scalars
    index = {scalar.name: i for i, scalar in enumerate(scalars, start=1)}
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=name,
        guid=guid,
        description=_summary(model),
        generationTool=tool,
        variableNamingConvention="structured",
    )
    options = {option: str(value).lower() for option, value in capabilities.items()}
    slave = ET.SubElement(root, "CoSimulation", modelIdentifier=name, **options)
    if sources:
        files = ET.SubElement(slave, "SourceFiles")
        for source in sources:
            ET.SubElement(files, "File", name=source)
    units = ET.SubElement(root, "UnitDefinitions")
    for unit in sorted({s.unit for s in scalars if s.type is float}):
        ET.SubElement(ET.SubElement(units, "Unit", name=unit), "BaseUnit", _base_unit(unit))
    categories = ET.SubElement(root, "LogCategories")
    for category in LOG_CATEGORIES:
        ET.SubElement(categories, "Category", name=category)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize="0.001")
    if data:
        own = ET.SubElement(ET.SubElement(root, "VendorAnnotations"), "Tool", name="orch")
        for file, content in sorted(data.items()):
            ET.SubElement(own, "File", name=file, sha256=hashlib.sha256(content).hexdigest())
    variables = ET.SubElement(root, "ModelVariables")
    for scalar in scalars:
        variables.append(_variable(scalar))
    structure = ET.SubElement(root, "ModelStructure")
    shown = [s for s in scalars if s.causality == "output"]
    calculated = [s for s in scalars if s.causality in ("output", "calculatedParameter")]
    states = model.layout().groups["state"]
    for section, unknowns in (("Outputs", shown), ("InitialUnknowns", calculated)):
        if unknowns:
            element = ET.SubElement(structure, section)
            for scalar in unknowns:
                known = None
                if equations is not None:
                    kind = equations.dependencies["outputs" if section == "Outputs" else "initial"]
                    known = sorted(index[other] for other in kind[scalar.name])
                elif section == "Outputs" and states.start <= scalar.place < states.stop:
                    known = []  # a state depends on no input of the same instant
                _unknown(element, index[scalar.name], known)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _base_unit(unit: str) -> dict[str, str]:
    """The attributes of BaseUnit.  Raises ValueError for a unit that is not known."""
    try:
        known = parse(unit)
    except ValueError as error:
        raise ValueError(f"unit {unit!r}: {error}") from None
    attributes = {base: str(exponent) for base, exponent in zip(BASE, known.exponents, strict=True) if exponent}
    scale = {"factor": known.factor} if known.factor != 1.0 else {}
    scale |= {"offset": known.offset} if known.offset else {}
    return attributes | {name: f"{value:.17g}" for name, value in scale.items()}


def _variable(scalar: Scalar) -> ET.Element:
    fixed = scalar.causality in ("parameter", "calculatedParameter")
    continuous = scalar.type is float
    element = ET.Element(
        "ScalarVariable",
        name=scalar.name,
        valueReference=str(scalar.place),
        causality=scalar.causality,
        variability="fixed" if fixed else "continuous" if continuous else "discrete",
    )
    if scalar.meaning:
        element.set("description", scalar.meaning)
    value: dict[str, Any] = {}
    if scalar.causality in ("parameter", "input"):
        number = scalar.type(scalar.start)
        value["start"] = repr(number) if continuous else str(number).lower()
        if scalar.causality == "parameter":
            element.set("initial", "exact")
    else:
        element.set("initial", "calculated")
    if continuous:
        value["unit"] = scalar.unit
        if scalar.quantity:
            value["quantity"] = scalar.quantity
        value |= {name: repr(v) for name, v in zip(("min", "max"), scalar.limits, strict=True) if math.isfinite(v)}
    ET.SubElement(element, TYPES[scalar.type], value)
    return element


def _unknown(parent: ET.Element, index: int, dependencies: list[int] | None) -> None:
    element = ET.SubElement(parent, "Unknown", index=str(index))
    if dependencies is not None:
        element.set("dependencies", " ".join(map(str, dependencies)))


def _summary(model: type) -> str:
    """The first paragraph of the docstring, without its line breaks."""
    text = inspect.getdoc(model) or model.__name__
    return " ".join(text.partition("\n\n")[0].split())
