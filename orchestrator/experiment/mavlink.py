"""[mavlink]: which components ground stations see as vehicles, where they are on Earth, and what PWM means.

`orchestrator.mavlink` shows them.  Whether a component is a vehicle depends on its FMU: `plan.resolve` checks that.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeGuard

from ..errors import Problem, did_you_mean

KEYS = ("vehicles", "origin", "pwm_map", "rates")
PWM_MAPS = ("linear", "t200_16V")
STREAMS = {  # Hz; ArduSub's defaults, libraries/GCS_MAVLink/GCS_MAVLink_Parameters.cpp
    "RAW_SENS": 2.0,
    "EXT_STAT": 2.0,
    "RC_CHAN": 2.0,
    "POSITION": 3.0,
    "EXTRA1": 10.0,
    "EXTRA2": 10.0,
    "EXTRA3": 3.0,
}
FASTEST_STREAM = 50.0  # Hz
ORIGIN = (44.65, -124.05)  # degrees; off Newport, Oregon
LARGEST_SYSTEM_ID = 250  # ground stations use those above
LIMITS = {"lat": 89.0, "lon": 180.0}  # degrees


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
    problems = _unknown("mavlink", table, KEYS)
    vehicles = _table("vehicles", table, problems)
    problems += _problems_of_vehicles(vehicles, components)
    origin = _table("origin", table, problems)
    if "origin" in table:
        problems += _problems_of_origin(origin)
    pwm_map = table.get("pwm_map", PWM_MAPS[0])
    if pwm_map not in PWM_MAPS:
        problems.append(Problem("mavlink.pwm_map", f"no {pwm_map!r}{did_you_mean(str(pwm_map), PWM_MAPS)}"))
    rates = _table("rates", table, problems)
    problems += _problems_of_rates(rates)
    if problems:
        return MavlinkSpec(vehicles=vehicles), problems
    spec = MavlinkSpec(
        vehicles=vehicles,
        origin=(float(origin["lat"]), float(origin["lon"])) if origin else ORIGIN,
        pwm_map=pwm_map,
        rates=STREAMS | {stream: float(rate) for stream, rate in rates.items()},
    )
    return spec, []


def _problems_of_vehicles(vehicles: Mapping[str, Any], components: Collection[str]) -> list[Problem]:
    problems = []
    owners: dict[int, str] = {}
    for name, system in vehicles.items():
        key = f"mavlink.vehicles.{name}"
        if name not in components:
            problems.append(Problem(key, f"no component {name!r}{did_you_mean(name, components, 'components')}"))
        if not isinstance(system, int) or isinstance(system, bool) or not 1 <= system <= LARGEST_SYSTEM_ID:
            what = f"is {system!r}; a system id is a whole number from 1 to {LARGEST_SYSTEM_ID}"
            problems.append(Problem(key, what))
        elif owners.setdefault(system, name) != name:
            what = f"{owners[system]!r} has the system id {system} already; each vehicle needs its own"
            problems.append(Problem(key, what))
    return problems


def _problems_of_origin(origin: Mapping[str, Any]) -> list[Problem]:
    problems = _unknown("mavlink.origin", origin, LIMITS)
    for name, limit in LIMITS.items():
        value = origin.get(name)
        if not _is_number(value) or abs(value) > limit:
            what = f"is {value!r}; give degrees from -{limit:g} to {limit:g}"
            problems.append(Problem(f"mavlink.origin.{name}", what))
    return problems


def _problems_of_rates(rates: Mapping[str, Any]) -> list[Problem]:
    problems = _unknown("mavlink.rates", rates, STREAMS)
    for name, rate in rates.items():
        if not _is_number(rate) or not 0 <= rate <= FASTEST_STREAM:
            problems.append(Problem(f"mavlink.rates.{name}", f"is {rate!r}; give 0 to {FASTEST_STREAM:g} Hz"))
    return problems


def _unknown(key: str, table: Iterable[str], names: Collection[str]) -> list[Problem]:
    return [Problem(f"{key}.{name}", f"unknown key{did_you_mean(name, names)}") for name in table if name not in names]


def _table(key: str, parent: Mapping[str, Any], problems: list[Problem]) -> Mapping[str, Any]:
    value = parent.get(key, {})
    if isinstance(value, Mapping):
        return value
    problems.append(Problem(f"mavlink.{key}", f"is {value!r}, not a table"))
    return {}


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
