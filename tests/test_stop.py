"""Work that never returns: it is reported while it hangs, and it ends when it is asked to; no row is lost."""

import os
import signal
import subprocess
import threading
import time

import h5py
import pytest

from commands import DEADLINE, ORCH, poll
from experiments import merged, single
from fmu_files import PROBE_VARIABLES, SOURCES, needs_compiler, probe_fmu
from orchestrator.models import build

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

    def begin(*arguments, **environment):
        environment = {**os.environ, "TMPDIR": str(tmp_path / "tmp"), "ORCH_SLOW": str(SLOW), **environment}
        process = subprocess.Popen(
            [ORCH, *map(str, arguments)],
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
