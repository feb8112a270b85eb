"""The vehicles of a record: where they went, where they should have gone, what drove them."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...metrics import distance
from ...names import split_axis

if TYPE_CHECKING:
    from ...arrays import Reals
    from ..file.run import Run

AXES = ("x", "y", "z", "phi", "theta", "psi")


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
        eta_d = wiring.arriving(f"{controller}.eta_d") if controller else {}
        u = wiring.arriving(f"{name}.u")
        envelopes = {
            **{("eta", axis): run.envelope(f"{name}.eta.{axis}") for axis in AXES},
            **{("eta_d", axis): wiring.envelope(f"{controller}.eta_d", axis) for axis in eta_d},
            **{("u", axis): wiring.envelope(f"{name}.u", axis) for axis in u},
        }
        result.append(
            Vehicle(
                name=name,
                eta={axis: run[f"{name}.eta.{axis}"] for axis in AXES},
                eta_d=eta_d,
                u=u,
                v_c=wiring.arriving(f"{name}.v_c"),
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


def _is_vehicle(run: Run, component: str) -> bool:
    etas = [f"eta.{axis}" for axis in AXES]
    group = run.file[component]
    return all(eta in group and group[eta].attrs.get("causality") == "output" for eta in etas)


class _Wiring:
    """What arrives at inputs: the connections and start values of the experiment, over the recorded signals."""

    def __init__(self, run: Run):
        self._run = run
        self._source: dict[str, str] = {}
        self._scale: dict[str, tuple[float, float]] = {}  # factor and offset, where they are not 1 and 0
        for sink, source, *scale in run.resolved.get("connections", []):
            self._source[sink] = source
            if scale:
                self._scale[sink] = scale[0], scale[1]
        self._start = {
            f"{component['name']}.{variable}": value
            for component in run.resolved.get("components", [])
            for variable, value in component["start"].items()
        }

    def arriving(self, vector: str) -> dict[str, Reals]:
        """{axis: (N,)} of an input such as "vehicle1.u": as recorded, else from its source, else its start value."""
        known = [*self._source, *self._start, *self._run.signals]
        axes = {axis for head, axis in map(split_axis, known) if head == vector and axis}
        values = {axis: self._values(vector, axis) for axis in sorted(axes, key=_in_order)}
        return {axis: array for axis, array in values.items() if array is not None}

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

    def envelope(self, vector: str, axis: str) -> Reals | None:
        """(N, 2): the least and greatest of an axis since the row before; its own, else of its source, else None."""
        for name in (f"{vector}.{axis}", f"{vector}[{axis}]"):
            own = self._run.envelope(name)
            if own is not None:
                return own
            source = self._run.envelope(self._source[name]) if name in self._source else None
            if source is not None:
                factor, offset = self._scale.get(name, (1.0, 0.0))
                return np.sort(factor * source + offset, axis=1)  # a negative factor turns them round
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


def _in_order(axis: str) -> tuple[int, int, str]:
    """eta's axes in their order, others after them, T10 after T9."""
    return AXES.index(axis) if axis in AXES else len(AXES), len(axis), axis
