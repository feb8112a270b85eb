"""Units of an SSP: what a name of one means."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..fmu.units import BASE, Unit
from .names import tag

Units = Mapping[str, Unit]


def read_units(node: Any) -> dict[str, Unit]:
    """The section Units of a file, {} for None; a unit whose definition is no number is left out."""
    units = {}
    for unit in node.iterfind(tag("ssc:Unit")) if node is not None else ():
        base = unit.find(tag("ssc:BaseUnit"))
        try:
            exponents = tuple(int(base.get(name, "0")) for name in BASE)
            factor, offset = float(base.get("factor", "1")), float(base.get("offset", "0"))
        except (AttributeError, ValueError):
            continue
        if factor:
            units[unit.get("name") or ""] = Unit(exponents, factor, offset)
    return units
