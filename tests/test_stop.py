"""Work that never returns: it is reported while it hangs, and it ends when it is asked to; no row is lost."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import h5py
import pytest

from commands import DEADLINE, ORCH, poll
from experiments import merged, single
from fmu_files import PROBE_VARIABLES, SOURCES, needs_compiler, probe_fmu
from orchestrator.models import build
from peers.station import free_port

SLOW = 0.6  # s; what the commands here take as long
HANGS = 15  # mode of the probe


@pytest.fixture(scope="session")
def trap(tmp_path_factory):
    """A probe whose component's name says what it does."""
    return probe_fmu(tmp_path_factory.mktemp("trap") / "trap.fmu", PROBE_VARIABLES, "-DTRAP")


@pytest.fixture(scope="session")
def endless(_build_folder):
    return build.build([str(SOURCES / "endless.py"), str(SOURCES / "clock.py")])


@pytest.fixture
def start(shipped, tmp_path):
    """start(*arguments, **environment) begins a command; what it says on stderr is in `.said`, line by line."""
    (tmp_path / "tmp").mkdir()
    processes = []

    def begin(*arguments, command=(ORCH,), **environment):
        environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp"), "ORCH_SLOW": str(SLOW), **environment}
        process = subprocess.Popen(
            [*command, *map(str, arguments)],
            cwd=tmp_path,
            env=environment,
            text=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        process.said = []
        process.reader = threading.Thread(target=lambda: process.said.extend(process.stderr), daemon=True)
        process.reader.start()
        processes.append(process)
        return process

    yield begin
    for process in processes:
        process.kill()
        process.wait()
        process.reader.join()
        process.stderr.close()


def said(process):
    return "".join(process.said)


def ends(process, code=130, within=4.0):
    began = time.monotonic()
    assert process.wait(DEADLINE) == code, said(process)
    assert time.monotonic() - began < within
    process.reader.join()
    assert "Traceback" not in said(process)
    return said(process)


def press_twice(process):
    """Ctrl-C, and again when it has not helped."""
    process.send_signal(signal.SIGINT)
    time.sleep(0.3)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    return ends(process)


def rows(path):
    with h5py.File(path, "r") as file:
        assert file.attrs["status"] == "interrupted"
        return file["time"][()].tolist()


def native(probe, **changes):
    return merged(single(probe, stop_time=10.0, mode=HANGS, at=0.05), changes)


HUNG = "'one' is in its step at t = 0.05 s, for "
PYTHON = {"components.one.fmu": "endless", "components.one.parameters": {"at": 0.05, "kind": 1}}
BESIDE = {"components.beside": {"fmu": "clock", "start": "fmu"}}  # a Python FMU: the loop holds Python's lock


@needs_compiler
@pytest.mark.parametrize("loop", ["", "python"])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        BESIDE,
        {"components.one.isolation": "process", "components.one.timeout": 1000.0},
        PYTHON,
        merged(PYTHON, {}) | {"components.one.parameters": {"at": 0.05, "kind": 2}},
        merged(PYTHON, {}) | {"components.one.parameters": {"at": 0.05, "kind": 3}},
    ],
    ids=["native", "native with the lock", "isolated", "python", "python that ignores it", "python with the lock"],
)
def test_a_step_that_never_returns_is_reported_and_ends_with_all_rows(
    start, write, probe, endless, tmp_path, changes, loop
):
    process = start("run", write(native(probe, **changes)), "-o", "hung.h5", ORCH_LOOP=loop)
    poll(lambda: HUNG in said(process), process)
    if "components.one.isolation" in changes:  # its process can be ended, and is
        process.send_signal(signal.SIGINT)
        text = ends(process)
    else:
        text = press_twice(process)
    assert "hung.h5: interrupted at t = 0.05 s" in text
    assert rows(tmp_path / "hung.h5") == [0.0, 0.01, 0.02, 0.03, 0.04, 0.05]
    assert not list((tmp_path / "tmp").iterdir())


# --- Starts and ends --------------------------------------------------------------------------------------------------


def named(trap, name):
    """The probe does what its name says."""
    table = single(trap, stop_time=0.05, name=name)
    return merged(table, {"components.before": {"fmu": "clock", "start": "fmu"}})


