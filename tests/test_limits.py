"""Models are valid within limits: values that leave them are reported, and so are references that jump."""

import tomllib

import numpy as np
import pytest

import orchestrator
from experiments import EXPERIMENTS, merged, single
from fmu_files import PROBE_VARIABLES, SOURCES, needs_compiler, probe_fmu
from orchestrator.models import build
from orchestrator.simulation.loop import compiled

LOOPS = ["python"] if compiled() is None else ["compiled", "python"]
CONTROLLERS = ("pid", "feedback_linearization", "lyapunov", "mfsosmc", "nstsmc", "ftsosmc")
NOT_VALID = "that its FMU declares, and {} at its farthest: the model is not valid there"


@pytest.fixture(scope="module")
def fmus(_build_folder):
    """The FMUs of fmus/NAME.py, by name."""
    names = ("turning", "spike", "bounded")
    return dict(zip(names, build.build([str(SOURCES / f"{name}.py") for name in names]).values(), strict=True))


@pytest.fixture(params=LOOPS)
def warnings(request, write, monkeypatch, tmp_path):
    """warnings(table) runs it in a loop: [(kind, text)] of the record."""
    monkeypatch.setenv("ORCH_LOOP", request.param)

    def run(table):
        with orchestrator.run(write(table), output=tmp_path / "run.h5") as record:
            return [(warning.kind.value, str(warning)) for warning in record.warnings]

    return run


@pytest.fixture
def spike(fmus):
    """spike(connection, parameters): its y.x drives `bounded.x`, 1 s in steps of 0.01 s, rows every 0.5 s."""

    def table(connection, bounded_first=True, **parameters):
        components = {
            "bounded": {"fmu": str(fmus["bounded"]), "start": {"psi": 0.0}},
            "spike": {"fmu": str(fmus["spike"]), "parameters": parameters},
        }
        return {
            "master": {"stop_time": 1.0, "step": 0.01},
            "components": components if bounded_first else dict(reversed(components.items())),
            "connections": {"bounded.x": {"from": "spike.y.x", **connection}},
            "record": {"every": 0.5, "signals": ["spike.y.psi"]},
        }

    return table


@pytest.mark.parametrize("bounded_first", [True, False])
def test_a_limit_left_for_one_step_between_rows_of_other_signals_is_a_warning(warnings, spike, bounded_first):
    """3 m, given as 3000 mm, for one step of a run whose rows and signals show nothing of it."""
    result = warnings(spike({}, bounded_first, height=3000.0, at=0.34, until=0.34))
    text = f"bounded.x, driven by spike.y.x, is 3 m at t = 0.34 s, above 2, the max {NOT_VALID.format(3)}"
    assert result == [("limit", text)]


def test_a_limit_is_in_the_unit_of_the_variable_after_gain_and_offset(warnings, spike):
    """x = -0.002 y.x / mm + 0.5 m is -1.1 m at 800 mm, and 0.5 m at 0."""
    ((kind, text),) = warnings(spike({"gain": -2.0, "offset": 0.5}, height=800.0, at=0.2, until=0.3))
    assert kind == "limit"
    assert text == f"bounded.x, driven by spike.y.x, is -1.1 m at t = 0.2 s, below -1, the min {NOT_VALID.format(-1.1)}"
    assert warnings(spike({"gain": -2.0, "offset": 0.5}, height=749.0, at=0.2, until=0.3)) == []


def test_a_value_at_its_limit_is_within_it(warnings, spike):
    """2 m, and rounding of the conversion from mm."""
    assert warnings(spike({}, height=2000.0)) == []
    assert warnings(spike({"offset": 2.0 * (1 + 1e-12)}, height=0.0)) == []
    assert len(warnings(spike({}, height=2000.01))) == 1


def test_an_input_that_a_gain_of_zero_makes_constant_is_watched(warnings, spike):
    assert warnings(spike({"gain": 0.0, "offset": 1.0}, height=9e9)) == []
    ((_, text),) = warnings(spike({"gain": 0.0, "offset": 3.0}))
    assert "is 3 m at t = 0 s, above 2" in text


