"""Declarations of the variables of components that run inside orch; all of them are reals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from ...fmu.variables import ANGLE, Variable
from ...names import ANGLE_AXES


def scalar(name: str, causality: str, unit: str, description: str, **more: Any) -> Variable:
    """A variable.  more: further fields of Variable.  An input without a start value starts at 0."""
    start = {"start": 0.0} if causality == "input" else {}
    fields = {"name": name, "causality": causality, "unit": unit, "description": description}
    return Variable(reference=0, type="Real", kind="real", **(start | fields | more))


def vector(name: str, causality: str, units: Mapping[str, str], description: str, **more: Any) -> list[Variable]:
    """A variable for each axis.  units: {axis: unit}."""
    return [
        scalar(
            f"{name}.{axis}",
            causality,
            unit,
            description,
            quantity=ANGLE if axis in ANGLE_AXES and unit == "rad" else "",
            **more,
        )
        for axis, unit in units.items()
    ]


def numbered(variables: Iterable[Variable]) -> tuple[Variable, ...]:
    """The variables of a component, in order: references count from 0."""
    return tuple(replace(variable, reference=reference) for reference, variable in enumerate(variables))
