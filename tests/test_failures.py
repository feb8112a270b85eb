"""Runs that do not reach their end: models that fail, Ctrl-C, a full disk, a folder that cannot be written."""

import importlib
import os
import pickle
import pkgutil
import resource
import shutil
import signal
import subprocess
import threading
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import orchestrator
from commands import DEADLINE, ORCH, poll
from experiments import merged, single
from orchestrator.errors import ExperimentError, FmuError, OrchError, Problem, RunError, StoreError
from orchestrator.models.build import BuildError
from orchestrator.records.store.query import WhereError

HALT = 2.0  # s; the contract says one, the other is for a loaded machine


@pytest.fixture
def run(orch, write, tmp_path):
    """run(dictionary, ...) -> the answer and the record it names."""

    def run(table, *options, **kw):
        answer = orch("run", write(table), "--json", *options, **kw)
        return answer, orchestrator.open_run(tmp_path / answer.json["file"])

    return run


def check_failed(answer, record, name, t, words, rows):
    assert answer.code == 3, answer.err
    message = f"'{name}' failed at t = {t:g} s: "
    assert answer.err.startswith(f"{answer.json['file']}: {message}")
    assert words in answer.err
    assert answer.json["status"] == "failed"
    assert answer.json["error"] == record.attributes["error"]
    assert answer.json["error"].startswith(message)
    assert record.status == "failed"
    assert record.attributes["failed_at"] == t
    assert record.time.tolist() == rows
    assert all(len(record[signal]) == len(rows) for signal in record.signals)


# --- Models that fail -------------------------------------------------------------------------------------------------

ROWS = [0.0, 0.01, 0.02]  # the trouble comes in the step that begins at 0.02


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (1, "RuntimeError: the thruster is gone at 0.02, 100 %s sure %n"),  # printf would crash on this
        (2, "output y is not finite: nan"),
        (3, "output y is not finite: inf"),
        (5, "do_step made it (2,)"),
    ],
)
def test_a_python_model_that_fails_is_reported_in_its_own_words(run, models, kind, words):
    answer, record = run(single("trouble", kind=kind))
    check_failed(answer, record, "one", 0.02, words, ROWS)
    assert record["one.y"].tolist() == ROWS


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        (1, 'fmi2Error: "the probe lost its mind: 100 % sure"'),
        (2, "output y is not finite: nan"),
        (3, "output y is not finite: -inf"),
        (5, 'fmi2Discard: "the step is too large"'),
        (6, "fmi2Fatal; the FMU logged no message"),
        (11, "fmi2Error; the FMU logged no message"),
        (16, "fmi2Pending; the FMU logged no message"),
    ],
)
def test_a_c_fmu_that_fails_is_reported_in_its_own_words(run, probe, mode, words):
    answer, record = run(single(probe, mode=mode))
    check_failed(answer, record, "one", 0.02, words, ROWS)
    assert record["one.y"].tolist() == ROWS
    assert "illegal call" not in answer.err


def test_a_local_that_is_not_finite_stops_the_run_where_it_is_recorded(run, probe):
    answer, record = run(merged(single(probe, mode=10), {"record": {"inputs": True}}))
    check_failed(answer, record, "one", 0.02, "local hidden is not finite: nan", ROWS)


def test_the_time_of_a_failure_is_the_start_of_the_component_s_own_step(run, probe):
    table = merged(single(probe, mode=1, stop_time=0.12), {"components.one.step": 0.03, "master.stop_time": 0.12})
    answer, record = run(table)
    check_failed(answer, record, "one", 0.03, "the probe lost its mind", [0.0, 0.01, 0.02, 0.03])


@pytest.mark.parametrize(
    ("fmu", "trouble", "words"),
    [
        ("trouble", {"kind": 6}, "no calm sea: déjà vu"),
        ("probe", {"mode": 7}, 'fmi2Error: "the probe will not wake"'),
        ("probe", {"mode": 8}, "output y is not finite: nan"),
    ],
)
def test_a_model_that_fails_in_initialization_leaves_a_record_without_rows(run, models, probe, fmu, trouble, words):
    answer, record = run(single(probe if fmu == "probe" else fmu, **trouble))
    check_failed(answer, record, "one", 0, words, [])
    assert "illegal call" not in answer.err