def test_an_output_is_watched_whether_something_reads_it_or_not(warnings, spike):
    """y = x, recorded in rows that show nothing of it, is beyond in the step after."""
    table = merged(spike({}, height=-5000.0, at=0.2, until=0.2), {"record.signals": ["bounded.y"]})
    texts = sorted(text for _, text in warnings(table))
    assert len(texts) == 2
    assert texts[0].startswith("bounded.x, driven by spike.y.x, is -5 m at t = 0.2 s, below -1, the min")
    assert texts[1].startswith("bounded.y is -5 m at t = 0.21 s, below -1, the min")


@needs_compiler
def test_limits_of_whole_numbers_are_watched(warnings, tmp_path):
    """`steps` adds 3 in every step, and may be 10 at most."""
    variables = [(*v[:6], None, "10") if v[0] == "steps" else v for v in PROBE_VARIABLES]
    table = single(probe_fmu(tmp_path / "probe.fmu", variables), stop_time=0.1)
    ((kind, text),) = warnings(table)
    assert kind == "limit"
    assert text == f"one.steps is 12 at t = 0.04 s, above 10, the max {NOT_VALID.format(30)}"


def test_commands_beyond_one_are_reported_for_each_thruster(warnings, fmus):
    """-3 t is given to two thrusters as their command, which goes from -1 to 1."""
    table = {
        "master": {"stop_time": 1.0, "step": 0.01},
        "components": {
            "vehicle": {"fmu": "bluerov2_thesis", "start": "fmu", "parameters": {"eta_0": [0, 0, 0.5, 0, 0, 0]}},
            "lift": {"fmu": str(fmus["turning"]), "parameters": {"psi_0": 0.0, "rate": -3.0, "wraps": False}},
        },
        "connections": {
            f"vehicle.u.{axis}": {"from": "lift.eta_d.psi", "gain": 1.0, "unit_check": False} for axis in ("T5", "T6")
        },
    }
    # -3 t passes -1, by more than rounding, in the step after t = 1/3 s; at its farthest it is -3
    text = f"vehicle.u.T5, driven by lift.eta_d.psi, is -1.02 at t = 0.34 s, below -1, the min {NOT_VALID.format(-3)}"
    assert ("limit", text) in warnings(table)


def test_a_vehicle_that_rises_out_of_the_water_is_a_warning(warnings):
    """A net buoyancy of 1.96 N lifts 25.07 kg from the surface by 1 cm in 0.51 s."""
    vehicle = {"fmu": "bluerov2_thesis", "start": "fmu", "parameters": {"eta_0": [0, 0, 0, 0, 0, 0]}}
    table = {"master": {"stop_time": 1.0, "step": 0.01}, "components": {"vehicle": vehicle}}
    ((kind, text),) = warnings(table)
    assert kind == "limit"
    assert text.startswith("vehicle.eta.z is -0.01")
    assert " m at t = 0.5" in text
    assert "s, below -0.01, the min that its FMU declares" in text


@pytest.fixture
def turning(fmus):
    """turning(rate, wraps, ...): a heading of 170 degrees that turns, as the reference of the spiral's PID."""
    table = tomllib.loads((EXPERIMENTS / "spiral_pid.toml").read_text())

    def run(rate, wraps=True, **changes):
        parameters = {"psi_0": np.radians(170.0), "rate": np.radians(rate), "wraps": wraps}
        start = {"eta_0": [0, 0, 2, 0, 0, np.radians(170.0)]}
        given = {
            "master.stop_time": 4.0,
            "record.every": 2.0,
            "metrics": {},
            "components.vehicle.parameters": start,
            "components.reference": {"fmu": str(fmus["turning"]), "parameters": parameters},
        }
        return merged(table, given | changes)

    return run


def test_a_reference_that_jumps_by_more_than_half_a_turn_is_a_note_once(warnings, turning):
    """170 + 100 t degrees passes 180 after 0.1 s, and again after 3.7 s; the record has neither."""
    ((kind, text),) = warnings(turning(100.0))
    assert kind == "jump"
    assert text.startswith("reference.eta_d.psi jumps by -6.28")
    assert " rad at t = 0.1" in text
    assert warnings(turning(100.0, wraps=False)) == []


