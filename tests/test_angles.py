"""Angles are on the circle."""

import tomllib
import zipfile

import h5py
import numpy as np
import pytest

import orchestrator
from experiments import EXPERIMENTS, merged
from fmu_files import SOURCES
from orchestrator.models import build
from orchestrator.names import ANGLE_AXES

CONTROLLERS = ("pid", "feedback_linearization", "lyapunov", "mfsosmc", "nstsmc", "ftsosmc")


@pytest.fixture(scope="module")
def turning(_build_folder):
    """The FMU of fmus/turning.py, as the controllers' reference."""
    return build.build([str(SOURCES / "turning.py")])["turning"]


@pytest.fixture
def heading(turning, write, tmp_path):
    """heading(controller, vehicle's start, reference's start, rate, ...) -> time [s], psi and psi_d [deg] of a run."""
    table = tomllib.loads((EXPERIMENTS / "spiral_pid.toml").read_text())

    def run(controller, start, psi_0, rate=0.0, wraps=True, packaging="auto", stop_time=4.0):
        changes = {
            "master.stop_time": stop_time,
            "master.step": 2e-4 if controller == "mfsosmc" else 2e-3,
            "components.controller.fmu": controller,
            "components.vehicle.parameters": {
                "eta_0": [0, 0, 2, 0, 0, np.radians(start)],
                "nu_0": [0, 0, 0, 0, 0, np.radians(rate)],
            },
            "components.reference": {
                "fmu": str(turning),
                "parameters": {"psi_0": np.radians(psi_0), "rate": np.radians(rate), "wraps": wraps},
            },
            "metrics": {},
        }
        path = write(merged(table, changes))
        with orchestrator.run(path, packaging=packaging, results=tmp_path / "results") as record:
            psi, psi_d = (np.degrees(record[name]) for name in ("vehicle.eta.psi", "reference.eta_d.psi"))
            return record.time, psi, psi_d

    return run


@pytest.mark.parametrize("packaging", ["native", "python"])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_controller_turns_the_short_way_round(heading, controller, packaging):
    """From -170 to +170 degrees it is 20 degrees to port, and 340 to starboard."""
    _, psi, _ = heading(controller, -170.0, 170.0, packaging=packaging)
    assert psi.max() <= -170.0 + 1.0  # never to starboard
    assert psi.min() > -190.0 - 10.0  # half the way of overshoot
    assert psi[-1] == pytest.approx(-190.0, abs=3.0)


@pytest.mark.parametrize("packaging", ["native", "python"])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_reference_that_wraps_is_followed_as_one_that_does_not(heading, controller, packaging):
    """The reference passes +180 degrees after 0.5 s; the run is that of the continuous one."""
    given = {"start": 170.0, "psi_0": 170.0, "rate": 20.0, "stop_time": 1.0, "packaging": packaging}
    time, psi, psi_d = heading(controller, wraps=True, **given)
    assert psi_d.min() < -169.0  # it did jump
    np.testing.assert_allclose(psi, 170.0 + 20.0 * time, atol=3.0)
    _, continuous, _ = heading(controller, wraps=False, **given)
    np.testing.assert_allclose(psi, continuous, atol=0.02)  # degrees; relays amplify the rounding of the remainder


def test_a_record_says_which_of_its_signals_are_angles(spiral, write, tmp_path):
    with orchestrator.run(write(spiral), results=tmp_path / "results") as record:
        angles = {name for name in record.signals if record.is_angle(name)}
        with h5py.File(record.path, "r", locking=False) as file:
            assert file["vehicle/eta.psi"].attrs["quantity"] == "angle"
    assert angles == {f"{vector}.{axis}" for vector in ("vehicle.eta", "reference.eta_d") for axis in ANGLE_AXES}


def test_an_angle_of_more_than_a_turn_is_reported_as_degrees(orch, write, spiral):
    """eta_0 is in rad: 90 of them are 14 turns and 2.035 rad; 6.28 rad are less than a turn."""
    degrees, turn = (
        write(merged(spiral, {"components.vehicle.parameters.eta_0": [2, -1, 1, 0, 0, psi]}), f"{psi}.toml")
        for psi in (90, 6.28)
    )
    words = "vehicle: eta_0.psi = 90 rad is more than a full turn; 90 degrees are 1.571 rad"
    assert words in orch("check", degrees, "--json").json["notes"]
    assert words in orch("run", degrees, "--json").json["warnings"]
    assert orch("check", turn, "--json").json["notes"] == []


