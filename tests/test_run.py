"""A run: what acts when, what is repeated, what is replaced, and what a user hears of it."""

import fcntl
import json
import os
import subprocess
import threading

import h5py
import numpy as np
import pytest

import orchestrator
from commands import ORCH, poll
from experiments import merged, single

KEYS = {"run_id", "file", "status", "wall_time", "real_time_factor", "metrics", "metrics_never", "warnings", "error"}
KEYS |= {"warning_kinds"}


def record(answer, folder):
    """The record that a `run --json` names."""
    return orchestrator.open_run(folder / answer.json["file"])


def rows(run):
    return {name: run[name].copy() for name in run.signals}


# --- What acts when ---------------------------------------------------------------------------------------------------

MODELS = {"plant": "clock", "memory": "memory"}  # the others relay


@pytest.fixture
def chain(orch, write, models, tmp_path):
    """chain({name: input or None}, algorithm, **periods): clocks and relays in this order; returns time and rows."""

    def run(sources, algorithm="gauss-seidel", stop_time=0.06, **periods):
        table = {
            "master": {"stop_time": stop_time, "step": 0.01, "algorithm": algorithm},
            "components": {
                name: {"fmu": MODELS.get(name, "relay"), **({"step": periods[name]} if name in periods else {})}
                for name in sources
            },
            "connections": {f"{name}.u": source for name, source in sources.items() if source},
        }
        answer = orch("run", write(table), "--json")
        assert answer.code == 0, answer.err
        with record(answer, tmp_path) as found:
            return found.time, rows(found)

    return run


def test_a_command_computed_at_t_acts_from_t(chain):
    """The controller stands before its plant: what it gives in the row of t + h was computed from the state at t."""
    time, values = chain({"controller": "plant.y", "actuator": "controller.y", "plant": None})
    assert values["plant.y"].tolist() == time.tolist()
    assert values["controller.y"].tolist() == [0.0, *time[:-1]]
    assert values["actuator.y"].tolist() == values["controller.y"].tolist()  # no further delay in the same step


def test_gauss_seidel_feeds_a_later_component_with_the_newest_outputs(chain):
    time, values = chain({"plant": None, "controller": "plant.y"})
    assert values["controller.y"].tolist() == time.tolist()


def test_jacobi_delays_every_connection_by_one_step_in_any_order(chain):
    time, values = chain({"plant": None, "controller": "plant.y", "actuator": "controller.y"}, "jacobi")
    assert values["controller.y"].tolist() == [0.0, *time[:-1]]
    assert values["actuator.y"].tolist() == [0.0, 0.0, *time[:-2]]


@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_a_slower_controller_holds_its_command(chain, algorithm):
    time, values = chain({"controller": "plant.y", "plant": None}, algorithm, controller=0.03)
    expected = [0.0, 0.0, 0.0, 0.0, 0.03, 0.03, 0.03]
    assert values["controller.y"].tolist() == expected
    assert values["plant.y"].tolist() == time.tolist()


@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
@pytest.mark.parametrize("first", ["controller", "plant"])
def test_a_slower_plant_is_not_seen_before_its_time(chain, algorithm, first):
    """Its outputs belong to the end of its own period, also for those that step meanwhile."""
    sources = {"controller": "plant.y", "plant": None}
    _, values = chain(dict(sorted(sources.items(), key=lambda item: item[0] != first)), algorithm, plant=0.03)
    assert values["plant.y"].tolist() == [0.0, 0.0, 0.0, 0.03, 0.03, 0.03, 0.06]
    assert values["controller.y"].tolist() == [0.0, 0.0, 0.0, 0.0, 0.03, 0.03, 0.03]


def test_a_slower_state_is_not_seen_before_its_time_although_it_has_inputs(chain):
    """A state at the end of a step does not depend on an input of that instant, also in plain Python."""
    _, values = chain({"controller": "memory.n", "memory": "plant.y", "plant": None}, memory=0.03)
    assert values["memory.n"].tolist() == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.03]
    assert values["controller.y"].tolist() == [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]


