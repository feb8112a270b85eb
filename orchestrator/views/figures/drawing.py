"""Figures of runs, as PNG, PDF or SVG: an overview of the vehicles, or chosen signals over time."""

from __future__ import annotations

import re
import textwrap
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ...errors import StoreError, did_you_mean
from ...fmu.units import conversion, readable
from ...names import matches, split_axis
from ...records.compare.labels import labels_of
from ...records.file.marks import COMPLETED, marked
from .. import figures, lines
from . import overview
from .panels import GREY, Curve, Panel, band_key, colour, draw_rows, plain, symbol

if TYPE_CHECKING:
    from matplotlib.artist import Artist

    from ...records.file.run import Run

WIDTH = 10.0  # inches
LEFT = 0.012  # where the title begins, of the width
LINE = 0.195  # inches, of a legend
TRACKS = 4.3  # inches, the height of the chart with its labels
MAX_PANELS = 200  # of one figure; matplotlib's images end at 65 536 pixels


def draw(runs: Sequence[Run], target: Path, signals: Sequence[str] = ()) -> Path:
    """Draw runs over each other and write the figure.

    target: its suffix, png, pdf or svg, is the format.  signals: globs over recorded signals; none gives the overview
    of the vehicles or, where there is no vehicle, all signals.
    Raises StoreError where there is nothing to draw, or the file has another suffix or cannot be written.
    """
    figures.target(target, [run.path for run in runs])
    for run in runs:
        if not len(run.time):
            raise StoreError(f"{run.path} holds no rows yet: there is nothing to plot")
    with figures.style():
        return figures.save(_figure(runs, signals), target)


@dataclass(frozen=True)
class Drawn:
    """time: of the last row [s].  running: whether a run has not ended yet."""

    time: float
    running: bool


def draw_files(paths: Sequence[Path], target: Path, signals: Sequence[str] = ()) -> Drawn:
    """`draw` records with the rows that they have now."""
    from ...records.file.run import Run

    runs = [Run(path) for path in paths]
    try:
        running = any(run.status == "running" for run in runs)
        draw(runs, target, signals)
        return Drawn(max(float(run.time[-1]) for run in runs), running)
    finally:
        for run in runs:
            run.close()


def following(paths: Sequence[Path], target: Path, signals: Sequence[str] = (), every: float = 1.0) -> Iterator[Drawn]:
    """`draw_files` repeatedly, with `every` seconds in between, until the runs have ended."""
    while True:
        drawn = draw_files(paths, target, signals)
        yield drawn
        if not drawn.running:
            return
        time.sleep(every)


def _figure(runs: Sequence[Run], signals: Sequence[str]) -> Figure:
    """From top to bottom: title and legend, tracks, panels over time."""
    traces = [] if signals else overview.traces(runs)
    rows = overview.rows(traces) if traces else [[panel] for panel in _chosen(runs, signals or ["*"])]
    legends: list[list[Artist]] = [keys for keys in (_run_keys(runs), overview.keys(traces)) if keys]
    if any(curve.bounds is not None for row in rows for panel in row for curve in panel.curves):
        legends = [*legends[:-1], [*(legends or [[]])[-1], band_key()]]
    head = 0.64 + sum(0.06 + LINE * -(-len(keys) // _columns(keys)) for keys in legends)
    tracks = TRACKS if traces else 0.0
    over_time = 0.4 + len(rows) * (1.2 if traces else 1.4)
    height = head + tracks + over_time
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = draw_rows(figure, rows)
    _write_head(figure, runs, legends)
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0.004, 0.04 / height, 0.992, (over_time - 0.04) / height), h_pad=0.05)
    engine.execute(figure)
    figure.set_layout_engine("none")
    if traces:
        left, right = axes[0].get_position().x0, max(ax.get_position().x1 for ax in axes)
        middle = left + 0.56 * (right - left)
        bottom, top = (over_time + 0.5) / height, (over_time + tracks - 0.1) / height
        overview.draw_chart(figure.add_axes((left, bottom, middle - left, top - bottom)), traces)
        bottom = (over_time + 0.2) / height
        overview.draw_space(figure.add_axes((middle, bottom, 0.975 - middle, top - bottom), projection="3d"), traces)
    return figure


