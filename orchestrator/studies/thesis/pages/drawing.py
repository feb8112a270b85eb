"""Draws the thesis's figures from records, as PNG and PDF.

    python -m orchestrator.studies.thesis.pages.drawing < JOB.json

Frames: NED and BODY; what is desired is dashed; the axes of z and of its error point down.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D

from ....records.file.run import Run
from ....views import figures
from ....views.figures.panels import DENSE, DESIRED, OKABE_ITO, Curve, Panel, band_key, draw_rows, symbol
from ..cases import signals
from ..cases.chapter5 import CASES
from ..cases.signals import Array, Track
from ..published.steps import STUDIED, STUDY_STEM
from .figures import FIGURES, ThesisFigure

DPI = 130
QUANTITIES = {  # Track's attributes, columns, names, units, least extent
    "position": ("eta", "eta_d", 0, ("x", "y", "z"), "m", 0.1),
    "attitude": ("eta", "eta_d", 3, ("phi", "theta", "psi"), "deg", 0.5),
    "velocity": ("nu", "nu_d", 0, ("u", "v", "w"), "m/s", 0.1),
    "angular_velocity": ("nu", "nu_d", 3, ("p", "q", "r"), "deg/s", 0.5),
}
FORCES = (("X", "N"), ("Y", "N"), ("Z", "N"), ("K", "N m"), ("M", "N m"), ("N", "N m"))
THRUSTERS = tuple(f"T{k}" for k in range(1, 7))
BODY_AXES = ("#D62728", "#2CA02C", "#7A3FB0")  # x red, as in the thesis
FRAMES_AT = (0.0, 6.0, 12.0, 18.0, 24.0, 30.0, 40.0)  # s
HELD = (12.0, 24.0)  # s
LATE = 8.0  # s, when what is left of the errors is small
Tracks = Mapping[str, list[Track]]


def main() -> None:
    """Draw what a job on stdin asks for: {"folder", "figures": [numbers], "records": {case: file}, "study": rows}."""
    job = json.load(sys.stdin)
    tracks: dict[str, list[Track]] = {}
    for number in job["figures"]:
        figure = FIGURES[number]
        for case in figure.cases:
            if case not in tracks:
                tracks[case] = _tracks(case, job["records"][case])
        write(canvas(figure, tracks), Path(job["folder"]) / figure.stem)
    if job["study"]:
        write(study_canvas(job["study"]), Path(job["folder"]) / STUDY_STEM)


def _tracks(case: str, record: str) -> list[Track]:
    with Run(record) as run:
        numbers = [""] if CASES[case].task == "spiral" else ["1", "2"]
        return [replace(signals.track(run, number), bounds=_bounds(run, number)) for number in numbers]


def _bounds(run: Run, number: str) -> dict[str, Array]:
    """The envelopes of the forces and the commands of a vehicle, as `Track.bounds`."""
    names = [f"vehicle{number}.tau.{axis}" for axis, _ in FORCES]
    names += [f"allocation{number}.u.{axis}" for axis in THRUSTERS]
    envelopes = {name.rpartition(".")[2]: run.envelope(name) for name in names}
    return {axis: bounds for axis, bounds in envelopes.items() if bounds is not None}


def write(drawn: Canvas, stem: Path) -> None:
    """Write a figure as .png and .pdf."""
    for suffix in (".png", ".pdf"):
        figures.save(drawn, stem.with_suffix(suffix), DPI)


def canvas(figure: ThesisFigure, tracks: Tracks) -> Canvas:
    """Draw one figure.  tracks: {case: its vehicles}."""
    with figures.style():
        return KINDS[figure.kind](figure, tracks)


def study_canvas(rows: list[dict[str, Any]]) -> Canvas:
    """The step study: each cell of the tables over the communication step.  rows: as thesis_steps.rows gives them."""
    with figures.style():
        drawn = Canvas(figsize=(9.0, 9.0), layout="constrained")
        axes = drawn.subplots(4, 3, sharex=True)
        keys = []
        for form, hue, marker in (("explicit", OKABE_ITO[1], "s"), ("semi-implicit", OKABE_ITO[0], "o")):
            of = [row for row in rows if row["integral"] == form]
            style: dict[str, Any] = {"color": hue, "marker": marker, "markersize": 4, "clip_on": False}
            for ax, (metric, unit) in zip(axes.flat, STUDIED.items(), strict=True):
                ax.semilogx([1e3 * row["step"] for row in of], [row[metric] for row in of], **style)
                kind, _, axis = metric.partition("_")
                ax.set_ylabel(f"{kind.upper()} {symbol(axis)} [{unit}]")
                ax.margins(x=0.06)
                if kind == "rms":
                    ax.set(yscale="log", ylim=(0.05, 1.1))
                    ax.set_yticks([0.05, 0.1, 0.2, 0.5, 1.0], ["0.05", "0.1", "0.2", "0.5", "1"])
                    ax.minorticks_off()
                elif axis == "phi":
                    ax.set_yscale("log")
            keys.append(Line2D([], [], label=f"{form} integral", **style))
        for ax, metric in zip(axes.flat, STUDIED, strict=True):
            if rows[0]["published"][metric]:
                ax.axhline(rows[0]["published"][metric], **DESIRED)
        for ax in axes[-1]:
            ax.set_xlabel("communication step [ms]")
        keys.append(Line2D([], [], label="published", **DESIRED))
        drawn.legend(handles=keys, loc="outside upper center", ncols=3)
        return drawn


def _states(figure: ThesisFigure, tracks: Tracks) -> Canvas:
    """Three components over time, and what was desired of them."""
    number = figure.options.get("vehicle", "1")
    track = tracks[figure.cases[0]][int(number) - 1]
    actual, desired, first, names, unit, span = QUANTITIES[figure.options["quantity"]]
    rows: list[list[Panel]] = []
    for k, name in enumerate(names):
        values, wanted = getattr(track, actual)[:, first + k], getattr(track, desired)[:, first + k]
        curves = [Curve(track.time, values, {"color": OKABE_ITO[k]})]
        if name not in ("theta", "q"):  # pitch is not controlled
            curves.append(Curve(track.time, wanted, dict(DESIRED)))
        rows.append([Panel(f"{symbol(name)} [{unit}]", curves, down=name == "z", span=span)])
    keys = [Line2D([], [], color="#444444", label="actual"), Line2D([], [], label="desired", **DESIRED)]
    return _over_time(rows, keys, height=1.5)


def _forces(figure: ThesisFigure, tracks: Tracks) -> Canvas:
    (track,) = tracks[figure.cases[0]]
    panels = [
        Panel(
            f"${name}$ [{unit}]",
            [Curve(track.time, track.tau[:, k], {"color": OKABE_ITO[0], **DENSE}, track.bounds.get(name))],
            span=2.0 if unit == "N" else 0.2,
        )
        for k, (name, unit) in enumerate(FORCES)
    ]
    rows = [[force, moment] for force, moment in zip(panels[:3], panels[3:], strict=True)]
    return _over_time(rows, _band_keys(track), height=1.5, width=8.5)


def _commands(figure: ThesisFigure, tracks: Tracks) -> Canvas:
    (track,) = tracks[figure.cases[0]]
    panels = [
        Panel(
            f"{symbol(name)} [-]",
            [Curve(track.time, track.u[:, k], {"color": OKABE_ITO[0], **DENSE}, track.bounds.get(name))],
            share="u",
            span=2.1,
        )
        for k, name in enumerate(THRUSTERS)
    ]
    return _over_time([[panels[i], panels[i + 1]] for i in (0, 2, 4)], _band_keys(track), height=1.5, width=8.5)


def _band_keys(track: Track) -> list[Artist]:
    return [band_key()] if track.bounds else []


def _errors(figure: ThesisFigure, tracks: Tracks) -> Canvas:
    """One axis's error under several controllers; of two vehicles a row each, the right column magnified."""
    axis = figure.options["axis"]
    angle = axis in ("phi", "theta", "psi")
    unit, fine, factor = ("deg", "deg", 1.0) if angle else ("m", "mm", 1e3)
    styles, bare = _palette(figure), symbol(axis).strip("$")
    gripping = CASES[figure.cases[0]].task == "gripping"
    rows: list[list[Panel]] = []
    for vehicle in range(len(tracks[figure.cases[0]])):
        index = str(vehicle + 1) if gripping else ""
        label = f"${bare}_{{{index}}} - {bare}_{{d{index}}}$" if gripping else f"${bare} - {bare}_d$"
        whole, late = [], []
        for case in figure.cases:
            track = tracks[case][vehicle]
            error = track.of(axis)
            whole.append(Curve(track.time, error, styles[case]))
            late.append(Curve(track.time, np.where(track.time >= LATE, factor * error, np.nan), styles[case]))
        row = [Panel(f"{label} [{unit}]", whole, down=axis == "z", span=0.5 if angle else 0.1)]
        if gripping:
            title = "" if rows else f"magnified, from {LATE:g} s"
            row.append(Panel(f"[{fine}]", late, title=title, down=axis == "z", span=0.2 if angle else 1.0))
        rows.append(row)
    return _over_time(rows, _keys(figure), *((2.3, 9.0) if gripping else (3.6, 7.0)))


