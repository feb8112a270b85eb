"""Vehicles in other units than m and rad, and one metric in several units: numbers are converted, or told apart."""

import base64
import json
import re

import numpy as np
import pytest
from pymavlink import mavutil

import orchestrator
from experiments import single
from fmu_files import SOURCES
from orchestrator.models import build
from orchestrator.names import ANGLE_AXES
from orchestrator.records.compare.vehicles import vehicles
from peers.station import Station, free_port, named


@pytest.fixture(scope="module")
def fmus(_build_folder):
    """The FMUs of fmus/NAME.py, by name."""
    names = ("turning", "small_craft", "small_pilot", "millimetres", "metres")
    return dict(zip(names, build.build([str(SOURCES / f"{name}.py") for name in names]).values(), strict=True))


@pytest.fixture
def craft(fmus):
    """A vehicle in mm and deg, whose controller is given a reference in m and rad, converted."""
    turning = {"psi_0": np.radians(170.0), "rate": np.radians(40.0), "wraps": False}
    return {
        "master": {"stop_time": 1.0, "step": 0.01},
        "components": {
            "pilot": {"fmu": str(fmus["small_pilot"])},
            "craft": {"fmu": str(fmus["small_craft"])},
            "reference": {"fmu": str(fmus["turning"]), "parameters": turning},
        },
        "connections": {"pilot.eta_d": "reference.eta_d", "craft.u": "pilot.u"},
    }


EXPECTED = {"x": 0.1, "y": 0.0, "z": 2.0, "phi": 0.0, "theta": 0.0, "psi": np.radians(-150.0)}  # [m, rad] at 1 s


def test_figures_and_reports_have_a_vehicle_in_metres_and_radians(write, tmp_path, craft):
    with orchestrator.run(write(craft), output=tmp_path / "run.h5") as record:
        (vehicle,) = vehicles(record)
    assert {axis: values[-1] for axis, values in vehicle.eta.items()} == pytest.approx(EXPECTED)
    desired = {"x": 0.0, "y": 0.0, "z": 2.0, "phi": 0.0, "theta": 0.0, "psi": np.radians(210.0)}
    assert {axis: values[-1] for axis, values in vehicle.eta_d.items()} == pytest.approx(desired)


def test_a_telemetry_log_has_metres_and_radians(orch, write, tmp_path, craft):
    assert orch("run", write(craft), "--output", "run.h5", "--tlog", "run.tlog").code == 0
    log = mavutil.mavlink_connection(str(tmp_path / "run.tlog"), dialect="ardupilotmega")
    messages = list(iter(log.recv_match, None))
    attitude = named("ATTITUDE")(messages, 1)[-1]
    assert (attitude.time_boot_ms, attitude.yaw) == (1000, pytest.approx(EXPECTED["psi"], abs=1e-6))
    assert attitude.yawspeed == pytest.approx(np.radians(40.0))
    position = named("LOCAL_POSITION_NED")(messages, 1)[-1]
    assert (position.x, position.z) == pytest.approx((0.1, 2.0), abs=1e-3)
    assert abs(position.vx + 1j * position.vy) == pytest.approx(0.1)


def test_the_bridge_shows_metres_and_radians(orch, write, craft):
    listener = Station.udpin(port := free_port())
    endpoint = f"udpout:127.0.0.1:{port}"
    assert orch("run", write(craft), "--output", "run.h5", "--mavlink", endpoint, "--realtime", "2").code == 0
    position = listener.expect("LOCAL_POSITION_NED", lambda m: m.time_boot_ms > 500)
    listener.close()
    assert position.x == pytest.approx(0.1 * position.time_boot_ms / 1000, abs=1e-6)
    assert position.z == pytest.approx(2.0)


def test_quaternions_for_foxglove_keep_their_sign_where_a_heading_wraps(orch, write, tmp_path, craft):
    """170 + 40 t degrees passes 180 after 0.25 s: from row to row it turns by 0.4 degrees."""
    reader = pytest.importorskip("mcap.reader")
    assert orch("run", write(craft), "--output", "run.h5").code == 0
    assert orch("export", "run.h5", "--format", "mcap", "-o", "run.mcap").code == 0
    with (tmp_path / "run.mcap").open("rb") as file:
        poses = [
            json.loads(m.data)["pose"]
            for _, c, m in reader.make_reader(file).iter_messages()
            if c.topic == "/craft/pose"
        ]
    q = np.array([[pose["orientation"][axis] for axis in "xyzw"] for pose in poses])
    assert np.sum(q[1:] * q[:-1], axis=1) == pytest.approx(np.cos(np.radians(0.2)), abs=1e-6)
    assert poses[-1]["position"] == pytest.approx({"x": 0.0, "y": 0.1, "z": -2.0})  # east, north, up


