"""orch plot: what is in the figure.  Figures are read back as SVG, where every text stands in a comment."""

import json
import re
import shutil
import tomllib
import xml.etree.ElementTree as ET
from itertools import pairwise

import h5py
import numpy as np
import pytest

import orchestrator
from experiments import EXPERIMENTS, merged, toml
from fmu_files import SOURCES
from orchestrator.errors import OrchError, StoreError
from orchestrator.models import build
from orchestrator.records.compare.vehicles import vehicles
from orchestrator.views.figures.drawing import draw

SVG = "{http://www.w3.org/2000/svg}"
ONE = [
    "$x$ [m]",
    "$y$ [m]",
    "$z$ [m]",
    r"$\phi$ [deg]",
    r"$\theta$ [deg]",
    r"$\psi$ [deg]",
    "$x - x_d$ [m]",
    "$y - y_d$ [m]",
    "$z - z_d$ [m]",
    *(f"$T_{{{i}}}$ [-]" for i in range(1, 7)),
]
TWO = ["distance [m]", r"$\psi_2 - \psi_1$ [deg]", "$z_2 - z_1$ [m]"]
CHART = ["East $y$ [m]", "North $x$ [m]"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("plots")


@pytest.fixture(scope="module")
def spiral_run(folder):
    """One vehicle under PID for two seconds, in a current."""
    changes = {"master.stop_time": 2.0, "components.current.parameters.velocity": [0.75, 0.25, 0.3]}
    return orchestrator.run(EXPERIMENTS / "spiral_pid.toml", changes, output=folder / "spiral.h5")


@pytest.fixture(scope="module")
def gripping_run(folder):
    """Two vehicles under PID for two seconds, in still water."""
    pid = {"controller1": "pid", "controller2": "pid"}
    changes = {"master.stop_time": 2.0, "master.step": 1e-3}
    return orchestrator.run(EXPERIMENTS / "gripping.toml", changes, pid, output=folder / "gripping.h5")


@pytest.fixture(scope="module")
def spiral_figure(spiral_run, folder):
    return Figure(draw([spiral_run], folder / "spiral.svg"))


@pytest.fixture(scope="module")
def gripping_figure(gripping_run, folder):
    return Figure(draw([gripping_run], folder / "gripping.svg"))


@pytest.fixture
def changed(tmp_path):
    """changed(run, change, name): a copy of the record after change(its open file)."""

    def make(run, change, name="changed.h5"):
        shutil.copy(run.path, tmp_path / name)
        with h5py.File(tmp_path / name, "r+") as file:
            change(file)
        return orchestrator.open_run(tmp_path / name)

    return make


class Figure:
    """A figure read back.  panels: {label of the vertical axis: {tick: height in the picture, growing downward}}."""

    def __init__(self, path):
        root = ET.parse(path, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))).getroot()
        self.texts = _texts(root)
        self.axes = [g for g in root.iter(f"{SVG}g") if re.fullmatch(r"axes_\d+", g.get("id", ""))]
        self.panels = {}
        for ax in self.axes:
            ticks = {}
            vertical = [g for g in ax.iter(f"{SVG}g") if any("ytick" in below.get("id", "") for below in g)]
            for group in vertical:
                for below in group:
                    if "ytick" in below.get("id", ""):
                        height = [float(use.get("y")) for use in below.iter(f"{SVG}use") if use.get("y")]
                        ticks[float(_texts(below)[-1].replace("\N{MINUS SIGN}", "-"))] = height[0]
                    elif below.get("id", "").startswith("text"):
                        self.panels[_texts(below)[0]] = ticks

    def values(self, label, style):
        """[(x in the picture, value)] of each subpath whose style has a text, of the panel with that label."""
        ax = self.axes[list(self.panels).index(label)]
        (low, below), *_, (high, above) = sorted(self.panels[label].items())
        paths = []
        for path in ax.iter(f"{SVG}path"):
            if style in path.get("style", "") and len(points := re.findall(r"([ML]) (\S+) (\S+)", path.get("d"))) > 1:
                for letter, x, y in points:
                    if letter == "M":
                        paths.append([])
                    paths[-1].append((float(x), low + (float(y) - below) / (above - below) * (high - low)))
        return paths

    def points_down(self, label):
        ticks = sorted(self.panels[label].items())
        return ticks[0][1] < ticks[-1][1]


