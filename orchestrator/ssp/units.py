"""Units of an SSP: what a name of one means."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .names import BASE_UNITS, tag

Meaning = tuple[tuple[int, ...], float, float]  # exponents of BASE_UNITS, factor, offset: SI = factor * value + offset
Units = Mapping[str, Meaning]


def read_units(node: Any) -> Units:
    """The section Units of a file, {} for None; a unit whose definition is no number is left out."""
    found = {}
    for unit in node.iterfind(tag("ssc:Unit")) if node is not None else ():
        base = unit.find(tag("ssc:BaseUnit"))
        try:
            exponents = tuple(int(base.get(name, "0")) for name in BASE_UNITS)
            found[unit.get("name") or ""] = exponents, float(base.get("factor", "1")), float(base.get("offset", "0"))
        except (AttributeError, ValueError):
            continue
    return found
