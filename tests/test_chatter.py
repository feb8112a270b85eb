"""What alternates from step to step is reported: the signature of a controller held beyond its stability limit."""

import json

import h5py
import pytest

from fmu_files import SOURCES
from orchestrator import open_run, run
from orchestrator.models import build

EXPERIMENT = """
[master]
stop_time = {stop}
step = 1e-3
[components.source]
fmu = "alternating"
{step}
parameters = {{ share = {share}, size = {size}, end = {end} }}
[record]
every = {every}
"""


@pytest.fixture(scope="module")
def alternating(_build_folder):
    build.build([str(SOURCES / "alternating.py")])


@pytest.fixture
def warnings(alternating, tmp_path):
    def warnings(share, size=1.0, stop=0.1, every=0.02, step="", end=1e9):
        path = tmp_path / "source.toml"
        text = EXPERIMENT.format(share=share, size=size, stop=stop, every=every, step=step, end=end)
        path.write_text(text, encoding="utf-8")
        return run(path, results=tmp_path).attributes["warnings"]

    return warnings


def test_a_signal_that_changes_its_sign_in_most_steps_is_named_with_its_share(warnings):
    (warning,) = warnings(0.8)
    assert warning.startswith("source.y (a) alternates from step to step in 80% of the run")
    assert "0.001 s" in warning
    assert "smaller step" in warning


def test_a_signal_that_changes_its_sign_in_fewer_steps_is_not_reported(warnings):
    assert warnings(0.45) == []


def test_rounding_noise_is_not_reported(warnings):
    assert warnings(1.0, size=1e-12) == []


def test_what_is_small_beside_its_vector_is_not_reported(warnings):
    assert warnings(1.0, size=1e-4) == []
    assert warnings(1.0, size=1e-1) != []


def test_a_run_that_an_fmu_ends_is_judged_too(warnings):
    assert warnings(1.0, end=0.0605) != []


def test_a_run_of_a_few_steps_is_not_judged(warnings):
    assert warnings(1.0, stop=0.01, every=0.01) == []


def test_a_slow_component_is_judged_by_its_own_steps(warnings):
    (warning,) = warnings(1.0, step="step = 4e-3")
    assert "100% of the run: held over 0.004 s" in warning


def test_mfsosmc_held_over_a_millisecond_is_reported_and_pid_is_not(orch, spiral, write, tmp_path):
    spiral["master"]["stop_time"] = 0.5
    path = write(spiral)
    assert "warning" not in orch("run", path).err
    answer = orch("run", path, "--swap", "controller=mfsosmc")
    assert answer.code == 0
    assert "warning: controller.tau" in answer.err
    assert "beyond its stability limit" in answer.err
    record = open_run("last", tmp_path / "results")
    assert [warning.kind for warning in record.warnings] == record.attributes["warning_kinds"]
    assert {"unstable"} == set(record.attributes["warning_kinds"])
    assert record.is_wrong
    assert "warning: controller.tau" in orch("show", "last").out


def test_a_record_without_kinds_of_warnings_is_read_and_repeated_as_it_was_made(orch, spiral, write, tmp_path):
    spiral["master"]["stop_time"] = 0.1
    made = orch("run", write(spiral), "--swap", "controller=mfsosmc", "--json").json
    assert set(made["warning_kinds"]) == {"unstable"}
    with h5py.File(tmp_path / made["file"], "r+") as file:
        del file.attrs["warning_kinds"]
        file.attrs["warnings"] = json.dumps(
            ["controller.tau (X) alternates from step to step: the loop is beyond its stability limit"]
        )
    record = open_run("last", tmp_path / "results")
    assert record.is_wrong
    again = orch("rerun", "last", "--verify")
    assert again.code == 0, again.out
    assert orch("run", tmp_path / "mine.toml", "--swap", "controller=mfsosmc", "--json").json["warning_kinds"] == [
        "unstable"
    ]
