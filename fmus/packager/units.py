"""SI base exponents of a unit expression, as modelDescription.xml wants them."""

from __future__ import annotations

import re

BASES = {
    "1": {},
    "m": {"m": 1},
    "kg": {"kg": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "K": {"K": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "Hz": {"s": -1},
}
SCALED = {"deg": ("rad", 0.017453292519943295)}  # unit: (SI unit, factor)


def base_unit(unit: str) -> dict[str, float]:
    """{base: exponent, and "factor" where it is not 1} of an expression such as "N.s2/m".

    Factors are joined by ".", each "/" divides by the one factor behind it, a number behind a symbol is its exponent.
    Raises ValueError for a unit it does not know.
    """
    exponents: dict[str, float] = {}
    scale = 1.0
    for operator, factor in re.findall(r"([./]?)([^./]+)", unit):
        match = re.fullmatch(r"([A-Za-z]+|1)(-?\d+)?", factor)
        if match is None:
            raise ValueError(f"unit {unit!r}: {factor!r} is not a symbol with an exponent")
        symbol, exponent = match[1], int(match[2] or 1) * (-1 if operator == "/" else 1)
        symbol, size = SCALED.get(symbol, (symbol, 1.0))
        if symbol not in BASES:
            raise ValueError(f"unit {unit!r}: {symbol!r} is unknown; known: {', '.join([*BASES, *SCALED])}")
        scale *= size**exponent
        for base, power in BASES[symbol].items():
            exponents[base] = exponents.get(base, 0) + power * exponent
    result: dict[str, float] = {base: power for base, power in exponents.items() if power}
    return result if scale == 1.0 else {**result, "factor": scale}