@pytest.fixture
def two_units(fmus):
    """experiment(fmu): `one.eta.x` is at rest, 2 m, whatever its unit."""
    metrics = {"far": {"of": "rms", "signal": "one.eta.z"}}
    return lambda fmu: single(fmus[fmu], stop_time=0.1) | {"metrics": metrics}


@pytest.fixture
def both(orch, write, two_units):
    """Records of the same metric in mm and in m."""
    for name in ("millimetres", "metres"):
        assert orch("run", write(two_units(name), f"{name}.toml"), "--output", f"{name}.h5").code == 0
    return "millimetres.h5", "metres.h5"


def test_orch_diff_says_the_units_of_a_metric_that_has_others(orch, both):
    changes = {c["name"]: (c["before"], c["after"]) for c in orch("diff", *both, "--json").json}
    assert changes["metrics.far [mm]"] == (2000.0, None)
    assert changes["metrics.far [m]"] == (None, 2.0)


def test_a_report_has_a_row_for_each_unit_of_a_metric(orch, both, tmp_path):
    assert orch("report", *both, "-o", "page.html").code == 0
    page = (tmp_path / "page.html").read_text()
    rows = [row for row in page.split("<tr") if ">far<" in row]
    assert len(rows) == 2
    assert ["2000" in row for row in rows] == [True, False]
    assert [">mm<" in row for row in rows] == [True, False]


def test_a_figure_of_runs_in_several_units_has_one(orch, both, tmp_path):
    """2000 mm and 2 m are the same line, in the two colours of the runs."""
    assert orch("plot", *both, "--signals", "one.eta.z", "-o", "figure.svg").code == 0
    figure = (tmp_path / "figure.svg").read_text().lower()
    lines = [re.search(rf'<path d="([^"]*)"[^>]*stroke: {colour}', figure)[1] for colour in ("#0072b2", "#d55e00")]
    assert lines[0] == lines[1]
    assert "[mm]" in figure


def test_a_sweep_whose_contenders_give_a_metric_in_several_units_is_refused(orch, write, fmus, two_units):
    names = [str(fmus["millimetres"]), str(fmus["metres"])]
    table = two_units("metres") | {"sweep": {"vary": {"components.one.fmu": names}}}
    answer = orch("sweep", write(table), "--json")
    assert answer.code == 2
    assert "metrics.far: is in 'mm' and in 'm'" in answer.err
    table["metrics"] = {"far": {"of": "rms", "signal": "one.eta.z", "unit": "m"}}
    answer = orch("sweep", write(table))
    assert answer.code == 0, answer.err


def test_a_replay_turns_with_a_heading_that_wraps_and_not_back_between_two_rows(orch, write, tmp_path, craft):
    """Between two rows the page follows a line: from 179.8 to -179.8 degrees it would go by 0."""
    assert orch("run", write(craft), "--output", "run.h5").code == 0
    assert orch("report", "run.h5", "-o", "page.html").code == 0
    pose = re.search(r'"pose": ?\{"f4": ?"([^"]*)"', (tmp_path / "page.html").read_text())[1]
    psi = np.degrees(np.frombuffer(base64.b64decode(pose), "<f4").reshape(-1, 6)[:, 5])
    assert np.diff(psi) == pytest.approx(0.4, abs=1e-4)


def test_exports_say_which_signals_are_angles(orch, write, spiral, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    assert orch("run", write(spiral), "--output", "run.h5").code == 0
    assert orch("export", "run.h5", "--format", "parquet", "-o", "run.parquet").code == 0
    fields = parquet.read_schema(tmp_path / "run.parquet")
    angles = {field.name for field in fields if (field.metadata or {}).get(b"quantity") == b"angle"}
    assert angles == {f"{vector}.{axis}" for vector in ("vehicle.eta", "reference.eta_d") for axis in ANGLE_AXES}