@pytest.fixture
def poses(turning, write):
    """Two references that turn alike, one of them in +-180 degrees, and positions in mm beside positions in m."""
    table = {"master": {"stop_time": 1.0, "step": 0.01}, "components": {}, "metrics": {}}
    for name, wraps in (("wrapped", True), ("continuous", False)):
        parameters = {"psi_0": np.radians(170.0), "rate": np.radians(40.0), "wraps": wraps}
        table["components"][name] = {"fmu": str(turning), "parameters": parameters}
    table["components"]["small"] = {"fmu": str(build.build([str(SOURCES / "millimetres.py")])["millimetres"])}
    return lambda metrics: merged(table, {"metrics": metrics})


WRAPPED, CONTINUOUS = "wrapped.eta_d.psi", "continuous.eta_d.psi"


def test_differences_of_angles_are_on_the_circle_in_metrics(orch, write, poses):
    """170 + 40 t degrees, as it is and in +-180 degrees: the error is 0, and 360 degrees where turns are meant."""
    both = {"signal": WRAPPED, "reference": CONTINUOUS, "unit": "deg"}
    metrics = {
        "rmse": {"of": "rmse", **both},
        "largest": {"of": "max_abs", **both},
        "settled": {"of": "settling_time", "band": 0.1, **both},
        "turns": {"of": "max_abs", "wrap": False, **both},
        "as_it_stands": {"of": "final", "signal": CONTINUOUS, "unit": "deg"},
    }
    values = orch("run", write(poses(metrics)), "--json").json["metrics"]
    assert values["rmse"] == pytest.approx(0.0, abs=1e-9)
    assert values["largest"] == pytest.approx(0.0, abs=1e-9)
    assert values["settled"] == 0.0
    assert values["turns"] == pytest.approx(360.0)
    assert values["as_it_stands"] == pytest.approx(210.0)


