"""Units of FMI: compared by their exponents of SI base units, converted by factor and offset.

This is the project's one table of units.  `fmus/packager` reads it, too, in the process that `orch build` runs it in:
what it writes into an FMU and what is read from one then agree.  Models (`fmus/uuv` and what derives from it) only name
their units, because Python FMUs carry them to where orchestrator may not be installed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
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


@dataclass(frozen=True)
class Symbol:
    r"""A unit that has a symbol of its own.  latex: macro of LaTeX's siunitx, such as \metre."""

    unit: Unit
    latex: str


def _symbol(latex: str, factor: float = 1.0, offset: float = 0.0, **exponents: int) -> Symbol:
    return Symbol(Unit(tuple(exponents.get(name, 0) for name in BASE), factor, offset), latex)


# Factors: BIPM, The International System of Units, 9th edition (2019), and its Table 8 for units beside the SI.
SYMBOLS = {
    "1": _symbol(""),
    "-": _symbol(""),
    "%": _symbol(r"\percent", 0.01),
    "m": _symbol(r"\metre", m=1),
    "mm": _symbol(r"\milli\metre", 1e-3, m=1),
    "cm": _symbol(r"\centi\metre", 1e-2, m=1),
    "km": _symbol(r"\kilo\metre", 1e3, m=1),
    "s": _symbol(r"\second", s=1),
    "ms": _symbol(r"\milli\second", 1e-3, s=1),
    "min": _symbol(r"\minute", 60.0, s=1),
    "h": _symbol(r"\hour", 3600.0, s=1),
    "kg": _symbol(r"\kilogram", kg=1),
    "g": _symbol(r"\gram", 1e-3, kg=1),
    "rad": _symbol(r"\radian", rad=1),
    "deg": _symbol(r"\degree", math.pi / 180, rad=1),
    "kn": _symbol(r"\text{kn}", 1852 / 3600, m=1, s=-1),
    "rpm": _symbol(r"\text{rpm}", 2 * math.pi / 60, rad=1, s=-1),
    "Hz": _symbol(r"\hertz", s=-1),
    "N": _symbol(r"\newton", kg=1, m=1, s=-2),
    "kN": _symbol(r"\kilo\newton", 1e3, kg=1, m=1, s=-2),
    "Pa": _symbol(r"\pascal", kg=1, m=-1, s=-2),
    "bar": _symbol(r"\bar", 1e5, kg=1, m=-1, s=-2),
    "J": _symbol(r"\joule", kg=1, m=2, s=-2),
    "W": _symbol(r"\watt", kg=1, m=2, s=-3),
    "A": _symbol(r"\ampere", A=1),
    "V": _symbol(r"\volt", kg=1, m=2, s=-3, A=-1),
    "K": _symbol(r"\kelvin", K=1),
    "degC": _symbol(r"\degreeCelsius", 1.0, 273.15, K=1),
}
FACTOR = re.compile(r"([A-Za-z]+|%)(-?[1-9][0-9]?)?|[1-]")
ANGLES = {"rad": "deg", "rad/s": "deg/s", "rad/s2": "deg/s2"}  # {unit of the model: unit for people}


def factors(text: str) -> list[tuple[str, int]]:
    """[(symbol, exponent)] of an expression such as "N.s2/m".

    Factors are joined by ".", each "/" divides by the one factor behind it, a number behind a symbol is its exponent.
    Raises ValueError with the reason for anything else, and for an unknown symbol.
    """
    result = []
    for operator, factor in zip(["", *re.findall(r"[./]", text)], re.split(r"[./]", text), strict=True):
        match = FACTOR.fullmatch(factor)
        if match is None:
            raise ValueError(f"{factor!r} is not a symbol with an exponent")
        symbol, exponent = match[1] or match[0], int(match[2] or 1)
        if symbol not in SYMBOLS:
            raise ValueError(f"{symbol!r} is unknown; known: {', '.join(SYMBOLS)}")
        result.append((symbol, -exponent if operator == "/" else exponent))
    return result