@needs_compiler
@pytest.mark.parametrize(
    ("name", "what", "status"),
    [
        ("never_loads", "is loaded", None),
        ("sleeps", "is set up", "interrupted"),
        ("never_freed", "is freed", "completed"),
    ],
)
def test_a_start_or_an_end_that_never_returns_is_reported_and_ends(
    start, write, trap, endless, tmp_path, name, what, status
):
    process = start("run", write(named(trap, name)), "-o", "hung.h5")
    poll(lambda: f"'{name}' {what}, for " in said(process), process)
    press_twice(process)
    assert not list((tmp_path / "tmp").iterdir())
    if status is None:
        assert not (tmp_path / "hung.h5").exists()
        return
    with h5py.File(tmp_path / "hung.h5", "r") as file:
        assert file.attrs["status"] == status
        assert len(file["time"]) == (6 if status == "completed" else 0)


def test_an_initialization_in_python_that_never_returns_is_reported_and_ends(start, write, endless, tmp_path):
    process = start("run", write(single("endless", kind=4)), "-o", "hung.h5")
    poll(lambda: "'one' is " in said(process), process)
    text = press_twice(process)
    assert "hung.h5: interrupted at t = 0 s" in text
    assert rows(tmp_path / "hung.h5") == []
    assert not list((tmp_path / "tmp").iterdir())


@needs_compiler
def test_an_fmu_on_trial_that_never_returns_is_reported_and_ends(start, write, trap, tmp_path):
    process = start("check", write(single(trap, name="sleeps")), "--load")
    poll(lambda: "'sleeps' is initialized, for " in said(process), process)
    process.send_signal(signal.SIGTERM)
    ends(process)
    assert not list((tmp_path / "tmp").iterdir())


def test_a_component_that_waits_for_the_world_is_reported_and_ends_at_once(start, spiral, write, shipped, tmp_path):
    """No ArduPilot answers."""
    vehicle = {**spiral["components"]["vehicle"], "start": "fmu"}
    connections = {f"ardusub.{name}": f"vehicle.{name}" for name in ("eta", "nu", "specific_force")}
    table = {
        "master": {"stop_time": 4.0, "step": 0.0025},
        "components": {
            "ardusub": {"builtin": "ardupilot_json", "parameters": {"port": free_port()}},
            "vehicle": vehicle,
        },
        "connections": {**connections, "vehicle.u": "ardusub.u"},
    }
    process = start("run", write(table), "-o", "run.h5")
    poll(lambda: "'ardusub' is in its step at t = 0 s, for " in said(process), process)
    process.send_signal(signal.SIGTERM)
    assert "run.h5: interrupted at t = " in ends(process)
    assert rows(tmp_path / "run.h5")
    assert not list((tmp_path / "tmp").iterdir())


def test_a_write_that_takes_long_is_reported(python, write, endless):
    write(single("clock"))
    answer = python(
        """
import time
import orchestrator as orch
from orchestrator.records.file.recorder import Recorder

conclude = Recorder._conclude


def slowly(self):
    time.sleep(1.5)
    conclude(self)


Recorder._conclude = slowly
print(orch.run("mine.toml", output="slow.h5").status)
""",
        env={**os.environ, "ORCH_SLOW": str(SLOW)},
    )
    assert (answer.code, answer.out) == (0, "completed\n")
    assert answer.err.startswith("slow.h5 is written, for 1 s now; Ctrl-C, pressed twice, ends it\n")


# --- SIGTERM and SIGHUP -----------------------------------------------------------------------------------------------


def flowing(**changes):
    return merged(single("clock", stop_time=1e5, step=1e-3), changes)


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_run_that_the_system_ends_ends_in_order(start, write, endless, tmp_path, name):
    process = start("run", write(flowing()), "-o", "run.h5")
    poll(lambda: (tmp_path / "run.h5").exists(), process)
    time.sleep(0.5)
    process.send_signal(getattr(signal, name))
    assert "run.h5: interrupted at t = " in ends(process)
    times = rows(tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "r") as file:
        assert times[-1] == file.attrs["interrupted_at"]
    assert len(times) > 1
    assert not list((tmp_path / "tmp").iterdir())