def test_a_model_that_cannot_be_instantiated_starts_nothing(orch, write, probe, models, tmp_path):
    table = single("clock")
    table["components"]["stillborn"] = {"fmu": str(probe), "start": "fmu"}
    answer = orch("run", write(table))
    assert answer.code == 2
    assert answer.err == f"{probe} cannot be instantiated as 'stillborn': no licence for a probe\n"
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("fmu", "trouble", "words"),
    [
        ("trouble", {"kind": 1}, "the thruster is gone"),
        ("trouble", {"kind": 6}, "no calm sea"),
        ("probe", {"mode": 1}, "the probe lost its mind"),
        ("probe", {"mode": 7}, "the probe will not wake"),
    ],
)
def test_one_failure_among_several_components_takes_nothing_else_down(run, models, probe, fmu, trouble, words):
    """A failed Python FMU may not be called or freed again, healthy ones must be freed: else the process crashes."""
    table = {
        "master": {"stop_time": 0.05, "step": 0.01},
        "components": {
            "clock": {"fmu": "clock"},
            "healthy": {"fmu": str(probe), "start": "fmu"},
            "bad": {"fmu": str(probe) if fmu == "probe" else fmu, "parameters": trouble, "start": "fmu"},
            "same": {"fmu": str(probe) if fmu == "probe" else fmu, "start": "fmu"},
            "relay": {"fmu": "relay"},
        },
        "connections": {"relay.u": "clock.y"},
    }
    early = 6 in trouble.values() or 7 in trouble.values()
    answer, record = run(table)
    check_failed(answer, record, "bad", 0 if early else 0.02, words, [] if early else ROWS)
    assert "illegal call" not in answer.err


def test_a_failing_fmu_of_another_tool_is_reported_in_its_own_words(run, foreign):
    answer, record = run(single(foreign.east))
    check_failed(answer, record, "one", 0.02, "an east wind", ROWS)


@pytest.mark.parametrize("order", [("probe", "relay"), ("relay", "probe")])
def test_what_gave_the_nan_is_blamed_not_what_choked_on_it(run, models, probe, order):
    """The relay raises at a nan in its input, in the same step or in the next one."""
    components = {"probe": {"fmu": str(probe), "start": "fmu", "parameters": {"mode": 2}}, "relay": {"fmu": "relay"}}
    table = {
        "master": {"stop_time": 0.05, "step": 0.01},
        "components": {name: components[name] for name in order},
        "connections": {"relay.u": "probe.y"},
    }
    answer, record = run(table)
    check_failed(answer, record, "probe", 0.02, "output y is not finite: nan", ROWS)


def test_a_warning_of_an_fmu_is_kept_and_the_run_goes_on(run, orch, write, probe):
    answer, record = run(single(probe, mode=9))
    assert answer.code == 0
    assert answer.json["warnings"] == record.attributes["warnings"] == ["one: the probe feels warm"]
    assert answer.json["warning_kinds"] == [""]
    assert not record.is_wrong
    assert "warning: one: the probe feels warm" in orch("run", write(single(probe, mode=9)), "--force").err


def test_failures_in_one_python_process_leave_it_usable(python, write, models, foreign, probe):
    """As in a notebook: runs fail, another one follows, and the interpreter ends as it should."""
    for i in (1, 2, 3, 5, 6):
        table = single("trouble", kind=i)
        table["components"] |= {"clock": {"fmu": "clock"}, "relay": {"fmu": "relay"}}
        table["connections"] = {"relay.u": "clock.y"}
        write(table, f"bad{i}.toml")
    write(single(probe, mode=1), "bad7.toml")
    write(single(foreign.east), "bad8.toml")
    write(single("trouble"), "good.toml")
    answer = python("""
import orchestrator as orch

failed = []
for i in (1, 2, 3, 5, 6, 7, 8):
    try:
        orch.run(f"bad{i}.toml")
    except orch.RunError as error:
        failed.append(error.run.status)
print(failed)
print(orch.run("good.toml")["one.y"][-1])
""")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out == f"{['failed'] * 7}\n0.05\n"


