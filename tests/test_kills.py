"""Runs that are killed, and runs that crowd into one store.  ORCH_FUZZ=10 kills ten times as often (`make fuzz`)."""

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import h5py
import pytest

import orchestrator
from commands import ORCH, poll
from experiments import merged
from fmu_files import COMPILER

KILLS = 20 * int(os.environ.get("ORCH_FUZZ", "1"))
LONGEST = 3.0  # s of wall time after which a run is killed at the latest


@pytest.fixture
def long(spiral):
    """An experiment that goes on for minutes."""
    return merged(spiral, {"master.stop_time": 1e6, "record.every": 0.1, "metrics": {}})


def true_rows(write, long, tmp_path, rows):
    """{signal: values, and envelope or None} of the first `rows` rows of the run that nobody kills."""
    short = merged(long, {"master.stop_time": round(0.1 * max(rows, 2), 1)})
    with orchestrator.run(write(short, "short.toml"), output=tmp_path / "true.h5") as run:
        return {name: (run[name][:rows], run.envelope(name)) for name in run.signals}


def test_after_a_kill_at_any_moment_the_rows_are_those_of_the_true_run(shipped, write, long, tmp_path):
    path, chance, found = write(long), random.Random(1), []
    for i in range(KILLS):
        record = tmp_path / f"{i}.h5"
        with subprocess.Popen([ORCH, "run", path, "--output", record, "--quiet"]) as process:
            poll(lambda record=record: record.exists() and record.stat().st_size, process)
            time.sleep(chance.uniform(0.0, LONGEST) ** 2 / LONGEST)
            process.kill()
        try:
            with h5py.File(record, "r") as file:
                n = len(file["time"])
                found.append((record, n))
        except OSError:  # killed before it was a file of HDF5
            assert not record.read_bytes().startswith(b"\x89HDF")
    assert len(found) > 0.7 * KILLS
    assert max(n for _, n in found) > 1000
    true = true_rows(write, long, tmp_path, max(n for _, n in found))
    for record, n in found:
        with orchestrator.open_run(record) as run:
            assert run.status == "interrupted (killed)"
            assert len(run.time) == n
            for name, (values, envelope) in true.items():
                assert run[name].tobytes() == values[:n].tobytes(), (record, name)
                if envelope is not None:
                    assert run.envelope(name).tobytes() == envelope[:n].tobytes(), (record, name)
            assert n == 0 or len(run.envelope("allocation.u.T1")) == n


@pytest.mark.skipif(COMPILER is None or sys.platform != "linux", reason="needs a C compiler and LD_PRELOAD")
def test_after_a_kill_between_any_two_writes_every_flushed_row_is_readable(python, write, spiral, tmp_path):
    """All that a run does to its file, write by write: each state is none yet, or has all rows that were there."""
    library, states = tmp_path / "snapshots.so", tmp_path / "states"
    source = Path(__file__).parent / "peers" / "snapshots.c"
    subprocess.run([COMPILER, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    states.mkdir()
    metrics = {"size": {"of": "rms", "signal": "vehicle.eta.x"}}
    record = {"every": 0.001, "signals": ["vehicle.eta.*"]}
    write(merged(spiral, {"master.stop_time": 2.5, "record": record, "metrics": metrics}))
    answer = python(
        """
import orchestrator as orch
from orchestrator.records.file import recorder
from orchestrator.simulation import master

master.CHUNK_SECONDS = 1e9  # each chunk of steps is twice the last one
recorder.FLUSH_SECONDS = 0.0  # after every chunk
orch.run("mine.toml", output="run.h5")
""",
        env={**os.environ, "LD_PRELOAD": str(library), "SNAPSHOTS": str(states)},
    )
    assert answer.code == 0, answer.err
    with orchestrator.open_run(tmp_path / "run.h5") as run:
        assert run.status == "completed"
        rows, true = len(run.time), {name: run[name] for name in run.signals}
    lengths = []
    for state in sorted(states.iterdir()):
        try:
            file = h5py.File(state, "r", locking=False)
        except OSError:
            assert not lengths, state
            continue
        with file:
            n = len(file["time"])
            assert file["time"][()].tolist() == [k / 1000 for k in range(n)]
            for name, values in true.items():
                assert file[name.replace(".", "/", 1)][:n].tobytes() == values[:n].tobytes(), (state, name)
            lengths.append(n)
    assert lengths == sorted(lengths)
    assert len(set(lengths)) > 5
    assert lengths[-1] == rows


def test_eight_runs_at_once_into_one_store_are_eight_good_records(shipped, write, spiral, tmp_path):
    path = write(merged(spiral, {"master.stop_time": 2.0}))
    command = [ORCH, "run", path, "--quiet", "--set"]
    changes = [f"components.vehicle.parameters.eta_0.z={1 + i / 10}" for i in range(8)]
    processes = [subprocess.Popen([*command, change], cwd=tmp_path) for change in changes]
    assert [process.wait() for process in processes] == [0] * 8
    depths = set()
    for record in tmp_path.glob("results/mine/*.h5"):
        with orchestrator.open_run(record) as run:
            assert run.status == "completed"
            assert len(run.time) == 201
            depths.add(round(float(run["vehicle.eta.z"][0]), 6))
    assert depths == {round(1 + i / 10, 6) for i in range(8)}


def test_a_plot_follows_a_run_until_it_ends(shipped, write, models, tmp_path):
    path = write(
        {
            "master": {"stop_time": 0.4, "step": 0.01},
            "components": {"one": {"fmu": "moody", "parameters": {"pause": 0.1}, "start": "fmu"}},
        }
    )
    with subprocess.Popen([ORCH, "run", path, "--quiet"], cwd=tmp_path) as process:
        record = poll(lambda: next(tmp_path.glob("results/mine/*.h5"), None), process)
        poll(lambda: has_rows(record), process)
        command = [ORCH, "plot", record, "--follow", "-o", "live.png"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert process.wait() == 0
    lines = done.stdout.splitlines()
    assert len(lines) > 1
    assert lines[0].startswith("live.png: t = 0.")
    assert lines[-1] == "live.png"
    assert (tmp_path / "live.png").stat().st_size > 1000


def has_rows(record):
    try:
        with h5py.File(record, "r", locking=False) as file:
            return len(file["time"]) > 0
    except (OSError, KeyError):
        return False
