"""[mavlink]: which components ground stations see as vehicles, where they are on Earth, and what PWM means.

`orchestrator.mavlink` shows them.  Whether a component is a vehicle depends on its FMU: `plan.resolve` checks that.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ..errors import Problem, did_you_mean
from .schema.sections import MAVLINK, PWM_MAPS, RATES, STREAMS, SYSTEM_ID
from .schema.sections import ORIGIN as ORIGIN_KEYS

ORIGIN = (44.65, -124.05)  # degrees; off Newport, Oregon


@dataclass(frozen=True, kw_only=True)
class MavlinkSpec:
    """A [mavlink] that was read.

    vehicles: {component: MAVLink system id}; empty: every vehicle.  origin: latitude and longitude of NED (0, 0, 0)
    [degrees].  pwm_map: one of PWM_MAPS.  rates: {ArduPilot's stream: Hz}.
    """

    vehicles: Mapping[str, int] = field(default_factory=dict)
    origin: tuple[float, float] = ORIGIN
    pwm_map: str = PWM_MAPS[0]
    rates: Mapping[str, float] = field(default_factory=lambda: dict(STREAMS))

    def showing(self, vehicles: Iterable[str]) -> MavlinkSpec:
        """With system ids 1, 2, ... for the vehicles of the experiment, where the file names none."""
        return self if self.vehicles else replace(self, vehicles={name: i for i, name in enumerate(vehicles, 1)})


def read(table: Mapping[str, Any], components: Collection[str]) -> tuple[MavlinkSpec, list[Problem]]:
    """What a table [mavlink] says, and everything that is wrong with it.

    components: all of the experiment.  The specification is complete only where there are no problems.
    """
    values, problems = MAVLINK.read(table, "mavlink")
    vehicles, origin = values.get("vehicles", {}), dict(zip(("lat", "lon"), ORIGIN, strict=True))
    problems += _problems_of_vehicles(vehicles, components)
    if "origin" in values:
        origin, unfit = ORIGIN_KEYS.read(values["origin"], "mavlink.origin")
        problems += unfit
    rates, unfit = RATES.read(values.get("rates", {}), "mavlink.rates")
    problems += unfit
    if problems:
        return MavlinkSpec(vehicles=vehicles), problems
    spec = MavlinkSpec(vehicles=vehicles, origin=(origin["lat"], origin["lon"]), pwm_map=values["pwm_map"], rates=rates)
    return spec, []


def _problems_of_vehicles(vehicles: Mapping[str, Any], components: Collection[str]) -> list[Problem]:
    problems = []
    owners: dict[int, str] = {}
    for name, system in vehicles.items():
        key = f"mavlink.vehicles.{name}"
        if name not in components:
            problems.append(Problem(key, f"no component {name!r}{did_you_mean(name, components, 'components')}"))
        if sentence := SYSTEM_ID.problem(system):
            problems.append(Problem(key, sentence))
        elif owners.setdefault(system, name) != name:
            words = f"{owners[system]!r} has the system id {system} already; each vehicle needs its own"
            problems.append(Problem(key, words))
    return problems
