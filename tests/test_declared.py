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


# --- What a model in plain Python declares ---------------------------------------------------------------------------

LAW = """
import numpy as np
from uuv import NU, TAU, Input, Output, Parameter, PythonModel, Signal, State

GAUGE = Signal((), "1", "a number")


class Law(PythonModel):
    nu, tau, alarm = Input(NU), Output(TAU), Output(GAUGE)
    count = State(GAUGE)

    def do_step(self, t, h):
        self.alarm = 0.0
        self.count = self.count + 1
        BODY
"""


@pytest.fixture
def law(orch, write, tmp_path):
    """law(name, body) builds and runs the model; returns the answer and the record."""

    def law(name, body):
        (tmp_path / f"{name}.py").write_text(LAW.replace("BODY", body.replace("\n", "\n        ")))
        built = orch("build", f"{name}.py")
        assert built.code == 0, built.err
        answer = orch("run", write({**alone(name), "record": {"inputs": True}}), "--json")
        return answer, orchestrator.open_run(tmp_path / answer.json["file"])

    return law


@pytest.mark.parametrize(
    ("name", "body", "words"),
    [
        (
            "misspelt",
            "self.taw = -3.0 * self.nu",
            "do_step never assigns its output tau; line 15 of misspelt.py assigns self.taw: did you mean self.tau?",
        ),
        ("silent", "pass", "do_step never assigns its output tau"),
        (
            "seldom",
            "if t < 0.02:\n    self.tau = -self.nu\nelse:\n    self.taau = -self.nu",
            "line 18 of seldom.py assigns self.taau, which nothing declares or reads: did you mean self.tau?",
        ),
        (
            "state",
            "self.tau = -self.nu\nself.cuont = 2.0",
            "line 16 of state.py assigns self.cuont, which nothing declares or reads: did you mean self.count?",
        ),
    ],
)
def test_an_output_that_is_never_assigned_ends_the_first_step(law, name, body, words):
    answer, record = law(name, body)
    assert answer.code == 3
    assert answer.json["error"].startswith("'one' failed at t = 0 s: ")
    assert words in answer.json["error"]
    assert record.time.tolist() == [0.0]


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("in_place", "self.tau[:] = 0.0"),
        ("one_by_one", "for i in range(6): self.tau[i] = 0.0"),
        ("by_numpy", "np.copyto(self.tau, np.zeros(6))"),
        ("by_name", "setattr(self, 'tau', np.zeros(6))"),
        ("late", "if t > 0.02: self.tau = np.ones(6)"),
        ("helped", "self.taus = [self.nu]\nself.tau_d = 1.0\nself.tau = sum(self.taus)"),
    ],
)
def test_a_model_may_assign_its_outputs_as_it_likes(law, name, body):
    answer, record = law(name, body)
    assert answer.code == 0, answer.err
    assert len(record.time) == 5


def test_a_failure_of_a_python_model_has_its_file_and_line_and_the_record_the_traceback(law):
    answer, record = law("broken", "k = len(3) if t > 0.01 else 1\nself.tau = k * self.nu")
    words = "TypeError: object of type 'int' has no len() (broken.py, line 15)"
    assert answer.json["error"] == f"'one' failed at t = 0.02 s: fmi2Fatal: \"{words}\""
    assert record.attributes["traceback"] == (
        "Traceback (most recent call last):\n"
        '  File "broken.py", line 15, in do_step\n'
        "    k = len(3) if t > 0.01 else 1\n"
        "        ^^^^^^\n"
        "TypeError: object of type 'int' has no len()"
    )