def _write_head(figure: Figure, runs: Sequence[Run], legends: Sequence[Sequence[Artist]]) -> None:
    height = figure.get_figheight()
    titles = dict.fromkeys(str(run.attributes["title"] or run.attributes["experiment"]) for run in runs)
    facts = [_facts(run) for run in runs]
    common = [fact for fact in facts[0] if all(fact in others for others in facts)]
    lines: list[tuple[list[str], float, int, dict[str, Any]]] = [
        (list(titles), 0.13, 100, {"weight": "bold", "size": 12}),
        (common if len(runs) == 1 else [f"{len(runs)} runs", *common], 0.38, 150, {"color": GREY}),
    ]
    for parts, down, limit, style in lines:
        text = textwrap.shorten("  ·  ".join(parts), limit, placeholder=" …")
        figure.text(LEFT, 1 - down / height, text, va="top", parse_math=False, **style)
    down = 0.62
    for keys in legends:
        figure.legend(
            handles=keys,
            loc="upper left",
            bbox_to_anchor=(LEFT, 1 - down / height),
            ncols=_columns(keys),
            borderaxespad=0,
            borderpad=0,
            handlelength=2.0,
            columnspacing=1.6,
            labelspacing=0.3,
        )
        down += 0.06 + LINE * -(-len(keys) // _columns(keys))


def _columns(keys: Sequence[Artist]) -> int:
    """As many columns of a legend as fit beside each other."""
    widths = [len(str(key.get_label())) + 7 for key in keys]
    return len(keys) if sum(widths) <= 120 else max(1, 120 // max(widths))


def _facts(run: Run) -> list[str]:
    """What ran, for the line below the title."""
    attributes = run.attributes
    models = dict.fromkeys(str(c["fmu"]) for c in attributes["experiment_resolved"]["components"])
    facts = [f"run {run.run_id}", f"{attributes['algorithm']}, step {attributes['step']:g} s", ", ".join(models)]
    if run.status != COMPLETED:
        facts.insert(1, f"{run.status} at t = {attributes.get('failed_at', run.time[-1]):.6g} s")
    return [facts[0], *(mark for mark in run.standing.marks if mark != run.status), *facts[1:]]


def _run_keys(runs: Sequence[Run]) -> list[Artist]:
    """The colour of each run and how it differs from the others."""
    if len(runs) == 1:
        return []
    keys: list[Artist] = []
    for i, (run, what) in enumerate(zip(runs, labels_of([run.resolved for run in runs]), strict=True)):
        label = f"{run.run_id}  {marked(run.standing, what)}".rstrip()
        keys.append(Line2D([], [], color=colour(i), label=plain(label)))
    return keys


def _chosen(runs: Sequence[Run], globs: Sequence[str]) -> list[Panel]:
    """A panel for each vector and unit that the globs choose or, of several runs, for each signal."""
    units = {name: run.units(name) for run in reversed(runs) for name in run.signals if _is_number(run, name)}
    for glob in globs:
        if not any(matches(name, glob) for name in units):
            vectors = dict.fromkeys(name.rpartition(".")[0] for name in units)
            raise StoreError(f"no recorded signal matches {glob!r}{did_you_mean(glob, [*vectors, *units], 'recorded')}")
    panels: dict[tuple[str, str], list[str]] = {}
    for name, unit in units.items():
        if any(matches(name, glob) for glob in globs):
            vector, axis = _split(name)
            alone = len(runs) > 1 or not axis or _is_depth(axis, unit)
            panels.setdefault((name if alone else vector, unit), []).append(name)
    if not panels:
        raise StoreError(f"{runs[0].path} holds no numbers: there is nothing to plot")
    if len(panels) > MAX_PANELS:
        raise StoreError(f"{len(panels)} panels are more than the {MAX_PANELS} of a figure; use --signals")
    return [_panel(runs, title, names, unit) for (title, unit), names in panels.items()]


def _panel(runs: Sequence[Run], title: str, names: Sequence[str], unit: str) -> Panel:
    """Signals that share a unit, angles in degrees; the components of an array side by side."""
    shown, _ = readable(unit)
    symbols = [symbol(_split(name)[1] or name.rpartition(".")[2]) for name in names]
    curves: list[Curve] = []
    for i, run in enumerate(runs):
        for name, label in zip(names, symbols, strict=True):
            if name not in run.signals:
                continue
            factor, offset = _conversion(run, name, unit, shown)
            columns = np.asarray(run[name], float).reshape(len(run.time), -1).T * factor + offset
            for k, values in enumerate(columns):
                style = {"color": colour(i if len(runs) > 1 else len(curves)), "linewidth": 1.0, "alpha": 0.9}
                if len(columns) > 1 and i == 0:
                    style["label"] = f"{label} {k + 1}"
                elif len(names) > 1:
                    style["label"] = label
                turn = lines.TURN if shown == "deg" and run.is_angle(name) else 0.0
                bounds = run.envelope(name)
                shown_bounds = None if bounds is None else bounds * factor + offset
                curves.append(Curve(run.time, values, style, shown_bounds, turn))
    text = f"{symbols[0]} … {symbols[-1]}" if len(symbols) > 3 else ", ".join(symbols)
    return Panel(f"{text} [{_printed(shown)}]", curves, plain(title), down=_is_depth(_split(names[0])[1], unit))


def _conversion(run: Run, name: str, unit: str, shown: str) -> tuple[float, float]:
    """Factor and offset from the unit of a signal in a run to the one that is shown, that of `unit` for people.

    Raises StoreError where the signal measures something else in this run.
    """
    own = run.units(name)
    if own == shown:
        return 1.0, 0.0
    try:
        return conversion(own, {}, shown, {})
    except ValueError as error:
        raise StoreError(f"{name} is in {own!r} in {run.path}, and in {unit!r} in another run: {error}") from None


def _split(name: str) -> tuple[str, str]:
    """("vehicle1.eta", "x") of "vehicle1.eta.x"; (name, "") of a scalar."""
    component, _, variable = name.partition(".")
    head, axis = split_axis(variable)
    return f"{component}.{head}", axis


def _is_depth(axis: str, unit: str) -> bool:
    return axis == "z" and unit == "m"


def _is_number(run: Run, name: str) -> bool:
    return bool(np.issubdtype(run.dtype(name), np.number))


def _printed(unit: str) -> str:
    """m/s2 with a superscript, N.m with a raised dot, - for none."""
    return "-" if unit in ("", "1") else re.sub(r"(?<=[a-z])(-?\d)", r"$^{\1}$", plain(unit).replace(".", "·"))
