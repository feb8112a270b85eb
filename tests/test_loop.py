"""The two loops, compiled and in Python: the same rows, failures and warnings, and what they say of their time."""

import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
import tomllib
from pathlib import Path

import pytest

import orchestrator
from commands import ORCH, poll
from experiments import EXPERIMENTS, merged, single, toml
from fmu_files import COMPILER, needs_compiler
from orchestrator.experiment.timegrid import TimeGrid
from orchestrator.simulation.loop import compiled

pytestmark = pytest.mark.skipif(compiled() is None, reason="orch was installed without a C compiler")

FILES = sorted(EXPERIMENTS.rglob("*.toml"))
OTHER_FACTS = ("status", "error", "warnings", "warning_kinds", "failed_at", "stopped_at", "metrics")


@pytest.fixture
def both(tmp_path, monkeypatch):
    """both(file, ...) runs it in both loops, finds the same in both records, and returns the compiled one's."""

    def run(path, **options):
        found = {}
        for loop in ("compiled", "python"):
            monkeypatch.setenv("ORCH_LOOP", loop)
            try:
                record = orchestrator.run(path, output=tmp_path / f"{loop}.h5", **options)
            except orchestrator.RunError as error:
                record = error.run
            assert record.attributes["timing"].get("loop", loop) == loop  # a run that does not get there has none
            found[loop] = record
        ours, theirs = found["compiled"], found["python"]
        assert ours.time.tobytes() == theirs.time.tobytes()
        assert ours.signals == theirs.signals
        for name in ours.signals:
            assert ours[name].tobytes() == theirs[name].tobytes(), name
        for fact in OTHER_FACTS:
            assert ours.attributes.get(fact) == theirs.attributes.get(fact), fact
        return ours

    return run


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_every_experiment_has_the_same_rows_in_both_loops(both, shipped, path, algorithm):
    with path.open("rb") as file:
        step = tomllib.load(file)["master"]["step"]
    stop_time, every = round(630 * step, 9), round(7 * step, 9)
    changes = {"master.stop_time": stop_time, "record.every": every, "master.algorithm": algorithm}
    changes |= {"metrics": {}, "sweep": {}}  # whose windows and objectives are of the whole run
    assert len(both(path, set=changes).time) == 91


@pytest.mark.parametrize("stride", [1, 3, 200])
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
@pytest.mark.parametrize("packaging", ["native", "python"])
def test_components_of_longer_periods_give_the_same_rows(both, shipped, spiral, write, stride, algorithm, packaging):
    if packaging == "native" and COMPILER is None:
        return
    table = merged(
        spiral,
        {
            "master.stop_time": 0.6,
            "master.algorithm": algorithm,
            "record.every": stride * 1e-3,
            "metrics": {},
            "components.controller.step": 0.01,
            "components.reference.step": 0.003,
        },
    )
    run = both(write(table), packaging=packaging)
    assert run.status == "completed"
    assert len(run.time) == 600 // stride + 1


def test_a_long_run_of_many_chunks_has_the_same_rows(both, shipped, spiral, write):
    table = merged(spiral, {"master.stop_time": 30.0, "record.every": 0.003, "metrics": {}})
    assert len(both(write(table)).time) == 10001


@needs_compiler
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_integers_booleans_and_enumerations_go_through_both_loops(both, probe, write, algorithm):
    table = {
        "master": {"stop_time": 0.2, "step": 0.01, "algorithm": algorithm},
        "components": {name: {"fmu": str(probe), "start": "fmu"} for name in ("one", "two", "slow")},
        "connections": {"two.count": "one.steps", "two.u": "one.y", "one.flag": "two.odd", "slow.count": "two.steps"},
        "record": {"every": 0.02, "signals": ["!*.words", "!*.text"]},
    }
    table["components"]["slow"]["step"] = 0.05
    run = both(write(table))
    assert run["two.steps"][-1] > run["one.steps"][-1] > 0
    assert set(run["one.odd"]) == {0, 1}


