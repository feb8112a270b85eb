"""What the components that steer a vehicle need to know about it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..errors import OrchError
from ..plan.motors import PILOT, motors_of, steered_by
from ..plan.plan import Component, Plan
from .components.manual import control_of
from .fleet import ARDUPILOT, flown_by_ardupilot, frame_of, spec_of
from .vehicle.control import Control
from .vehicle.frame import ThrusterFrame


def context_of(plan: Plan) -> dict[str, dict[str, Any]]:
    """{component: its context}: of `mavlink_manual` a Control, of `mavlink_motors` and `ardupilot_json` a frame.

    Raises OrchError if ArduSub has no frame with the thrusters of a vehicle that it flies, or a component is to start
    in a mode that the vehicle cannot enter.
    """
    context: dict[str, dict[str, Any]] = {}
    for component in plan.components:
        vehicle = vehicle_of(plan, component)
        if _is(component, PILOT):
            motors = motors_of(component, plan.components, plan.connections)
            frame = _frame_if_any(plan, vehicle) if vehicle and motors else None
            control = control_of(component.parameters, stops=motors is not None, mixes=frame is not None)
            if reason := control.refusal(control.mode):
                key = f"components.{component.name}.parameters.start_disarmed"
                raise OrchError(f"{key}: {vehicle.name if vehicle else 'nothing'} cannot be in mode MANUAL: {reason}")
            context[component.name] = {"control": control}
            if motors:
                context[motors.name] = {"frame": frame}
        elif _is(component, ARDUPILOT) and vehicle:
            frame, _ = frame_of(plan, vehicle, plan.experiment.mavlink_spec.pwm_map)
            context[component.name] = {"frame": frame}
    return context


def _frame_if_any(plan: Plan, vehicle: Component) -> ThrusterFrame | None:
    """The frame of a vehicle; None if it is none of ArduSub's."""
    try:
        return frame_of(plan, vehicle, plan.experiment.mavlink_spec.pwm_map)[0]
    except OrchError:
        return None


def controls_of(plan: Plan, context: Mapping[str, Mapping[str, Any]]) -> dict[str, Control]:
    """{component of a vehicle: where its steering goes}."""
    return {
        vehicle.name: context[component.name]["control"]
        for component in plan.components
        if "control" in context.get(component.name, {}) and (vehicle := vehicle_of(plan, component))
    }


def unheard(plan: Plan) -> list[str]:
    """Notes on components that nobody can steer, for a run without --mavlink."""
    names = [component.name for component in plan.components if _is(component, PILOT)]
    return [f"nobody steers {name!r}: give --mavlink ENDPOINT" for name in names]


def speaking_themselves(plan: Plan) -> list[str]:
    """Notes on vehicles that the bridge does not show, for ArduPilot speaks for them."""
    shown = spec_of(plan).vehicles
    return [
        f"{vehicle} is not shown: ArduPilot, which flies it, speaks for system id {system}; connect stations to it"
        for vehicle, system in flown_by_ardupilot(plan).items()
        if shown.get(vehicle) == system
    ]


def vehicle_of(plan: Plan, component: Component) -> Component | None:
    """The vehicle whose `eta` a component takes."""
    return steered_by(component, plan.components, plan.connections)


def _is(component: Component, builtin: str) -> bool:
    return component.live and component.fmu_name == builtin
