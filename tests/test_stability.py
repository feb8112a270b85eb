"""A feedback loop that is unstable because of its step is reported; noise is not, whatever reads it."""

import json
import re
import signal

import h5py
import pytest

import orchestrator
from experiments import merged
from fmu_files import SOURCES
from orchestrator import open_run, run
from orchestrator.models import build
from orchestrator.records.file.run import Run
from orchestrator.runs.prepare import prepare
from orchestrator.runs.runner import execute
from orchestrator.simulation.observer import Observer

STEP = 1e-3


@pytest.fixture(scope="module")
def models(_build_folder):
    return build.build([str(SOURCES / f"{name}.py") for name in ("limited_law", "lag", "noisy_sensor")])


@pytest.fixture(scope="module")
def explosive(_build_folder):
    return build.build([str(SOURCES / f"{name}.py") for name in ("law", "plant")])


@pytest.fixture
def loop(models):
    """loop(**parameters of the law) -> an experiment: a law and a lag of one step, unstable for gains above 1.

    At half the step it is stable up to gains of 3.
    """

    def experiment(stop=0.5, noise=0.0, reads="lag.y", period=None, T=STEP, decay=1.0, **law):
        own = {} if period is None else {"step": period}
        return {
            "master": {"stop_time": stop, "step": STEP},
            "components": {
                "law": {"fmu": "limited_law", "parameters": law, **own},
                "lag": {"fmu": "lag", "parameters": {"T": T, "noise": noise, "decay": decay}},
            },
            "connections": {"law.y": reads, "lag.u": "law.u"},
            "record": {"every": stop / 10},
        }

    return experiment


@pytest.fixture
def recorded(write, tmp_path):
    """recorded(experiment, ...) runs it, also where it fails, and returns the record."""

    def recorded(table, **options):
        try:
            return run(write(table), output=tmp_path / "record.h5", **options)
        except orchestrator.RunError as error:
            return error.run

    return recorded


@pytest.fixture
def warnings(recorded):
    return lambda table, **options: recorded(table, **options).warnings


# --- What is reported -------------------------------------------------------------------------------------------------


def test_a_loop_beyond_its_limit_is_reported_with_signal_share_step_and_what_to_do(loop, warnings):
    (warning,) = warnings(loop(gain=1.5))
    assert warning.startswith("law.u (a) oscillates with a period of about 2 steps of 0.001 s, 100% of its mean square")
    assert re.search(r"at half the step the rms of law\.u\.a is 9\d% less", warning)
    assert "the numbers of the run are wrong even where they look right; take a smaller step" in warning
    assert warning.kind == "unstable"


@pytest.mark.parametrize(
    ("integrators", "gain", "stop"),
    [
        (1, 2.1 / STEP, 0.1),  # times -1.1 in each step, for a hundred steps
        (1, 2.1 / STEP, 1.0),
        (2, (0.8 / STEP) ** 2, 0.1),  # times 1.28 in each step, at periods of nine
    ],
)
def test_a_loop_that_explodes_is_reported_though_it_is_small_until_the_end(
    warnings, explosive, integrators, gain, stop
):
    """Without limits, a loop that grows fast has most of its squares in the last steps of the run."""
    chain = [f"p{k}" for k in range(integrators)]  # from the one that is measured to the one that is driven
    table = {
        "master": {"stop_time": stop, "step": STEP},
        "components": {
            "law": {"fmu": str(explosive["law"]), "start": {"r": 0.0}},
            **{name: {"fmu": str(explosive["plant"])} for name in chain},
        },
        "connections": {
            "law.x": "p0.x",
            f"{chain[-1]}.u": {"from": "law.u", "gain": 2 * gain},
            **({"p0.u": "p1.x"} if integrators == 2 else {}),
        },
    }
    ((text),) = warnings(table)
    assert "the feedback loop is unstable at this step" in text


def test_a_loop_within_its_limit_is_not_reported(loop, warnings):
    assert warnings(loop(gain=0.9)) == []


def test_a_sensor_that_alternates_and_is_not_read_is_not_reported(loop, warnings):
    assert warnings(loop(gain=0.5, noise=0.1, T=0.02)) == []


def test_a_sensor_that_alternates_and_is_read_does_not_make_numbers_wrong(loop, recorded):
    record = recorded(loop(gain=0.5, noise=0.1, reads="lag.y_m", T=0.02, stop=3.0))
    assert [warning.kind for warning in record.warnings] == ["switching"]
    assert not record.is_wrong


def test_what_alternates_outside_of_all_loops_is_not_reported(loop, warnings):
    table = loop(noise=1.0, reads="lag.y_m")
    table["components"]["lag"]["start"] = "fmu"
    del table["connections"]["lag.u"]
    assert warnings(table) == []


