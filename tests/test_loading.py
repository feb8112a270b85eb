"""orch check loads no FMU, unless --load asks for it; then each in a process of its own."""

import os
import time
from pathlib import Path

import pytest

from experiments import merged, single
from fmu_files import PROBE_VARIABLES, needs_compiler, paper_fmu, probe_fmu


@pytest.fixture(scope="session")
def trap(tmp_path_factory):
    """A probe whose component's name says what it does."""
    return probe_fmu(tmp_path_factory.mktemp("trap") / "trap.fmu", PROBE_VARIABLES, "-DTRAP")


def many(path, *names):
    """Components of one FMU; what is the same in all values would be tried once."""
    components = {name: {"fmu": str(path), "parameters": {"at": i}, "start": "fmu"} for i, name in enumerate(names)}
    return {**single(path), "components": components}


@needs_compiler
def test_check_runs_no_code_of_an_fmu_unless_it_is_asked_to(orch, write, trap, tmp_path):
    path, env = write(single(trap)), {**os.environ, "AWAKE": str(tmp_path / "awake")}
    assert orch("check", path, env=env).code == 0
    assert not (tmp_path / "awake").exists()
    answer = orch("check", path, "--load", env=env)
    assert (answer.code, answer.err) == (0, "every FMU was loaded and initialized\n")
    assert (tmp_path / "awake").exists()


@needs_compiler
def test_what_kills_a_process_is_an_error_message_for_each_component(orch, write, trap, tmp_path):
    names = ("falls", "aborts", "leaves", "sleeps", "stillborn", "lives")
    began = time.monotonic()
    answer = orch("check", write(many(trap, *names)), "--load", "--timeout", "3", "--json")
    assert time.monotonic() - began < 30
    assert answer.code == 2
    found = {problem["key"]: problem["problem"] for problem in answer.json["problems"]}
    assert found == {
        "components.falls.fmu": f"{trap} ended the process (SIGSEGV) while it was loaded and instantiated",
        "components.aborts.fmu": f"{trap} ended the process (SIGABRT) while it was initialized",
        "components.leaves.fmu": f"{trap} ended the process (exit code 3) while it was initialized",
        "components.sleeps.fmu": f"{trap} was not ready within 3 s and was killed while it was initialized",
        "components.stillborn.fmu": f"{trap} cannot be instantiated as 'stillborn': no licence for a probe",
    }
    assert not (tmp_path / "results").exists()


@needs_compiler
def test_an_fmu_that_fails_to_initialize_says_why(orch, write, probe):
    answer = orch("check", write(single(probe, mode=7)), "--load")
    assert answer.code == 2
    assert f'{probe} fails to initialize: fmi2Error: "the probe will not wake"' in answer.err
    answer = orch("check", write(single(probe, mode=8)), "--load")
    assert "output y is not finite: nan" in answer.err


def test_a_binary_that_is_none_is_found_by_loading_it(orch, write, tmp_path):
    path = write(single(paper_fmu(tmp_path / "paper.fmu")))
    assert orch("check", path).code == 0
    answer = orch("check", path, "--load")
    assert answer.code == 2
    assert "components.one.fmu: " in answer.err
    assert "paper.fmu cannot be loaded: " in answer.err


def test_python_fmus_are_loaded_too_and_nothing_is_left(orch, write, spiral, models, tmp_path):
    table = merged(spiral, {"components.controller.parameters.K_p.z": 91.0})
    answer = orch("check", write(table), "--load", "--packaging", "python")
    assert answer.code == 0, answer.err
    assert [p.name for p in tmp_path.iterdir()] == ["mine.toml"]
    answer = orch("check", write(single("trouble", kind=6)), "--load")
    assert answer.code == 2
    assert "no calm sea: déjà vu" in answer.err
    assert not list(Path(os.environ["TMPDIR"]).glob("orch-*/outcome"))
