"""The [mavlink] table of an experiment: which components are vehicles, where they are on Earth, what PWM means."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..errors import ExperimentError, Problem, did_you_mean
from ..plan.plan import Component, Plan
from .vehicle.frame import PWM_MAPS

BODY = ("u", "v", "w", "p", "q", "r")
AXES = ("x", "y", "z", "phi", "theta", "psi")
KEYS = ("vehicles", "origin", "pwm_map", "rates")
STREAMS = {
    "RAW_SENS": 2.0,
    "EXT_STAT": 2.0,
    "RC_CHAN": 2.0,
    "POSITION": 3.0,
    "EXTRA1": 10.0,
    "EXTRA2": 10.0,
    "EXTRA3": 3.0,
}  # Hz; ArduSub's own, GCS_MAVLink_Parameters.cpp
ORIGIN = (44.65, -124.05)  # degrees; off Newport, Oregon
LAST_SYSTEM = 250  # those above are ground stations'


@dataclass(frozen=True)
class Settings:
    """vehicles: {component: system id}; origin: latitude, longitude of NED (0, 0, 0) [degrees]; rates: {stream: Hz}."""

    vehicles: Mapping[str, int]
    origin: tuple[float, float] = ORIGIN
    pwm_map: str = "linear"
    rates: Mapping[str, float] = field(default_factory=lambda: dict(STREAMS))


def vehicles_of(components: Iterable[Component]) -> list[str]:
    """The components that put out a whole `eta` and `nu`, in their order."""
    return [
        component.name
        for component in components
        if _puts_out(component, "eta", AXES) and _puts_out(component, "nu", BODY)
    ]


def _puts_out(component: Component, vector: str, axes: tuple[str, ...]) -> bool:
    found = component.fmu.lookup(vector)
    return all(axis in found and found[axis].causality == "output" and found[axis].kind == "real" for axis in axes)


def problems(table: Mapping[str, Any], components: Iterable[str], vehicles: Iterable[str]) -> list[Problem]:
    """What does not fit in the table.  vehicles: the components that are some."""
    checker = _Checker()
    checker.check(table, list(components), list(vehicles))
    return checker.problems


def settings_of(plan: Plan) -> Settings:
    """The settings of a plan.  Raises ExperimentError with every problem, or where it has no vehicle."""
    table, vehicles = plan.experiment.mavlink, vehicles_of(plan.components)
    found = problems(table, [component.name for component in plan.components], vehicles)
    if not found and not vehicles:
        found = [Problem("mavlink", "no component is a vehicle: none puts out eta.x to eta.psi and nu.u to nu.r")]
    if found:
        raise ExperimentError(plan.experiment.path, found)
    return settings_from(table, vehicles)


def settings_from(table: Mapping[str, Any], vehicles: Iterable[str]) -> Settings:
    """Of a table without problems.  vehicles: those of the experiment, where the table names none."""
    chosen = dict(table.get("vehicles", {})) or {name: i for i, name in enumerate(vehicles, 1)}
    origin = table.get("origin", dict(zip(("lat", "lon"), ORIGIN, strict=True)))
    return Settings(
        chosen,
        (float(origin["lat"]), float(origin["lon"])),
        table.get("pwm_map", "linear"),
        STREAMS | {name: float(rate) for name, rate in table.get("rates", {}).items()},
    )


class _Checker:
    def __init__(self) -> None:
        self.problems: list[Problem] = []

    def problem(self, key: str, sentence: str) -> None:
        self.problems.append(Problem(key, sentence))

    def check(self, table: Mapping[str, Any], components: list[str], vehicles: list[str]) -> None:
        self.known(table, KEYS, "mavlink")
        self.systems(self.table(table, "vehicles"), components, vehicles)
        if "origin" in table:
            self.origin(self.table(table, "origin"))
        pwm_map = table.get("pwm_map", PWM_MAPS[0])
        if pwm_map not in PWM_MAPS:
            self.problem("mavlink.pwm_map", f"no {pwm_map!r}{did_you_mean(str(pwm_map), PWM_MAPS)}")
        rates = self.table(table, "rates")
        self.known(rates, tuple(STREAMS), "mavlink.rates")
        for name, rate in rates.items():
            if not _is_number(rate) or not 0 <= rate <= 50:
                self.problem(f"mavlink.rates.{name}", f"is {rate!r}; give 0 to 50 Hz")

    def systems(self, table: Mapping[str, Any], components: list[str], vehicles: list[str]) -> None:
        owners: dict[int, str] = {}
        for name, system in table.items():
            key = f"mavlink.vehicles.{name}"
            if name not in components:
                self.problem(key, f"no component {name!r}{did_you_mean(name, vehicles, 'vehicles')}")
            elif name not in vehicles:
                near = did_you_mean(name, vehicles, "vehicles")
                self.problem(key, f"{name!r} is no vehicle: it does not put out eta and nu{near}")
            if not isinstance(system, int) or isinstance(system, bool) or not 1 <= system <= LAST_SYSTEM:
                self.problem(key, f"is {system!r}; a system id is a whole number from 1 to {LAST_SYSTEM}")
            elif owners.setdefault(system, name) != name:
                self.problem(key, f"{owners[system]!r} has the system id {system} already; each vehicle needs its own")

    def origin(self, table: Mapping[str, Any]) -> None:
        self.known(table, ("lat", "lon"), "mavlink.origin")
        for name, limit in (("lat", 89.0), ("lon", 180.0)):
            value = table.get(name)
            if not _is_number(value) or abs(float(value or 0)) > limit:
                self.problem(f"mavlink.origin.{name}", f"is {value!r}; give degrees from -{limit:g} to {limit:g}")

    def table(self, parent: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        value = parent.get(key, {})
        if isinstance(value, Mapping):
            return value
        self.problem(f"mavlink.{key}", f"is {value!r}, not a table")
        return {}

    def known(self, table: Iterable[str], names: tuple[str, ...], path: str) -> None:
        for key in table:
            if key not in names:
                self.problem(f"{path}.{key}", f"unknown key{did_you_mean(key, names)}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
