"""The panels over time: which curves the page draws, grouped as a reader looks for them.

A curve has keys; the buttons of the legend hide all the curves that have one.  A run has a colour and its vehicles
shades of it; where there is one run, each vehicle has a colour: as in the figures of `orch plot`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...fmu.units import readable, scale
from ...metrics import on_circle
from ...names import NU_UNITS, split_axis
from ...records.compare.vehicles import AXES, Vehicle, formation
from .. import lines
from .colours import colours
from .packing import packed

if TYPE_CHECKING:
    from ...arrays import Reals
    from ...records.file.run import Run


DEG = 180.0 / np.pi
LETTERS = {"phi": "φ", "theta": "θ", "psi": "ψ"}
LEAST = {"m": 0.1, "deg": 1.0}  # extent of a state's axis: rest is drawn as rest, not as micrometres of motion
MAX_PANELS = 60  # of a run without vehicles
MAX_POINTS = 3000  # of a curve; what a screen shows, and few enough for a page of 8 MB
MAX_STEPS = 1000  # of a band
BAND = "band"  # the key of all bands
Fleet = Sequence[tuple["Run", list[Vehicle]]]  # every run with its vehicles


def groups(fleet: Fleet) -> list[dict[str, Any]]:
    """The groups of panels of all runs, without groups of which nothing is recorded."""
    if not any(vehicles for _, vehicles in fleet):
        return _signals([run for run, _ in fleet])
    every = [
        ("Position and attitude", "Dashed: the reference. Depth points down.", _states(fleet)),
        ("Errors", "State minus reference.", _errors(fleet)),
        ("Thruster commands", "Normalized, from -1 to 1.", _thrusters(fleet)),
        ("Formation", "The second vehicle seen from the first.", _formation(fleet)),
        ("Velocities", "In the body frame.", _velocities(fleet)),
    ]
    return [{"title": title, "note": note, "panels": panels} for title, note, panels in every if panels]


def keys(fleet: Fleet, labels: Sequence[str]) -> list[dict[str, Any]]:
    """The buttons of the legend.  labels: of the runs."""
    several = len(fleet) > 1
    buttons: list[dict[str, Any]] = []
    if several:
        buttons = [{"key": f"run{i}", "label": label, "colour": colours(i, 0)} for i, label in enumerate(labels)]
    names = list(dict.fromkeys(vehicle.name for _, vehicles in fleet for vehicle in vehicles))
    if not several or len(names) > 1:
        buttons += [{"key": n, "label": n, "colour": None if several else colours(k, 0)} for k, n in enumerate(names)]
    if any(vehicle.eta_d for _, vehicles in fleet for vehicle in vehicles):
        buttons.append({"key": "desired", "label": "reference", "colour": None, "shape": "dashed"})
    return buttons


def band_keys(groups: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The button of the bands, where there are any."""
    drawn = any("band" in curve for group in groups for panel in group["panels"] for curve in panel["curves"])
    return [{"key": BAND, "label": lines.BAND, "colour": None, "shape": "band"}] if drawn else []


def vehicle_colours(fleet: Fleet, run: int, name: str) -> list[str]:
    """Colour of a vehicle on light and on dark ground."""
    names = list(dict.fromkeys(vehicle.name for _, vehicles in fleet for vehicle in vehicles))
    return colours(run, names.index(name)) if len(fleet) > 1 else colours(names.index(name), 0)


def _states(fleet: Fleet) -> list[dict[str, Any]]:
    panels = []
    for axis in AXES:
        unit, factor = ("deg", DEG) if axis in LETTERS else ("m", 1.0)
        curves = []
        for i, run, vehicle in _each(fleet):
            for vector, values in (("eta", vehicle.eta), ("eta_d", vehicle.eta_d)):
                if axis in values:
                    bounds = vehicle.bounds.get((vector, axis))
                    points = _points(run.time, values[axis], bounds, factor, turning=axis in LETTERS)
                    curves.append(_curve(fleet, i, vehicle.name, points, desired=vector == "eta_d"))
        panels.append(_panel(LETTERS.get(axis, axis), unit, curves, least=LEAST[unit], down=axis == "z"))
    return panels


def _errors(fleet: Fleet) -> list[dict[str, Any]]:
    panels = []
    for axis in AXES:
        unit, factor = ("deg", DEG) if axis in LETTERS else ("m", 1.0)
        letter = LETTERS.get(axis, axis)
        curves = [
            _curve(
                fleet, i, vehicle.name, _points(run.time, _error(vehicle, axis), None, factor, turning=axis in LETTERS)
            )
            for i, run, vehicle in _each(fleet)
            if axis in vehicle.eta_d
        ]
        panels.append(_panel(f"{letter} - {letter}_d", unit, curves, down=axis == "z"))
    return [panel for panel in panels if panel["curves"]]


def _error(vehicle: Vehicle, axis: str) -> Reals:
    """eta - eta_d of an axis, of an angle on the circle, (N,) [m, rad]."""
    difference = vehicle.eta[axis] - vehicle.eta_d[axis]
    return on_circle(difference, 2 * np.pi) if axis in LETTERS else difference