def _distance(figure: ThesisFigure, tracks: Tracks) -> Canvas:
    return _formation(figure, tracks, signals.distance, 0.5, "distance [m]", 1e3, "distance - 0.5 m [mm]", 0.5)


def _heading(figure: ThesisFigure, tracks: Tracks) -> Canvas:
    label = r"$\psi_2 - \psi_1$"
    return _formation(
        figure, tracks, signals.heading_difference, 180.0, f"{label} [deg]", 1.0, rf"{label} - 180$^\circ$ [deg]", 0.1
    )


def _formation(
    figure: ThesisFigure,
    tracks: Tracks,
    measure: Callable[[Track, Track], Array],
    wanted: float,
    label: str,
    factor: float,
    magnified: str,
    span: float,
) -> Canvas:
    """How the vehicles lie to each other, and the same magnified while they hold the object."""
    styles, whole, near = _palette(figure), [], []
    for case in figure.cases:
        one, two = tracks[case]
        values = measure(one, two)
        held = (one.time >= HELD[0]) & (one.time <= HELD[1])
        whole.append(Curve(one.time, values, styles[case]))
        near.append(Curve(one.time, np.where(held, factor * (values - wanted), np.nan), styles[case]))
    time = whole[0].time
    whole.append(Curve(time, np.full(len(time), wanted), dict(DESIRED)))
    near.append(Curve(time, np.zeros(len(time)), dict(DESIRED)))
    rows = [[Panel(label, whole)], [Panel(magnified, near, title="magnified, while they hold the object", span=span)]]
    keys = [*_keys(figure), Line2D([], [], label="desired", **DESIRED)]
    drawn = _over_time(rows, keys, height=2.1)
    for ax in drawn.axes:
        ax.axvspan(*HELD, color="#f3efe0", zorder=0)
    return drawn


