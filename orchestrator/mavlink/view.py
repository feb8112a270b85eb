"""What the bridge sees of the vehicles of a run: which values, where they lie in the tables of values, and when."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from ..fmu.units import scale
from ..fmu.variables import Variable
from ..names import ETA_AXES, ETA_UNITS, NU_UNITS, split_axis
from ..plan.plan import Component, Connection, Plan
from ..simulation.observer import SystemView
from .vehicle.autopilot import Autopilot
from .vehicle.sample import Sample, gravity_alone

if TYPE_CHECKING:
    from ..arrays import Places, Reals

FORCE_UNITS = dict.fromkeys(("x", "y", "z"), "m/s2")
PATIENCE = 4  # times at whole milliseconds that may be missed before a sample is taken at another time


@dataclass(kw_only=True)
class _VectorSource:
    """Where a vector comes from: signals of the plan, each scaled, or constant values.

    signals: component and variable of each element.  factors, offsets: (N,) of the elements.  values: (N,) if there are
    no signals.  places: (N,) of the signals in the table of reals.
    """

    signals: Sequence[tuple[str, Variable]] = ()
    factors: Reals | None = None  # None: as they are
    offsets: Reals | float = 0.0
    values: Sequence[float] = ()
    places: Places | None = None

    def read(self, table: Reals) -> Reals:
        if self.places is None:
            return np.array(self.values)
        vector: Reals = table[self.places]
        return vector if self.factors is None else self.factors * vector + self.offsets


class VehicleView:
    """Takes samples of the vehicles, at whole milliseconds, in which MAVLink counts, if the step allows it."""

    def __init__(self, plan: Plan, autopilots: Sequence[Autopilot], due: Callable[[int], float]):
        """due: when it is time for a tick (monotonic) [s]; a paced run may be ahead."""
        self._due = due
        self._autopilots, self._grid, self._steps = autopilots, plan.experiment.grid, plan.steps
        # Ticks from one time at a whole millisecond to the next.
        self._beat = (Fraction(repr(plan.experiment.master.step)) * 1000).denominator
        self._last = plan.first  # tick of the last sample
        self._vectors = {autopilot.system: _vectors(plan, autopilot.component) for autopilot in autopilots}

    def watched(self, plan: Plan) -> Plan:
        """The plan whose system has a place for every value of a sample."""
        signals = [s for vectors in self._vectors.values() for vector in vectors.values() for s in vector.signals]
        return replace(plan, watched=(*plan.watched, *signals))

    def opened(self, view: SystemView) -> None:
        """Find the values in the table of reals, and take the first sample."""
        self._table = view.tables["real"]
        for vectors in self._vectors.values():
            for vector in vectors.values():
                if vector.signals:
                    places = [view.places[component, variable.name] for component, variable in vector.signals]
                    vector.places = np.array(places, dtype=np.intp)
        self._sample(self._last)

    def limit(self, tick: int, last: int) -> int:
        """Where a chunk from `tick` to `last` should end: at a whole millisecond, if there is one."""
        whole = last - last % self._beat
        return whole if whole > tick else last

    def look(self, tick: int) -> None:
        """Take a sample, if this is a time for it."""
        if tick % self._beat == 0 or tick == self._steps or tick - self._last >= PATIENCE * self._beat:
            self._sample(tick)

    def _sample(self, tick: int) -> None:
        """Add a sample to each autopilot, where the bridge's thread reads it."""
        self._last = tick
        t = self._grid.time(tick)
        for autopilot in self._autopilots:
            values = {name: vector.read(self._table) for name, vector in self._vectors[autopilot.system].items()}
            if not len(values["specific_force"]):
                values["specific_force"] = gravity_alone(values["eta"])
            autopilot.show(Sample(t=t, origin=autopilot.origin, **values), self._due(tick))


def is_guided(plan: Plan, vehicle: str) -> bool:
    """Whether a vehicle follows an eta_d that another component puts out."""
    return bool(_desired(plan, vehicle).signals)