def test_what_is_small_beside_its_vector_is_not_reported(loop, warnings):
    assert warnings(loop(gain=1.5, limit=1e-4, companion=1.0)) == []
    assert warnings(loop(gain=1.5, limit=1e-1, companion=1.0)) != []
    assert warnings(loop(gain=1.5, limit=1e-4)) != []


@pytest.mark.parametrize(("delays", "gain"), [(1, 0.8), (2, 0.6), (4, 0.4), (6, 0.3)])
def test_limit_cycles_of_longer_periods_are_reported_too(loop, warnings, delays, gain):
    """An integrator whose loop has `delays` and 2 steps more of delay: it oscillates at about 4 to 6 times that."""
    table = loop(gain=gain, limit=0.1, decay=0.0, stop=1.0)
    table["master"]["algorithm"] = "jacobi"
    newest = "lag.y"
    for n in range(delays):
        table["components"][f"delay{n}"] = {"fmu": "lag", "parameters": {"T": 0.0}}
        table["connections"][f"delay{n}.u"], newest = newest, f"delay{n}.y"
    table["connections"]["law.y"] = newest
    (warning,) = warnings(table)
    assert warning.kind == "unstable"
    period = float(warning.partition("a period of about ")[2].partition(" ")[0])
    assert 3 * (delays + 2) < period < 7 * (delays + 2)


def test_a_saturated_limit_cycle_that_is_one_at_half_the_step_too_is_reported(loop, warnings):
    # gain h / T is 9, 4.5 at half the step, 2.25 at a quarter; above 2 the command jumps between its limits.
    (warning,) = warnings(loop(gain=9.0, decay=0.0, target=10.0))
    assert "at an eighth of the step" in warning
    assert warning.kind == "unstable"


def test_a_relay_that_switches_at_every_step_is_reported_without_calling_its_numbers_wrong(loop, recorded):
    record = recorded(loop(gain=0.0, decay=0.0, T=1.0, target=0.9))
    (warning,) = record.warnings
    assert warning.kind == "switching"
    assert "takes as many steps down to a sixteenth of the step" in warning
    assert not record.is_wrong


# --- Whose steps they are ---------------------------------------------------------------------------------------------


def test_a_loop_that_a_slow_component_makes_unstable_names_it_and_is_right_for_it(loop, recorded):
    record = recorded(loop(gain=1.5, T=0.01, period=0.02, stop=2.0))
    (warning,) = record.warnings
    assert "because law steps every 0.02 s, and a smaller master.step would not change that" in warning
    assert "shorten components.law.step" in warning
    assert warning.kind == "sampling"
    assert not record.is_wrong


def test_a_loop_with_a_slow_component_that_the_step_makes_unstable_is_wrong(loop, recorded):
    table = loop(gain=1.5)
    table["components"]["slow"] = {"fmu": "lag", "parameters": {"T": 10.0}, "step": 4 * STEP}
    table["connections"] |= {"slow.u.a": "law.u.b", "slow.u.b": "law.u.b", "law.y": "lag.y", "law.y2": "slow.y"}
    del table["connections"]["law.y2"]
    record = recorded(table)
    assert [warning.kind for warning in record.warnings] == ["unstable"]


# --- Runs that end otherwise ------------------------------------------------------------------------------------------


def test_a_run_that_an_fmu_ends_is_judged_too(loop, warnings):
    assert [w.kind for w in warnings(loop(gain=1.5, end=0.0605))] == ["unstable"]


@pytest.mark.filterwarnings("ignore:overflow")  # in the FMU
def test_a_run_that_fails_because_its_loop_diverges_says_why(loop, recorded):
    record = recorded(loop(gain=5.0, T=2 * STEP, limit=0.0, stop=2.0))
    assert record.status == "failed"
    assert "not finite" in record.attributes["error"]
    assert [warning.kind for warning in record.warnings] == ["unstable"]


def test_a_run_of_a_few_steps_is_not_judged(loop, warnings):
    assert warnings(loop(gain=1.5, stop=0.01)) == []


class InterruptAt(Observer):
    """Presses Ctrl-C."""

    def __init__(self, tick):
        self.tick = tick

    def limit(self, tick, last):
        return min(last, self.tick) if tick < self.tick else last

    def progress(self, tick):
        if tick >= self.tick:
            signal.raise_signal(signal.SIGINT)


def test_an_interrupted_run_says_that_it_oscillates_and_is_not_compared(loop, write, tmp_path):
    result = execute(prepare(write(loop(gain=1.5))), tmp_path / "record.h5", observers=[InterruptAt(300)])
    assert result.status == "interrupted"
    (warning,) = result.warnings
    assert warning.kind == "unchecked"
    assert "could not be compared with one at half the step, because it was interrupted" in warning


