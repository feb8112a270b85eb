"""Parameter sources of an SSP: sets of values (.ssv or inline), and mappings of their names (.ssm or inline)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ..fmu.fmu import Fmu
from ..fmu.units import conversion
from ..fmu.variables import FLOATS, WHOLE, Variable
from .archive import SspArchive, Unreadable
from .names import PARAMETER_MAPPING, PARAMETER_SET, tag
from .units import Units, read_units

KINDS: dict[str, Callable[[str], Any]] = {
    "Real": float,
    "Integer": int,
    "Boolean": lambda text: {"true": True, "1": True, "false": False, "0": False}[text.strip()],
    "String": str,
    "Enumeration": str,
    "Binary": lambda text: bytes.fromhex(text).hex(),
}
TYPES = {"truth": "Boolean", "boolean": "Boolean", "string": "String", "binary": "Binary"}  # {kind: type}


@dataclass(frozen=True)
class Value:
    """type: of the file, a key of KINDS; units: that the file defines."""

    type: str
    value: Any
    unit: str = ""
    units: Units = field(default_factory=dict)

    def transformed(self, factor: float, offset: float) -> Value:
        """factor * value + offset.  Raises Unreadable where that means nothing."""
        if (factor, offset) == (1.0, 0.0):
            return self
        if self.type not in ("Real", "Integer"):
            raise Unreadable(f"a linear transformation of a {self.type}")
        return dataclasses.replace(self, type="Real", value=factor * self.value + offset)


Binding = dict[str, Value]  # {name of a parameter of the element, prefix and mapping applied: value}


def read_binding(archive: SspArchive, node: Any, units: Units) -> Binding:
    """One ssd:ParameterBinding.  units: of the description.  Raises Unreadable."""
    kind, source = node.get("type") or PARAMETER_SET, node.get("source")
    if kind != PARAMETER_SET:
        raise Unreadable(f"a source of type {kind}; orch reads {PARAMETER_SET}")
    if node.get("sourceBase") == "component":
        raise Unreadable(f"{source!r} lies inside an FMU; orch reads what lies in the archive")
    inline = node.find(f"{tag('ssd:ParameterValues')}/{tag('ssv:ParameterSet')}")
    root = archive.xml(source) if source else inline
    if root is None or root.tag != tag("ssv:ParameterSet"):
        raise Unreadable(f"{source or 'the binding'} holds no parameter set")
    prefix = node.get("prefix") or ""
    values = {prefix + name: value for name, value in _values(root, units).items()}
    mapping = node.find(tag("ssd:ParameterMapping"))
    return values if mapping is None else _mapped(values, _mapping(archive, mapping))


def _values(root: Any, units: Units) -> Binding:
    meanings = {**units, **read_units(root.find(tag("ssv:Units")))}
    result: Binding = {}
    for parameter in root.iterfind(f"{tag('ssv:Parameters')}/{tag('ssv:Parameter')}"):
        name = parameter.get("name") or ""
        for type, read in KINDS.items():
            typed = parameter.find(tag(f"ssv:{type}"))
            if typed is None:
                continue
            text, unit = typed.get("value", ""), typed.get("unit") or ""
            try:
                result[name] = Value(type, read(text), unit, meanings)
            except (ValueError, KeyError):
                raise Unreadable(f"{name} is {text!r}, not a value of type {type}") from None
            break
        else:
            types = [str(child.tag).rpartition("}")[2] for child in parameter]
            raise Unreadable(
                f"{name} is a {types[0] if types else 'parameter without a type'}; orch reads {', '.join(KINDS)}"
            )
    return result


def _mapping(archive: SspArchive, node: Any) -> list[tuple[str, str, float, float]]:
    """(source, target, factor, offset) of each entry."""
    kind, source = node.get("type") or PARAMETER_MAPPING, node.get("source")
    if kind != PARAMETER_MAPPING or node.get("sourceBase") == "component":
        raise Unreadable(f"a mapping of type {kind} that orch does not read")
    root = archive.xml(source) if source else node.find(tag("ssm:ParameterMapping"))
    if root is None or root.tag != tag("ssm:ParameterMapping"):
        raise Unreadable(f"{source or 'the binding'} holds no parameter mapping")
    entries = []
    for entry in root.iterfind(tag("ssm:MappingEntry")):
        linear = entry.find(tag("ssc:LinearTransformation"))
        if linear is None and any("Transformation" in str(child.tag) for child in entry):
            raise Unreadable(f"the mapping of {entry.get('source')} maps values one by one, which orch does not do")
        try:
            factor, offset = (
                (1.0, 0.0) if linear is None else (float(linear.get("factor", "1")), float(linear.get("offset", "0")))
            )
        except ValueError:
            raise Unreadable(f"the mapping of {entry.get('source')} has a factor that is not a number") from None
        entries.append((entry.get("source") or "", entry.get("target") or "", factor, offset))
    return entries


def _mapped(values: Binding, entries: list[tuple[str, str, float, float]]) -> Binding:
    """The values by their targets' names; a value that no entry names keeps its own."""
    named = {source for source, *_ in entries}
    result = {name: value for name, value in values.items() if name not in named}
    for source, target, factor, offset in entries:
        if source in values:
            result[target] = values[source].transformed(factor, offset)
    return result


def for_variable(value: Value, variable: Variable, fmu: Fmu) -> Any:
    """The value as the experiment file gives it to this variable, in its unit.  Raises Unreadable."""
    if variable.kind in FLOATS and value.type in ("Real", "Integer"):
        try:
            factor, offset = conversion(value.unit, value.units, variable.unit, fmu.units)
        except ValueError as error:
            raise Unreadable(f"is in {value.unit!r}, the FMU's in {variable.unit!r}: {error}") from None
        return factor * float(value.value) + offset
    if variable.type == "Enumeration" and value.type == "Enumeration":
        number = value.value.lstrip("-").isdecimal() and value.value not in dict(variable.items)
        return int(value.value) if number else value.value
    if variable.kind in WHOLE and value.type in ("Real", "Integer") and float(value.value).is_integer():
        return int(value.value)
    if TYPES.get(variable.kind) == value.type:
        return value.value
    raise Unreadable(f"is {value.value!r} ({value.type}), and the FMU's is {variable.type}")
