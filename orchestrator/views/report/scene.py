"""What the replay shows: poses of the vehicles and their references, the current, the object, and the space around."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import metrics
from ...names import ANGLE_AXES
from ...records.compare.vehicles import AXES, Vehicle
from .curves import Fleet, vehicle_colours
from .packing import even, packed

if TYPE_CHECKING:
    from ...arrays import Places, Reals, Truths
    from ...records.file.run import Run


STEADY = 1e-3  # m; a reference distance that stays within this holds an object
HELD = 0.2  # of the length; without references, the recorded distance may stray that far
BELOW = 0.19  # m; the object hangs in grippers below the vehicles, whose bodies nearly touch above it
THICKNESS = 0.05  # m, radius of the object as drawn
MARGIN = 0.7  # m around the tracks
FLOOR = 0.6  # m below the deepest point where no object lies on the floor
ROOM = 16.0  # m; in a larger one the vehicles are drawn larger than they are


def replay(fleet: Fleet) -> dict[str, Any] | None:
    """All runs that have vehicles; None where there is none."""
    moving = [(i, run, vehicles) for i, (run, vehicles) in enumerate(fleet) if vehicles]
    if not moving:
        return None
    runs = [_run(fleet, i, run, vehicles) for i, run, vehicles in moving]
    low, high = _extent([vehicle for _, _, vehicles in moving for vehicle in vehicles])
    resting = [place[2] for run in runs if run["object"] for place in run["object"]["rests"]]
    floor = max([high[2] + (0.25 if resting else FLOOR), *(z + BELOW + THICKNESS for z in resting)])
    low, high = low - MARGIN, high + MARGIN
    low[2], high[2] = min(low[2] + MARGIN - 0.3, -0.3), floor
    return {
        "start": min(float(run.time[0]) for _, run, _ in moving),
        "stop": max(float(run.time[-1]) for _, run, _ in moving),
        "runs": runs,
        "low": low.tolist(),
        "high": high.tolist(),
        "scale": max(1.0, round(max(high - low) / ROOM, 1)),
        "below": BELOW,
        "thickness": THICKNESS,
    }


def _run(fleet: Fleet, number: int, run: Run, vehicles: Sequence[Vehicle]) -> dict[str, Any]:
    rows = even(len(run.time))
    current = next((v.v_c for v in vehicles if {*"xyz"} <= {*v.v_c}), {})
    shown = [
        {
            "name": vehicle.name,
            "colour": vehicle_colours(fleet, number, vehicle.name),
            "pose": packed(_columns(vehicle.eta, rows)),
            "desired": packed(_columns(vehicle.eta_d, rows)) if {*"xyz"} <= {*vehicle.eta_d} else None,
        }
        for vehicle in vehicles
    ]
    return {
        "number": number,
        "time": packed(run.time[rows]),
        "vehicles": shown,
        "current": packed(np.column_stack([current[axis][rows] for axis in "xyz"])) if current else None,
        "object": gripped(run, vehicles),
    }


def _columns(vector: Mapping[str, Reals], rows: Places) -> Reals:
    """(K, 6) of eta's axes, angles without jumps, as lines are followed between rows; nan where an axis is missing."""
    missing = np.full(len(rows), math.nan)
    smooth = {axis: np.unwrap(values) if axis in ANGLE_AXES else values for axis, values in vector.items()}
    return np.column_stack([smooth[axis][rows] if axis in smooth else missing for axis in AXES])


def gripped(run: Run, vehicles: Sequence[Vehicle]) -> dict[str, Any] | None:
    """The object that two vehicles hold between them: who, how long it is [m], from when to when [s], where it rests.

    That they hold one is what the experiment says: a metric asks for their distance over a window with a beginning and
    an end, and their references keep one distance in it.  The object is as long as that, and is held for as long as
    that lasts.  Without references the window is taken as it is, if the vehicles stayed near one distance.
    """
    by_name = {f"{vehicle.name}.eta": vehicle for vehicle in vehicles}
    for spec in run.attributes["experiment_resolved"].get("metrics", {}).values():
        ends = [by_name.get(str(spec.get(end))) for end in ("signal", "reference")]
        if spec["of"] != "distance" or None in ends or not {"after", "before"} <= {*spec}:
            continue
        pair = [vehicle for vehicle in ends if vehicle]
        time = run.time
        window = (time >= spec["after"]) & (time <= spec["before"])
        if not window.any():
            continue
        guided = all({*"xyz"} <= {*vehicle.eta_d} for vehicle in pair)
        paths = [_places(vehicle.eta_d if guided else vehicle.eta) for vehicle in pair]
        distance = metrics.distance(*paths)
        length = float(np.median(distance[window]))
        steady = np.abs(distance - length) <= (STEADY if guided else HELD * length)
        if length == 0.0 or not steady[window].all():
            continue
        first, last = _around(steady, window) if guided else (window.argmax(), len(window) - window[::-1].argmax() - 1)
        middle = (_places(pair[0].eta) + _places(pair[1].eta)) / 2
        return {
            "vehicles": [vehicles.index(vehicle) for vehicle in pair],
            "length": length,
            "from": float(time[first]),
            "to": float(time[last]),
            "rests": [middle[first].tolist(), middle[last].tolist()],
        }
    return None


def _places(vector: Mapping[str, Reals]) -> Reals:
    return np.column_stack([vector[axis] for axis in "xyz"])


def _around(steady: Truths, window: Truths) -> tuple[int, int]:
    """First and last row of the steady stretch that the window lies in."""
    start, stop = int(window.argmax()), len(window) - int(window[::-1].argmax()) - 1
    before, after = np.flatnonzero(~steady[:start]), np.flatnonzero(~steady[stop:])
    return int(before[-1]) + 1 if len(before) else 0, stop + int(after[0]) - 1 if len(after) else len(steady) - 1


def _extent(vehicles: Sequence[Vehicle]) -> tuple[Reals, Reals]:
    """The lowest and the highest of each of x, y, z, over tracks and references [m]."""
    paths = [v.eta for v in vehicles] + [v.eta_d for v in vehicles if {*"xyz"} <= {*v.eta_d}]
    points = np.concatenate([_places(path) for path in paths])
    return np.nanmin(points, axis=0), np.nanmax(points, axis=0)
