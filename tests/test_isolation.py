"""Components in processes of their own: the same numbers; whatever fails there is an error message and costs no row.

ORCH_FUZZ=10 has each fault 50 times (`make fuzz`).
"""

import os
import random
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

import orchestrator
from commands import ORCH, poll
from experiments import merged, single
from fmu_files import SOURCES, needs_compiler

pytestmark = [needs_compiler, pytest.mark.skipif(not hasattr(os, "fork"), reason="needs POSIX")]

FUZZ = int(os.environ.get("ORCH_FUZZ", "1"))
FAULTS = {
    "segfault": (12, "its process was ended by signal 11 (Segmentation fault)"),
    "abort": (13, "its process was ended by signal 6 (Aborted)"),
    "exit": (14, "its process ended by itself, with exit code 3"),
    "hang": (15, "it did not answer within 0.5 s (timeout); its process was ended"),
    "nan": (2, "output y is not finite: nan"),
    "error": (1, 'fmi2Error: "the probe lost its mind: 100 % sure"'),
}


def two(probe, isolated="process", **changes):
    """One probe feeds another with numbers, truths and words."""
    table = single(probe, stop_time=0.2)
    table["components"]["two"] = {"fmu": str(probe), "start": "fmu", "isolation": isolated}
    table["connections"] = {"two.u": "one.y", "two.count": "one.steps", "two.flag": "one.odd"}
    table["record"] = {"inputs": True, "signals": ["*", "!*.text", "!*.words"]}
    return merged(table, changes)


