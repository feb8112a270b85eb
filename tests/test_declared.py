"""What an FMU declares is honoured, refused or noted."""

import h5py
import pytest

import orchestrator
from fmu_files import SOURCES, compile_fmu, needs_compiler

pytestmark = needs_compiler

EXPERIMENT = '<DefaultExperiment startTime="0" stopTime="1" tolerance="1e-5"/>'


@pytest.fixture(scope="session")
def bucket(tmp_path_factory):
    """bucket(version, *changes) is the FMU of fmus/bucket.c; each change is (old, new) of its description."""
    made = {}

    def bucket(version, *changes):
        if (version, changes) not in made:
            path = tmp_path_factory.mktemp("bucket") / "bucket.fmu"
            description = (SOURCES / f"bucket{version}.xml").read_text()
            for old, new in changes:
                assert old in description
                description = description.replace(old, new, 1)
            flags = ["-DFMI3"] * (version == 3)
            made[version, changes] = compile_fmu(path, "bucket.c", description, *flags, version=version)
        return made[version, changes]

    return bucket


def alone(fmu, **keys):
    component = {"fmu": str(fmu), "start": "fmu", **keys}
    return {"master": {"stop_time": 0.04, "step": 0.01}, "components": {"one": component}}


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("isolation", ["none", "process"])
def test_an_fmu_is_given_the_tolerance_that_it_declares_or_the_experiment_s(
    bucket, write, tmp_path, version, isolation
):
    tolerant = bucket(version, ("<ModelVariables>", EXPERIMENT + "<ModelVariables>"))
    runs = [
        orchestrator.run(write(alone(fmu, isolation=isolation, **keys)), results=tmp_path)
        for fmu, keys in [(bucket(version), {}), (tolerant, {}), (tolerant, {"tolerance": 1e-9})]
    ]
    assert [run["one.tolerance"][0] for run in runs] == [-1.0, 1e-5, 1e-9]
    assert len({run.run_id for run in runs}) == 3
    same = orchestrator.run(write(alone(tolerant, isolation=isolation, tolerance=1e-5)), results=tmp_path)
    assert same.run_id == runs[1].run_id


def test_a_tolerance_that_cannot_be_one_is_refused(bucket, problems):
    assert problems(alone(bucket(2), tolerance=0.0)) == [
        ("components.one.tolerance", "is 0.0; give a positive number"),
    ]
    wrong = bucket(2, ("<ModelVariables>", EXPERIMENT.replace("1e-5", "0") + "<ModelVariables>"))
    (key, sentence), *_ = problems(alone(wrong))
    assert key == "components.one.fmu"
    assert "the tolerance of its DefaultExperiment is '0'" in sentence
    table = alone(bucket(2))
    table["components"]["pilot"] = {"builtin": "mavlink_manual", "tolerance": 1e-3, "start": "fmu"}
    assert ("components.pilot.tolerance", "is for the solver inside an FMU; a builtin has none") in problems(table)


def test_a_record_made_before_tolerances_were_passed_on_is_repeated_without(bucket, orch, write, tmp_path):
    tolerant = bucket(2, ("<ModelVariables>", EXPERIMENT + "<ModelVariables>"))
    record = tmp_path / orch("run", write(alone(bucket(2))), "--json").json["file"]
    with h5py.File(record, "r+") as file:  # as that release would have made it of the other FMU
        file.attrs["experiment_toml"] = file.attrs["experiment_toml"].replace(str(bucket(2)), str(tolerant))
    answer = orch("rerun", record, "--verify")
    assert "digest" in answer.out  # the FMU's file is another one, and
    assert "signals differ" not in answer.out


def test_a_run_goes_on_from_a_checkpoint_with_its_tolerance_only(bucket, orch, write):
    path = write(alone(bucket(2), tolerance=1e-4))
    answer = orch("run", path, "--checkpoint-at", "0.02", "--json")
    assert answer.code == 0, answer.err
    checkpoint = next(path.parent.rglob("*.checkpoint"))
    refused = orch("run", path, "--from", checkpoint, "--set", "components.one.tolerance=1e-6")
    assert refused.code == 2
    assert "components.one.tolerance: is 1e-06, and was 0.0001 in the checkpoint" in refused.err
    assert orch("run", path, "--from", checkpoint).code == 0


def test_a_difference_of_tolerance_is_named(bucket, orch, write, tmp_path):
    for tolerance in (1e-4, 1e-6):
        orch("run", write(alone(bucket(2), tolerance=tolerance)))
    runs = sorted((tmp_path / "results").rglob("*.h5"))
    assert "components.one.tolerance" in orch("diff", *runs).out