def _thrusters(fleet: Fleet) -> list[dict[str, Any]]:
    axes = dict.fromkeys(axis for _, _, vehicle in _each(fleet) for axis in vehicle.u)
    return [
        _panel(
            axis,
            "1",
            [
                _curve(fleet, i, vehicle.name, _points(run.time, vehicle.u[axis], vehicle.bounds.get(("u", axis))))
                for i, run, vehicle in _each(fleet)
                if axis in vehicle.u
            ],
        )
        for axis in axes
    ]


def _formation(fleet: Fleet) -> list[dict[str, Any]]:
    """Distance, heading and depth of the second vehicle relative to the first, of every run that has two."""
    rows: dict[str, list[dict[str, Any]]] = {"distance": [], "heading": [], "depth": []}
    for i, (run, vehicles) in enumerate(fleet):
        if len(vehicles) != 2:
            continue
        for name, values in formation(*vehicles).items():
            points = _points(run.time, values, factor=DEG if name == "heading" else 1.0)
            rows[name].append(_curve(fleet, i, vehicles[0].name, points, keys=[f"run{i}"]))
    panels = [
        _panel("distance", "m", rows["distance"], least=0.1),
        _panel("ψ₂ - ψ₁", "deg", rows["heading"], least=1.0),
        _panel("z₂ - z₁", "m", rows["depth"], least=0.1, down=True),
    ]
    return [panel for panel in panels if panel["curves"]]


def _velocities(fleet: Fleet) -> list[dict[str, Any]]:
    panels = []
    for axis in "uvwpqr":
        unit, factor = ("m/s", 1.0) if axis in "uvw" else ("deg/s", DEG)
        curves = [
            _curve(
                fleet,
                i,
                vehicle.name,
                _points(run.time, run[name], run.envelope(name), factor * scale(run.units(name), NU_UNITS[axis])),
            )
            for i, run, vehicle in _each(fleet)
            if (name := f"{vehicle.name}.nu.{axis}") in run.signals
        ]
        panels.append(_panel(axis, unit, curves))
    return [panel for panel in panels if panel["curves"]]


def _signals(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Runs without vehicles: a panel for each vector and unit or, of several runs, for each signal."""
    panels: dict[tuple[str, str], dict[str, Any]] = {}
    for i, run in enumerate(runs):
        for name in run.signals:
            values = run[name]
            if not np.issubdtype(values.dtype, np.number) or values.ndim > 1 or not len(values):
                continue
            unit = run.units(name)
            shown, factor = readable(unit)
            component, _, variable = name.partition(".")
            head, axis = split_axis(variable)
            title = name if len(runs) > 1 or (axis == "z" and unit == "m") else f"{component}.{head}"
            panel = panels.setdefault((title, unit), _panel(title, shown, [], down=axis == "z"))
            tone = colours(i if len(runs) > 1 else len(panel["curves"]), 0)
            turning = shown == "deg" and run.is_angle(name)
            points = _points(run.time, values, run.envelope(name), factor, turning)
            panel["curves"].append(points | {"name": axis or head, "keys": [f"run{i}"], "colour": tone})
    for panel in panels.values():
        panel["legend"] = len(runs) == 1 and len(panel["curves"]) > 1
    note = f"The first {MAX_PANELS} of {len(panels)} panels." if len(panels) > MAX_PANELS else "As recorded."
    return [{"title": "Signals", "note": note, "panels": list(panels.values())[:MAX_PANELS]}] if panels else []


def _each(fleet: Fleet) -> list[tuple[int, Run, Vehicle]]:
    return [(i, run, vehicle) for i, (run, vehicles) in enumerate(fleet) for vehicle in vehicles]


def _panel(
    name: str, unit: str, curves: list[dict[str, Any]], least: float = 0.0, down: bool = False
) -> dict[str, Any]:
    """least: the least extent of the vertical axis, in its unit.  down: it points down."""
    shown = "" if unit in ("", "1") else unit
    return {"name": name, "unit": shown, "curves": curves, "least": least, "down": down, "legend": False}


def _curve(
    fleet: Fleet,
    run: int,
    vehicle: str,
    points: Mapping[str, Any],
    desired: bool = False,
    keys: Sequence[str] | None = None,
) -> dict[str, Any]:
    name = f"{vehicle} reference" if desired else vehicle
    own: dict[str, Any] = {
        "name": name if len(fleet) == 1 else f"{fleet[run][0].run_id} {name}",
        "keys": [f"run{run}", vehicle, *(["desired"] if desired else [])] if keys is None else list(keys),
        "colour": vehicle_colours(fleet, run, vehicle),
        "desired": desired,
    }
    return {**points, **own}


def _points(
    time: Reals, values: Reals, bounds: Reals | None = None, factor: float = 1.0, turning: bool = False
) -> dict[str, Any]:
    """A line and its band.

    bounds: (N, 2), the least and the greatest since the row before.  factor: from both to what is shown.  turning:
    whether these are angles, in degrees then.
    """
    turn, values = lines.TURN if turning else 0.0, np.asarray(values, float) * factor
    t, y = lines.line(time, values, MAX_POINTS, turn)
    points: dict[str, Any] = {"t": packed(t), "y": packed(y)}
    if bounds is not None:
        band = lines.band(time, values, bounds * factor, MAX_STEPS, turn)
        points["band"] = {name: packed(array) for name, array in band._asdict().items()}
    return points