def test_units_that_an_fmu_defines_under_names_of_its_own_are_those_that_they_mean(orch, write, poses, tmp_path):
    """Angles in "radian" are on the circle, too, and lengths in "metre" compare with those in m."""
    table = poses({})
    foreign = tmp_path / "foreign.fmu"
    with zipfile.ZipFile(table["components"]["wrapped"]["fmu"]) as source, zipfile.ZipFile(foreign, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                content = content.replace(b'"rad"', b'"radian"').replace(b'"m"', b'"metre"')
            target.writestr(name, content)
    for name in ("wrapped", "continuous"):
        table["components"][name]["fmu"] = str(foreign)
    table["metrics"] = {
        "angle": {"of": "rmse", "signal": WRAPPED, "reference": CONTINUOUS, "unit": "deg"},
        "length": {"of": "rmse", "signal": "wrapped.eta_d.z", "reference": "small.eta.z"},
    }
    values = orch("run", write(table), "--json").json["metrics"]
    assert values == {"angle": pytest.approx(0.0, abs=1e-9), "length": pytest.approx(0.0, abs=1e-9)}


@pytest.mark.parametrize(
    ("apart", "mean"), [(0.0, 0.0), (90.0, 90.0), (180.0, 180.0), (-179.9999, 180.0001), (-179.0, -179.0)]
)
def test_a_heading_difference_is_on_the_circle(orch, write, poses, apart, mean):
    """A vehicle that looks 1.2 degrees to either side of a direction: the mean is the direction, wherever it lies."""
    table = poses({})
    swing = {"psi_0": np.radians(apart - 1.2), "rate": np.radians(2.4), "wraps": True}
    table["components"]["wrapped"]["parameters"] = swing
    table["components"]["continuous"]["parameters"] = {"psi_0": 0.0, "rate": 0.0, "wraps": False}
    both = {"of": "heading_difference", "signal": "wrapped.eta_d", "reference": "continuous.eta_d"}
    table |= {"master": {"stop_time": 1.0, "step": 0.01}}
    table |= {"metrics": {stat: both | {"stat": stat} for stat in ("mean", "min", "max")}}
    values = orch("run", write(table), "--json").json["metrics"]
    assert values["mean"] == pytest.approx(mean, abs=1e-9)
    assert values["min"] == pytest.approx(mean - 1.2, abs=1e-9)
    assert values["max"] == pytest.approx(mean + 1.2, abs=1e-9)


def test_a_heading_that_turns_round_deviates_by_half_a_turn(orch, write, poses):
    table = poses({})
    table["components"]["wrapped"]["parameters"] = {"psi_0": 0.0, "rate": 2 * np.pi * 1.25, "wraps": True}
    table["components"]["continuous"]["parameters"] = {"psi_0": 0.0, "rate": 0.0, "wraps": False}
    both = {"of": "heading_difference", "signal": "wrapped.eta_d", "reference": "continuous.eta_d"}
    table |= {"master": {"stop_time": 1.0, "step": 0.01}}
    table |= {"metrics": {stat: both | {"stat": stat} for stat in ("mean", "min", "max")}}
    values = orch("run", write(table), "--json").json["metrics"]
    assert values["mean"] == pytest.approx(45.0, abs=2.0)  # of the quarter that it passes once more
    assert (values["min"], values["max"]) == pytest.approx((values["mean"] - 180.0, values["mean"] + 180.0))


def test_wrap_puts_a_signal_that_is_no_declared_angle_on_the_circle(orch, write, poses):
    """The heading in deg of `small` is 350 less 0.01 degrees, its bearing -10: 0.01 apart, declared by nobody."""
    both = {"of": "max_abs", "signal": "small.heading", "reference": "small.bearing"}
    values = orch("run", write(poses({"plain": both, "wrapped": both | {"wrap": True}})), "--json").json["metrics"]
    assert values["plain"] == pytest.approx(359.99)
    assert values["wrapped"] == pytest.approx(0.01, abs=1e-9)


def test_metrics_of_two_signals_convert_the_units_of_each(orch, write, poses):
    """`small` is where the references are, at (0, 0, 2) m, in mm and deg; its heading is 349.99 deg."""
    metrics = {
        "distance": {"of": "distance", "signal": "wrapped.eta_d", "reference": "small.eta"},
        "rmse_z": {"of": "rmse", "signal": "small.eta.z", "reference": "wrapped.eta_d.z"},
        "heading": {"of": "heading_difference", "signal": "small.eta", "reference": "wrapped.eta_d", "stat": "max"},
        "final_psi": {"of": "final", "signal": WRAPPED, "reference": "small.eta.psi", "unit": "deg"},
        "radians": {"of": "final", "signal": "small.heading", "unit": "rad"},
        "band": {"of": "settling_time", "signal": "small.eta.z", "band": 1999.0},
        "band_m": {"of": "settling_time", "signal": "small.eta.z", "band": 2.001, "unit": "m"},
    }
    values = orch("run", write(poses(metrics)), "--json").json["metrics"]
    assert values["distance"] == pytest.approx(0.0, abs=1e-12)  # the difference of the numbers is 1998 m
    assert values["rmse_z"] == pytest.approx(0.0, abs=1e-9)
    assert values["heading"] == pytest.approx(179.99)  # 349.99 - 170
    assert values["final_psi"] == pytest.approx(-139.99)  # -150 - 349.99 + 360
    assert values["radians"] == pytest.approx(np.radians(349.99))
    assert values["band"] is None  # 2000 mm are outside 1999 mm
    assert values["band_m"] == 0.0


@pytest.mark.parametrize(
    ("spec", "key", "words"),
    [
        ({"of": "energy", "signal": "wrapped.eta_d", "max_power": 1.0}, "signal", "is in 'm'; energy takes commands"),
        ({"of": "distance", "signal": "wrapped.eta_d_dot", "reference": "small.eta"}, "reference", "in 'mm'"),
        (
            {"of": "distance", "signal": "wrapped.eta_d_dot", "reference": "continuous.eta_d_dot"},
            "signal",
            "is in 'm/s'; distance takes positions",
        ),
        (
            {"of": "heading_difference", "signal": "wrapped.eta_d_dot", "reference": "continuous.eta_d_dot"},
            "signal",
            "is in 'rad/s'; heading_difference takes an angle",
        ),
        ({"of": "rms", "signal": WRAPPED, "wrap": True}, "wrap", "give a reference"),
        ({"of": "rmse", "signal": WRAPPED, "reference": CONTINUOUS, "wrap": 1}, "wrap", "neither true nor false"),
        (
            {"of": "rmse", "signal": "wrapped.eta_d.x", "reference": "continuous.eta_d.x", "wrap": True},
            "wrap",
            "is in 'm', which is no unit of angles",
        ),
    ],
)
def test_a_metric_of_units_that_do_not_fit_is_refused(problems, poses, spec, key, words):
    result = problems(poses({"it": spec}))
    assert any(k == f"metrics.it.{key}" and words in sentence for k, sentence in result), result


def test_a_record_of_the_first_format_has_its_angles_by_axis_and_unit(spiral, write, tmp_path):
    """Format 1 had no quantities."""
    with orchestrator.run(write(spiral), output=tmp_path / "run.h5") as record:
        now = {name for name in record.signals if record.is_angle(name)}
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file.attrs["format_version"] = 1
        for axis in ANGLE_AXES:
            for vector in ("vehicle/eta", "reference/eta_d"):
                del file[f"{vector}.{axis}"].attrs["quantity"]
    with orchestrator.open_run(tmp_path / "run.h5") as record:
        assert {name for name in record.signals if record.is_angle(name)} == now
        assert "reference.eta_d_dot.psi" in record.signals  # rad/s
