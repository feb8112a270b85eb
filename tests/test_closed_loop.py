"""Whole experiments: what the thesis publishes, and when a component's results reach the others."""

import itertools
import math
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import orchestrator as orch
from fmu_files import SOURCES
from orchestrator.models import build, catalogue

EXPERIMENTS = catalogue.experiments_folder()


# Published results (thesis Tables 5.2-5.7)


def assert_metrics(run, expected, tolerance):
    found = {name: run.metrics[name] for name in expected}
    assert found == pytest.approx(expected, rel=tolerance)


def test_the_spiral_under_pid_is_the_published_one(tmp_path):
    run = orch.run(EXPERIMENTS / "spiral_pid.toml", results=tmp_path)
    published = {
        "rmse_x": 0.1788,
        "rmse_y": 0.2482,
        "rmse_z": 0.1628,
        "rmse_theta": 0.4911,
        "rmse_psi": 0.5159,
        "rms_T1": 0.2078,
        "rms_T2": 0.1946,
        "rms_T3": 0.2010,
        "rms_T4": 0.2105,
    }
    assert_metrics(run, published, 0.05)  # a reference simulation in continuous time meets them within 5 %


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "x", "y", "z", "theta", "psi"),
    [
        ("spiral_mfsosmc", 0.1989, 0.2163, 0.1879, 0.0706, 1.0366),
        ("spiral_mfsosmc_currents", 0.1989, 0.2164, 0.1878, 0.0705, 1.0404),
    ],
)
def test_the_spiral_under_mfsosmc_is_the_published_one_and_reached_at_the_time_base(
    tmp_path, name, x, y, z, theta, psi
):
    run = orch.run(EXPERIMENTS / f"{name}.toml", results=tmp_path)
    published = {"rmse_x": x, "rmse_y": y, "rmse_z": z, "rmse_theta": theta, "rmse_psi": psi}
    assert_metrics(run, published, 0.01)  # the project's bound for this controller
    assert run.metrics["rmse_phi"] < 0.005  # printed as 0
    after = run.time >= 3.0
    error = (run["vehicle.eta"] - run["reference.eta_d"])[after]
    assert np.abs(error[:, :3]).max() < 0.002  # m; the time base leaves delta = 0.001 of 1 m, the surface as much again
    assert np.degrees(np.abs(error[:, 5])).max() < 0.05


@pytest.mark.slow
def test_two_vehicles_meet_at_the_time_base_and_hold_their_object_in_a_current(tmp_path):
    run = orch.run(EXPERIMENTS / "gripping_currents.toml", results=tmp_path)
    at = {t: int(np.flatnonzero(run.time == t)[0]) for t in (6.0, 12.0, 24.0)}
    for i in (1, 2):
        error = (run[f"vehicle{i}.eta"] - run[f"reference{i}.eta_d"])[at[6.0]]
        assert np.abs(error[:3]).max() < 0.005  # m; delta = 0.001 of the initial 2 m, and the hold of 0.1 ms
        assert np.degrees(np.abs(error[[3, 5]])).max() < 0.5
    holding = slice(at[12.0], at[24.0] + 1)
    one, two = run["vehicle1.eta"][holding], run["vehicle2.eta"][holding]
    distance = np.linalg.norm(one[:, :3] - two[:, :3], axis=1)
    np.testing.assert_allclose(distance, 0.5, atol=0.002)  # m; the project's bound
    heading = np.degrees(two[:, 5] - one[:, 5]) % 360
    np.testing.assert_allclose(heading, 180, atol=0.2)  # degrees; the project's bound
    assert run.metrics["max_theta1"] < 1  # degrees, until 30 s: the thesis's claim
    assert run.metrics["max_theta2"] < 2


# Repetition


def datasets(path):
    found = {}
    with h5py.File(path, "r", locking=False) as file:  # as `orch.run` has it still open
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def test_a_run_is_bit_identical_to_its_repetition_in_another_process(tmp_path):
    experiment = EXPERIMENTS / "gripping_currents.toml"
    first = orch.run(experiment, set={"master.stop_time": 0.05}, results=tmp_path / "here")
    script = (
        "import orchestrator as orch, sys\n"
        "print(orch.run(sys.argv[1], set={'master.stop_time': 0.05}, results=sys.argv[2]).path)"
    )
    arguments = [sys.executable, "-c", script, str(experiment), str(tmp_path / "there")]
    answer = subprocess.run(arguments, capture_output=True, text=True, check=True)
    one, two = datasets(first.path), datasets(answer.stdout.strip())
    assert one.keys() == two.keys()
    assert len(one) > 100
    for name, values in one.items():
        np.testing.assert_array_equal(values, two[name], err_msg=name)
    assert np.ptp(one["vehicle1/eta.x"]) > 0


# When results become visible.  The loop is so small that the recursion can be written down:
# u = K (r - x),  x_dot = u by Euler's method,  r = t^2, with `wire` handing u on.  Every operation is the same as in
# the models, so that the rows must agree to the last bit.

H, K, X_0, STEPS = 0.125, 0.5, 1.0, 24


@pytest.fixture(scope="session")
def parts(tmp_path_factory):
    """{name: FMU} of the four models, built into a folder of their own."""
    folder = tmp_path_factory.mktemp("parts")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ORCH_BUILD", str(folder))
        return build.build([str(SOURCES / f"{name}.py") for name in ("law", "wire", "plant", "reference")])


