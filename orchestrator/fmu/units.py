"""Units of FMI: compared by their exponents of SI base units, converted by factor and offset."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class Unit:
    """value in SI base units = factor * value + offset.  `exponents`: of BASE."""

    exponents: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0

    def __str__(self) -> str:
        powers = zip(BASE, self.exponents, strict=True)
        return ".".join(name + (str(n) if n != 1 else "") for name, n in powers if n) or "1"


def _unit(factor: float = 1.0, offset: float = 0.0, **exponents: int) -> Unit:
    return Unit(tuple(exponents.get(name, 0) for name in BASE), factor, offset)


# For FMUs that name a unit and do not define it.  Factors: BIPM, The International System of Units, 9th edition.
KNOWN = {
    "1": _unit(),
    "-": _unit(),
    "%": _unit(0.01),
    "m": _unit(m=1),
    "mm": _unit(1e-3, m=1),
    "cm": _unit(1e-2, m=1),
    "km": _unit(1e3, m=1),
    "s": _unit(s=1),
    "ms": _unit(1e-3, s=1),
    "min": _unit(60.0, s=1),
    "h": _unit(3600.0, s=1),
    "kg": _unit(kg=1),
    "g": _unit(1e-3, kg=1),
    "rad": _unit(rad=1),
    "deg": _unit(math.pi / 180, rad=1),
    "m/s": _unit(m=1, s=-1),
    "kn": _unit(1852 / 3600, m=1, s=-1),
    "km/h": _unit(1 / 3.6, m=1, s=-1),
    "m/s2": _unit(m=1, s=-2),
    "rad/s": _unit(rad=1, s=-1),
    "deg/s": _unit(math.pi / 180, rad=1, s=-1),
    "rpm": _unit(2 * math.pi / 60, rad=1, s=-1),
    "rad/s2": _unit(rad=1, s=-2),
    "Hz": _unit(s=-1),
    "N": _unit(kg=1, m=1, s=-2),
    "kN": _unit(1e3, kg=1, m=1, s=-2),
    "N.m": _unit(kg=1, m=2, s=-2),
    "Pa": _unit(kg=1, m=-1, s=-2),
    "bar": _unit(1e5, kg=1, m=-1, s=-2),
    "W": _unit(kg=1, m=2, s=-3),
    "A": _unit(A=1),
    "V": _unit(kg=1, m=2, s=-3, A=-1),
    "K": _unit(K=1),
    "degC": _unit(1.0, 273.15, K=1),
}


def defined(description: Any) -> dict[str, Unit]:
    """{name: unit} of FMPy's model description: those with a base unit."""
    found = {}
    for unit in description.unitDefinitions or ():
        base = unit.baseUnit
        if base is not None:
            exponents = tuple(int(getattr(base, name) or 0) for name in BASE)
            found[unit.name] = Unit(exponents, float(base.factor), float(base.offset))
    return found


def conversion(
    source: str, defined_there: Mapping[str, Unit], sink: str, defined_here: Mapping[str, Unit]
) -> tuple[float, float]:
    """Factor and offset that turn a value in the unit `source` into one in `sink`.

    A unit that is not given fits any.  Raises ValueError, with the reason, where they measure different things, or
    where it cannot be known.
    """
    if (source == sink and defined_there.get(source) == defined_here.get(sink)) or not source or not sink:
        return 1.0, 0.0
    units = []
    for name, definitions in ((source, defined_there), (sink, defined_here)):
        unit = definitions.get(name) or KNOWN.get(name)
        if unit is None:
            if source == sink:
                return 1.0, 0.0
            raise ValueError(f"{name!r} is not defined in its FMU by SI base units")
        units.append(unit)
    a, b = units
    if a.exponents != b.exponents:
        raise ValueError(f"one is {a}, the other {b} in SI base units")
    if a == b or (source == sink and math.isclose(a.factor, b.factor, rel_tol=1e-6) and a.offset == b.offset):
        return 1.0, 0.0
    return a.factor / b.factor, (a.offset - b.offset) / b.factor
