"""Values of an experiment file assigned to FMI variables: scalars, lists, tables of axes, nested lists."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import did_you_mean
from .fmu import Fmu
from .variables import DTYPES, FLOATS, TRUTHS, WHOLE, Variable


def flatten(
    fmu: Fmu, causalities: tuple[str, ...], table: Mapping[str, Any]
) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """{FMI variable: value} of a table such as { t_b = 6.0, K_p = { x = 100.0 }, "K_i.z" = 0.5 }.

    An axis given by itself takes precedence over its vector.  Returns the values, and problems as (key, message).
    """
    values: dict[str, Any] = {}
    causality = causalities[0]
    problems: list[tuple[str, str]] = []
    for name, value in sorted(table.items(), key=lambda item: item[0] in fmu.variables):
        variables = fmu.lookup(name)
        if not variables:
            problems.append((name, f"no {causality} {name!r}{did_you_mean(name, fmu.names(causality), 'it has')}"))
        elif any(v.causality not in causalities or v.fixed for v in variables.values()):
            problems.append((name, f"is {_what(next(iter(variables.values())))}, not {_a(causality)}"))
        else:
            try:
                values |= {v.name: _typed(v, value) for v, value in _spread(name, variables, value)}
            except ValueError as error:
                problems.append((name, str(error)))
    return values, problems


def _what(variable: Variable) -> str:
    return "a constant" if variable.fixed else _a(variable.causality)


def _a(causality: str) -> str:
    return f"{'an' if causality[0] in 'aeiou' else 'a'} {causality}"


def _spread(name: str, variables: Mapping[str, Variable], value: Any) -> list[tuple[Variable, Any]]:
    """Each variable with its part of the value.  Raises ValueError if the shapes differ."""
    if "" in variables:
        return [(variables[""], value)]
    if isinstance(value, Mapping):
        unknown = [axis for axis in value if axis not in variables]
        if unknown:
            raise ValueError(f"no axis {unknown[0]!r}{did_you_mean(unknown[0], variables, 'it has')}")
        return [(variables[axis], part) for axis, part in value.items()]
    axes = list(variables)
    if not isinstance(value, list):
        raise ValueError(f"is a vector ({' '.join(axes)}), not {value!r}; give {len(axes)} values, or a table of axes")
    if all("," in axis for axis in axes):
        return _matrix(variables, value)
    if len(value) != len(axes):
        raise ValueError(f"has {len(value)} values for {len(axes)} axes ({' '.join(axes)})")
    return [(variables[axis], part) for axis, part in zip(axes, value, strict=True)]


def _matrix(variables: Mapping[str, Variable], rows: list[Any]) -> list[tuple[Variable, Any]]:
    cells = {
        f"{i},{j}": cell
        for i, row in enumerate(rows, 1)
        for j, cell in enumerate(row if isinstance(row, list) else [row], 1)
    }
    if set(cells) != set(variables):
        raise ValueError(f"is a matrix up to [{max(variables)}]; give a list of rows")
    return [(variables[axis], cell) for axis, cell in cells.items()]


def _typed(variable: Variable, value: Any) -> Any:
    """The value as the variable's FMI type.  Raises ValueError if it is not of that type."""
    kind, what = variable.kind, f"{variable.name} is {variable.type}, not {value!r}"
    if kind in TRUTHS and isinstance(value, bool):
        return value
    if kind == "string" and isinstance(value, str) and "\0" not in value:
        return value
    if kind == "binary" and isinstance(value, str):
        try:
            return bytes.fromhex(value).hex()  # what JSON can hold
        except ValueError:
            raise ValueError(f"{variable.name} is Binary; give its bytes as hexadecimal digits") from None
    if variable.type == "Enumeration" and isinstance(value, str):
        items = dict(variable.items)
        if value not in items:
            raise ValueError(f"{variable.name}: no item {value!r}{did_you_mean(value, items)}")
        return items[value]
    if isinstance(value, bool):
        raise ValueError(what)
    if variable.items and isinstance(value, int) and value not in (number for _, number in variable.items):
        known = ", ".join(f"{name} = {number}" for name, number in variable.items)
        raise ValueError(f"{variable.name}: no item {value}; it has {known}")
    if kind in FLOATS and isinstance(value, (int, float)):
        if not math.isfinite(value):
            raise ValueError(f"{variable.name} is {value}; give a finite number")
        if abs(value) > np.finfo(DTYPES[kind]).max:
            raise ValueError(f"{variable.name} = {value} does not fit {variable.type}")
        return float(value)
    if kind in WHOLE and isinstance(value, int):
        limits = np.iinfo(DTYPES[kind])
        if not limits.min <= value <= limits.max:
            raise ValueError(f"{variable.name} = {value} does not fit {limits.bits} bits ({variable.type})")
        return value
    raise ValueError(what)
