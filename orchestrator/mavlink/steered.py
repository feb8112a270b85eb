"""Which vehicle a component steers, and what it needs to know about it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..plan.plan import Component, Plan
from .fleet import frame_of
from .vehicle.control import Control

MANUAL, ARDUPILOT = "mavlink_manual", "ardupilot_json"


def context_of(plan: Plan) -> dict[str, dict[str, Any]]:
    """{component: its context}: of `mavlink_manual` a Control, of `ardupilot_json` the vehicle's frame.

    Raises OrchError if ArduSub has no frame with the vehicle's thrusters.
    """
    context: dict[str, dict[str, Any]] = {}
    for component in plan.components:
        if _is(component, MANUAL):
            context[component.name] = {"control": Control()}
        elif _is(component, ARDUPILOT) and (vehicle := vehicle_of(plan, component)):
            frame, _ = frame_of(plan, vehicle, plan.experiment.mavlink_spec.pwm_map)
            context[component.name] = {"frame": frame}
    return context


def controls_of(plan: Plan, context: Mapping[str, Mapping[str, Any]]) -> dict[str, Control]:
    """{component of a vehicle: where its steering goes}."""
    return {
        vehicle.name: context[component.name]["control"]
        for component in plan.components
        if "control" in context.get(component.name, {}) and (vehicle := vehicle_of(plan, component))
    }


def unheard(plan: Plan) -> list[str]:
    """Notes on components that nobody can steer, for a run without --mavlink."""
    names = [component.name for component in plan.components if _is(component, MANUAL)]
    return [f"nobody steers {name!r}: give --mavlink ENDPOINT" for name in names]


def vehicle_of(plan: Plan, component: Component) -> Component | None:
    """The vehicle whose `eta` a component takes."""
    sources = {c.source for c in plan.connections if c.sink == component.name and c.input.name.startswith("eta.")}
    return next((other for other in plan.components if other.name in sources and other.is_vehicle), None)


def _is(component: Component, builtin: str) -> bool:
    return component.live and component.fmu_name == builtin