def test_an_interrupted_run_with_noise_that_is_small_beside_what_it_rides_on_is_not_reported(loop, write, tmp_path):
    """A quarter to a half of the mean square of y_m alternates: suspect, and too little for a rhythm of its own."""
    table = loop(gain=0.5, target=3.0, limit=10.0, noise=0.4, reads="lag.y_m")
    result = execute(prepare(write(table)), tmp_path / "record.h5", observers=[InterruptAt(300)])
    assert result.status == "interrupted"
    assert result.warnings == []


def test_a_run_whose_comparison_is_interrupted_is_repeated(loop, write, tmp_path):
    """Else the wrong numbers of an unstable loop would be recalled as those of a completed run."""
    plan, store = prepare(write(loop(gain=1.5))), tmp_path / "results"
    result = execute(plan, results=store, observers=[InterruptAt(500)])
    assert result.status == "interrupted"
    assert result.error == "every row is there, but the comparison with shorter steps was interrupted"
    (warning,) = result.warnings
    assert warning.kind == "unchecked"
    assert "because the comparison was interrupted" in warning
    with Run(result.file) as record:
        assert (record.status, record.time[-1]) == ("interrupted", plan.experiment.master.stop_time)
    again = execute(plan, results=store)
    assert (again.status, again.repeated, [w.kind for w in again.warnings]) == ("completed", True, ["unstable"])


def test_an_fmu_that_takes_no_other_step_leaves_the_cause_open(loop, warnings):
    (warning,) = warnings(loop(gain=1.5, only=STEP))
    assert warning.kind == "unchecked"
    assert "I step by 0.001 s" in warning


# --- The vehicle, its six controllers, and noise ----------------------------------------------------------------------


def test_mfsosmc_held_over_a_millisecond_is_reported_and_pid_is_not(orch, spiral, write, tmp_path):
    spiral["master"]["stop_time"] = 0.5
    path = write(spiral)
    assert "warning" not in orch("run", path).err
    answer = orch("run", path, "--swap", "controller=mfsosmc")
    assert answer.code == 0
    assert "warning: controller.tau" in answer.err
    assert "the feedback loop is unstable at this step" in answer.err
    record = open_run("last", tmp_path / "results")
    assert record.attributes["warning_kinds"] == [warning.kind for warning in record.warnings] == ["unstable"]
    assert record.is_wrong
    shown = " ".join(orch("show", "last").out.split())
    assert "warning: controller.tau" in shown
    assert "compared with" in answer.out
    for text in (answer.out, shown):
        assert "shorter steps afterwards, in " in text


def test_a_saturated_limit_cycle_of_ten_steps_under_jacobi_is_reported(orch, spiral, write):
    spiral["master"]["stop_time"] = 2.0
    changes = ("--swap", "controller=mfsosmc", "--set", 'master.algorithm="jacobi"')
    answer = orch("run", write(spiral), *changes, "--json").json
    assert answer["warning_kinds"] == ["unstable"]
    assert "with a period of about 9" in answer["warnings"][0] or "with a period of about 1" in answer["warnings"][0]


@pytest.mark.parametrize("read", [True, False])
@pytest.mark.parametrize("interval", [0.0, 0.02])
def test_a_sensor_with_noise_is_not_reported_whether_the_controller_reads_it_or_not(
    models, spiral, write, recorded, read, interval
):
    sensor = {"sigma_eta": 0.02, "sigma_nu": 0.02, "seed": 5, "interval": interval}
    table = merged(spiral, {"master.stop_time": 3.0, "metrics": {}})
    table["components"] = {"sensor": {"fmu": "noisy_sensor", "parameters": sensor}, **table["components"]}
    for signal_ in ("eta", "nu"):
        table["connections"][f"sensor.{signal_}"] = f"vehicle.{signal_}"
        if read:
            table["connections"][f"controller.{signal_}"] = f"sensor.{signal_}_m"
    record = recorded(table)
    assert record.warnings == []
    assert ("comparison" in record.attributes["timing"]) == read  # that is what it took to tell