@pytest.fixture
def left(tmp_path, monkeypatch):
    """What is left of processes, memory and folders since the test began."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))

    def memory():  # semaphores are somebody else's
        return {p for p in Path("/dev/shm").glob("*") if not p.name.startswith("sem.")}

    before = memory()

    def find():
        found = [str(p) for p in folder.iterdir()] + [str(p) for p in (memory() - before)]
        for process in Path("/proc").glob("[0-9]*"):
            try:
                command = (process / "cmdline").read_bytes().split(b"\0")
                environment = (process / "environ").read_bytes()
            except OSError:
                continue
            if b"orchestrator.instances.isolated_child" in command and str(folder).encode() in environment:
                found.append(b" ".join(command).decode())
        return found

    return find


@pytest.mark.parametrize("loop", ["", "python"])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"master.algorithm": "jacobi"},
        {"components.two.step": 0.04},
        {"record.signals": ["*"]},
        {"connections.two.text": "one.words", "record.signals": ["*"]},
    ],
)
def test_a_process_of_its_own_changes_no_bit(orch, write, probe, changes, loop, monkeypatch, tmp_path):
    monkeypatch.setenv("ORCH_LOOP", loop)
    records = []
    for isolated in ("none", "process"):
        answer = orch("run", write(two(probe, isolated, **changes)), "--json", "--force", "-o", f"{isolated}.h5")
        assert answer.code == 0, answer.err
        records.append(orchestrator.open_run(tmp_path / answer.json["file"]))
    assert records[0].signals == records[1].signals
    assert records[0].run_id == records[1].run_id
    for signal_ in records[0].signals:
        assert records[0][signal_].tolist() == records[1][signal_].tolist(), signal_


@pytest.mark.parametrize("loop", ["", "python"])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_there_is_reported_and_keeps_every_row(orch, write, probe, left, tmp_path, fault, loop, monkeypatch):
    monkeypatch.setenv("ORCH_LOOP", loop)
    mode, words = FAULTS[fault]
    steps = random.Random(fault + loop).choices(range(1, 19), k=(2 if loop else 3) * FUZZ)
    for n, k in enumerate(steps):
        changes = {"components.two.parameters": {"mode": mode, "at": k / 100}}
        if fault == "hang":
            changes["components.two.timeout"] = 0.5
        answer = orch("run", write(two(probe, **changes)), "--json", "-o", f"fault{n}.h5")
        assert answer.code == 3
        assert answer.json["error"] == f"'two' failed at t = {k / 100:g} s: {words}"
        with orchestrator.open_run(tmp_path / f"fault{n}.h5") as record:
            assert record.time.tolist() == [i / 100 for i in range(k + 1)]
            np.testing.assert_allclose(record["one.y"], record.time)
            assert record.attributes["last_inputs"]["u"] == pytest.approx((k + 1) / 100)
        assert left() == []


@pytest.mark.parametrize(("mode", "code", "words"), [(7, 3, "the probe will not wake"), (8, 3, "not finite")])
def test_a_fault_in_initialization_is_reported(orch, write, probe, left, mode, code, words):
    answer = orch("run", write(two(probe, **{"components.two.parameters": {"mode": mode}})))
    assert answer.code == code
    assert words in answer.err
    assert left() == []


def test_one_that_cannot_be_instantiated_starts_nothing(orch, write, probe, left, tmp_path):
    table = single(probe)
    table["components"]["stillborn"] = {"fmu": str(probe), "start": "fmu", "isolation": "process"}
    answer = orch("run", write(table))
    assert answer.code == 2
    assert answer.err == f"{probe} cannot be instantiated as 'stillborn': no licence for a probe\n"
    assert left() == []
    assert not (tmp_path / "results").exists()


def test_ctrl_c_ends_a_run_whose_component_hangs(write, probe, left, tmp_path):
    path = write(two(probe, **{"components.two.parameters": {"mode": 15, "at": 0.05}}))
    command = [ORCH, "run", path, "-o", "hung.h5", "-q"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
        poll(lambda: [p for p in left() if "child" in p], process)
        poll(lambda: (tmp_path / "hung.h5").exists(), process)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=30)
    assert process.returncode == 130, error
    assert "interrupted" in error
    assert left() == []
    with orchestrator.open_run(tmp_path / "hung.h5") as record:
        assert record.status == "interrupted"


def test_a_killed_run_leaves_no_process(write, probe, left, tmp_path):
    path = write(two(probe, **{"components.two.parameters": {"mode": 15, "at": 0.05}}))
    with subprocess.Popen([ORCH, "run", path, "-q"], cwd=tmp_path) as process:
        poll(lambda: [p for p in left() if "child" in p], process)
        process.kill()
    poll(lambda: not [p for p in left() if "child" in p])


def test_a_run_cleans_up_what_a_killed_one_left(orch, write, probe, left, tmp_path):
    path = write(two(probe, **{"components.two.parameters": {"mode": 15, "at": 0.05}}))
    with subprocess.Popen([ORCH, "run", path, "-q"], cwd=tmp_path) as process:
        poll(lambda: [p for p in left() if "child" in p], process)
        process.kill()
    poll(lambda: not [p for p in left() if "child" in p])
    assert left() != []
    assert orch("run", write(single(probe), "other.toml")).code == 0
    assert left() == []


def test_the_last_inputs_of_what_failed_are_reported(orch, write, probe):
    answer = orch("run", write(two(probe, **{"components.two.parameters": {"mode": 12, "at": 0.05}})))
    assert answer.err.splitlines()[-1] == "  its last inputs: u = 0.06, count = 18, flag = 0"


def test_a_timeout_is_of_a_step_and_not_of_the_start(orch, write, probe):
    assert orch("run", write(two(probe, **{"components.two.timeout": 0.2}))).code == 0


def test_isolation_and_timeout_are_checked(orch, write, probe):
    answer = orch("check", write(two(probe, "proces", **{"components.one.timeout": -1})))
    assert answer.code == 2
    assert "components.two.isolation: no 'proces'; did you mean 'process'?" in answer.err
    assert "components.one.timeout: is -1" in answer.err


def test_an_fmu_that_prints_does_not_spoil_the_answer(orch, write, models, tmp_path):
    assert orch("build", SOURCES / "chatty.py").code == 0
    table = single("chatty")
    table["components"]["one"]["isolation"] = "process"
    assert orch("run", write(table), "--json").json["status"] == "completed"
