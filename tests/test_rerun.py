"""A record run again: from itself alone, to the same bits, or to the first difference."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

import fmu_files
import orchestrator
from experiments import EXPERIMENTS, single
from fmu_files import COMPILER

FILES = sorted(EXPERIMENTS.rglob("*.toml"))
IDENTICAL = "bit-identical"


@pytest.fixture
def elsewhere(tmp_path):
    """elsewhere(*arguments) runs the command of a copy of the project at another path, which builds its own FMUs."""
    root = Path(orchestrator.__file__).parent.parent
    for folder in ("orchestrator", "fmus"):
        shutil.copytree(
            root / folder, tmp_path / "copy" / folder, ignore=shutil.ignore_patterns("build", "__pycache__")
        )

    def run(*arguments):
        environment = {**os.environ, "PYTHONPATH": str(tmp_path / "copy"), "ORCH_BUILD": str(tmp_path / "copy/build")}
        command = [sys.executable, "-m", "orchestrator.cli", *map(str, arguments)]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    return run


def test_a_record_is_run_again_without_its_experiment_file(orch, write, spiral, tmp_path):
    path = write(spiral)
    orch("run", path, "--swap", "controller=mfsosmc", "--set", "components.vehicle.parameters.eta_0.z=1.3")
    path.unlink()
    answer = orch("rerun", "last", "--verify")
    assert (answer.code, IDENTICAL in answer.out) == (0, True)
    assert len(list(tmp_path.glob("results/*/*"))) == 1


@pytest.mark.parametrize("packaging", ["native", "python"])
def test_a_copy_of_the_project_elsewhere_gives_the_same_bits(orch, write, spiral, elsewhere, packaging):
    if packaging == "native" and COMPILER is None:
        return
    record = orch("run", write(spiral), "--packaging", packaging, "--json").json["file"]
    answer = elsewhere("rerun", record, "--verify")
    assert (answer.returncode, IDENTICAL in answer.stdout) == (0, True), answer
    assert "not the same any more" not in answer.stderr


@pytest.mark.slow
def test_every_shipped_experiment_is_bit_identical_again_at_another_path(orch, elsewhere):
    for path in FILES:
        record = orch("run", path, "--json").json["file"]
        answer = elsewhere("rerun", record, "--verify")
        assert (answer.returncode, IDENTICAL in answer.stdout) == (0, True), (path, answer)


def test_the_first_signal_that_differs_is_named_with_its_time(orch, write, spiral, tmp_path):
    record = tmp_path / orch("run", write(spiral), "--json").json["file"]
    with h5py.File(record, "r+") as file:
        file["vehicle/eta.x"][3] += 1e-9
        file["controller/tau.X"][2:5] *= 1 + 1e-12
    answer = orch("rerun", "last", "--verify")
    assert answer.code == 1
    assert "2 signals differ, controller.tau.X first, at t = 0.02 s" in answer.out


def test_a_run_that_ends_otherwise_differs_and_one_with_fewer_rows(orch, write, models):
    path = write(single("moody"))
    record = orch("run", path, "--json", env={**os.environ, "MOOD": "bad"}).json["file"]
    answer = orch("rerun", record, "--verify")
    assert answer.code == 1
    assert "status: failed then, completed now" in answer.out
    assert "rows: " in answer.out


def test_an_fmu_that_has_changed_is_reported(orch, write, tmp_path):
    source = fmu_files.model("slope")
    model = tmp_path / "own_clock.py"
    model.write_text(source, encoding="utf-8")
    orch("build", model)
    record = orch("run", write(single("own_clock")), "--json").json["file"]
    model.write_text(source.replace("SLOPE = 1", "SLOPE = 2"), encoding="utf-8")
    answer = orch("rerun", record, "--verify")
    assert answer.code == 1
    assert "one: own_clock is not the same any more" in answer.err
    assert "one.y first, at t = " in answer.out


def test_without_verify_the_run_goes_into_the_store(orch, write, spiral, tmp_path):
    record = tmp_path / orch("run", write(spiral), "--json").json["file"]
    record.rename(tmp_path / "given.h5")
    answer = orch("rerun", "given.h5")
    assert answer.code == 0
    assert record.exists()
    assert "already in the store" in orch("rerun", "given.h5").out
    assert "already in the store" not in orch("rerun", "given.h5", "--force").out


def test_a_record_knows_the_descriptions_of_its_fmus(orch, write, spiral, tmp_path):
    with orchestrator.open_run(tmp_path / orch("run", write(spiral), "--json").json["file"]) as run:
        descriptions = run.attributes["model_descriptions"]
        assert set(descriptions) == {run.fact(name, "fmu_sha256") for name in spiral["components"]}
        assert 'modelName="bluerov2_thesis"' in descriptions[run.fact("vehicle", "fmu_sha256")]