@pytest.mark.parametrize(
    ("controller", "noisy", "kinds"), [("mfsosmc", False, ["unchecked"]), ("pid", False, []), ("pid", True, [])]
)
def test_what_is_steered_from_outside_cannot_be_compared_and_says_so_only_where_it_oscillates(
    models, spiral, write, recorded, controller, noisy, kinds
):
    pytest.importorskip("pymavlink")
    table = merged(spiral, {"master.stop_time": 1.0, "components.reference": None, "metrics": {}})
    table["components"]["controller"]["fmu"] = controller
    pilot = {"builtin": "mavlink_manual", "step": 0.02}
    sensor = {"fmu": "noisy_sensor", "parameters": {"sigma_eta": 0.02, "sigma_nu": 0.02} if noisy else {}}
    table["components"] = {"sensor": sensor, **table["components"], "pilot": pilot}
    table["connections"]["pilot.eta"] = "vehicle.eta"
    for name in ("eta_d", "eta_d_dot", "eta_d_ddot"):
        table["connections"][f"controller.{name}"] = f"pilot.{name}"
    for name in ("eta", "nu"):
        table["connections"] |= {f"sensor.{name}": f"vehicle.{name}", f"controller.{name}": f"sensor.{name}_m"}
    record = recorded(table)
    assert [warning.kind for warning in record.warnings] == kinds
    assert all("because it was steered from outside and cannot be repeated" in text for text in record.warnings)
    assert not record.is_wrong
    assert "comparison" not in record.attributes["timing"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("controller", "algorithm"),
    [
        *(
            (c, a)
            for c in ("feedback_linearization", "lyapunov", "nstsmc", "ftsosmc")
            for a in ("gauss-seidel", "jacobi")
        ),
        ("mfsosmc", "gauss-seidel"),  # under Jacobi, the sensor delays its loop beyond its limit, noise or not
    ],
)
def test_no_controller_s_loop_is_called_unstable_for_the_noise_that_it_reads(
    models, spiral, write, recorded, controller, algorithm
):
    step = 1e-4 if controller == "mfsosmc" else STEP  # of each, well within its limit
    table = merged(spiral, {"master.stop_time": 2000 * step, "master.step": step, "metrics": {}})
    table["master"]["algorithm"] = algorithm
    table["components"]["controller"]["fmu"] = controller
    sensor = {"fmu": "noisy_sensor", "parameters": {"sigma_eta": 2e-3, "sigma_nu": 2e-3, "seed": 5}}
    table["components"] = {"sensor": sensor, **table["components"]}
    for name in ("eta", "nu"):
        table["connections"] |= {f"sensor.{name}": f"vehicle.{name}", f"controller.{name}": f"sensor.{name}_m"}
    assert recorded(table).warnings == []


# --- Where runs are made ----------------------------------------------------------------------------------------------


def test_the_comparison_and_what_it_took_are_no_part_of_the_run(loop, recorded):
    unstable, stable = recorded(loop(gain=1.5)), None
    timing = unstable.attributes["timing"]
    assert timing["comparison"]["steps"] <= 2 * 500
    assert timing["components"]["law"]["steps"] == 500
    assert len(unstable.time) == 11
    stable = recorded(loop(gain=0.5))
    assert "comparison" not in stable.attributes["timing"]


def test_a_run_that_goes_on_from_a_checkpoint_is_judged(spiral, write, tmp_path):
    path = write(merged(spiral, {"master.stop_time": 1.0, "metrics": {}}))
    changes = {"master.algorithm": "jacobi"}
    first = run(path, changes, {"controller": "mfsosmc"}, results=tmp_path / "results", checkpoint_at=[0.5])
    assert first.is_wrong
    (checkpoint,) = (tmp_path / "results").rglob("*.checkpoint")
    second = run(start_from=checkpoint, results=tmp_path / "results")
    assert [warning.kind for warning in second.warnings] == ["unstable"]
    assert second.time[0] == 0.5


def test_runs_of_a_sweep_are_judged(orch, spiral, write, tmp_path):
    table = merged(spiral, {"master.stop_time": 0.5, "master.algorithm": "jacobi"})
    table["sweep"] = {"draws": 1, "keep": "metrics", "vary": {"components.controller.fmu": ["pid", "mfsosmc"]}}
    answer = orch("sweep", write(table))
    assert answer.code == 0, answer.err
    kinds = {}
    for path in (tmp_path / "results").rglob("*.h5"):
        record = open_run(path)
        kinds[record.fact("controller", "fmu")] = [warning.kind for warning in record.warnings]
    assert kinds == {"pid": [], "mfsosmc": ["unstable"]}


def test_a_record_without_kinds_of_warnings_is_read_and_repeated_as_it_was_made(orch, spiral, write, tmp_path):
    spiral["master"]["stop_time"] = 0.1
    made = orch("run", write(spiral), "--swap", "controller=mfsosmc", "--json").json
    assert made["warning_kinds"] == ["unstable"]
    with h5py.File(tmp_path / made["file"], "r+") as file:
        del file.attrs["warning_kinds"]
        file.attrs["warnings"] = json.dumps(
            ["controller.tau (X) alternates from step to step: the loop is beyond its stability limit"]
        )
    record = open_run("last", tmp_path / "results")
    assert record.is_wrong
    again = orch("rerun", "last", "--verify")
    assert again.code == 0, again.out
    recalled = orch("run", tmp_path / "mine.toml", "--swap", "controller=mfsosmc", "--json")
    assert recalled.json["warning_kinds"] == ["unstable"]
