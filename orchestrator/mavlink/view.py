"""How the bridge looks at the vehicles of a run: which values, where they lie, and when."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ExperimentError, OrchError, Problem, did_you_mean
from ..experiment import mavlink
from ..experiment.mavlink import MavlinkSpec
from ..fmu.variables import Variable
from ..names import ETA_AXES, NU_AXES, split_axis
from ..plan.plan import Component, Plan
from ..simulation.initialization import initialize
from ..simulation.observer import SystemView
from ..simulation.system import System
from .protocol.links import Endpoint
from .vehicle.autopilot import MODES, Autopilot
from .vehicle.control import Control
from .vehicle.frame import Frame
from .vehicle.parameters import Parameters
from .vehicle.sample import Sample, gravity_alone

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

FORCE = ("x", "y", "z")
PATIENCE = 4  # times as long as wanted may pass between two samples at whole milliseconds

Signal = tuple[str, Variable]


@dataclass
class _Vector:
    """Where a vector comes from: signals of components, each by its factor and offset, or values that stand still."""

    signals: list[Signal] = field(default_factory=list)
    scaling: list[tuple[float, float]] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    places: Array | None = None

    def read(self, table: Array) -> Array:
        if self.places is None:
            return np.array(self.values)
        found: Array = table[self.places]
        if not self.scaling:
            return found
        factors, offsets = np.array(self.scaling).T
        scaled: Array = factors * found + offsets
        return scaled


class View:
    """Samples of the vehicles, at whole milliseconds where the communication step allows it, for that is how MAVLink
    counts."""

    def __init__(self, plan: Plan, autopilots: Sequence[Autopilot], due: Callable[[int], float]):
        """due: when it is time for a tick (monotonic) [s]: a paced run may be ahead."""
        self._due = due
        self._autopilots, self._grid, self._steps = autopilots, plan.experiment.grid, plan.steps
        self._beat = (Fraction(repr(plan.experiment.master.step)) * 1000).denominator  # ticks
        self._looked = 0
        self._vectors = {a.system: _vectors(plan, a.component) for a in autopilots}

    def watched(self, plan: Plan) -> Plan:
        """The plan whose system has a place for every value that is looked at."""
        signals = [s for vectors in self._vectors.values() for vector in vectors.values() for s in vector.signals]
        return replace(plan, watched=(*plan.watched, *signals))

    def opened(self, view: SystemView) -> None:
        self._table = view.tables["real"]
        for vectors in self._vectors.values():
            for vector in vectors.values():
                if vector.signals:
                    places = [view.places[component, variable.name] for component, variable in vector.signals]
                    vector.places = np.array(places, dtype=np.intp)

    def limit(self, tick: int, last: int) -> int:
        whole = last - last % self._beat
        return whole if whole > tick else last

    def look(self, tick: int) -> None:
        """Put a sample of each vehicle where the bridge's thread finds it."""
        if tick % self._beat and tick < self._steps and tick - self._looked < PATIENCE * self._beat:
            return
        self._looked = tick
        t = self._grid.time(tick)
        for autopilot in self._autopilots:
            values = {name: vector.read(self._table) for name, vector in self._vectors[autopilot.system].items()}
            if not len(values["specific_force"]):
                values["specific_force"] = gravity_alone(values["eta"])
            autopilot.show(Sample(t, origin=autopilot.origin, **values), self._due(tick))


def spec_of(plan: Plan) -> MavlinkSpec:
    """The [mavlink] of a plan, with the system ids of the vehicles that are shown.

    Raises ExperimentError where no component is a vehicle.
    """
    spec, _ = mavlink.read(plan.experiment.mavlink, [component.name for component in plan.components])
    spec = spec.showing(component.name for component in plan.components if component.is_vehicle)
    if not spec.vehicles:
        what = "no component is a vehicle: none puts out eta.x to eta.psi and nu.u to nu.r"
        raise ExperimentError(plan.experiment.path, [Problem("mavlink", what)])
    return spec


def fleet(plan: Plan, controls: Mapping[str, Control], endpoints: Sequence[Endpoint] = ()) -> list[Autopilot]:
    """The vehicles of a plan as autopilots.

    endpoints: those for one vehicle.  Raises OrchError where a vehicle cannot be shown as ArduSub, or an endpoint is
    for none.
    """
    spec = spec_of(plan)
    for endpoint in endpoints:
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