BAND = "opacity: 0.3"  # in the style of a band
KEY = "least to greatest between rows"
LINE = "fill: none; stroke: #0072b2"


def _texts(element):
    return [e.text.strip() for e in element.iter() if e.tag is ET.Comment]


def test_the_overview_of_one_vehicle_has_every_panel_with_its_unit(spiral_figure):
    assert list(spiral_figure.panels) == [*ONE, CHART[1]]
    assert len(spiral_figure.axes) == len(ONE) + 3  # the chart, the space, the current
    assert {*CHART, "$t$ [s]", "vehicle", "desired", "start", "end", "heading"} <= {*spiral_figure.texts}


def test_the_overview_of_two_vehicles_has_their_formation(gripping_figure):
    assert list(gripping_figure.panels) == [*ONE, *TWO, CHART[1]]
    assert {"vehicle1", "vehicle2"} <= {*gripping_figure.texts}


def test_depth_points_down_and_all_else_up(gripping_figure):
    down = [label for label in gripping_figure.panels if gripping_figure.points_down(label)]
    assert down == ["$z$ [m]", "$z - z_d$ [m]", "$z_2 - z_1$ [m]"]


def test_the_current_is_drawn_where_there_is_one(spiral_figure, gripping_figure):
    assert "0.85 m/s" in spiral_figure.texts
    assert "current" in spiral_figure.texts
    assert "current" not in gripping_figure.texts


def test_the_heading_difference_starts_near_zero_and_does_not_jump_by_a_turn(gripping_run, gripping_figure):
    turn = np.degrees(gripping_run["vehicle2.eta.psi"] - gripping_run["vehicle1.eta.psi"])
    ticks = gripping_figure.panels[TWO[1]]
    margin = 0.06 * (turn.max() - turn.min())  # matplotlib leaves 5 % above and below a curve
    assert turn.max() > 100
    assert turn.min() - margin < min(ticks) <= max(ticks) < turn.max() + margin


@pytest.mark.parametrize(("suffix", "start"), [(".PNG", b"\x89PNG"), (".pdf", b"%PDF")])
def test_png_and_pdf_are_written_and_the_same_figure_is_the_same_bytes(spiral_run, tmp_path, suffix, start):
    first, second = (
        draw([spiral_run], tmp_path / f"{name}{suffix}", ["vehicle.eta"]).read_bytes() for name in ("new/one", "two")
    )
    assert first.startswith(start)
    assert first == second


def test_the_command_draws_runs_over_each_other_and_says_what_differs(orch, write, spiral, spiral_run, tmp_path):
    other = orch("run", write(spiral), "--set", "components.controller.parameters.K_p.z=60", "-o", "other.h5")
    assert other.code == 0, other.err
    answer = orch("plot", spiral_run.path, "other.h5", "-o", "both.svg")
    assert (answer.code, answer.out, answer.err) == (0, "both.svg\n", "")
    texts = Figure(tmp_path / "both.svg").texts
    assert any(spiral_run.run_id in text and "velocity = (0.75, 0.25, 0.3)" in text for text in texts)
    assert any("controller.K_p.z = 60" in text and "velocity = (0, 0, 0)" in text for text in texts)


def test_without_a_name_the_figure_lies_beside_the_record(orch, spiral_run, tmp_path):
    shutil.copy(spiral_run.path, tmp_path / "mine.h5")
    assert orch("plot", "mine.h5", "--signals", "vehicle.eta.z").out == "mine.png\n"
    assert (tmp_path / "mine.png").stat().st_size > 5_000


def test_signals_are_grouped_by_vector_and_unit(spiral_run, tmp_path):
    figure = Figure(draw([spiral_run], tmp_path / "f.svg", ["vehicle.eta", "allocation.u.*"]))
    angles = r"$\phi$, $\theta$, $\psi$ [deg]"
    assert list(figure.panels) == ["$T_{1}$ … $T_{6}$ [-]", "$x$, $y$ [m]", "$z$ [m]", angles]
    assert figure.points_down("$z$ [m]")
    assert not figure.points_down("$x$, $y$ [m]")