@needs_compiler
def test_texts_take_the_loop_in_python(probe, write, tmp_path):
    run = orchestrator.run(write(single(probe)), output=tmp_path / "texts.h5")
    assert run.attributes["timing"]["loop"] == "python"
    assert run["one.words"][-1] == "hallo 15"


@needs_compiler
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
@pytest.mark.parametrize("period", [1, 2])
@pytest.mark.parametrize("mode", range(1, 12))
def test_failures_are_the_same_in_both_loops(both, probe, write, mode, period, algorithm):
    table = {
        "master": {"stop_time": 0.1, "step": 0.01, "algorithm": algorithm},
        "components": {
            "before": {"fmu": str(probe), "start": "fmu"},
            "bad": {"fmu": str(probe), "start": "fmu", "step": 0.01 * period, "parameters": {"mode": mode, "at": 0.04}},
            "after": {"fmu": str(probe), "start": "fmu"},
        },
        "connections": {"after.u": "bad.y", "bad.u": "before.y"},
        "record": {"signals": ["!*.words", "!*.text"]},
    }
    run = both(write(table))
    if mode in (1, 2, 3, 5, 6, 11):
        assert run.status == "failed"
        assert "'bad' failed at t = 0.04 s" in run.attributes["error"]
        assert run.time[-1] == pytest.approx(0.04)


@needs_compiler
def test_a_value_that_is_not_finite_is_found_in_its_own_step_not_later(both, probe, write):
    table = single(probe, stop_time=50.0, mode=2, at=37.21)
    table["record"] = {"every": 1.0, "signals": ["!*.words", "!*.text"]}
    run = both(write(table))
    assert run.attributes["failed_at"] == pytest.approx(37.21)
    assert "output y is not finite: nan" in run.attributes["error"]


@pytest.mark.parametrize("change", ["del _loop.LAYOUT", "_loop.LAYOUT['StepperProgram'] += ' tolerance'"])
def test_a_compiled_loop_of_other_sources_is_reported_and_not_used(python, write, spiral, change):
    write(merged(spiral, {"metrics": {}}))
    answer = python(
        f"""
import orchestrator as orch
from orchestrator.simulation import _loop

fresh = orch.run("mine.toml", output="fresh.h5")
{change}
stale = orch.run("mine.toml", output="stale.h5")
print(fresh.attributes["timing"]["loop"], stale.attributes["timing"]["loop"])
print(fresh["vehicle.eta"].tobytes() == stale["vehicle.eta"].tobytes(), len(fresh.attributes["warnings"]))
print(*stale.attributes["warnings"])
import sys
from orchestrator.cli.main import main
sys.argv = ["orch", "--version"]
main()
"""
    )
    assert answer.code == 0, answer.err
    loops, rows, warning, version = answer.out.splitlines()
    assert loops == "compiled python"
    assert rows == "True 0"
    assert "was built from other sources than this orch" in warning
    assert "pip install -e ." in warning
    assert version.endswith("loop in Python")
    assert answer.err.strip() == warning


@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_an_unstable_loop_is_reported_alike_by_both_loops_in_a_long_run(both, shipped, spiral, write, algorithm):
    table = merged(spiral, {"master.stop_time": 20.0, "master.algorithm": algorithm, "metrics": {}})
    run = both(write(merged(table, {"record.every": 0.1})), swap={"controller": "mfsosmc"})
    assert [warning.kind for warning in run.warnings] == ["unstable"]
    assert run.warnings[0].startswith("controller.tau")


@pytest.mark.parametrize("step", [1e-4, 0.003, 1.2345678901234567e-05])
def test_times_of_many_ticks_are_those_of_each(step):
    grid = TimeGrid(step)
    assert [grid.time(k) for k in range(999, 2100)] == grid.times(999, 2100).tolist()