@pytest.fixture
def loop(parts, tmp_path):
    """(order of the components, algorithm, period=ticks) -> x, u and r of the record, one entry a tick."""

    def run(order, algorithm="gauss-seidel", **periods):
        lines = [f'[master]\nstop_time = {STEPS * H}\nstep = {H}\nalgorithm = "{algorithm}"']
        for name in order:
            lines.append(f'[components.{name}]\nfmu = "{parts[name].as_posix()}"\nstep = {periods.get(name, 1) * H}')
        source = "wire.b" if "wire" in order else "law.u"
        lines.append(f'[connections]\n"law.x" = "plant.x"\n"law.r" = "reference.r"\n"plant.u" = "{source}"')
        if "wire" in order:
            lines.append('"wire.a" = "law.u"')
        (tmp_path / "loop.toml").write_text("\n".join(lines))
        with orch.run(tmp_path / "loop.toml", results=tmp_path / "results") as record:
            np.testing.assert_array_equal(record.time, np.arange(STEPS + 1) * H)
            return tuple(record[signal] for signal in ("plant.x", "law.u", "reference.r"))

    return run


def r(k):
    return (k * H) ** 2


def law(x, k):
    return K * (r(k) - x)


def test_a_command_computed_at_t_acts_from_t(loop):
    xs, us, rs = loop(["law", "plant", "reference"])
    x, u = X_0, law(X_0, 0)
    for k in range(STEPS + 1):
        assert (xs[k], us[k], rs[k]) == (x, u, r(k))  # a row's command acted over the step that ended there
        u = law(x, k)
        x = x + H * u


def test_a_component_on_the_way_adds_no_delay(loop):
    direct, through = loop(["law", "plant", "reference"]), loop(["law", "wire", "plant", "reference"])
    np.testing.assert_array_equal(direct, through)


def test_a_component_listed_before_the_one_it_reads_is_a_step_late(loop):
    xs, _, _ = loop(["wire", "law", "plant", "reference"])
    x, late = X_0, law(X_0, 0)
    for k in range(STEPS + 1):
        assert xs[k] == x
        now = law(x, k)
        x, late = x + H * late, now


def test_a_reference_listed_before_the_law_that_reads_it_is_a_step_early(loop):
    xs, _, _ = loop(["reference", "law", "plant"])
    x = X_0
    for k in range(STEPS + 1):
        assert xs[k] == x
        x = x + H * law(x, k + 1)


@pytest.mark.parametrize("order", list(itertools.permutations(["law", "plant", "reference"])))
def test_jacobi_feeds_everyone_with_the_state_at_t_whatever_the_order(loop, order):
    xs, us, rs = loop(order, "jacobi")
    x, u = X_0, law(X_0, 0)
    for k in range(STEPS + 1):
        assert (xs[k], us[k], rs[k]) == (x, u, r(k))
        x, u = x + H * u, law(x, k)  # both see the tick before: the command is a step late


@pytest.mark.parametrize(
    ("order", "algorithm", "ended"),
    [
        (["law", "plant", "reference"], "gauss-seidel", True),
        (["plant", "law", "reference"], "gauss-seidel", False),
        (["law", "plant", "reference"], "jacobi", False),
        (["plant", "law", "reference"], "jacobi", False),
    ],
)
def test_a_rows_command_acts_over_the_step_that_docs_record_md_names(loop, order, algorithm, ended):
    xs, us, _ = loop(order, algorithm)
    acted = us[1:] if ended else us[:-1]
    np.testing.assert_array_equal(xs[1:], xs[:-1] + H * acted)
    text = " ".join((Path(__file__).parent.parent / "docs" / "record.md").read_text(encoding="utf-8").split())
    assert (
        "Under Gauss-Seidel the command of a component that stands before what it steers is the one that acted" in text
    )
    assert "Under Jacobi, and of a component that stands after what it steers, it is the one that acts over the" in text


def test_a_law_of_a_longer_period_holds_its_command(loop):
    xs, us, _ = loop(["law", "plant", "reference"], law=3)
    x, u = X_0, law(X_0, 0)
    for k in range(STEPS + 1):
        assert (xs[k], us[k]) == (x, u)
        if k % 3 == 0:
            u = law(x, k)
        x = x + H * u


def test_a_law_of_a_longer_period_holds_its_command_under_jacobi(loop):
    xs, us, _ = loop(["law", "plant", "reference"], "jacobi", law=3)
    x, u = X_0, law(X_0, 0)
    for k in range(STEPS + 1):
        assert (xs[k], us[k]) == (x, u)
        now = law(x, k) if k % 3 == 0 else u
        x, u = x + H * u, now


@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_a_plant_of_a_longer_period_shows_its_state_when_the_period_has_ended(loop, algorithm):
    xs, us, _ = loop(["law", "plant", "reference"], algorithm, plant=4)
    x, coming, u = X_0, X_0, law(X_0, 0)
    for k in range(STEPS + 1):
        if k % 4 == 0:
            x = coming
        assert (xs[k], us[k]) == (x, u)
        before, u = u, law(x, k)
        if k % 4 == 0:
            coming = x + 4 * H * (u if algorithm == "gauss-seidel" else before)


@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_a_reference_of_a_longer_period_is_never_seen_before_its_time(loop, algorithm):
    xs, us, rs = loop(["law", "plant", "reference"], algorithm, reference=6)
    x, u = X_0, law(X_0, 0)
    for k in range(STEPS + 1):
        seen = r(k - k % 6)
        assert (xs[k], us[k], rs[k]) == (x, u, seen)
        before, u = u, K * (seen - x)
        x = x + H * (u if algorithm == "gauss-seidel" else before)


def test_a_period_is_the_step_that_the_component_makes(loop):
    xs, _, _ = loop(["law", "plant", "reference"], law=2, plant=2, reference=2)
    x = X_0
    for k in range(0, STEPS + 1, 2):  # the whole loop at twice the step
        assert xs[k] == x
        x = x + 2 * H * law(x, k)
    assert math.isfinite(x)
