"""Whether a modelDescription.xml makes sense: what readers of FMUs take for granted is checked first.

A start value that is not a number, a variable that occurs twice, an index before the first variable: a reader that does
not check takes something near to it, and computes with that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import FmuError, did_you_mean

SHOWN = 8  # faults that a message names
REFERENCES = 1 << 32
CAUSALITIES = (
    "parameter",
    "calculatedParameter",
    "input",
    "output",
    "local",
    "independent",
    "structuralParameter",
    "dependent",
)
VARIABILITIES = ("constant", "fixed", "tunable", "discrete", "continuous")
FLOATS = ("Real", "Float32", "Float64")
BOOLEANS = ("true", "false", "1", "0")
# {type: bits, signed}
WHOLE = {"Integer": (32, True), "Enumeration": (64, True)} | {
    f"{sign}Int{bits}": (bits, not sign) for sign in ("", "U") for bits in (8, 16, 32, 64)
}
FMI2_TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
FMI3_TYPES = (*(name for name in WHOLE if name != "Integer"), *FLOATS[1:], "Boolean", "String", "Binary", "Clock")


def check(path: Path, text: str) -> Any:
    """The root of a description.  Raises FmuError, naming the faults, if one of FMI 2.0 or 3.0 does not make sense.

    text: checked XML.  Other versions, and other roots, are left to the reader.
    """
    from lxml import etree

    root = etree.fromstring(text.encode())
    version = (root.get("fmiVersion") or "")[:2]
    if root.tag != "fmiModelDescription" or version not in ("2.", "3."):
        return root
    faults = [*_head(root, version), *_variables(root, version), *_units(root)]
    faults += _structure2(root) if version == "2." else _structure3(root)
    if faults:
        shown = "; ".join(faults[:SHOWN]) + (f"; and {len(faults) - SHOWN} more" if len(faults) > SHOWN else "")
        raise FmuError(f"{path}: modelDescription.xml cannot be read: {shown}")
    return root


def _head(root: Any, version: str) -> Iterator[str]:
    for name in ("modelName", "guid" if version == "2." else "instantiationToken"):
        if root.get(name) is None:
            yield f"it has no {name}"
    for element in root.findall("CoSimulation"):
        if not element.get("modelIdentifier"):
            yield "its CoSimulation has no modelIdentifier"
        step = element.get("fixedInternalStepSize")
        if step is not None and not 0.0 < (_number(step) or 0.0) < math.inf:
            yield f"its fixedInternalStepSize is {_short(step)}"
    for experiment in root.findall("DefaultExperiment"):
        for name in ("startTime", "stopTime", "stepSize", "tolerance"):
            text = experiment.get(name)
            value = _number(text) if text is not None else None
            if text is not None and (
                value is None or not math.isfinite(value) or (name in ("stepSize", "tolerance") and value <= 0.0)
            ):
                yield f"the {name} of its DefaultExperiment is {_short(text)}"
    if len(root.findall("CoSimulation")) > 1:
        yield "it has several CoSimulation elements"
    if len(root.findall("ModelVariables")) != 1:
        yield "it needs one ModelVariables element"


def _variables(root: Any, version: str) -> Iterator[str]:
    """Faults of the variables, by name and line."""
    items = _items(root, version)
    names: set[str] = set()
    for element in root.iterfind("ModelVariables/*"):
        name = element.get("name")
        where = f"variable {name!r} (line {element.sourceline})"
        if not name:
            yield f"the variable of line {element.sourceline} has no name"
            continue
        for own in (name, *(alias.get("name") for alias in element.iterfind("Alias"))):
            if own in names:
                yield f"{where}: the name {own!r} occurs twice"
            names.add(own)
        reference = _whole(element.get("valueReference"))
        if reference is None or not 0 <= reference < REFERENCES:
            yield f"{where}: valueReference {element.get('valueReference')!r} is not a number of 32 bits"
        for attribute, known in (("causality", CAUSALITIES), ("variability", VARIABILITIES)):
            value = element.get(attribute)
            if value is not None and value not in known:
                yield f"{where}: no {attribute} {value!r}{did_you_mean(value, known)}"
        typed = [child for child in element if child.tag in FMI2_TYPES] if version == "2." else [element]
        if len(typed) != 1:
            yield f"{where} has {len(typed)} types"
        elif version == "3." and element.tag not in FMI3_TYPES:
            yield f"{where}: no type {element.tag!r}{did_you_mean(str(element.tag), FMI3_TYPES)}"
        else:
            for fault in _values(typed[0], items.get(typed[0].get("declaredType"), set())):
                yield f"{where}: {fault}"


def _values(element: Any, items: set[int]) -> Iterator[str]:
    """Faults of start, min and max.  items: values of the enumeration."""
    kind = element.tag
    given: dict[str, list[Any]] = {}
    for attribute in ("start", "min", "max"):
        text = element.get(attribute)
        if text is None or kind in ("String", "Binary", "Clock"):
            continue
        words = text.split() if element.find("Dimension") is not None else [text.strip()]
        values = [_value(kind, word) for word in words]
        if None in values:
            yield f"{attribute} {_short(text)} is not of type {kind}"
        given[attribute] = values
    low, high = given.get("min"), given.get("max")
    if low and high and None not in (low[0], high[0]) and low[0] > high[0]:
        yield f"min {low[0]} is greater than max {high[0]}"
    if kind == "Enumeration" and items:
        for value in given.get("start", []):
            if value is not None and value not in items:
                yield f"start {value} is not an item of its enumeration"


def _value(kind: str, word: str) -> Any:
    """The value of a word of XML Schema; None if it is not of that type."""
    if kind == "Boolean":
        return word in ("true", "1") if word in BOOLEANS else None
    if kind in WHOLE:
        bits, signed = WHOLE[kind]
        value = _whole(word)
        low, high = (-(1 << bits - 1), 1 << bits - 1) if signed else (0, 1 << bits)
        return value if value is not None and low <= value < high else None
    return _number(word)


def _whole(word: str | None) -> int | None:
    digits = (word or "").strip()
    if digits[:1] in ("+", "-"):
        digits = digits[1:]
    # Python's int() also takes "1_000" and digits of other scripts, and refuses thousands of them.
    return int((word or "").strip()) if digits.isascii() and digits.isdigit() and len(digits) < 30 else None


def _number(word: str | None) -> float | None:
    try:
        value = float(word or "")
    except ValueError:
        return None
    # "1e400" is not infinity: a finite number is meant, which does not fit.
    meant = not math.isinf(value) or (word or "").strip().lstrip("+-") in ("INF", "inf", "Infinity")
    return value if meant and "_" not in (word or "") else None


def _items(root: Any, version: str) -> dict[str, set[int]]:
    """{name of an enumeration: values of its items}."""
    items = {}
    for element in root.iterfind("TypeDefinitions/*"):
        values = {_whole(item.get("value")) for item in element.iter("Item")}
        if version in ("2.", "3.") and values and element.get("name"):
            items[element.get("name")] = {value for value in values if value is not None}
    return items


def _units(root: Any) -> Iterator[str]:
    for element in root.iter("Item"):
        if element.get("value") is not None and _whole(element.get("value")) is None:
            yield f"the item of line {element.sourceline} has the value {_short(element.get('value'))}"
    for unit in root.iterfind("UnitDefinitions/Unit"):
        for base in unit.iterfind("BaseUnit"):
            for name, text in base.attrib.items():
                value = _number(text) if name in ("factor", "offset") else _whole(text)
                if value is None or (name == "factor" and not (value and math.isfinite(value))):
                    yield f"unit {unit.get('name')!r} has the {name} {_short(text)}"


def _structure2(root: Any) -> Iterator[str]:
    """FMI 2.0 refers to variables by their index, from 1 on."""
    count = len(root.findall("ModelVariables/ScalarVariable"))
    for unknown in root.iterfind("ModelStructure/*/Unknown"):
        for word in (unknown.get("index") or "", *(unknown.get("dependencies") or "").split()):
            index = _whole(word)
            if index is None or not 1 <= index <= count:
                yield f"line {unknown.sourceline} refers to variable {_short(word)} of {count}"


def _structure3(root: Any) -> Iterator[str]:
    """FMI 3.0 refers to variables by their value references."""
    known = {_whole(element.get("valueReference")) for element in root.iterfind("ModelVariables/*")}
    for unknown in root.iterfind("ModelStructure/*"):
        for word in (unknown.get("valueReference") or "", *(unknown.get("dependencies") or "").split()):
            if _whole(word) not in known or _whole(word) is None:
                yield f"line {unknown.sourceline} refers to the value reference {_short(word)}, which no variable has"


def _short(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:40]}...")
