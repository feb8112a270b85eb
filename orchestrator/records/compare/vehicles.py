"""The vehicles of a record: where they went, where they should have gone, what drove them."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...fmu.units import scale
from ...metrics import distance
from ...names import ETA_UNITS, split_axis

if TYPE_CHECKING:
    from ...arrays import Reals
    from ..file.run import Run

AXES = tuple(ETA_UNITS)
NO_UNITS: Mapping[str, str] = {}
CURRENT_UNITS = dict.fromkeys(("x", "y", "z"), "m/s")


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """The signals of one vehicle, each {axis: (N,)}, without the axes that the record does not hold."""

    name: str
    eta: Mapping[str, Reals]  # position in NED and zyx Euler angles [m, rad]
    eta_d: Mapping[str, Reals]  # the reference of its controller, likewise
    u: Mapping[str, Reals]  # normalized thruster commands
    v_c: Mapping[str, Reals]  # velocity of the current in NED [m/s]
    bounds: Mapping[tuple[str, str], Reals]  # least and greatest since the row before, {("u", "T1"): (N, 2)}


def vehicles(run: Run) -> list[Vehicle]:
    """The components of a run that put out a whole `eta`, in the order of the record."""
    wiring = _Wiring(run)
    names = [c for c in dict.fromkeys(s.partition(".")[0] for s in run.signals) if _is_vehicle(run, c)]
    result = []
    for name in names:
        controller = wiring.controller(name, names)
        eta_d = wiring.arriving(f"{controller}.eta_d", ETA_UNITS) if controller else {}
        u = wiring.arriving(f"{name}.u")
        scales = {axis: scale(run.units(f"{name}.eta.{axis}"), unit) for axis, unit in ETA_UNITS.items()}
        envelopes = {
            **{("eta", axis): _scaled(run.envelope(f"{name}.eta.{axis}"), scales[axis]) for axis in AXES},
            **{("eta_d", axis): wiring.envelope(f"{controller}.eta_d", axis, ETA_UNITS) for axis in eta_d},
            **{("u", axis): wiring.envelope(f"{name}.u", axis) for axis in u},
        }
        result.append(
            Vehicle(
                name=name,
                eta={axis: run[f"{name}.eta.{axis}"] * scales[axis] for axis in AXES},
                eta_d=eta_d,
                u=u,
                v_c=wiring.arriving(f"{name}.v_c", CURRENT_UNITS),
                bounds={place: bounds for place, bounds in envelopes.items() if bounds is not None},
            )
        )
    return result


def formation(one: Vehicle, other: Vehicle) -> dict[str, Reals]:
    """The other vehicle seen from the first: `distance` [m], `heading` [rad] and `depth` [m], each (N,).

    heading: psi - psi, without jumps, and within half a turn of zero in the first row.
    """
    positions = [np.column_stack([vehicle.eta[axis] for axis in AXES[:3]]) for vehicle in (other, one)]
    heading = np.unwrap(other.eta["psi"] - one.eta["psi"])
    turn = 2 * np.pi
    return {
        "distance": distance(*positions),
        "heading": heading - turn * round(heading[0] / turn),
        "depth": other.eta["z"] - one.eta["z"],
    }


def _scaled(bounds: Reals | None, factor: float) -> Reals | None:
    return None if bounds is None else bounds * factor


def _is_vehicle(run: Run, component: str) -> bool:
    etas = [f"eta.{axis}" for axis in AXES]
    known = set(run.signals)
    names = [f"{component}.{eta}" for eta in etas]
    return all(name in known and run.about(name, "causality") == "output" for name in names)


class _Wiring:
    """What arrives at inputs: the connections and start values of the experiment, over the recorded signals."""

    def __init__(self, run: Run):
        self._run = run
        self._source: dict[str, str] = {}
        self._scale: dict[str, tuple[float, float]] = {}  # factor and offset, where they are not 1 and 0
        for sink, source, *between in run.resolved.get("connections", []):
            self._source[sink] = source
            if between:
                self._scale[sink] = between[0], between[1]
        self._declared: dict[str, dict[str, str]] = {}  # {component: {variable: unit}}
        self._start = {
            f"{component['name']}.{variable}": value
            for component in run.resolved.get("components", [])
            for variable, value in component["start"].items()
        }

    def arriving(self, vector: str, units: Mapping[str, str] = NO_UNITS) -> dict[str, Reals]:
        """{axis: (N,)} of an input such as "vehicle1.u": as recorded, else from its source, else its start value.

        units: {axis: the unit that is wanted}, where it is not that of the input.
        """
        known = [*self._source, *self._start, *self._run.signals]
        axes = {axis for head, axis in map(split_axis, known) if head == vector and axis}
        values = {axis: self._values(vector, axis) for axis in sorted(axes, key=_in_order)}
        return {
            axis: array * self._to(f"{vector}.{axis}", units.get(axis, ""))
            for axis, array in values.items()
            if array is not None
        }

    def _to(self, name: str, wanted: str) -> float:
        """Factor from the unit of an input to the one that is wanted, if any."""
        return scale(self._unit(name), wanted) if wanted else 1.0

    def _unit(self, name: str) -> str:
        """The unit of an input: as recorded, else its source's, else what its FMU declares."""
        source = name if name in self._run.signals else self._source.get(name, "")
        if source in self._run.signals and name not in self._scale:
            return self._run.units(source)
        component, _, variable = name.partition(".")
        if component not in self._declared:
            self._declared[component] = _declared_units(self._run, component)
        return self._declared[component].get(variable, "")

    def _values(self, vector: str, axis: str) -> Reals | None:
        recorded = set(self._run.signals)
        for name in (f"{vector}.{axis}", f"{vector}[{axis}]"):
            if name in recorded:
                return np.asarray(self._run[name], float)
            if self._source.get(name) in recorded:
                factor, offset = self._scale.get(name, (1.0, 0.0))
                return factor * np.asarray(self._run[self._source[name]], float) + offset
            if name in self._start:
                return np.full(len(self._run.time), float(self._start[name]))
        return None

    def envelope(self, vector: str, axis: str, units: Mapping[str, str] = NO_UNITS) -> Reals | None:
        """(N, 2): the least and greatest of an axis since the row before; its own, else of its source, else None."""
        to = self._to(f"{vector}.{axis}", units.get(axis, ""))
        for name in (f"{vector}.{axis}", f"{vector}[{axis}]"):
            own = self._run.envelope(name)
            if own is not None:
                return own * to
            source = self._run.envelope(self._source[name]) if name in self._source else None
            if source is not None:
                factor, offset = self._scale.get(name, (1.0, 0.0))
                return np.sort(factor * source + offset, axis=1) * to  # a negative factor turns them round
        return None

    def controller(self, vehicle: str, others: list[str]) -> str | None:
        """The nearest component upstream of the vehicle that has an input `eta_d`; None if there is none.

        others: vehicles; the search does not pass them, as every controller reads its own vehicle.
        """
        feeds: dict[str, dict[str, None]] = {}
        for sink, source in self._source.items():
            feeds.setdefault(sink.partition(".")[0], {})[source.partition(".")[0]] = None
        guided = {n.partition(".")[0] for n in [*self._source, *self._start] if split_axis(n)[0].endswith(".eta_d")}
        seen, queue = {*others, vehicle}, deque([vehicle])
        while queue:
            for component in feeds.get(queue.popleft(), {}):
                if component in guided:
                    return component
                if component not in seen:
                    seen.add(component)
                    queue.append(component)
        return None


def _declared_units(run: Run, component: str) -> dict[str, str]:
    """{variable: unit} by the model description of a component's FMU."""
    description = run.description(component)
    units: dict[str, str] = {}
    for element in () if description is None else description.iter():  # types stand before variables
        parts = [element, *element]  # FMI 3.0 has the unit here, FMI 2.0 one below
        own = next((unit for part in parts if (unit := part.get("unit"))), "")
        declared = next((units.get(of, "") for part in parts if (of := part.get("declaredType"))), "")
        if name := element.get("name"):
            units[name] = own or declared
    return units


def _in_order(axis: str) -> tuple[int, int, str]:
    """eta's axes in their order, others after them, T10 after T9."""
    return AXES.index(axis) if axis in AXES else len(AXES), len(axis), axis
