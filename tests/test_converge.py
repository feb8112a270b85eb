"""orch converge: one experiment at several steps."""

import math
import re

import pytest

from experiments import EXPERIMENTS, merged, single
from orchestrator.studies.convergence import assess, observed_order


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("steps", [(4e-3, 2e-3, 1e-3), (1e-2, 5e-3, 1e-3)])
def test_the_order_of_a_power_law_is_determined(order, steps):
    values = tuple(3.0 + 7.0 * h**order for h in steps)
    # the values differ by as little as 7e-12 of 3: rounding leaves four digits of the order
    assert observed_order(steps, values) == pytest.approx(order, rel=1e-3)


def test_values_that_do_not_approach_anything_have_no_order():
    assert math.isnan(observed_order((4e-3, 2e-3, 1e-3), (1.0, 2.0, 1.0)))
    assert math.isnan(observed_order((4e-3, 2e-3, 1e-3), (1.0, 1.0, 1.0)))


def test_the_error_is_the_distance_to_the_extrapolated_limit():
    metric = assess("m", "m", {h: 2.0 + 100.0 * h for h in (4e-3, 2e-3, 1e-3)}, own=2e-3)
    assert metric.limit == pytest.approx(2.0, rel=1e-9)  # exact but for rounding: the model is linear in h
    assert metric.error == pytest.approx(0.2, rel=1e-9)
    assert not metric.converged(2e-3)


def test_a_metric_that_is_the_same_at_every_step_is_converged():
    metric = assess("m", "m", dict.fromkeys((4e-3, 2e-3, 1e-3), 2.0), own=1e-3)
    assert metric.error == 0.0
    assert metric.converged(1e-3)


@pytest.fixture
def short(spiral):
    spiral["master"]["stop_time"] = 0.4
    return spiral


def test_pid_at_one_millisecond_is_converged(orch, write, short, tmp_path):
    answer = orch("converge", write(short))
    assert answer.code == 0, answer.err
    assert "mine is converged at 0.001 s" in answer.out
    assert (tmp_path / "results" / "_converge" / "mine.png").stat().st_size > 10_000
    assert max(len(line) for line in answer.out.splitlines()) <= 110


def test_mfsosmc_at_one_millisecond_is_not_although_its_position_errors_look_right(orch, write, short):
    answer = orch("converge", write(short), "--swap", "controller=mfsosmc", "--steps", "2e-3,1e-3,5e-4", "--json")
    assert answer.code == 1, answer.err
    assert answer.json["converged"] is False
    assert any("controller.tau" in warning for warning in answer.json["warnings"])
    assert answer.json["metrics"]["rmse_x"]["converged"] is True
    assert answer.json["metrics"]["rms_T1"]["converged"] is False


@pytest.fixture
def inverse(models, write):
    """inverse(record, **metrics) -> the path of an experiment with tests/fmus/inverse.py."""

    def path(record=None, **metrics):
        return write(
            {
                "master": {"stop_time": 0.04, "step": 0.002},
                "components": {"model": {"fmu": "inverse"}},
                "record": record or {},
                "metrics": metrics,
            }
        )

    return path


def test_a_metric_that_doubles_with_each_halving_is_not_converged_however_small_it_is(orch, inverse):
    answer = orch("converge", inverse(last={"of": "final", "signal": "model.y"}), "--steps", "4e-3,1e-3", "--json")
    assert answer.code == 1, answer.err
    assert answer.json["metrics"]["last"]["values"] == {"0.004": 2.5e-7, "0.002": 5e-7, "0.001": 1e-6}
    assert answer.json["metrics"]["last"]["order"] is None
    assert not answer.json["converged"]


def test_an_angle_on_either_side_of_the_seam_is_the_same_one(orch, write, models):
    """pi + 1 mrad at 4 ms, pi - 1 and pi - 2 mrad at 2 and 1 ms: the order is 1, the limit pi - 3 mrad."""
    table = {
        "master": {"stop_time": 0.04, "step": 0.002},
        "components": {"model": {"fmu": "seam"}},
        "metrics": {"psi": {"of": "final", "signal": "model.eta.psi"}},
    }
    answer = orch("converge", write(table), "--steps", "4e-3,1e-3", "--json")
    assert answer.code == 0, answer.err
    psi = answer.json["metrics"]["psi"]
    assert psi["order"] == pytest.approx(1.0, abs=1e-6)
    assert psi["limit"] == pytest.approx(math.pi - 0.003)
    assert psi["error"] == pytest.approx(0.002)


@pytest.mark.parametrize("record", [{}, {"every": 0.04, "signals": ["model.y"]}])
@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_an_error_is_negligible_beside_its_quantity_in_any_unit_recorded_or_not(orch, inverse, unit, record):
    metrics = {name: {"of": "final", "signal": f"model.{name}", "unit": unit} for name in ("z.a", "z.b")}
    path = inverse(record, small=metrics["z.a"], large=metrics["z.b"])
    answer = orch("converge", path, "--steps", "4e-3,1e-3", "--json")
    assert answer.code == 0, answer.out
    assert [sorted(run["metrics"]) for run in orch("list", "--json").json] == [["large", "small"]] * 3
    assert answer.json["metrics"]["small"]["error"] > 0.4 * answer.json["metrics"]["small"]["values"]["0.001"]