def test_of_several_runs_every_signal_has_its_panel(spiral_run, gripping_run, tmp_path):
    figure = Figure(draw([spiral_run, gripping_run], tmp_path / "f.svg", ["vehicle?.nu.[ur]", "*.eta.z"]))
    titles = ["vehicle1.eta.z", "vehicle1.nu.u", "vehicle1.nu.r", "vehicle2.eta.z", "vehicle2.nu.u", "vehicle2.nu.r"]
    assert [text for text in figure.texts if text.startswith("vehicle")] == [*titles, "vehicle.eta.z"]


def test_an_unknown_signal_names_the_nearest_one(orch, spiral_run):
    answer = orch("plot", spiral_run.path, "-o", "f.png", "--signals", "vehicle.etta.*")
    assert answer.code == 2
    assert "no recorded signal matches 'vehicle.etta.*'; did you mean 'vehicle.eta" in answer.err


def test_an_unknown_format_names_the_three(orch, spiral_run, tmp_path):
    answer = orch("plot", spiral_run.path, "-o", "f.jpg")
    assert answer.code == 2
    assert "f.jpg: a figure is a .png, .pdf or .svg file" in answer.err
    with pytest.raises(OrchError, match=r"\.png, \.pdf or \.svg"):
        draw([spiral_run], tmp_path / "without")


def test_a_folder_that_cannot_be_made_is_an_error_message(spiral_run, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match=r"f\.png cannot be written"):
        draw([spiral_run], tmp_path / "file" / "f.png", ["vehicle.eta"])


def test_a_record_without_rows_is_an_error_message(changed, spiral_run, tmp_path):
    with pytest.raises(StoreError, match="holds no rows yet"):
        draw([changed(spiral_run, lambda file: file["time"].resize((0,)))], tmp_path / "f.png")


def test_a_run_that_failed_after_its_first_row_is_drawn_and_says_so(changed, spiral_run, tmp_path):
    def fail(file):
        file["time"].resize((1,))
        file.attrs.update(status="failed", failed_at=0.005)

    figure = Figure(draw([changed(spiral_run, fail)], tmp_path / "f.svg"))
    assert list(figure.panels) == [*ONE, CHART[1]]
    assert any("failed at t = 0.005 s" in text for text in figure.texts)


def test_figures_say_which_runs_ended_early_or_warned(changed, spiral_run, tmp_path):
    def end(file):
        file.attrs["stopped_at"] = 0.04
        file.attrs.update(warnings='["it is wrong"]', warning_kinds='["unstable"]')

    ended = changed(spiral_run, end)
    words = "ended early at 0.04 s", "warned: unstable at this step"
    alone = Figure(draw([ended], tmp_path / "f.svg"))
    assert all(any(word in text for text in alone.texts) for word in words)
    both = Figure(draw([ended, spiral_run], tmp_path / "g.svg"))
    assert any(f"{ended.run_id}  ({'; '.join(words)})" in text for text in both.texts)


def test_what_is_not_recorded_leaves_no_empty_panel(changed, spiral_run, tmp_path):
    def forget(file):
        for name in ("reference", "allocation", "current"):
            del file[name]

    figure = Figure(draw([changed(spiral_run, forget)], tmp_path / "f.svg"))
    assert list(figure.panels) == [*ONE[:6], CHART[1]]
    assert not {"desired", "current"} & {*figure.texts}


def test_a_run_without_a_vehicle_shows_its_signals(changed, spiral_run, tmp_path):
    def forget(file):
        for name in ("vehicle", "controller", "reference"):
            del file[name]

    figure = Figure(draw([changed(spiral_run, forget)], tmp_path / "f.svg"))
    assert list(figure.panels) == ["$T_{1}$ … $T_{6}$ [-]", "$x$, $y$, $z$ [m/s]"]


def test_the_reference_is_found_along_the_connections_not_by_name(changed, gripping_run):
    def cross(file):
        resolved = json.loads(file.attrs["experiment_resolved"])
        swap = {"reference1": "reference2", "reference2": "reference1"}
        for pair in resolved["connections"]:
            component, _, variable = pair[1].partition(".")
            pair[1] = f"{swap.get(component, component)}.{variable}"
        file.attrs["experiment_resolved"] = json.dumps(resolved)

    for run, references in ((gripping_run, "12"), (changed(gripping_run, cross), "21")):
        for vehicle, number in zip(vehicles(run), references, strict=True):
            assert list(vehicle.eta_d) == ["x", "y", "z", "phi", "theta", "psi"]
            assert (vehicle.eta_d["y"] == run[f"reference{number}.eta_d.y"]).all()
            assert (vehicle.u["T3"] == run[f"allocation{vehicle.name[-1]}.u.T3"]).all()