@pytest.mark.parametrize("before", ["", "import helper"])
def test_modules_that_clash_in_one_python_process_run_in_another(python, write, foreign, tmp_path, before):
    """The second run would compute with the modules of the first, or of the caller."""
    (tmp_path / "helper.py").write_text("WORD = 'mine'\n", encoding="utf-8")
    write(single(foreign.north), "north.toml")
    write(single(foreign.south), "south.toml")
    answer = python(f"""
{before}
import orchestrator as orch

print(*(orch.run(f"{{name}}.toml", force=True)["one.s"][-1] for name in ("north", "south", "north")), sep=", ")
""")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out == "nord 4, süd 4, nord 4\n"


# --- Ctrl-C -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def start(shipped, write, tmp_path):
    """start(dictionary) -> the process of a run in the test's folder, which unpacks its FMUs into `tmp`."""
    (tmp_path / "tmp").mkdir()
    processes = []

    def begin(table, *options, **environment):
        environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp"), **environment}
        processes.append(
            subprocess.Popen(
                [ORCH, "run", str(write(table)), *options],
                cwd=tmp_path,
                env=environment,
                text=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
        )
        return processes[-1]

    yield begin
    for process in processes:
        process.kill()
        process.communicate()


def interrupt(process):
    """Ctrl-C; returns what the process still says.  It ends within a second."""
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    _, text = process.communicate(timeout=DEADLINE)
    assert time.monotonic() - began < HALT
    assert process.returncode == 130, text
    assert "Traceback" not in text
    return text


def rows_on_disk(folder):
    for path in folder.glob("results/*/*.h5"):
        try:
            with h5py.File(path, "r", locking=False) as file:
                return len(file["time"])
        except (OSError, KeyError):
            return 0
    return 0


@pytest.mark.parametrize("wait", [0.0, 0.13, 0.31])
def test_ctrl_c_in_the_loop_closes_the_record(start, spiral, tmp_path, wait):
    process = start(merged(spiral, {"master.stop_time": 1000.0}))
    poll(lambda: list(tmp_path.glob("results/*/*.h5")), process)
    threading.Event().wait(wait)  # anywhere in the loop
    text = interrupt(process)
    (path,) = tmp_path.glob("results/*/*.h5")
    assert f"results/mine/{path.name}: interrupted at t = " in text
    with h5py.File(path, "r") as file:
        assert file.attrs["status"] == "interrupted"
        n = len(file["time"])
        assert all(len(file["vehicle"][name]) == n for name in file["vehicle"])
    with orchestrator.open_run(path) as record:
        assert record.status == "interrupted"
        assert f"interrupted at t = {record.time[-1]:.2g}"[:18] in record.attributes["error"]
        assert not list((tmp_path / "tmp").iterdir())


def test_ctrl_c_several_times_is_one(start, spiral, tmp_path):
    process = start(merged(spiral, {"master.stop_time": 1000.0}))
    poll(lambda: list(tmp_path.glob("results/*/*.h5")), process)
    for _ in range(20):
        process.send_signal(signal.SIGINT)
    interrupt(process)
    (path,) = tmp_path.glob("results/*/*.h5")
    assert orchestrator.open_run(path).status == "interrupted"


def test_ctrl_c_during_slow_steps_waits_for_one_of_them_only(start, models, tmp_path):
    process = start(single("moody", stop_time=100.0, pause=0.3))
    poll(lambda: list(tmp_path.glob("results/*/*.h5")), process)
    interrupt(process)


def test_the_metrics_of_an_interrupted_run_are_those_of_the_steps_that_it_did(start, orch, models, tmp_path):
    table = single("waves", stop_time=1000.0, step=1e-3)
    metrics = {
        "rms": {"of": "rms", "signal": "one.ramp"},
        "last": {"of": "final", "signal": "one.ramp"},
        "never": {"of": "rms", "signal": "one.ramp", "after": 900.0},
    }
    process = start(merged(table, {"record.every": 1e-3, "metrics": metrics}))
    poll(lambda: rows_on_disk(tmp_path), process)
    interrupt(process)
    (path,) = tmp_path.glob("results/*/*.h5")
    with orchestrator.open_run(path) as record:
        ramp, end = record["one.ramp"], record.time[-1]
        assert record.attributes["interrupted_at"] == record.ended_at == end
        assert record.metrics["rms"] == pytest.approx(np.sqrt((ramp**2).mean()), rel=1e-12)  # sums in another order
        assert record.metrics["last"] == ramp[-1]
        assert record.unsampled == {"never"}
    assert f"  metrics, of the time until {end:.10g} s only" in orch("show", path).out


@pytest.mark.parametrize("wait", [0.0, 0.05, 0.1, 0.2])
def test_ctrl_c_while_fmus_are_loaded_ends_without_a_crash(start, spiral, tmp_path, wait):
    """Inside a Python FMU that is being instantiated, a KeyboardInterrupt would be an error of that FMU."""
    process = start(merged(spiral, {"master.stop_time": 1000.0}))
    poll(lambda: list((tmp_path / "tmp").glob("orch-*")), process)
    threading.Event().wait(wait)
    assert "interrupted" in interrupt(process)
    records = list(tmp_path.glob("results/*/*"))
    assert all(orchestrator.open_run(path).status == "interrupted" for path in records)
    assert wait or not records  # the first of five FMUs was on its way: the others are not waited for
    assert not list((tmp_path / "tmp").iterdir())


def test_the_next_run_removes_what_a_killed_one_has_unpacked_and_leaves_a_living_one_alone(start, models, tmp_path):
    temporary = tmp_path / "tmp"
    killed = start(single("moody", stop_time=100.0, pause=0.01))
    poll(lambda: list(tmp_path.glob("results/*/*.h5")), killed)
    killed.kill()
    killed.wait(DEADLINE)
    (left,) = temporary.iterdir()
    living = start(single("moody", stop_time=100.0, pause=0.02))
    poll(lambda: len(list(tmp_path.glob("results/*/*.h5"))) == 2, living)
    (own,) = temporary.iterdir()
    assert own != left
    assert start(single("clock", stop_time=0.01)).wait(DEADLINE) == 0
    assert list(temporary.iterdir()) == [own]
    interrupt(living)
    assert not list(temporary.iterdir())


def test_ctrl_c_during_the_build_starts_nothing(start, spiral, tmp_path):
    process = start(spiral, ORCH_BUILD=str(tmp_path / "fresh"))
    assert process.stderr.readline().startswith("building")
    interrupt(process)
    assert not (tmp_path / "results").exists()


def test_ctrl_c_leaves_an_earlier_record_alone(start, orch, write, models, tmp_path):
    table = single("moody", stop_time=0.05, pause=0.1)
    first = orch("run", write(table), "--json")
    process = start(table, "--force")
    poll(lambda: len(list(tmp_path.glob("results/mine/*.h5"))) == 2, process)
    interrupt(process)
    assert orchestrator.open_run(tmp_path / first.json["file"]).status == "completed"


def test_ctrl_c_in_python_is_a_keyboard_interrupt_when_the_record_is_closed(python, write, models):
    write(single("moody", stop_time=100.0, pause=0.01))
    answer = python("""
import glob
import os
import signal
import threading
import time
import orchestrator as orch

def press():
    while not glob.glob("results/*/*.h5"):
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGINT)


threading.Thread(target=press).start()
try:
    orch.run("mine.toml")
except KeyboardInterrupt:
    print(orch.open_run("last").status)
""")
    assert (answer.code, answer.out, answer.err) == (0, "interrupted\n", "")


# --- Disks and folders ------------------------------------------------------------------------------------------------


def limited(size):
    """For a process in which no file may grow beyond `size` bytes, as on a disk that fills up."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


@pytest.mark.slow
def test_a_disk_that_fills_up_ends_the_run_with_a_message_and_keeps_its_rows(run, models):
    table = merged(single("waves", stop_time=1000.0, step=1e-3), {"record": {"signals": ["*", "!*.eta"]}})
    answer, record = run(table, preexec_fn=limited(24 << 20))
    assert answer.code == 3
    assert answer.err == f"{answer.json['file']}: {answer.json['error']}\n"
    assert answer.json["error"] == f"{answer.json['file']} cannot be written: File too large"
    assert record.status == answer.json["status"] == "failed"
    assert record.attributes["error"] == answer.json["error"]
    # It took several writes to fill it: those before the last are there, whole.
    assert len(record.time) > 1000
    assert record["one.ramp"].tolist() == pytest.approx(2 * record.time, abs=1e-12)  # rounding of t + h
    record.close()
    with h5py.File(record.path, "r") as file:
        assert len(file["one"]["ramp"]) == len(file["time"])


def test_a_disk_without_room_for_the_first_rows_says_so(run, models):
    answer, record = run(single("waves", stop_time=5.0, step=1e-3), preexec_fn=limited(512 << 10))
    assert answer.code == 3
    assert "cannot be written: File too large" in answer.err
    assert (record.status, len(record.time)) == ("failed", 0)


def test_a_disk_that_is_full_in_a_sweep_leaves_the_records_of_failed_runs(orch, write, models):
    table = single("waves", stop_time=20.0, step=1e-3)
    table["metrics"] = {"far": {"of": "final", "signal": "one.ramp"}}
    table["sweep"] = {"keep": "full", "vary": {"components.one.parameters.heading": [0.0, 1.0]}}
    answer = orch("sweep", write(table), "--json", "--workers", "1", preexec_fn=limited(1 << 20))
    assert (answer.json["completed"], answer.json["failed"]) == (0, 2), answer.err
    runs = orch("list", "--json").json
    assert [run["status"] for run in runs] == ["failed", "failed"]
    assert all(run["error"].endswith(" cannot be written: File too large") for run in runs)


def test_a_disk_without_room_for_the_file_starts_nothing(orch, write, probe, tmp_path):
    answer = orch("run", write(single(probe)), preexec_fn=limited(64 << 10))
    assert answer.code == 2
    assert answer.err.startswith("results/mine/")
    assert answer.err.endswith(" cannot be written: File too large\n")
    assert not list(tmp_path.glob("results/*/*"))


def test_a_flush_that_fails_leaves_the_rows_before_it(python, write, spiral):
    write(merged(spiral, {"record.every": 0.001}))
    answer = python("""
import h5py
import orchestrator as orch
from orchestrator.records.file import recorder

flush, flushes = h5py.File.flush, []


def fails_once(file):
    flushes.append(file)
    if len(flushes) == 6:
        raise RuntimeError("can't flush file")
    flush(file)


h5py.File.flush, recorder.FLUSH_SECONDS = fails_once, 0.0
try:
    orch.run("mine.toml", output="run.h5")
except orch.RunError as error:
    print(error)
with orch.open_run("run.h5") as run:
    print(run.status, len(run.time), len(run["vehicle.eta.x"]))
""")
    assert answer.out == "run.h5: run.h5 cannot be written: can't flush file\nfailed 4 4\n", answer.err


def test_a_full_disk_in_python_is_a_run_error_and_other_runs_follow(python, write, models):
    write(single("waves", stop_time=5.0, step=1e-3))
    answer = python("""
import resource
import orchestrator as orch

limits = resource.getrlimit(resource.RLIMIT_FSIZE)
orch.run("mine.toml", set={"master.stop_time": 0.01})
resource.setrlimit(resource.RLIMIT_FSIZE, (512 << 10, limits[1]))
try:
    orch.run("mine.toml")
except orch.RunError as error:
    print(error.run.status)
resource.setrlimit(resource.RLIMIT_FSIZE, limits)
print(orch.run("mine.toml").status)
""")
    assert (answer.code, answer.out, answer.err) == (0, "failed\ncompleted\n", "")


def test_a_full_file_system_ends_the_run_with_a_message(write, models, tmp_path):
    """A real one, of 1 MB, in a mount namespace of its own."""
    if shutil.which("unshare") is None:
        pytest.skip("no unshare")
    path = write(single("waves", stop_time=20.0, step=1e-3))
    (tmp_path / "small").mkdir()
    script = 'mount -t tmpfs -o size=1m none small || exit 77; "$@"; code=$?; cp small/* .; exit $code'
    done = subprocess.run(
        ["unshare", "-r", "-m", "sh", "-c", script, "sh", ORCH, "run", path, "--output", "small/full.h5"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=DEADLINE,
    )
    if done.returncode == 77 or "unshare:" in done.stderr:
        pytest.skip("no mount namespaces here")
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr == "small/full.h5: small/full.h5 cannot be written: No space left on device\n"
    assert orchestrator.open_run(tmp_path / "full.h5").status == "failed"


@pytest.mark.parametrize("results", ["file", "file/below", "/proc/nowhere", "/dev/null"])
def test_a_folder_that_cannot_be_written_starts_nothing(orch, write, probe, tmp_path, results):
    (tmp_path / "file").write_text("in the way")
    answer = orch("run", write(single(probe)), "--results", results)
    assert answer.code == 2
    assert answer.err.count("\n") == 1
    assert f"{results}/mine/" in answer.err
    assert "cannot be written: " in answer.err
    assert (tmp_path / "file").read_text() == "in the way"


def test_a_temporary_folder_without_room_starts_nothing(orch, write, spiral, tmp_path):
    options = (write(spiral), "--packaging", "python")  # pythonfmu's libraries are larger than the limit
    orch("check", *options)
    answer = orch("run", *options, preexec_fn=limited(100 << 10))
    assert answer.code == 2
    assert "cannot be unpacked" in answer.err
    assert "File too large" in answer.err
    assert not (tmp_path / "results").exists()


# --- Pools of processes -----------------------------------------------------------------------------------------------


class Closed:
    """Like an open record: it cannot be pickled."""

    def __reduce__(self):
        raise TypeError("cannot be pickled")


ERRORS = [
    OrchError("what"),
    ExperimentError("a.toml", [Problem("master.step", "is missing"), Problem("", "is empty")]),
    FmuError("an FMU"),
    StoreError("a record"),
    RunError("it failed", Closed()),
    BuildError({"pid": "no compiler"}, {"nstsmc": Path("nstsmc.fmu")}),
    WhereError("what?"),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_error_arrives_whole_from_another_process(error):
    arrived = pickle.loads(pickle.dumps(error))
    assert type(arrived) is type(error)
    assert (str(arrived), arrived.args) == (str(error), error.args)
    kept = {name: value for name, value in vars(error).items() if name != "run"}
    assert {name: value for name, value in vars(arrived).items() if name != "run"} == kept
    assert getattr(arrived, "run", None) is None


def test_every_error_is_known_to_the_test_above():
    for module in pkgutil.walk_packages(orchestrator.__path__, "orchestrator."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    waiting, classes = [OrchError], set()
    while waiting:
        classes.add(waiting.pop())
        waiting += [c for known in classes for c in known.__subclasses__() if c not in classes]
    assert classes == {type(error) for error in ERRORS}


def test_a_pool_whose_worker_cannot_run_an_experiment_says_why_and_goes_on(python, write, models, spiral):
    bad, failing = write(merged(spiral, {"master.step": -1.0})), single("trouble", kind=1)
    answer = python(f"""
from concurrent.futures import ProcessPoolExecutor

import orchestrator as orch

if __name__ == "__main__":
    with ProcessPoolExecutor(1) as pool:
        for path in [{str(bad)!r}, {str(write(failing, "failing.toml"))!r}]:
            try:
                pool.submit(orch.run, path).result()
            except orch.ExperimentError as error:
                print(error.problems[0].key)
            except orch.RunError as error:
                print(error.run)
""")
    assert answer.out.split() == ["master.step", "None"], answer.err