def test_a_slower_component_may_step_beyond_the_stop_time(chain):
    time, values = chain({"controller": "plant.y", "plant": None}, stop_time=0.04, controller=0.03)
    assert values["controller.y"].tolist() == [0.0, 0.0, 0.0, 0.0, 0.03]
    assert time[-1] == 0.04


def test_the_first_row_agrees_with_itself_through_any_chain(orch, write, models, tmp_path):
    """Five relays in the worst order pass a value on during initialization."""
    table = {
        "master": {"stop_time": 0.01, "step": 0.01},
        "components": {
            **{f"r{i}": {"fmu": "relay"} for i in range(5)},
            "source": {"fmu": "waves", "parameters": {"place": [3.5, 0, 0]}},
        },
        "connections": {"r4.u": "source.eta.x", **{f"r{i}.u": f"r{i + 1}.y" for i in range(4)}},
    }
    with record(orch("run", write(table), "--json"), tmp_path) as found:
        assert [found[f"r{i}.y"][0] for i in range(5)] == [3.5] * 5


def test_an_algebraic_loop_is_reported_with_its_signals(orch, write, models):
    table = {
        "master": {"stop_time": 0.01, "step": 0.01},
        "components": {"a": {"fmu": "plus"}, "b": {"fmu": "relay"}},
        "connections": {"a.u": "b.y", "b.u": "a.y"},
    }
    answer = orch("run", write(table))
    assert answer.code == 3
    assert "the initial values do not settle in 100 sweeps" in answer.err
    assert "an algebraic loop through a.u <- b.y <- b.u <- a.y <- a.u; its equations are singular" in answer.err


def test_time_does_not_drift(orch, write, models, tmp_path):
    """A running sum of 0.001 is off by 1e-16 after three steps; k * step is not."""
    with record(orch("run", write(single("clock", 0.3, 0.001)), "--json"), tmp_path) as found:
        assert found.time.tolist() == [k / 1000 for k in range(301)]


def test_rows_come_every_so_often_from_zero_to_the_stop_time(orch, write, models, tmp_path):
    table = merged(single("clock", 0.06, 0.01), {"record.every": 0.03})
    with record(orch("run", write(table), "--json"), tmp_path) as found:
        assert found.time.tolist() == [0.0, 0.03, 0.06]
        assert found["one.n"].tolist() == [0.0, 3.0, 6.0]


# --- The end that an FMU asks for -------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [0.0, 0.02])
def test_a_python_model_that_returns_false_ends_the_run(orch, write, models, tmp_path, at):
    path = write(single("trouble", kind=4, at=at))
    answer = orch("run", path)
    assert answer.code == 0, answer.err
    assert f"completed; an FMU ended it at t = {at:g} s" in answer.out
    check_stopped(orch("run", path, "--force", "--json"), tmp_path, at)


@pytest.mark.parametrize("at", [0.0, 0.02])
def test_a_discarded_step_of_an_fmu_that_is_done_ends_the_run(orch, write, probe, tmp_path, at):
    answer = orch("run", write(single(probe, mode=4, at=at)), "--json")
    check_stopped(answer, tmp_path, at)
    assert "illegal call" not in answer.err


def check_stopped(answer, folder, at):
    assert answer.code == 0, answer.err
    assert (answer.json["status"], answer.json["error"]) == ("completed", "")
    with record(answer, folder) as found:
        assert found.attributes["stopped_at"] == at
        assert found.time.tolist() == [0.0, 0.01, 0.02][: round(at * 100) + 1]


# --- The store --------------------------------------------------------------------------------------------------------


def test_a_run_prints_its_id_its_file_its_speed_and_its_metrics(orch, write, spiral, tmp_path):
    answer = orch("run", write(spiral))
    assert (answer.code, answer.err) == (0, "")
    (path,) = tmp_path.glob("results/*/*")
    assert answer.out.startswith(f"mine {path.stem}: completed\n")
    for word in (f"results/mine/{path.name}", "wall time", "real-time factor", "rmse_theta"):
        assert word in answer.out


