"""The vehicles of a plan as autopilots: which are shown, with which thrusters, origin, parameters and mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..errors import ExperimentError, OrchError, Problem, did_you_mean
from ..experiment.mavlink import MavlinkSpec
from ..plan.motors import steered_by
from ..plan.plan import Component, Plan
from ..simulation.initialization import initialize
from ..simulation.system import System
from ..watch import interruptible
from .protocol.links import Endpoint
from .vehicle.autopilot import Autopilot
from .vehicle.control import Control
from .vehicle.frame import DEFAULT_MAX_THRUST, ThrusterFrame, matrix_of
from .vehicle.modes import FlightMode
from .vehicle.parameters import AutopilotParameters
from .view import is_guided

ARDUPILOT = "ardupilot_json"  # a builtin


def spec_of(plan: Plan) -> MavlinkSpec:
    """The [mavlink] of a plan, with the system ids of the vehicles that are shown.

    Raises ExperimentError if no component is a vehicle.
    """
    vehicles = [component.name for component in plan.components if component.is_vehicle]
    spec = plan.experiment.mavlink_spec.showing(vehicles)
    if not spec.vehicles:
        what = "no component is a vehicle: none puts out eta.x to eta.psi and nu.u to nu.r"
        raise ExperimentError(plan.experiment.path, [Problem("mavlink", what)])
    return spec


def fleet(plan: Plan, controls: Mapping[str, Control], endpoints: Sequence[Endpoint] = ()) -> list[Autopilot]:
    """The vehicles of a plan as autopilots.

    controls: {component of a vehicle: where its steering goes}.  endpoints: those that show one vehicle only.  A
    vehicle for which ArduPilot speaks, as it flies it, is left out.  Raises OrchError if a vehicle cannot be shown as
    ArduSub, if there is none for an endpoint, or if another vehicle has ArduPilot's system id.
    """
    spec, flown = spec_of(plan), flown_by_ardupilot(plan)
    spec = replace(spec, vehicles={name: system for name, system in spec.vehicles.items() if flown.get(name) != system})
    for name, system in spec.vehicles.items():
        if system in flown.values():
            raise OrchError(
                f"mavlink.vehicles.{name}: ArduPilot, which flies another vehicle, has the system id {system}, too; "
                "each vehicle needs its own"
            )
    for endpoint in endpoints:
        if endpoint.system in flown.values():
            what = f"ArduPilot speaks for the system id {endpoint.system}; connect the station to it"
            raise OrchError(f"--mavlink {endpoint.text}: {what}")
        if endpoint.system not in spec.vehicles.values():
            known = [str(system) for system in spec.vehicles.values()]
            raise OrchError(
                f"--mavlink {endpoint.text}: no vehicle has the system id {endpoint.system}"
                f"{did_you_mean(str(endpoint.system), known, 'ids')}"
            )
    components = {component.name: component for component in plan.components}
    return [
        _autopilot(plan, components[name], system, spec, controls.get(name)) for name, system in spec.vehicles.items()
    ]


def flown_by_ardupilot(plan: Plan) -> dict[str, int]:
    """{vehicle: the MAVLink system id of the ArduPilot that flies it}.  Stations hear ArduPilot itself."""
    shown = spec_of(plan).vehicles
    flown: dict[str, int] = {}
    for component in plan.components:
        if component.live and component.fmu_name == ARDUPILOT:
            vehicle = steered_by(component, plan.components, plan.connections)
            own = int(component.parameters.get("system_id", 0))
            if vehicle and (own or vehicle.name in shown):
                flown[vehicle.name] = own or shown[vehicle.name]
    return flown


def _autopilot(plan: Plan, component: Component, system: int, spec: MavlinkSpec, control: Control | None) -> Autopilot:
    frame, max_thrust = frame_of(plan, component, spec.pwm_map)
    own = {} if max_thrust is None else {"SIM_MAX_THRUST": max_thrust}
    return Autopilot(
        system=system,
        component=component.name,
        parameters=AutopilotParameters(system, spec.rates, own),
        origin=spec.origin,
        frame=frame,
        control=control,
        mode=FlightMode.GUIDED if is_guided(plan, component.name) else FlightMode.MANUAL,
    )


def frame_of(plan: Plan, component: Component, pwm_map: str) -> tuple[ThrusterFrame | None, float | None]:
    """The vehicle's frame and the largest thrust of a thruster [N]; None for a vehicle without a thruster matrix.

    Raises OrchError if ArduSub has no such frame.
    """
    entries = {axis: v for axis, v in component.fmu.lookup("T").items() if v.kind == "real" and "," in axis}
    if not entries:
        return None, None
    thrust = component.fmu.variables.get("max_thrust")
    read = [*entries.values(), *([thrust] if thrust else [])]
    alone = replace(
        plan, components=(component,), connections=(), recorded=tuple((component.name, v) for v in read), watched=()
    )
    with interruptible() as interrupt, System.open(alone, interrupt.is_set) as system:
        initialize(system)  # a matrix that is calculated is known only then
        table = system.tables["real"].copy()
        places = {v.name: system.places[component.name, v.name] for v in read}
    if interrupt.is_set():
        raise KeyboardInterrupt
    T = matrix_of({axis: table[places[variable.name]] for axis, variable in entries.items()})
    max_thrust = float(table[places["max_thrust"]]) if thrust else DEFAULT_MAX_THRUST
    try:
        return ThrusterFrame(T, max_thrust, pwm_map), max_thrust
    except OrchError as error:
        raise OrchError(f"mavlink.vehicles.{component.name}: {error}") from None