@needs_compiler
def test_a_run_that_the_system_ends_does_not_wait_for_what_never_returns(start, write, probe, tmp_path):
    process = start("run", write(native(probe)), "-o", "hung.h5")
    poll(lambda: HUNG in said(process), process)
    process.send_signal(signal.SIGTERM)
    ends(process, within=8.0)
    assert len(rows(tmp_path / "hung.h5")) == 6
    assert not list((tmp_path / "tmp").iterdir())


def test_what_nohup_ignores_stays_ignored(start, write, endless, tmp_path):
    path = write(flowing())
    command = f"trap '' HUP; exec {ORCH} run {path} -o run.h5"
    process = start(command=["sh", "-c", command])
    poll(lambda: (tmp_path / "run.h5").exists(), process)
    process.send_signal(signal.SIGHUP)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    ends(process)


# --- Other commands ---------------------------------------------------------------------------------------------------


def descendants(process):
    """Command lines of what a process has begun that still runs."""
    text = subprocess.run(["ps", "-eo", "pid,ppid,args"], capture_output=True, text=True, check=True).stdout
    lines = [line.split(None, 2) for line in text.splitlines()[1:]]
    family, grown = {str(process.pid)}, True
    while grown:
        more = {pid for pid, parent, _ in lines if parent in family} - family
        family, grown = family | more, bool(more)
    return {pid: arguments for pid, _, arguments in lines if pid in family - {str(process.pid)}}


def gone(pids):
    return not any((path := Path(f"/proc/{pid}/cmdline")).exists() and path.read_bytes() for pid in pids)


@needs_compiler
def test_a_study_reports_which_of_its_runs_hangs_and_ends_it(start, write, probe, tmp_path):
    table = native(probe, metrics={"last": {"of": "final", "signal": "one.y"}})
    process = start("converge", write(table), "--steps", "0.005,0.02")
    poll(lambda: "step 0.01 s: 'one' is in its step at t = 0.05 s, for " in said(process), process)
    children = descendants(process)
    assert children
    press_twice(process)
    assert gone(children)
    records = list(tmp_path.glob("results/*/*.h5"))
    assert records
    assert all(rows(path) for path in records)
    assert not list((tmp_path / "tmp").iterdir())


@needs_compiler
@pytest.mark.skipif(sys.platform != "linux", reason="a process learns there only that its parent has ended")
def test_runs_of_a_study_that_is_killed_end_with_it(start, write, probe, tmp_path):
    table = native(probe, metrics={"last": {"of": "final", "signal": "one.y"}})
    process = start("converge", write(table), "--steps", "0.005,0.02")
    poll(lambda: "step 0.01 s: 'one' is in its step at t = 0.05 s, for " in said(process), process)
    children = descendants(process)
    process.kill()
    poll(lambda: gone(children))
    records = list(tmp_path.glob("results/*/*.h5"))
    assert records
    assert all(rows(path) for path in records)


def swept(table, **tune):
    """A sweep of two runs, of which one hangs."""
    sweep = {"vary": {"components.one.parameters.at": [0.05, 1e9]}}
    table = merged(table, {"metrics": {"last": {"of": "final", "signal": "one.y"}}, "sweep": sweep | tune})
    return merged(table, {"master.stop_time": 0.2})


@needs_compiler
@pytest.mark.parametrize("beside", [{}, BESIDE], ids=["native", "native with the lock"])
def test_a_sweep_reports_which_of_its_runs_hangs_and_ends(start, write, probe, endless, tmp_path, beside):
    process = start("sweep", write(swept(native(probe, **beside))), "--workers", "2")
    poll(lambda: "run 0 of the sweep: 'one' is in its step at t = 0.05 s, for " in said(process), process)
    children = descendants(process)
    press_twice(process)
    assert gone(children)
    (results,) = tmp_path.glob("results/*")
    assert "completed" in next(results.glob("*.csv")).read_text()
    assert not list((tmp_path / "tmp").glob("orch-*"))