def test_json_is_one_object_and_nothing_else(orch, write, spiral, tmp_path):
    answer = orch("run", write(spiral), "--json")
    assert answer.err == ""
    assert answer.json.keys() == KEYS
    assert answer.json["status"] == "completed"
    assert len(answer.json["run_id"]) == 10
    assert set(answer.json["metrics"]) == set(spiral["metrics"])
    assert answer.json["real_time_factor"] == pytest.approx(0.05 / answer.json["wall_time"])
    assert (tmp_path / answer.json["file"]).is_file()


def test_json_of_what_does_not_start_is_one_object_too(orch, write, spiral):
    answer = orch("run", write(merged(spiral, {"master.stepp": 1})), "--json")
    assert answer.code == 2
    assert answer.json.keys() == KEYS
    assert "master.stepp" in answer.json["error"]


def test_quiet_prints_nothing(orch, write, spiral):
    answer = orch("run", write(spiral), "--quiet")
    assert (answer.code, answer.out, answer.err) == (0, "", "")


def test_a_completed_run_is_not_repeated_and_its_stored_metrics_are_shown(orch, write, spiral, tmp_path):
    first = orch("run", write(spiral), "--json")
    path = tmp_path / first.json["file"]
    content = path.read_bytes()
    table = merged(spiral, {"title": "Another"})
    second = orch("run", write(table))
    assert "already in the store (--force runs it again)" in second.out
    assert "rmse_x" in second.out
    again = orch("run", write(table), "--json").json
    assert again["run_id"] == first.json["run_id"]
    assert again["wall_time"] == first.json["wall_time"]
    assert again["metrics"] == first.json["metrics"]
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    "metrics",
    [
        {"last": {"of": "final", "signal": "vehicle.eta.x"}},
        {"rmse_x": {"of": "rmse", "signal": "vehicle.eta.x", "reference": "reference.eta_d.x", "every": 0.01}},
    ],
)
def test_a_record_without_a_metric_of_that_definition_is_repeated_to_the_same_rows(
    orch, write, spiral, tmp_path, metrics
):
    first = orch("run", write(spiral), "--json")
    path = tmp_path / first.json["file"]
    with orchestrator.open_run(path) as run:
        before = rows(run)
    table = merged(spiral, {"metrics": metrics})
    second = orch("run", write(table))
    (name,) = metrics
    assert f"repeated, the same rows bit for bit, for metrics that were not stored: {name}" in second.out
    again = orch("run", write(table), "--json").json
    assert (again["run_id"], again["file"]) == (first.json["run_id"], first.json["file"])
    with orchestrator.open_run(path) as run:
        assert {name: values.tobytes() for name, values in rows(run).items()} == {
            name: values.tobytes() for name, values in before.items()
        }
        assert run.metrics == again["metrics"]
        assert run.resolved["metrics"] == metrics


def test_a_repeated_record_whose_rows_differ_leaves_the_earlier_one(orch, write, spiral, tmp_path):
    first = orch("run", write(spiral), "--json")
    path = tmp_path / first.json["file"]
    with h5py.File(path, "r+") as file:
        file["vehicle/eta.x"][3] = 0.5
    table = merged(spiral, {"metrics": {"last": {"of": "final", "signal": "vehicle.eta.x"}}})
    answer = orch("run", write(table))
    assert answer.code == 2
    assert "the rows are not the same" in answer.err
    with orchestrator.open_run(path) as run:
        assert run["vehicle.eta.x"][3] == 0.5


def test_a_record_of_format_1_says_that_its_metrics_are_of_rows(orch, write, spiral, tmp_path):
    path = write(merged(spiral, {"record": {"every": 0.01}}))
    first = orch("run", path, "--json")
    with h5py.File(tmp_path / first.json["file"], "r+") as file:
        file.attrs["format_version"] = 1
        del file.attrs["metrics_of"], file.attrs["metric_units"]
    with orchestrator.open_run(tmp_path / first.json["file"]) as run:
        assert run.metrics_of == "rows"
        assert run.is_wrong
    assert "its metrics are of its rows, every 0.01 s" in orch("show", first.json["run_id"]).out
    assert orch("run", path, "--json").json["metrics"] == first.json["metrics"]
    with orchestrator.open_run(tmp_path / first.json["file"]) as run:
        assert run.metrics_of == "steps"
        assert not run.is_wrong