def _vectors(plan: Plan, vehicle: str) -> dict[str, _VectorSource]:
    """The vectors of a sample.  vehicle: name of a component."""
    component = next(component for component in plan.components if component.name == vehicle)
    commands = [v for v in component.fmu.lookup("u").values() if v.causality == "input" and v.kind == "real"]
    return {
        "eta": _outputs(component, "eta", ETA_UNITS),
        "nu": _outputs(component, "nu", NU_UNITS),
        "specific_force": _outputs(component, "specific_force", FORCE_UNITS),
        "u": _inputs(plan, component, commands, np.ones(len(commands))),
        "eta_d": _desired(plan, vehicle),
    }


def _outputs(component: Component, vector: str, units: Mapping[str, str]) -> _VectorSource:
    """A vector that a component puts out, in {axis: unit}; empty if it does not."""
    if not component.puts_out(vector, units):
        return _VectorSource()
    variables = component.fmu.lookup(vector)
    factors = np.array([scale(variables[axis].unit, unit, component.fmu.units) for axis, unit in units.items()])
    signals = [(component.name, variables[axis]) for axis in units]
    return _VectorSource(signals=signals, factors=None if np.all(factors == 1.0) else factors)


def _inputs(plan: Plan, component: Component, inputs: Sequence[Variable], scales: Reals) -> _VectorSource:
    """What drives some inputs of a component: outputs of others, or its start values.

    scales: (N,) factors from the units of the inputs.
    """
    by_input = {c.input.name: c for c in plan.connections if c.sink == component.name}
    connections = [by_input[v.name] for v in inputs if v.name in by_input]
    if inputs and len(connections) == len(inputs) and all(c.output.kind == "real" for c in connections):
        return _connected(connections, scales)
    values = [float(component.start.get(v.name, v.initial)) * s for v, s in zip(inputs, scales, strict=True)]
    return _VectorSource(values=values)


def _connected(connections: Sequence[Connection], scales: Reals) -> _VectorSource:
    signals = [(c.source, c.output) for c in connections]
    if all(c.direct for c in connections) and np.all(scales == 1.0):
        return _VectorSource(signals=signals)
    factors, offsets = np.array([(c.factor, c.offset) for c in connections]).T
    return _VectorSource(signals=signals, factors=factors * scales, offsets=offsets * scales)


def _desired(plan: Plan, vehicle: str) -> _VectorSource:
    """The eta_d that a vehicle's controller is given; nan if it is given none."""
    guide = _guide(plan, vehicle)
    if guide is None:
        return _VectorSource(values=[np.nan] * len(ETA_AXES))
    inputs = [guide.fmu.variables[f"eta_d.{axis}"] for axis in ETA_AXES]
    scales = [scale(v.unit, unit, guide.fmu.units) for v, unit in zip(inputs, ETA_UNITS.values(), strict=True)]
    return _inputs(plan, guide, inputs, np.array(scales))


def _guide(plan: Plan, vehicle: str) -> Component | None:
    """The nearest component upstream of a vehicle that takes an `eta_d`, without a way through other vehicles."""
    components = {component.name: component for component in plan.components}
    others = {component.name for component in plan.components if _puts_out_some_eta(component)}
    seen, queue = {vehicle, *others}, deque([vehicle])
    while queue:
        name = queue.popleft()
        for source in dict.fromkeys(c.source for c in plan.connections if c.sink == name):
            eta_d = components[source].fmu.lookup("eta_d")
            if set(ETA_AXES) <= set(eta_d) and all(v.causality == "input" for v in eta_d.values()):
                return components[source]
            if source not in seen:
                seen.add(source)
                queue.append(source)
    return None


def _puts_out_some_eta(component: Component) -> bool:
    outputs = (v.name for v in component.fmu.variables.values() if v.causality == "output")
    return "eta" in {split_axis(name)[0] for name in outputs}