def parse(text: str) -> Unit:
    """The unit that an expression such as "N.s2/m" means; see `factors`.  Raises ValueError with the reason."""
    parts = [(SYMBOLS[symbol].unit, exponent) for symbol, exponent in factors(text)]
    if len(parts) == 1 and parts[0][1] == 1:
        return parts[0][0]
    if any(unit.offset for unit, _ in parts):
        raise ValueError("a temperature with an offset cannot be part of a product")
    exponents = tuple(sum(unit.exponents[i] * n for unit, n in parts) for i in range(len(BASE)))
    return Unit(exponents, math.prod(unit.factor**n for unit, n in parts))


def defined(description: Any) -> dict[str, Unit]:
    """{name: unit} of FMPy's model description: those with a base unit."""
    result = {}
    for unit in description.unitDefinitions or ():
        base = unit.baseUnit
        if base is not None:
            exponents = tuple(int(getattr(base, name) or 0) for name in BASE)
            result[unit.name] = Unit(exponents, float(base.factor), float(base.offset))
    return result


def conversion(
    source: str, defined_there: Mapping[str, Unit], sink: str, defined_here: Mapping[str, Unit]
) -> tuple[float, float]:
    """Factor and offset that turn a value in the unit `source` into one in `sink`.

    defined_there, defined_here: what the two FMUs define; a unit that an FMU only names means what `parse` says.
    A unit that is not given fits any.  Raises ValueError, with the reason, if they measure different things, or if
    that cannot be known.
    """
    if (source == sink and defined_there.get(source) == defined_here.get(sink)) or not source or not sink:
        return 1.0, 0.0
    units = []
    for name, definitions in ((source, defined_there), (sink, defined_here)):
        try:
            units.append(definitions[name] if name in definitions else parse(name))
        except ValueError:
            if source == sink:
                return 1.0, 0.0
            raise ValueError(f"{name!r} is not defined in its FMU by SI base units") from None
    a, b = units
    if a.exponents != b.exponents:
        raise ValueError(f"one is {a}, the other {b} in SI base units")
    if a == b or (source == sink and math.isclose(a.factor, b.factor, rel_tol=1e-6) and a.offset == b.offset):
        return 1.0, 0.0
    return a.factor / b.factor, (a.offset - b.offset) / b.factor


def scale(unit: str, wanted: str, defined: Mapping[str, Unit] = MappingProxyType({})) -> float:
    """Factor from a unit to the one that is wanted; 1 where it has none, or one that does not convert.

    defined: units that the FMU defines.
    """
    try:
        return conversion(unit, defined, wanted, {})[0]
    except ValueError:
        return 1.0


def symbol(text: str, defined: Mapping[str, Unit]) -> str:
    """The name in SYMBOLS of a unit that an FMU defines under one that is not known here, as "radian"; else `text`.

    defined: units that the FMU defines.
    """
    own = defined.get(text)
    try:
        parse(text)
    except ValueError:
        names = (name for name, known in SYMBOLS.items() if own and _same(known.unit, own))
        return next(names, text)
    return text


def readable(text: str) -> tuple[str, float]:
    """The unit in which people read values of the unit `text`, and the factor to it: degrees for angles."""
    shown = ANGLES.get(text, text)
    return shown, conversion(text, {}, shown, {})[0]


def alternatives(text: str) -> list[str]:
    """Units to which a value in the unit `text` converts: itself, and one symbol of it in place of another."""
    try:
        parts = factors(text)
    except ValueError:
        return [text]
    result = [text, *(symbol for symbol, known in SYMBOLS.items() if _alike(known.unit, parse(text)))]
    for i, (own, _) in enumerate(parts):
        for symbol, known in SYMBOLS.items():
            if symbol != own and not known.unit.offset and _alike(known.unit, SYMBOLS[own].unit):
                words = re.split(r"([./])", text)
                words[2 * i] = words[2 * i].replace(own, symbol, 1)
                result.append("".join(words))
    return list(dict.fromkeys(result))


def _same(a: Unit, b: Unit) -> bool:
    return a.exponents == b.exponents and math.isclose(a.factor, b.factor, rel_tol=1e-6) and a.offset == b.offset


def _alike(a: Unit, b: Unit) -> bool:
    return a.exponents == b.exponents and not a.offset and not b.offset
