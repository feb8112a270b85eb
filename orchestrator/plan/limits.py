"""What of a plan is watched in every step: limits that FMUs declare by min and max, and references, which may jump.

An output is watched against its own limits and those of the inputs that it drives, converted to its unit; start values
and parameters are looked at by the plan.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from ..fmu.units import conversion
from ..fmu.variables import NUMBERS
from .plan import Connection, Plan

BEYOND = 1e-9  # of a limit: less is rounding


@dataclass(frozen=True)
class Limit:
    """A variable that declares limits, and the output that gives it its value: variable = factor * output + offset."""

    output: tuple[str, str]
    kind: str
    variable: str
    unit: str
    bounds: tuple[float, float]
    factor: float = 1.0
    offset: float = 0.0

    @property
    def range(self) -> tuple[float, float]:
        """The least and the largest value of the output, wider by what is rounding."""
        margins = [BEYOND * abs(bound) if math.isfinite(bound) else 0.0 for bound in self.bounds]
        low, high = self.bounds[0] - margins[0], self.bounds[1] + margins[1]
        if self.factor == 0.0:  # the input is constant
            return (-math.inf, math.inf) if low <= self.offset <= high else (math.inf, -math.inf)
        ends = (low - self.offset) / self.factor, (high - self.offset) / self.factor
        return min(ends), max(ends)


@dataclass(frozen=True)
class Reference:
    """A real output that is an angle and no vehicle's: half a turn in its unit."""

    output: tuple[str, str]
    unit: str
    turn: float


def limits_of(plan: Plan) -> Iterator[Limit]:
    """Limits of what is connected, recorded or measured; those that say the same of one output are one."""
    outputs = {(k.source, k.output.name): k.output for k in plan.connections} | {
        (component, v.name): v for component, v in (*plan.recorded, *plan.measured) if v.causality != "input"
    }
    driven: dict[tuple[str, str], list[Connection]] = {}
    for connection in plan.connections:
        driven.setdefault((connection.source, connection.output.name), []).append(connection)
    for output, v in outputs.items():
        if v.kind not in NUMBERS:
            continue
        limits = [Limit(output, v.kind, ".".join(output), v.unit, v.limits)]
        limits += [
            Limit(output, v.kind, f"{k.sink}.{k.input.name}", k.input.unit, k.input.limits, k.factor, k.offset)
            for k in driven.get(output, ())
        ]
        ranges = {limit.range: limit for limit in reversed(limits)}
        ranges.pop((-math.inf, math.inf), None)
        yield from reversed(ranges.values())


def references_of(plan: Plan) -> Iterator[Reference]:
    """Outputs that drive an input, are angles by what one of both declares, and are no vehicle's."""
    components = {component.name: component for component in plan.components}
    ends = {(k.source, k.output.name): k for k in plan.connections if k.output.is_angle or k.input.is_angle}
    for output, k in ends.items():
        source = components[k.source]
        if source.is_vehicle or k.output.kind != "real":
            continue
        unit = k.output.unit if k.output.is_angle else k.input.unit
        units = source.fmu.units if k.output.is_angle else components[k.sink].fmu.units
        try:
            turn = math.pi * conversion("rad", {}, unit, units)[0]
        except ValueError:  # a unit of its own
            continue
        if not k.output.is_angle:
            turn = turn / abs(k.factor) if k.factor else math.inf
        yield Reference(output, k.output.unit or unit, turn)