# --- Where the time goes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("loop", ["compiled", "python"])
def test_a_record_knows_the_seconds_of_each_component(shipped, spiral, write, tmp_path, monkeypatch, loop):
    monkeypatch.setenv("ORCH_LOOP", loop)
    table = merged(spiral, {"master.stop_time": 20.0, "components.controller.step": 0.01, "metrics": {}})
    timing = orchestrator.run(write(table), output=tmp_path / "timed.h5").attributes["timing"]
    components = timing["components"]
    assert list(components) == list(table["components"])
    assert (components["vehicle"]["steps"], components["controller"]["steps"]) == (20000, 2000)
    spent = sum(seconds[phase] for seconds in components.values() for phase in ("set", "step", "get"))
    # One step in 127 is timed: one in which the process had to wait for a core counts that often.
    assert 0.3 * timing["stepping"] < spent <= timing["stepping"] * (1 + 1e-12)
    assert components["vehicle"]["step"] > components["current"]["step"]


def test_show_prints_where_the_time_went(orch, shipped, spiral, write):
    file = orch("run", write(spiral), "--json").json["file"]
    text = orch("show", file).out
    assert "time in the loop (compiled): " in text
    assert "loop and recording" in text
    assert orch("show", file, "--json").json["timing"]["components"]["vehicle"]["step"] > 0


# --- Ctrl-C, and the sanitizers ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("packaging", ["native", "python"])
def test_ctrl_c_ends_a_run_at_once_twenty_times(shipped, spiral, write, tmp_path, packaging):
    if packaging == "native" and COMPILER is None:
        return
    path = write(merged(spiral, {"master.stop_time": 1e5, "record.every": 0.1, "metrics": {}}))
    took = []
    for i in range(20):
        record = tmp_path / f"{i}.h5"
        command = [ORCH, "run", path, "--packaging", packaging, "--output", record, "--quiet"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            poll(lambda record=record: record.exists() and record.stat().st_size, process)
            time.sleep(0.05 * i / 4)
            process.send_signal(signal.SIGINT)
            began = time.monotonic()
            assert "interrupted at t = " in process.communicate()[1]
            took.append(time.monotonic() - began)
        assert process.returncode == 130
        with orchestrator.open_run(record) as run:
            assert run.status == "interrupted"
            assert len(run["vehicle.eta.x"]) == len(run.time) > 0
    assert sorted(took)[10] < 0.5


SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer", "-g", "-O1")


@needs_compiler
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the sanitizers' library is preloaded as Linux does")
def test_the_sanitizers_find_nothing_in_the_compiled_loop(shipped, spiral, probe, write, tmp_path):
    package = Path(orchestrator.__file__).parent
    shutil.copytree(package, tmp_path / "orchestrator", ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    shutil.copytree(package.parent / "fmus", tmp_path / "fmus", ignore=shutil.ignore_patterns("build", "__pycache__"))
    subprocess.run(
        [
            COMPILER,
            "-std=c11",
            *SANITIZE,
            "-D_POSIX_C_SOURCE=200809L",
            "-shared",
            "-fPIC",
            f"-I{sysconfig.get_path('include')}",
            "-o",
            tmp_path / "orchestrator/simulation/_loop.abi3.so",
            package / "simulation/_loop.c",
        ],
        check=True,
    )
    libraries = [
        subprocess.check_output([COMPILER, f"-print-file-name={name}"], text=True).strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    environment = {
        **os.environ,
        "PYTHONPATH": str(tmp_path),
        "LD_PRELOAD": " ".join(libraries),
        "ORCH_LOOP": "compiled",
        "ASAN_OPTIONS": "detect_leaks=0",
    }
    mixed = merged(
        spiral, {"components.controller.step": 0.01, "master.algorithm": "jacobi", "record.every": 0.005, "metrics": {}}
    )
    bad = {**single(probe, mode=2), "record": {"signals": ["!*.words", "!*.text"]}}
    for table, code in ((spiral, 0), (mixed, 0), (bad, 3)):
        path = write(table)
        command = [sys.executable, "-m", "orchestrator.cli", "run", path, "--force"]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert "ERROR: AddressSanitizer" not in done.stderr
        assert "runtime error" not in done.stderr
        assert done.returncode == code, (toml(table), done.stderr)