def test_a_forced_run_gives_the_same_bits_again(orch, write, spiral, tmp_path):
    path = write(spiral)
    first = orch("run", path, "--json")
    with record(first, tmp_path) as found:
        before, created = rows(found), found.attributes["pid"]
    second = orch("run", path, "--force", "--json")
    assert second.json["file"] == first.json["file"]
    with record(second, tmp_path) as found:
        assert found.attributes["pid"] != created
        assert found.signals == list(before)
        for name, values in before.items():
            assert found[name].tobytes() == values.tobytes(), name
    assert [p.name for p in tmp_path.glob("results/mine/*")] == [f"{first.json['run_id']}.h5"]


def test_runs_of_other_content_lie_side_by_side(orch, write, spiral, tmp_path):
    path = write(spiral)
    orch("run", path)
    orch("run", path, "--set", "master.stop_time=0.04")
    assert len(list(tmp_path.glob("results/mine/*.h5"))) == 2


def test_an_earlier_record_is_replaced_only_when_the_new_one_is_completed(orch, write, models, tmp_path):
    path = write(single("moody"))
    bad = {**os.environ, "MOOD": "bad"}
    first = orch("run", path, "--json", env=bad)
    assert first.code == 3
    final = tmp_path / first.json["file"]
    assert orchestrator.open_run(final).status == "failed"

    second = orch("run", path, "--json", env=bad)  # a failed record is no reason not to run
    assert second.code == 3
    assert second.json["file"] == first.json["file"].replace(".h5", ".2.h5")
    (tmp_path / second.json["file"]).unlink()

    third = orch("run", path, "--json")
    assert third.json["file"] == first.json["file"]
    assert orchestrator.open_run(final).status == "completed"

    fourth = orch("run", path, "--json", "--force", env=bad)
    assert (fourth.code, fourth.json["status"]) == (3, "failed")
    assert fourth.json["file"] != first.json["file"]
    assert orchestrator.open_run(final).status == "completed"
    assert orch("run", path, "--json", env=bad).json["status"] == "completed"  # it is there


def test_a_second_process_that_runs_the_same_is_refused_and_names_the_first(orch, write, models, tmp_path):
    path = write(single("moody", pause=0.5))
    with subprocess.Popen([ORCH, "run", str(path), "--json"], cwd=tmp_path, stdout=subprocess.PIPE) as first:
        poll(lambda: any(p.stat().st_size for p in tmp_path.glob("results/mine/*.h5")), first)
        second = orch("run", path)
        assert second.code == 2
        assert f"is being written by process {first.pid} on " in second.err
        other = orch("run", path, "--output", "other.h5", "--set", "components.one.parameters.pause=0")
        assert other.code == 0
        assert json.loads(first.communicate()[0])["status"] == "completed"
    assert first.returncode == 0


