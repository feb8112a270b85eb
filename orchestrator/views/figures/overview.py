"""The vehicles of runs at a glance: tracks on a chart and in space, states, errors, thrusters, formation.

Frames: NED.  Tracks lie as on a chart, north up and east to the right; depth points down on every axis.
A run has a colour and its vehicles shades of it; where there is one run, each vehicle has a colour.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from ...records.compare.vehicles import Vehicle, formation, vehicles
from .. import lines
from .panels import DENSE, DESIRED, GREY, MAX_POINTS, Curve, Panel, colour, plain, symbol, tint

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from ...arrays import Reals
    from ...records.file.run import Run


DEG = 180.0 / np.pi
HEADINGS = 12  # arrows along a track, fewer along many
LEAST_EXTENT = 1.0  # m; a vehicle that holds its place is drawn as a point, not as micrometres of motion


@dataclass(frozen=True)
class Trace:
    """A vehicle of a run.  run: its number; time: (N,) [s]."""

    run: int
    time: Reals
    vehicle: Vehicle
    colour: Any


def traces(runs: Sequence[Run]) -> list[Trace]:
    """Every vehicle of every run."""
    every = [(i, run.time, vehicle) for i, run in enumerate(runs) for vehicle in vehicles(run)]
    names = list(dict.fromkeys(vehicle.name for _, _, vehicle in every))
    number = {name: k for k, name in enumerate(names)}
    return [
        Trace(i, time, vehicle, colour(i, number[vehicle.name]) if len(runs) > 1 else colour(number[vehicle.name]))
        for i, time, vehicle in every
    ]


def keys(traces: Sequence[Trace]) -> list[Artist]:
    """The legend: vehicles, and what the marks mean."""
    handles: list[Artist] = []
    several = len({trace.run for trace in traces}) > 1
    names = list(dict.fromkeys(trace.vehicle.name for trace in traces))
    if not several or len(names) > 1:
        for k, name in enumerate(names):
            handles.append(Line2D([], [], color=tint(GREY, k) if several else colour(k), label=plain(name)))
    if any(trace.vehicle.eta_d for trace in traces):
        handles.append(Line2D([], [], label="desired", **DESIRED))
    mark: dict[str, Any] = {"linestyle": "", "color": GREY, "markersize": 6}
    if traces:
        handles.append(Line2D([], [], marker="o", label="start", **mark | {"markerfacecolor": "white"}))
        handles.append(Line2D([], [], marker="s", label="end", **mark))
        handles.append(Line2D([], [], marker=r"$\rightarrow$", label="heading", **mark | {"markersize": 11}))
    return handles


def rows(traces: Sequence[Trace]) -> list[list[Panel]]:
    """Panels over time, as far as their signals are recorded."""
    thrusters = dict.fromkeys(axis for trace in traces for axis in trace.vehicle.u)
    commands = [_command(traces, axis) for axis in thrusters]
    every = [
        [_state(traces, axis, "m", 1.0, 0.1) for axis in ("x", "y", "z")],
        [_state(traces, axis, "deg", DEG, 1.05) for axis in ("phi", "theta", "psi")],
        [_error(traces, axis) for axis in ("x", "y", "z")],
        *(commands[i : i + 3] for i in range(0, len(commands), 3)),
        _formation(traces),
    ]
    return [panels for row in every if (panels := [panel for panel in row if panel.curves])]


def _state(traces: Sequence[Trace], axis: str, unit: str, factor: float, span: float) -> Panel:
    turn = lines.TURN if unit == "deg" else 0.0
    actual = [
        Curve(t.time, t.vehicle.eta[axis] * factor, {"color": t.colour}, _bounds(t, "eta", axis, factor), turn)
        for t in traces
    ]
    desired = [
        Curve(t.time, t.vehicle.eta_d[axis] * factor, DESIRED, _bounds(t, "eta_d", axis, factor), turn)
        for t in traces
        if axis in t.vehicle.eta_d
    ]
    return Panel(f"{symbol(axis)} [{unit}]", actual + desired, down=axis == "z", span=span)


def _bounds(trace: Trace, vector: str, axis: str, factor: float = 1.0) -> Reals | None:
    bounds = trace.vehicle.bounds.get((vector, axis))
    return None if bounds is None else bounds * factor


def _error(traces: Sequence[Trace], axis: str) -> Panel:
    curves = [
        Curve(t.time, t.vehicle.eta[axis] - t.vehicle.eta_d[axis], {"color": t.colour})
        for t in traces
        if axis in t.vehicle.eta_d
    ]
    return Panel(f"${axis} - {axis}_d$ [m]", curves, down=axis == "z", span=0.02)


def _command(traces: Sequence[Trace], axis: str) -> Panel:
    curves = [
        Curve(t.time, t.vehicle.u[axis], {"color": t.colour, **DENSE}, _bounds(t, "u", axis))
        for t in traces
        if axis in t.vehicle.u
    ]
    return Panel(f"{symbol(axis)} [-]", curves, span=0.2, share="u")


def _formation(traces: Sequence[Trace]) -> list[Panel]:
    """Of the two vehicles of a run: their distance, and the second's heading and depth relative to the first's."""
    curves: dict[str, list[Curve]] = {"distance": [], "heading": [], "depth": []}
    runs = list(dict.fromkeys(trace.run for trace in traces))
    for i in runs:
        pair = [trace for trace in traces if trace.run == i]
        if len(pair) != 2:
            continue
        style = {"color": pair[0].colour if len(runs) > 1 else GREY}
        for name, values in formation(pair[0].vehicle, pair[1].vehicle).items():
            curves[name].append(Curve(pair[0].time, values * (DEG if name == "heading" else 1.0), style))
    return [
        Panel("distance [m]", curves["distance"], span=0.1),
        Panel(r"$\psi_2 - \psi_1$ [deg]", curves["heading"], span=1.05),
        Panel("$z_2 - z_1$ [m]", curves["depth"], down=True, span=0.1),
    ]


def draw_chart(ax: Axes, traces: Sequence[Trace]) -> None:
    """The tracks from above, with headings and the current."""
    for trace in traces:
        eta = trace.vehicle.eta
        ax.plot(*_track(eta, "yx"), color=trace.colour)
        if {"x", "y"} <= trace.vehicle.eta_d.keys():
            ax.plot(*_track(trace.vehicle.eta_d, "yx"), **DESIRED)
        x, y, psi = eta["x"], eta["y"], eta["psi"]
        way = np.concatenate([[0.0], np.hypot(np.diff(x), np.diff(y)).cumsum()])
        at = np.searchsorted(way, np.linspace(0.0, way[-1], max(4, min(HEADINGS, 2 * HEADINGS // len(traces)))))
        ax.quiver(
            y[at],
            x[at],
            np.sin(psi[at]),
            np.cos(psi[at]),
            color=trace.colour,
            units="inches",
            width=0.022,
            scale=4.0,
            scale_units="inches",
            zorder=4,
        )
        ax.plot(y[0], x[0], "o", color=trace.colour, markerfacecolor="white", zorder=5)
        ax.plot(y[-1], x[-1], "s", color=trace.colour, zorder=5)
    (west, east), (south, north) = _extent(traces, "y", margin=0.1), _extent(traces, "x", margin=0.1)
    scale = max((east - west) / ax.bbox.width, (north - south) / ax.bbox.height)  # m a pixel, the same both ways
    ax.set_xlim((west + east - scale * ax.bbox.width) / 2, (west + east + scale * ax.bbox.width) / 2)
    ax.set_ylim((south + north - scale * ax.bbox.height) / 2, (south + north + scale * ax.bbox.height) / 2)
    ax.set_xlabel("East $y$ [m]")
    ax.set_ylabel("North $x$ [m]")
    _draw_current(ax, traces)


def _draw_current(ax: Axes, traces: Sequence[Trace]) -> None:
    """An arrow in the emptiest corner along each current's mean; in a run's colour where not all runs share it."""
    currents: dict[tuple[float, ...], list[Trace]] = {}  # {velocity in NED [m/s]: who is in it}
    for trace in traces:
        mean = tuple(round(float(part.mean()), 3) for part in trace.vehicle.v_c.values())
        if len(mean) == 3 and any(mean):
            currents.setdefault(mean, []).append(trace)
    if not currents:
        return
    to_axes = ax.transData + ax.transAxes.inverted()
    points = np.concatenate([to_axes.transform(np.column_stack(_track(t.vehicle.eta, "yx"))) for t in traces])
    corners = [(0.0, 0.78), (0.78, 0.78), (0.0, 0.0), (0.78, 0.0)]  # in the order of preference
    clear = [np.hypot(*(points - (left + 0.11, low + 0.11)).T).min() for left, low in corners]
    place = corners[int(np.argmax(np.minimum(clear, 0.3)))]
    inset = ax.inset_axes((*place, 0.22, 0.22), xlim=(-1, 1), ylim=(-1, 1))
    inset.set_axis_off()
    for (north, east, _), members in currents.items():
        length = np.hypot(north, east)
        if length:
            shade = "#222222" if len(members) == len(traces) else members[0].colour
            inset.quiver(
                0,
                0.4,
                east / length,
                north / length,
                color=shade,
                units="inches",
                width=0.035,
                scale=2.2,
                scale_units="inches",
                pivot="mid",
            )
    steady = all(np.ptp(part) < 1e-3 for trace in traces for part in trace.vehicle.v_c.values())
    speeds = ", ".join(f"{np.linalg.norm(velocity):.2f}" for velocity in currents)
    name = "current" if steady else "mean current"
    inset.text(0, -0.55, f"{name}\n{speeds} m/s", ha="center", va="center", fontsize=8)


def draw_space(ax: Any, traces: Sequence[Trace]) -> None:
    """The tracks in space, seen from the south-east and above, with their shadows on the lowest level."""
    limits = {axis: _extent(traces, axis, margin=0.03) for axis in ("x", "y", "z")}
    for trace in traces:
        east, north, depth = _track(trace.vehicle.eta, "yxz")
        ax.plot(east, north, np.full(len(depth), limits["z"][1]), color="#c8c8c8", linewidth=1.0)
        ax.plot(east, north, depth, color=trace.colour)
        for row, face in ((0, "white"), (-1, trace.colour)):
            mark = [[values[row]] for values in (east, north, depth)]
            ax.plot(*mark, "os"[row], color=trace.colour, markerfacecolor=face, markersize=4)
        if {"x", "y", "z"} <= trace.vehicle.eta_d.keys():
            ax.plot(*_track(trace.vehicle.eta_d, "yxz"), **DESIRED)
    ax.set(xlim=limits["y"], ylim=limits["x"], zlim=limits["z"][::-1])
    extents = np.array([limits[axis][1] - limits[axis][0] for axis in ("y", "x", "z")])
    ax.set_box_aspect(np.maximum(extents / extents.max(), 0.6), zoom=0.9)
    ax.view_init(elev=24, azim=-58)
    ax.patch.set_visible(False)  # it reaches over the chart's last label
    for axis, name in ((ax.xaxis, "$y$ [m]"), (ax.yaxis, "$x$ [m]"), (ax.zaxis, "$z$ [m]")):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
        axis.set_label_text(name)
        axis.set_tick_params(pad=0)
        axis.set_pane_color((0.97, 0.97, 0.97))
        axis.labelpad = 0


def _track(eta: Mapping[str, Reals], axes: str) -> list[Reals]:
    """The named axes, each (n,) with n <= MAX_POINTS, the last row among them."""
    count = len(eta[axes[0]])
    rows = np.unique([*range(0, count, 1 + count // MAX_POINTS), count - 1])
    return [eta[axis][rows] for axis in axes]


def _extent(traces: Sequence[Trace], axis: str, margin: float) -> tuple[float, float]:
    """Lowest and highest coordinate of all tracks, desired ones too, with a margin on both sides [m]."""
    values = [eta[axis] for t in traces for eta in (t.vehicle.eta, t.vehicle.eta_d) if axis in eta]
    low, high = min(v.min() for v in values), max(v.max() for v in values)
    half = max(high - low, LEAST_EXTENT) * (0.5 + margin)
    return (low + high) / 2 - half, (low + high) / 2 + half