def test_a_set_point_that_the_experiment_gives_as_start_value_is_the_reference(changed, spiral_run):
    def hold(file):
        resolved = json.loads(file.attrs["experiment_resolved"])
        resolved["connections"] = [pair for pair in resolved["connections"] if ".eta_d." not in pair[0]]
        controller = next(c for c in resolved["components"] if c["name"] == "controller")
        controller["start"] = {"eta_d.x": 0.5, "eta_d.z": 3.0}
        file.attrs["experiment_resolved"] = json.dumps(resolved)

    run = changed(spiral_run, hold)
    (vehicle,) = vehicles(run)
    assert {axis: set(values) for axis, values in vehicle.eta_d.items()} == {"x": {0.5}, "z": {3.0}}
    assert len(vehicle.eta_d["x"]) == len(run.time)


def test_a_long_signal_is_thinned_without_losing_its_peak(changed, spiral_run, tmp_path):
    rows = 200_000

    def lengthen(file):
        del file["_envelope"]
        values = np.sin(np.arange(rows))
        values[123_456] = 1e3
        for name, array in (("time", np.arange(rows) * 1e-3), ("allocation/u.T1", values)):
            attributes = {key: file[name].attrs[key] for key in ("units", "causality") if key in file[name].attrs}
            del file[name]
            file[name] = array
            file[name].attrs.update(attributes)

    path = draw([changed(spiral_run, lengthen)], tmp_path / "f.svg", ["allocation.u.T1"])
    assert max(Figure(path).panels["$T_{1}$ [-]"]) >= 750
    assert path.stat().st_size < 500_000


# --- Bands and angles -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def chattering_run(folder):
    """A relay at a step that is too long for it: the commands alternate from step to step, and a row is ten steps."""
    changes = {"record.every": 0.01, "master.stop_time": 10.0}
    path = EXPERIMENTS / "spiral_pid.toml"
    return orchestrator.run(path, changes, {"controller": "mfsosmc"}, output=folder / "chattering.h5")


@pytest.fixture(scope="module")
def turning_run(folder):
    """A reference that turns by 3 rad/s and wraps at half a turn, with its envelope; the vehicle is left behind."""
    turning = build.build([str(SOURCES / "turning.py")])["turning"]
    table = tomllib.loads((EXPERIMENTS / "spiral_pid.toml").read_text())
    changes = {
        "master.stop_time": 5.0,
        "components.reference": {"fmu": str(turning), "parameters": {"psi_0": 0.0, "rate": 3.0, "wraps": True}},
        "record": {"every": 0.01, "envelope": ["reference.eta_d"]},
        "metrics": {},
    }
    path = folder / "turning.toml"
    path.write_text("\n".join(f"{key} = {toml(value)}" for key, value in merged(table, changes).items()))
    return orchestrator.run(path, output=folder / "turning.h5")


def test_a_band_shows_the_oscillation_that_rows_do_not(chattering_run, tmp_path):
    rows, envelope = chattering_run["allocation.u.T1"][1:], chattering_run.envelope("allocation.u.T1")[1:]
    assert rows.min() > 0.0  # as if it pushed one way only
    assert envelope.min() == -1.0
    for signals, label in (((), "$T_{1}$ [-]"), (["allocation.u.T1"], "$T_{1}$ [-]")):
        figure = Figure(draw([chattering_run], tmp_path / "f.svg", signals))
        (band,) = figure.values(label, BAND)
        values = [value for _, value in band]
        assert min(values) == pytest.approx(envelope.min(), abs=0.01)  # px
        assert max(values) == pytest.approx(envelope.max(), abs=0.01)
        assert figure.texts.count(KEY) == 1


def test_the_band_of_a_row_lies_over_the_steps_since_the_row_before(chattering_run, changed, tmp_path):
    rows = 11

    def pulse(file):
        file["time"].resize((rows,))
        values = np.zeros((rows, 2))
        values[5] = -0.5, 0.25
        file["allocation/u.T1"][:rows], file["_envelope/allocation/u.T1"][:rows] = 0.0, values

    run = changed(chattering_run, pulse)
    figure = Figure(draw([run], tmp_path / "f.svg", ["allocation.u.T1"]))
    (band,), (line,) = (figure.values("$T_{1}$ [-]", style) for style in (BAND, LINE))
    left, right = line[0][0], line[-1][0]
    wide = {round((x - left) / (right - left) * (rows - 1), 2) for x, value in band if abs(value) > 0.2}
    assert wide == {4.0, 5.0}