def test_of_processes_that_begin_at_once_one_runs(write, models, tmp_path):
    path = write(single("moody", pause=0.4))
    processes = [
        subprocess.Popen([ORCH, "run", path], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    texts = [process.communicate() for process in processes]
    assert {process.returncode for process in processes} <= {0, 2}
    # One that comes when the first has ended already shows its record.
    ran = [out for out, _ in texts if out and "already in the store" not in out]
    assert len(ran) == 1, texts
    refused = [err for (_, err), process in zip(texts, processes, strict=True) if process.returncode == 2]
    assert all("is being written by process" in err for err in refused), texts
    (final,) = tmp_path.glob("results/mine/*")
    assert orchestrator.open_run(final).status == "completed"


def test_a_record_that_a_process_is_about_to_lock_is_taken(orch, write, models, tmp_path):
    path = write(single("moody"))
    final = tmp_path / orch("run", path, "--json").json["file"]
    final.write_bytes(bytes(1 << 16))  # created by another process, its room reserved
    with final.open("rb+") as file:
        another = threading.Timer(0.3, fcntl.flock, (file, fcntl.LOCK_EX | fcntl.LOCK_NB))
        with subprocess.Popen([ORCH, "run", path], cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
            another.start()
            assert "is being written by" in process.communicate()[1]
    assert process.returncode == 2
    assert list(tmp_path.glob("results/mine/*")) == [final]


def test_a_record_whose_living_writer_has_not_locked_it_yet_is_taken(orch, python, write, models, tmp_path):
    path = write(single("moody"))
    final = tmp_path / orch("run", path, "--json").json["file"]
    with h5py.File(final, "r+") as file:
        file.attrs["status"], file.attrs["pid"] = "running", os.getpid()
    answer = python(f"""
import itertools
import orchestrator
from orchestrator.records.file import access

looks = itertools.count()
access.is_locked = lambda path: next(looks) > 2  # the other process locks it after the third look
try:
    orchestrator.run({str(path)!r})
except orchestrator.StoreError as error:
    print(error)
""")
    assert "is being written by" in answer.out, answer


def test_a_record_completed_while_the_fmus_were_loaded_is_not_repeated(python, write, models):
    path = write(single("moody"))
    script = f"""
import orchestrator
from orchestrator.runs import runner

def late(*arguments, open_=runner.System.open):
    runner.System.open = open_
    print(orchestrator.run({str(path)!r}).attributes["wall_time"])
    return open_(*arguments)

runner.System.open = late
print(orchestrator.run({str(path)!r}).attributes["wall_time"])
"""
    first, second = python(script).out.split()
    assert first == second


def test_output_writes_exactly_that_file_and_always_runs(orch, write, spiral, tmp_path):
    path = write(spiral)
    for _ in range(2):
        answer = orch("run", path, "--output", "deep/down/mine.h5", "--json")
        assert answer.json["file"] == "deep/down/mine.h5"
    assert {p.name for p in tmp_path.iterdir()} == {"mine.toml", "deep"}
    assert [p.name for p in (tmp_path / "deep/down").iterdir()] == ["mine.h5"]
    with orchestrator.open_run(tmp_path / "deep/down/mine.h5") as found:
        assert found.run_id == answer.json["run_id"]


def test_output_spares_what_is_no_record(orch, write, spiral, tmp_path):
    path = write(spiral)
    text = path.read_bytes()
    (tmp_path / "folder").mkdir()
    (tmp_path / "notes.txt").write_text("mine")
    refused = {path: "is already used by this command", "folder": "is a folder", "notes.txt": "not a record"}
    for target, words in refused.items():
        answer = orch("run", path, "--output", target)
        assert answer.code == 2
        assert answer.err.startswith(f"{target} ")
        assert words in answer.err
    assert path.read_bytes() == text
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_results_names_the_store(orch, write, spiral, tmp_path):
    answer = orch("run", write(spiral), "--results", "other/place", "--json")
    assert answer.json["file"] == f"other/place/mine/{answer.json['run_id']}.h5"


def test_an_experiment_is_the_same_from_any_folder(orch, write, spiral, tmp_path, shipped):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "copy.fmu").write_bytes(shipped["pid"].read_bytes())
    path = write(merged(spiral, {"components.controller.fmu": "mine/copy.fmu"}))
    first = orch("run", path, "--json")
    second = orch("run", "../mine.toml", "--json", cwd=tmp_path / "mine")
    assert first.code == second.code == 0
    assert first.json["run_id"] == second.json["run_id"]


def test_a_swap_and_a_set_run_and_say_what_they_dropped(orch, write, spiral, tmp_path):
    table = merged(spiral, {"components.controller.parameters": {"K_p": {"z": 90.0}}})
    answer = orch("run", write(table), "--swap", "controller=mfsosmc", "--set", "master.step=5e-4")
    assert answer.code == 0
    assert "controller: mfsosmc in place of pid; dropped its parameters K_p" in answer.err
    with orchestrator.open_run(next(tmp_path.glob("results/mine/*.h5"))) as found:
        (controller,) = [c for c in found.attributes["experiment_resolved"]["components"] if c["name"] == "controller"]
        assert (controller["fmu"], controller["parameters"]) == ("mfsosmc", {})
        assert found.attributes["step"] == 5e-4


# --- From Python ------------------------------------------------------------------------------------------------------


def test_python_runs_and_reads(python, write, spiral):
    write(spiral)
    answer = python("""
import h5py
import numpy as np
import orchestrator as orch

run = orch.run("mine.toml", set={"master.stop_time": 0.02}, swap={"controller": "mfsosmc"})
assert run["vehicle.eta.x"].shape == (3,)
assert run["vehicle.eta"].shape == (3, 6)
assert (run["vehicle.eta"][:, 2] == run["vehicle.eta.z"]).all()
assert run.time.tolist() == [0.0, 0.01, 0.02]
frame = run.to_dataframe()
assert frame.index.name == "time"
assert frame.index.tolist() == run.time.tolist()
assert list(frame.columns) == run.signals
assert (frame["vehicle.eta.x"].to_numpy() == run["vehicle.eta.x"]).all()
assert run.units("vehicle.eta.phi") == "rad"
try:
    run["vehicle.etta"]
except KeyError as error:
    assert "did you mean 'vehicle.eta'" in str(error)
else:
    raise AssertionError("no KeyError")
assert set(run.metrics) == set(run.attributes["metrics"])
last = orch.open_run("last")
assert last.run_id == run.run_id
assert orch.open_run(run.run_id[:4]).path == last.path
assert orch.open_run(run.path, results="elsewhere").run_id == run.run_id
with orch.run("mine.toml", output="here.h5") as other:
    assert str(other.path) == "here.h5"
print("done")
""")
    assert (answer.code, answer.out, answer.err) == (0, "done\n", "")


def test_python_raises_what_the_command_would_say(python, write, spiral, models):
    write(merged(spiral, {"master.stepp": 1}))
    write(single("trouble", kind=1), "bad.toml")
    answer = python("""
import orchestrator as orch

try:
    orch.run("mine.toml")
except orch.ExperimentError as error:
    assert [p.key for p in error.problems] == ["master.stepp"]
try:
    orch.run("bad.toml")
except orch.RunError as error:
    assert "'one' failed at t = 0.02 s" in str(error)
    assert error.run.status == "failed"
    assert error.run["one.y"].tolist() == [0.0, 0.01, 0.02]
try:
    orch.open_run("nothing")
except orch.StoreError as error:
    assert "no record 'nothing'" in str(error)
for error in (orch.ExperimentError, orch.FmuError, orch.RunError, orch.StoreError):
    assert issubclass(error, orch.OrchError)
print("done")
""")
    assert (answer.code, answer.out, answer.err) == (0, "done\n", "")


def test_numbers_of_numpy_are_numbers(python, write, spiral):
    """A loop over numpy.linspace is the usual way to vary a parameter."""
    write(spiral)
    answer = python("""
import h5py
import numpy as np
import orchestrator as orch

run = orch.run("mine.toml", set={"master.stop_time": np.float64(0.02), "master.seed": np.int64(3),
                                 "components.vehicle.parameters.eta_0": np.array([1.0, 2, 3, 0, 0, 0]),
                                 "components.controller.parameters.K_p.x": np.float32(100)})
print(run["vehicle.eta"][0].tolist(), run.attributes["seed"])
""")
    assert (answer.code, answer.out) == (0, "[1.0, 2.0, 3.0, 0.0, 0.0, 0.0] 3\n"), answer.err


def test_a_run_leaves_no_folder_behind(orch, write, spiral, tmp_path):
    """FMUs are unpacked into a temporary folder, which goes with the run."""
    (tmp_path / "tmp").mkdir()
    environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp")}
    assert orch("run", write(spiral), env=environment).code == 0
    assert list((tmp_path / "tmp").iterdir()) == []


def test_the_metrics_in_the_record_are_those_that_were_printed(orch, write, spiral, tmp_path):
    answer = orch("run", write(merged(spiral, {"record": {}})), "--json")  # every step
    with record(answer, tmp_path) as found:
        error = found["vehicle.eta.x"] - found["reference.eta_d.x"]
        assert answer.json["metrics"]["rmse_x"] == pytest.approx(np.sqrt((error**2).mean()), rel=1e-14)  # rounding
        assert found.metrics == answer.json["metrics"]