def _autopilot(plan: Plan, component: Component, system: int, spec: MavlinkSpec, control: Control | None) -> Autopilot:
    frame, max_thrust = frame_of(plan, component, spec.pwm_map)
    own = {} if max_thrust is None else {"SIM_MAX_THRUST": max_thrust}
    guided = bool(_vectors(plan, component.name)["eta_d"].signals)
    autopilot = Autopilot(
        system,
        component.name,
        Parameters(system, spec.rates, own),
        spec.origin,
        frame,
        control,
        mode=MODES["POSHOLD" if control else "GUIDED" if guided else "MANUAL"],
    )
    if control:
        control.armed, control.guided = autopilot.armed, False
    return autopilot


def frame_of(plan: Plan, component: Component, pwm_map: str) -> tuple[Frame | None, float | None]:
    """The vehicle's frame, None where it says nothing of its thrusters, and the thrust of one [N]."""
    matrix = {axis: v for axis, v in component.fmu.lookup("T").items() if v.kind == "real" and "," in axis}
    if not matrix:
        return None, None
    thrust = component.fmu.variables.get("max_thrust")
    read = [*matrix.values(), *([thrust] if thrust else [])]
    alone = replace(
        plan, components=(component,), connections=(), recorded=tuple((component.name, v) for v in read), watched=()
    )
    with System.open(alone) as system:
        initialize(system)  # a matrix that is calculated is known only then
        table = system.tables["real"].copy()
        places = {v.name: system.places[component.name, v.name] for v in read}
    rows, columns = np.array([[int(i) for i in axis.split(",")] for axis in matrix]).max(axis=0)
    T = np.zeros((rows, columns))
    for axis, variable in matrix.items():
        i, j = map(int, axis.split(","))
        T[i - 1, j - 1] = table[places[variable.name]]
    max_thrust = float(table[places["max_thrust"]]) if thrust else 40.0
    try:
        return Frame(T, max_thrust, pwm_map), max_thrust
    except OrchError as error:
        raise OrchError(f"mavlink.vehicles.{component.name}: {error}") from None


def _vectors(plan: Plan, vehicle: str) -> dict[str, _Vector]:
    component = next(component for component in plan.components if component.name == vehicle)
    commands = [v for v in component.fmu.lookup("u").values() if v.causality == "input" and v.kind == "real"]
    guide = _guide(plan, vehicle)
    return {
        "eta": _outputs(component, "eta", ETA_AXES),
        "nu": _outputs(component, "nu", NU_AXES),
        "specific_force": _outputs(component, "specific_force", FORCE),
        "u": _arriving(plan, component, commands),
        "eta_d": _arriving(plan, guide, [guide.fmu.variables[f"eta_d.{axis}"] for axis in ETA_AXES])
        if guide
        else _Vector(values=[np.nan] * 6),
    }


def _outputs(component: Component, vector: str, axes: Sequence[str]) -> _Vector:
    if not component.puts_out(vector, axes):
        return _Vector()
    variables = component.fmu.lookup(vector)
    return _Vector([(component.name, variables[axis]) for axis in axes])


def _arriving(plan: Plan, component: Component, inputs: Sequence[Variable]) -> _Vector:
    """What drives some inputs of a component: outputs of others, or its start values."""
    connections = {
        connection.input.name: connection for connection in plan.connections if connection.sink == component.name
    }
    if inputs and all(v.name in connections and connections[v.name].output.kind == "real" for v in inputs):
        found = [connections[v.name] for v in inputs]
        scaling = (
            []
            if all(connection.direct for connection in found)
            else [(connection.factor, connection.offset) for connection in found]
        )
        return _Vector([(connection.source, connection.output) for connection in found], scaling)
    return _Vector(values=[float(component.start.get(v.name, v.initial)) for v in inputs])


def _guide(plan: Plan, vehicle: str) -> Component | None:
    """The nearest component upstream of a vehicle that is given an `eta_d`; not through other vehicles."""
    components = {component.name: component for component in plan.components}
    others = {
        component.name
        for component in plan.components
        if "eta" in {split_axis(n)[0] for n in _names_of_outputs(component)}
    }
    seen, queue = {vehicle, *others}, deque([vehicle])
    while queue:
        name = queue.popleft()
        for source in dict.fromkeys(connection.source for connection in plan.connections if connection.sink == name):
            eta_d = components[source].fmu.lookup("eta_d")
            if set(ETA_AXES) <= set(eta_d) and all(v.causality == "input" for v in eta_d.values()):
                return components[source]
            if source not in seen:
                seen.add(source)
                queue.append(source)
    return None


def _names_of_outputs(component: Component) -> list[str]:
    return [v.name for v in component.fmu.variables.values() if v.causality == "output"]