def test_a_heading_that_only_its_reader_declares_an_angle_is_watched_in_its_own_unit(warnings, fmus, turning):
    """y.x in mm, taken as degrees: 350 of them at once are more than half a turn, 170 are not."""
    for height, kinds in ((350.0, ["jump"]), (170.0, [])):
        spike = {"fmu": str(fmus["spike"]), "parameters": {"height": height, "at": 0.5, "until": 9.0}}
        table = turning(0.0)
        table["components"]["spike"] = spike
        vector = {f"controller.eta_d.{axis}": f"reference.eta_d.{axis}" for axis in ("x", "y", "z", "phi", "theta")}
        del table["connections"]["controller.eta_d"]
        psi = {"from": "spike.y.x", "gain": float(np.radians(1.0)), "unit_check": False}
        table["connections"] |= vector | {"controller.eta_d.psi": psi}
        result = warnings(table)
        assert [kind for kind, _ in result] == kinds
        assert all("spike.y.x jumps by 350 mm at t = 0.5 s" in text for _, text in result)


def test_a_jump_is_printed_as_a_note_and_a_limit_as_a_warning(orch, write, turning):
    answer = orch("run", write(turning(100.0)))
    assert "note: reference.eta_d.psi jumps by" in answer.err
    shown = orch("show", "last").out
    assert "note: reference.eta_d.psi jumps by" in shown
    assert "warning" not in shown


def test_what_is_not_valid_from_the_start_is_a_note_of_check_and_a_warning_of_the_run(orch, write, spiral):
    """Above the water, beyond the singularity, rates in degrees; a mass and a damping of the wrong sign."""
    changes = {
        "components.vehicle.parameters": {"eta_0": [0, 0, -1, 5, 1.5, 0], "nu_0": {"r": 30.0}, "m": -1.0, "X_u": 4.0},
        "components.allocation.parameters": {"gamma": 45.0, "max_thrust": -40.0},
        "components.reference.parameters": {"omega": 30.0},
        "components.current.parameters": {"velocity": [50.0, 0, 0]},
        "master.stop_time": 0.01,
        "metrics": {},
    }
    path = write(merged(spiral, changes))
    notes = orch("check", path, "--json").json["notes"]
    assert sorted(notes) == [
        "allocation: gamma = 45 rad is more than a full turn; 45 degrees are 0.7854 rad",
        "allocation: gamma = 45.0 is above 3.14159, the max that its FMU declares",
        "allocation: max_thrust = -40.0 is below 1e-09, the min that its FMU declares",
        "current: velocity.x = 50.0 is above 10, the max that its FMU declares",
        "reference: omega = 30.0 is above 6.28319, the max that its FMU declares",
        "vehicle: X_u = 4.0 is above 0, the max that its FMU declares",
        "vehicle: eta_0.phi = 5.0 is above 3.14159, the max that its FMU declares",
        "vehicle: eta_0.theta = 1.5 is above 1.48353, the max that its FMU declares",
        "vehicle: eta_0.z = -1.0 is below -0.01, the min that its FMU declares",
        "vehicle: m = -1.0 is below 1e-09, the min that its FMU declares",
        "vehicle: nu_0.r = 30.0 is above 6.28319, the max that its FMU declares",
    ]
    result = orch("run", path, "--json").json
    assert set(notes) < set(result["warnings"])
    assert set(result["warning_kinds"]) == {"limit"}


@pytest.mark.parametrize("swap", CONTROLLERS)
def test_the_experiments_that_are_shipped_stay_within_what_their_models_declare(orch, swap):
    """One second of the spiral under each controller, at the step of the most demanding one."""
    options = ("--swap", f"controller={swap}", "--set", "master.stop_time=1", "--set", "master.step=5e-5")
    result = orch("run", EXPERIMENTS / "spiral_pid.toml", *options, "--json").json
    assert result["warnings"] == []


def test_a_desired_pitch_in_degrees_is_a_warning_wherever_it_comes_from(warnings, fmus, turning):
    """30, from an FMU that gives no fitting unit, is no pitch in rad."""
    spike = {"fmu": str(fmus["spike"]), "parameters": {"height": 30.0, "at": 0.5, "until": 0.5}}
    table = turning(0.0)
    table["components"]["spike"] = spike
    del table["connections"]["controller.eta_d"]
    rest = {f"controller.eta_d.{axis}": f"reference.eta_d.{axis}" for axis in ("x", "y", "z", "phi", "psi")}
    pitch = {"controller.eta_d.theta": {"from": "spike.y.x", "unit_check": False}}
    kinds = dict(warnings(merged(table, {"connections": table["connections"] | rest | pitch})))
    assert kinds["limit"].startswith(
        "controller.eta_d.theta, driven by spike.y.x, is 30 rad at t = 0.5 s, above 1.48353"
    )