def _path(figure: ThesisFigure, tracks: Tracks) -> Canvas:
    """Trajectories in space with the bodies' axes, or on the chart, seen from above."""
    above = figure.options["view"] == "above"
    drawn = Canvas(figsize=(6.6, 5.6), layout="constrained")
    ax: Any = drawn.add_subplot(projection=None if above else "3d")
    vehicles = tracks[figure.cases[0]]
    keys = []
    for k, track in enumerate(vehicles):
        name = f"UUV{k + 1}" if len(vehicles) > 1 else "actual"
        columns = [track.eta[:, 1], track.eta[:, 0], track.eta[:, 2]]
        wanted = [track.eta_d[:, 1], track.eta_d[:, 0], track.eta_d[:, 2]]
        ax.plot(*columns[: 2 if above else 3], color=OKABE_ITO[k])
        ax.plot(*wanted[: 2 if above else 3], **DESIRED)
        keys.append(Line2D([], [], color=OKABE_ITO[k], label=name))
        _frames(ax, track, above, 0.4 if len(vehicles) > 1 else 0.25)
    keys.append(Line2D([], [], label="desired", **DESIRED))
    shown = BODY_AXES[:2] if above else BODY_AXES
    keys += [Line2D([], [], color=c, label=f"body {a}") for a, c in zip("xyz", shown, strict=False)]
    ax.set_xlabel("East $y$ [m]")
    ax.set_ylabel("North $x$ [m]")
    if above:
        ax.set_aspect("equal", adjustable="datalim")
        ax.margins(0.05)
    else:
        ax.set_zlabel("Depth $z$ [m]")
        ax.invert_zaxis()
        ax.set_aspect("equal" if len(vehicles) > 1 else "auto")
        ax.set_box_aspect(None, zoom=0.86)
        ax.view_init(elev=28, azim=-52)
    drawn.legend(handles=keys, loc="outside upper center", ncols=len(keys))
    return drawn


def _frames(ax: Any, track: Track, above: bool, length: float) -> None:
    """The body's axes at some instants."""
    at = np.searchsorted(track.time, [t for t in FRAMES_AT if t <= track.time[-1]])
    eta = track.eta[at] / signals.DEGREES
    R = signals.rotation(eta) * length
    for position, axes in zip(eta[:, :3], R, strict=True):
        for k, hue in enumerate(BODY_AXES[: 2 if above else 3]):
            ends = np.column_stack([position, position + axes[:, k]])[[1, 0, 2]]
            ax.plot(*ends[: 2 if above else 3], color=hue, linewidth=1.6, zorder=5)


def _over_time(rows: list[list[Panel]], keys: Sequence[Artist], height: float, width: float = 7.0) -> Canvas:
    drawn = Canvas(figsize=(width, 0.5 + height * len(rows) + (0.3 if keys else 0.0)), layout="constrained")
    draw_rows(drawn, rows)
    if keys:
        drawn.legend(handles=keys, loc="outside upper center", ncols=len(keys) if len(keys) <= 4 else 3)
    return drawn


def _palette(figure: ThesisFigure) -> dict[str, dict[str, Any]]:
    """A colour for each controller, the same in every figure; MFSOSMC's three time bases differ in their dashes."""
    order = ("mfsosmc", "pid", "feedback_linearization", "lyapunov", "nstsmc", "ftsosmc")
    hues = dict(zip(order, (0, 1, 2, 3, 1, 2), strict=True))
    dashes = {None: "-", 3: "-", 5: (0, (5, 1.5)), 7: (0, (1.5, 1))}
    styles = {}
    for name in figure.cases:
        case = CASES[name]
        styles[name] = {"color": OKABE_ITO[hues[case.controller]], "linestyle": dashes[case.t_b], "linewidth": 1.3}
    return styles


def _keys(figure: ThesisFigure) -> list[Line2D]:
    return [Line2D([], [], label=CASES[name].label, **style) for name, style in _palette(figure).items()]


KINDS: dict[str, Callable[[ThesisFigure, Tracks], Canvas]] = {
    "states": _states,
    "forces": _forces,
    "commands": _commands,
    "errors": _errors,
    "distance": _distance,
    "heading": _heading,
    "path": _path,
}

if __name__ == "__main__":
    main()