def test_the_band_follows_the_scale_of_a_connection(chattering_run, changed):
    def scale(file):
        resolved = json.loads(file.attrs["experiment_resolved"])
        for pair in resolved["connections"]:
            if pair[0] == "vehicle.u.T1":
                pair[2:] = [-2.0, 0.5]
        file.attrs["experiment_resolved"] = json.dumps(resolved)

    (vehicle,) = vehicles(changed(chattering_run, scale))
    least, greatest = chattering_run.envelope("allocation.u.T1").T
    assert (vehicle.bounds["u", "T1"] == np.column_stack([0.5 - 2 * greatest, 0.5 - 2 * least])).all()
    (plain,) = vehicles(chattering_run)
    assert (plain.bounds["u", "T2"] == chattering_run.envelope("allocation.u.T2")).all()


def test_a_run_that_records_every_step_or_no_envelope_has_no_band(spiral_figure, orch, write, spiral, tmp_path):
    assert KEY in spiral_figure.texts  # every 10 steps
    changes = ({"record.every": 1e-3}, {"record.envelope": False})
    for change in changes:
        assert orch("run", write(merged(spiral, change)), "-o", "f.h5").code == 0
        assert orch("plot", "f.h5", "-o", "f.svg").code == 0
        assert KEY not in Figure(tmp_path / "f.svg").texts


def jumps(piece):
    """Where a line goes through more than half a turn within a few points of the picture."""
    return [a for (x, a), (y, b) in pairwise(piece) if abs(b - a) > 180.0 and abs(y - x) < 5.0]


def test_an_angle_that_wraps_leaves_a_gap(turning_run, tmp_path):
    """Also in its band: of what was on both ends of a turn, neither end is between."""
    wraps = int((abs(np.diff(turning_run["reference.eta_d.psi"])) > np.pi).sum())
    assert wraps == 2
    figure = Figure(draw([turning_run], tmp_path / "f.svg", ["reference.eta_d.psi"]))
    pieces = figure.values(r"$\psi$ [deg]", LINE)
    assert len(pieces) == wraps + 1
    bands = figure.values(r"$\psi$ [deg]", BAND)
    assert len(bands) == wraps + 1
    assert not any(map(jumps, (*pieces, *bands)))
    overview = Figure(draw([turning_run], tmp_path / "g.svg"))
    desired = overview.values(r"$\psi$ [deg]", "stroke-dasharray")
    assert len(desired) == wraps + 1
    assert not any(map(jumps, desired))


def test_an_angle_that_wraps_there_and_back_between_rows_has_no_band_there(turning_run, changed, tmp_path):
    def sway(file):
        file["reference/eta_d.psi"][50:54] = 3.13
        file["_envelope/reference/eta_d.psi"][52] = -3.14, 3.14

    figure = Figure(draw([changed(turning_run, sway)], tmp_path / "f.svg", ["reference.eta_d.psi"]))
    assert len(figure.values(r"$\psi$ [deg]", BAND)) == 4
    assert len(figure.values(r"$\psi$ [deg]", LINE)) == 3


def test_a_number_that_is_no_angle_is_drawn_with_its_jumps(turning_run, changed, tmp_path):
    def forget(file):
        del file["reference/eta_d.psi"].attrs["quantity"]

    figure = Figure(draw([changed(turning_run, forget)], tmp_path / "f.svg", ["reference.eta_d.psi"]))
    (piece,) = figure.values(r"$\psi$ [deg]", LINE)
    assert len(jumps(piece)) == 2


def test_a_gap_in_a_signal_stays_one(changed, chattering_run, tmp_path):
    def cut(file):
        file["allocation/u.T1"][300:500] = np.nan
        file["_envelope/allocation/u.T1"][300:500] = np.nan

    figure = Figure(draw([changed(chattering_run, cut)], tmp_path / "f.svg", ["allocation.u.T1"]))
    assert len(figure.values("$T_{1}$ [-]", BAND)) == 2