def test_what_never_happens_is_no_missing_number(orch, inverse):
    time = {"of": "convergence_time", "after": 0.004}
    metrics = {
        "coarse": {**time, "signal": "model.y", "band": 3e-7},
        "none": {**time, "signal": "model.z.b", "band": 0.5},
    }
    answer = orch("converge", inverse(**metrics), "--steps", "4e-3,1e-3")
    assert answer.code == 1
    rows = {line.split()[0]: line.split() for line in answer.out.splitlines() if line.strip()}
    assert rows["coarse"][1:4] == ["0.004", "never", "never"]
    assert rows["coarse"][-2:] == ["not", "converged"]
    assert rows["none"][1:4] == ["never"] * 3
    assert rows["none"][-1] != "converged"


def test_what_counts_changes_gets_no_order(orch, inverse, short, write):
    metrics = {"turns": {"of": "total_variation", "signal": "model.n"}}
    answer = orch("converge", inverse(**metrics), "--steps", "4e-3,1e-3", "--json")
    assert answer.code == 1
    assert answer.json["metrics"]["turns"]["order"] is None
    short["metrics"] = {
        "smooth": {"of": "total_variation", "signal": "allocation.u.T1"},
        "rms_T1": {"of": "rms", "signal": "allocation.u.T1"},
    }
    answer = orch("converge", write(short), "--json")
    assert answer.json["metrics"]["smooth"]["order"] is None
    assert answer.json["metrics"]["rms_T1"]["order"] is not None
    assert answer.code == 0


@pytest.mark.slow
def test_the_spiral_under_mfsosmc_is_converged_although_its_roll_of_a_hundred_thousandth_of_a_degree_is_not(orch):
    answer = orch("converge", EXPERIMENTS / "spiral_mfsosmc.toml", "--json")
    roll = answer.json["metrics"]["rmse_phi"]
    assert 0.05 * roll["values"]["5e-05"] < roll["error"] < 5e-5  # deg
    assert answer.json["converged"] is True


def test_a_warning_that_does_not_call_numbers_wrong_leaves_them_converged(orch, probe, write):
    path = write(
        {
            "master": {"stop_time": 0.04, "step": 0.002},
            "components": {"probe": {"fmu": str(probe), "start": "fmu", "parameters": {"mode": 9}}},
            "metrics": {"last": {"of": "final", "signal": "probe.y"}},
        }
    )
    answer = orch("converge", path, "--steps", "4e-3,1e-3", "--json")
    assert answer.json["warnings"]
    assert answer.json["converged"] is True
    assert answer.code == 0


def test_steps_that_do_not_fit_are_refused_with_their_reason(orch, write, short):
    answer = orch("converge", write(short), "--steps", "3e-3,1e-3,5e-4")
    assert answer.code == 2
    assert "3e-3" in answer.err or "0.003" in answer.err
    assert "master.stop_time: 0.4 s is not a multiple of master.step = 0.003 s" in answer.err
    answer = orch("converge", write(short), "--steps", "1e-3,5e-4")
    assert answer.code == 2
    assert "at least 3" in answer.err
    assert orch("converge", write(short), "--steps", "fine").code == 2


def test_runs_that_crash_are_named_with_their_steps(orch, probe, write, tmp_path):
    path = write(
        {
            "master": {"stop_time": 0.04, "step": 0.002},
            "components": {"probe": {"fmu": str(probe), "start": "fmu", "parameters": {"mode": 13}}},
            "metrics": {"last": {"of": "final", "signal": "probe.y"}},
        }
    )
    answer = orch("converge", path, "--steps", "4e-3,1e-3")
    assert answer.code == 3
    assert "Traceback" not in answer.err
    for step in ("0.004", "0.002", "0.001"):
        assert re.search(rf"^step {step} s: the process ended with exit code -6$", answer.err, re.MULTILINE)
    assert not (tmp_path / "results" / "_converge").exists()


def test_records_of_a_study_name_its_command_whatever_lies_in_the_folder(orch, write, short, tmp_path):
    (tmp_path / "json.py").write_text("raise SystemExit('not the json of Python')")
    assert orch("converge", write(short)).code == 0
    for run in orch("list", "--json").json:
        assert orch("show", run["run_id"], "--json").json["command"][1] == "converge"


def test_runs_that_an_fmu_ended_early_are_named(orch, write, models):
    table = merged(single("trouble", stop_time=0.08, kind=4, at=0.03), {"components.one.start": {"u": 0.0}})
    table["metrics"] = {"rms": {"of": "rms", "signal": "one.y"}}
    answer = orch("converge", write(table), "--json", "--steps", "0.01,0.005,0.0025")
    (warning,) = answer.json["warnings"]
    assert warning.startswith("an FMU ended the run early, at step 0.01 s at 0.03 s, at step 0.005 s at 0.03 s")
