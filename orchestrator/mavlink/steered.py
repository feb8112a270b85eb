"""Which vehicle a component steers, and what it needs to know of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..experiment import mavlink
from ..plan.plan import Component, Plan
from .vehicle.control import Control
from .view import frame_of

MANUAL, ARDUPILOT = "mavlink_manual", "ardupilot_json"


def context_of(plan: Plan) -> dict[str, dict[str, Any]]:
    """{component: its context}: of `mavlink_manual` a Control, of `ardupilot_json` the vehicle's frame.

    Raises OrchError where the vehicle's thrusters are none that ArduSub knows.
    """
    found: dict[str, dict[str, Any]] = {}
    spec, _ = mavlink.read(plan.experiment.mavlink, [component.name for component in plan.components])
    for component in plan.components:
        if component.live and component.fmu_name == MANUAL:
            found[component.name] = {"control": Control()}
        elif component.live and component.fmu_name == ARDUPILOT and (vehicle := vehicle_of(plan, component)):
            frame, _ = frame_of(plan, vehicle, spec.pwm_map)
            found[component.name] = {"frame": frame}
    return found


def controls_of(plan: Plan, context: Mapping[str, Mapping[str, Any]]) -> dict[str, Control]:
    """{vehicle: where its steering goes}."""
    components = {component.name: component for component in plan.components}
    found = {}
    for name, its in context.items():
        if "control" in its and (vehicle := vehicle_of(plan, components[name])):
            found[vehicle.name] = its["control"]
    return found


def unheard(plan: Plan) -> list[str]:
    """What to say of components that nobody can steer, in a run without --mavlink."""
    names = [component.name for component in plan.components if component.live and component.fmu_name == MANUAL]
    return [f"nobody steers {name!r}: give --mavlink ENDPOINT" for name in names]


def vehicle_of(plan: Plan, component: Component) -> Component | None:
    """The vehicle whose `eta` a component is given."""
    sources = [
        connection.source
        for connection in plan.connections
        if connection.sink == component.name and connection.input.name.startswith("eta.")
    ]
    return next((other for other in plan.components if other.name in sources and other.is_vehicle), None)