@needs_compiler
def test_tuning_ends_while_a_trial_hangs(start, write, probe, endless, tmp_path):
    space = {"at": {"distribution": "uniform", "low": 0.01, "high": 0.02}}
    tune = {
        "objective": "last",
        "trials": 2,
        "draws": 1,
        "held_out": 1,
        "component": "one",
        "search": {str(probe): space},
    }
    vary = {"components.two.parameters.at": {"distribution": "uniform", "low": 0.01, "high": 0.05}}
    table = native(probe, metrics={"last": {"of": "final", "signal": "one.y"}}, sweep={"vary": vary, "tune": tune})
    table = merged(table, {"components.two": {"fmu": "endless", "start": "fmu"}})
    process = start("tune", write(table), "--workers", "1")
    poll(lambda: "of the sweep: 'two' is in its step at t = " in said(process), process)
    children = descendants(process)
    press_twice(process)
    assert gone(children)


MODEL = "import time\nwhile True:\n    time.sleep(1)\n"


def test_a_build_that_never_ends_is_reported_and_ends_with_its_processes(start, tmp_path):
    (tmp_path / "forever.py").write_text(MODEL)
    process = start("build", "forever.py", ORCH_BUILD=str(tmp_path / "built"))
    poll(lambda: "building forever, for " in said(process), process)
    children = descendants(process)
    assert children
    process.send_signal(signal.SIGTERM)
    assert "interrupted" in ends(process)
    assert gone(children)


@pytest.mark.parametrize("option", ["--force", "--verify"])
def test_an_interrupted_rerun_says_so(start, orch, write, models, tmp_path, option):
    first = orch("run", write(single("moody", pause=0.4)), "--json").json
    process = start("rerun", tmp_path / first["file"], option)
    poll(lambda: list((tmp_path / "tmp").glob("orch-*/0")), process)
    time.sleep(0.6)
    process.send_signal(signal.SIGINT)
    assert "interrupted" in ends(process)
    assert not list((tmp_path / "tmp").iterdir())


def test_a_paced_run_ends_at_once(start, write, endless, tmp_path):
    process = start("run", write(single("clock", stop_time=100.0, step=20.0)), "--realtime", "-o", "run.h5")
    poll(lambda: (tmp_path / "run.h5").exists(), process)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    assert "run.h5: interrupted at t = " in ends(process, within=2.0)


# --- In Python --------------------------------------------------------------------------------------------------------


def test_in_python_a_second_ctrl_c_ends_a_model_and_the_process_goes_on(python, write, endless):
    write(merged(single("endless", stop_time=10.0, at=0.05), {}))
    answer = python("""
import glob
import os
import signal
import threading
import time
from pathlib import Path
import orchestrator as orch

def press():
    while not glob.glob("results/*/*.h5"):
        time.sleep(0.01)
    for _ in range(2):
        time.sleep(0.7)
        os.kill(os.getpid(), signal.SIGINT)


threading.Thread(target=press).start()
try:
    orch.run("mine.toml")
except KeyboardInterrupt:
    run = orch.open_run("last")
    print(run.status, len(run.time))
time.sleep(1.0)
print("on")
""")
    assert (answer.code, answer.out, answer.err) == (0, "interrupted 6\non\n", "")


def test_in_a_thread_what_hangs_is_reported_and_the_process_can_end(python, write, endless):
    write(merged(single("endless", stop_time=10.0, at=0.05), {}))
    answer = python(
        """
import threading
import time
from pathlib import Path
import orchestrator as orch

threading.Thread(target=orch.run, args=("mine.toml",), daemon=True).start()
time.sleep(6.0)
print("on", flush=True)
import os
os._exit(0)
""",
        env={**os.environ, "ORCH_SLOW": str(SLOW)},
    )
    assert (answer.code, answer.out) == (0, "on\n")
    assert answer.err.startswith("'one' is in its step at t = 0.05 s, for 1 s now\n")


def test_a_record_that_is_being_closed_is_closed_whatever_is_pressed(python, write, endless):
    write(flowing())
    answer = python("""
import glob
import os
import signal
import threading
import time
import orchestrator as orch
from orchestrator.records.file.recorder import Recorder

conclude = Recorder._conclude


def slowly(self):
    for _ in range(3):
        time.sleep(0.4)
        os.kill(os.getpid(), signal.SIGINT)
    conclude(self)


Recorder._conclude = slowly
threading.Thread(target=lambda: (time.sleep(1.0), os.kill(os.getpid(), signal.SIGINT))).start()
try:
    orch.run("mine.toml")
except KeyboardInterrupt:
    print(orch.open_run("last").status)
""")
    assert (answer.code, answer.out, answer.err) == (0, "interrupted\n", "")
