"""What an FMU declares is honoured, refused or noted."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import casadi
import fmpy
import h5py
import pytest
from lxml import etree

import orchestrator
from fmu_files import SOURCES, compile_fmu, needs_compiler, paper_fmu
from orchestrator.fmu import declared
from test_archive import with_description

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


# --- Data files -------------------------------------------------------------------------------------------------------

POINTS = """
import numpy as np
from uuv import File, Output, Parameter, PythonModel, Signal


class Points(PythonModel):
    y = Output(Signal((), "m", "a set point"))
    data = File("points.csv")

    def __init__(self):
        self.points = np.loadtxt(self.data, ndmin=1)

    def do_step(self, t, h):
        self.y = self.points[int(t > 0.015)] + len(self.data.read_text())
"""
TRACED = """
import numpy as np
from uuv import File, Model, Output, Parameter, Signal


class Traced(Model):
    y = Output(Signal((), "m", "a set point"))
    gain = Parameter(1.0)
    data = File("points.csv")

    def step(self, t, h):
        return {"y": self.gain * np.loadtxt(self.data)[0]}
"""


@pytest.mark.parametrize(
    ("name", "source", "packaging", "values"),
    [
        ("points", POINTS, "python", ([16.0, 16.0, 16.0, 17.0], [18.0, 18.0, 18.0, 23.0])),
        ("traced", TRACED, "native", ([8.0] * 4, [9.0] * 4)),
        ("traced", TRACED, "python", ([8.0] * 4, [9.0] * 4)),
    ],
)
def test_a_data_file_is_packed_and_decides_the_run_id(orch, write, tmp_path, name, source, packaging, values):
    (tmp_path / f"{name}.py").write_text(source)
    table = alone(name)
    table["master"]["stop_time"] = 0.03
    records = []
    for text, expected in zip(("8.0\n9.0\n", "9.0\n14.0\n"), values, strict=True):
        (tmp_path / "points.csv").write_text(text)
        if not records:
            assert orch("build", f"{name}.py", f"--{packaging}").code == 0
        answer = orch("run", write(table), "--packaging", packaging, "--json")
        assert answer.code == 0, answer.err
        record = orchestrator.open_run(tmp_path / answer.json["file"])
        assert record.fact("one", "packaging") == packaging
        assert record["one.y"].tolist() == expected
        records.append(record)
    assert records[0].run_id != records[1].run_id
    digest = hashlib.sha256(b"9.0\n14.0\n").hexdigest()
    with h5py.File(records[1].path, locking=False) as file:
        assert json.loads(file["one"].attrs["data_files"]) == {"points.csv": digest}
    assert f"points.csv {digest[:10]}" in orch("fmus", name).out
    (tmp_path / "points.csv").unlink()
    answer = orch("build", f"{name}.py", f"--{packaging}", "--force")
    assert answer.code == 2
    assert f"data: no data file '{tmp_path / 'points.csv'}'" in answer.err


def test_a_python_model_reads_its_data_file_again_in_a_second_run_of_one_process(python, write, tmp_path):
    (tmp_path / "points.py").write_text(POINTS)
    (tmp_path / "points.csv").write_text("8.0\n9.0\n")
    path = write(alone("points"))
    answer = python(
        "import orchestrator\nfrom orchestrator.models.build import build\nbuild(['points.py'])\n"
        f"print([float(orchestrator.run({str(path)!r}, output=f'{{n}}.h5')['one.y'][-1]) for n in range(2)])"
    )
    assert answer.out == "[17.0, 17.0]\n", answer.err


def test_two_files_of_one_model_name_are_refused_together_and_said_one_after_the_other(orch, write, tmp_path):
    for folder, number in (("one", 1), ("two", 2)):
        (tmp_path / folder).mkdir()
        source = TRACED.replace("np.loadtxt(self.data)[0]", str(number)).replace('    data = File("points.csv")\n', "")
        if folder == "two":  # plain Python: no native FMU takes the place of that of the other
            source = POINTS.replace('    data = File("points.csv")\n', "").partition("    def __init__")[0]
            source += "    def do_step(self, t, h):\n        self.y = 2.0\n"
        (tmp_path / folder / "doubled.py").write_text(source)
    both = orch("build", "one/doubled.py", "two/doubled.py")
    assert both.code == 2
    assert "would both be the model 'doubled'; rename one of the files" in both.err
    assert orch("build", "one/doubled.py").code == 0
    again = orch("build", "two/doubled.py")
    assert again.code == 0
    first, second = (tmp_path / folder / "doubled.py" for folder in ("one", "two"))
    note = f"note: doubled was built from {first}; experiments that name doubled run {second} from now on"
    assert note in again.err
    answer = orch("run", write(alone("doubled")), "--json")
    assert orchestrator.open_run(tmp_path / answer.json["file"])["one.y"][-1] == 2.0


# --- The folder that a model lies in ---------------------------------------------------------------------------------

CASADI = """
import casadi as ca
from beside import GAIN
from uuv import ETA, ETA_D, NU, TAU, Input, Model, Output, Parameter


class MyController(Model):
    eta, nu, eta_d, tau = Input(ETA), Input(NU), Input(ETA_D), Output(TAU)
    K_p = Parameter(140.0, "N/m", "position gain")

    def step(self, t, h):
        return {"tau": ca.vertcat(GAIN * self.K_p * (self.eta_d - self.eta)[:3], ca.SX.zeros(3))}
"""


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A clone of the project with its environment .venv inside, as the README has it made."""
    root = tmp_path_factory.mktemp("clone")
    here = Path(orchestrator.__file__).parent.parent
    for name in ("orchestrator", "fmus"):
        shutil.copytree(here / name, root / name, ignore=shutil.ignore_patterns("build", "__pycache__"))
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", root / ".venv"], check=True)
    packages = next((root / ".venv").glob("lib/python*/site-packages"))
    for path in Path(casadi.__file__).parent.parent.iterdir():
        if path.name not in ("__pycache__", "orchestrator") and "editable" not in path.name:
            os.symlink(path, packages / path.name)
    os.symlink(root / "orchestrator", packages / "orchestrator")
    return root


@pytest.mark.parametrize("packaging", ["--native", "--python"])
def test_a_controller_builds_in_the_root_of_a_clone_with_its_environment_inside(clone, packaging):
    def build():
        command = [clone / ".venv/bin/python", "-m", "orchestrator.cli", "build", "my_controller.py", packaging]
        environment = {**os.environ, "ORCH_BUILD": str(clone / "build")}
        return subprocess.run(command, cwd=clone, env=environment, capture_output=True, text=True, check=False)

    (clone / "beside.py").write_text("GAIN = 2.0\n")
    (clone / "my_controller.py").write_text(CASADI.replace("self.eta_d", "self.eta_dd"))
    wrong = build()
    assert wrong.returncode == 2
    words = "line 12: AttributeError: 'MyController' object has no attribute 'eta_dd'"
    assert words in wrong.stderr
    (clone / "my_controller.py").write_text(CASADI)
    right = build()
    assert right.returncode == 0, right.stderr


# --- Randomness, and runs without rows -------------------------------------------------------------------------------

NOISE = """
import numpy as np
from uuv import Input, Output, Parameter, PythonModel, Signal

NUMBER = Signal((), "m", "a number")


class Noise(PythonModel):
    u, y = Input(NUMBER), Output(NUMBER)

    def initialize(self):
        GENERATOR

    def do_step(self, t, h):
        self.y = self.u + DRAW
"""


@pytest.fixture
def noise(orch, write, tmp_path):
    """noise(name, generator, draw) runs the model twice in a chain; returns the answer."""

    def noise(name, generator, draw):
        source = NOISE.replace("GENERATOR", generator).replace("DRAW", draw)
        (tmp_path / f"{name}.py").write_text(source)
        assert orch("build", f"{name}.py").code == 0
        table = alone(name)
        table["components"] = {"first": table["components"]["one"], "second": {"fmu": name}}
        table["connections"] = {"second.u": "first.y"}
        return orch("run", write(table), "--json")

    return noise


def test_random_numbers_without_a_seed_are_named_and_not_called_an_algebraic_loop(noise, orch):
    answer = noise("unseeded", "pass", "np.random.normal()")
    assert answer.code == 3
    error = answer.json["error"]
    assert error.startswith("'second' failed at t = 0 s: its output y is ")
    assert "it draws random numbers without a seed" in error
    assert "circle" not in error


def test_random_numbers_of_a_generator_of_its_own_are_the_same_again(noise, orch):
    assert noise("seeded", "self.random = np.random.default_rng(3)", "self.random.normal()").code == 0
    assert "bit-identical" in orch("rerun", "last", "--verify").out


def test_a_run_that_failed_before_its_first_row_is_not_called_bit_identical(noise, orch):
    answer = noise("hopeless", "raise ValueError('no sea')", "0.0")
    assert answer.code == 3
    again = orch("rerun", "last", "--verify")
    assert again.code == 1
    assert "bit-identical" not in again.out
    assert "has no rows to compare; the run failed again in the same way: 'first' failed at t = 0 s" in again.out


# --- Units -----------------------------------------------------------------------------------------------------------


def test_check_shows_where_one_end_of_a_connection_states_no_unit(orch, write, tmp_path):
    ends = [("u", "Real", "input", "0", "rad"), ("v", "Real", "input", "0", None), ("w", "Real", "input", "0", "rad")]
    sink = paper_fmu(tmp_path / "sink.fmu", ends)
    outs = [("y", "Real", "output", None, None), ("z", "Real", "output", None, "rad")]
    source = paper_fmu(tmp_path / "source.fmu", outs)
    table = {
        "master": {"stop_time": 0.04, "step": 0.01},
        "components": {"source": {"fmu": str(source)}, "sink": {"fmu": str(sink)}},
        "connections": {"sink.u": "source.y", "sink.v": "source.z", "sink.w": "source.z"},
    }
    answer = orch("check", write(table), env={**os.environ, "COLUMNS": "120"})
    rows = {line.split()[0]: " ".join(line.split()) for line in answer.out.splitlines() if line.startswith("  sink.")}
    assert rows == {
        "sink.u": "sink.u source.y - rad (output: no unit) -",
        "sink.v": "sink.v source.z - rad (input: no unit) -",
        "sink.w": "sink.w source.z - rad -",
    }


@pytest.mark.parametrize("when", ["imported", "made", "stepped"])
def test_a_file_that_a_python_model_reads_undeclared_is_a_warning(orch, write, tmp_path, when):
    read = f"open({str(tmp_path / 'points.csv')!r}).read()"
    source = POINTS.replace('    data = File("points.csv")\n', "").replace(
        "np.loadtxt(self.data, ndmin=1)", "[1.0, 2.0]"
    )
    source = source.replace("len(self.data.read_text())", f"len({read})" if when == "stepped" else "0.0")
    source = source.replace("self.points =", f"self.points = {read} and" if when == "made" else "self.points =")
    name = f"reads_{when}"
    (tmp_path / f"{name}.py").write_text(source + f"\nTEXT = {read}" * (when == "imported"))
    (tmp_path / "points.csv").write_text("8.0\n9.0\n")
    assert orch("build", f"{name}.py").code == 0
    answer = orch("run", write(alone(name)), "--json")
    assert answer.code == 0, answer.err
    assert answer.json["warnings"] == [
        f"{name} reads {tmp_path / 'points.csv'}, which no digest covers: the run id is the same after a change of it; "
        'a model declares it, File("points.csv")'
    ]
    assert answer.json["warning_kinds"] == ["files"]
    assert "bit-identical" in orch("rerun", "last", "--verify").out


def test_an_equation_model_that_reads_a_file_undeclared_is_built_again_after_an_edit(orch, write, tmp_path):
    source = TRACED.replace('    data = File("points.csv")\n', "").replace("File, ", "")
    source = source.replace("self.data", repr(str(tmp_path / "points.csv")))
    (tmp_path / "undeclared.py").write_text(source)
    values = []
    for text in ("8.0\n9.0\n", "9.0\n8.0\n"):
        (tmp_path / "points.csv").write_text(text)
        if not values:
            built = orch("build", "undeclared.py")
            words = f"note: undeclared reads {tmp_path / 'points.csv'} while it is built"
            assert (built.code, words in built.err) == (0, True), built.err
        answer = orch("run", write(alone("undeclared")), "--json")
        values.append(orchestrator.open_run(tmp_path / answer.json["file"])["one.y"][-1])
    assert values == [8.0, 9.0]


def test_a_model_that_imports_libraries_and_reads_its_data_file_warns_of_nothing(orch, write, tmp_path):
    source = POINTS.replace("import numpy", "import email.mime.text, json, pandas\nimport numpy")
    (tmp_path / "clean.py").write_text(source)
    (tmp_path / "points.csv").write_text("8.0\n9.0\n")
    assert orch("build", "clean.py").code == 0
    assert orch("run", write(alone("clean")), "--json").json["warnings"] == []


@pytest.mark.parametrize(
    ("output", "input", "offset"), [("", "", 273.15), ("true", "true", 0.0), ("type", "true", 0.0), ("true", "", None)]
)
def test_a_difference_of_temperatures_takes_no_offset(resolve, problems, tmp_path, output, input, offset):
    """FMI 2.0, 2.2.3: where relativeQuantity is true, the offset of a unit is ignored."""

    def thermal(name, causality, unit, relative):
        path = paper_fmu(tmp_path / f"{name}.fmu", [("x", "Real", causality, None, unit)])
        with zipfile.ZipFile(path) as archive:
            xml = archive.read("modelDescription.xml").decode()
        extra = ' relativeQuantity="true"'
        if relative == "type":
            kind = f'<SimpleType name="Difference"><Real{extra}/></SimpleType></TypeDefinitions>'
            xml = xml.replace("</TypeDefinitions>", kind).replace("<Real unit", '<Real declaredType="Difference" unit')
        elif relative:
            xml = xml.replace("<Real ", f"<Real{extra} ")
        return with_description(path, xml)

    table = {
        "master": {"stop_time": 0.04, "step": 0.01},
        "components": {
            "source": {"fmu": str(thermal("source", "output", "degC", output))},
            "sink": {"fmu": str(thermal("sink", "input", "K", input))},
        },
        "connections": {"sink.x": "source.x"},
    }
    if offset is None:
        (_, sentence), *_ = problems(table)
        assert "one is a difference (relativeQuantity), the other is not" in sentence
    else:
        assert [(c.factor, c.offset) for c in resolve(table).connections] == [(1.0, offset)]


def test_limits_of_unsigned_numbers_are_read(bucket, resolve, tmp_path):
    low = (
        '<UInt8 name="small" valueReference="30" causality="parameter" variability="fixed" start="1" min="2" max="9"/>'
    )
    plan = resolve(alone(bucket(3, ("</ModelVariables>", low + "</ModelVariables>")), parameters={"small": 1}))
    assert plan.warnings == ["one: small = 1 is below 2, the min that its FMU declares"]


# --- The table -------------------------------------------------------------------------------------------------------

XS = "{http://www.w3.org/2001/XMLSchema}"
SCHEMAS = Path(fmpy.__file__).parent / "schema"


def attributes_of_schema(version):
    """{(place of the table, attribute)} of everything that the schema of a version allows below its root."""
    named = {}
    for file in sorted((SCHEMAS / f"fmi{version}").glob("*.xsd")):
        for element in etree.parse(file).getroot():
            if isinstance(element.tag, str):
                named.setdefault((element.tag, element.get("name")), element)
    result = set()

    def local(name):
        return name.rpartition(":")[2]

    def content(node, path):
        for child in node.iterchildren(tag=etree.Element):
            kind = child.tag.removeprefix(XS)
            if kind == "attribute":
                result.add((place_of(path), child.get("name")))
            elif kind in ("attributeGroup", "group") and child.get("ref"):
                content(named[f"{XS}{kind}", local(child.get("ref"))], path)
            elif kind == "element":
                walk(child, path)
            elif kind != "annotation":
                if kind == "extension" and (f"{XS}complexType", local(child.get("base"))) in named:
                    content(named[f"{XS}complexType", local(child.get("base"))], path)
                content(child, path)

    def walk(element, path):
        if element.get("ref"):
            element = named[f"{XS}element", local(element.get("ref"))]
        path = (*path, element.get("name"))
        type_ = named.get((f"{XS}complexType", local(element.get("type") or "")))
        content(element if type_ is None else type_, path)

    walk(named[f"{XS}element", "fmiModelDescription"], ())
    return result


def place_of(path):
    last, below = path[-1], path[1:]
    if last in ("Tool", "Annotation"):
        return "annotation"
    if below[:1] in (("ModelExchange",), ("ScheduledExecution",)):
        return below[0]
    if last == "File":
        return "SourceFiles"
    if last in ("ClockType", "Clock"):
        return "clock"
    if below[:1] == ("ModelStructure",):
        known = any(name in below[1] for name in ("Output", "InitialUnknown")) if below[1:] else False
        return "Output, InitialUnknown" if known else "other unknowns"
    if last in ("Alias", "Dimension", "Start", "Item", "Unit", "BaseUnit", "DisplayUnit", "Category"):
        return last
    if below[:1] == ("TypeDefinitions",):
        return "type"
    return "variable" if below[:1] == ("ModelVariables",) else last


def test_the_table_has_every_attribute_of_the_schemas_and_no_other():
    in_schema = attributes_of_schema(2) | attributes_of_schema(3)
    rows = [(row.place, name) for row in declared.TABLE for name in row.attributes]
    assert len(rows) == len(set(rows))
    whole = {place for place, name in rows if name == "*"}
    assert len(in_schema) > 150
    assert {row for row in in_schema if row[0] not in whole} == {row for row in rows if row[1] != "*"}
    assert whole <= {place for place, _ in in_schema}


def test_the_page_has_the_table():
    page = (Path(__file__).parent.parent / "docs" / "fmus.md").read_text(encoding="utf-8")
    assert f"{declared.BEGIN}\n{declared.page()}\n{declared.END}" in page, "run `make reference`"


SLAVE = "<CoSimulation "
CLOCK = (
    '<Clock name="tick" valueReference="40" causality="input" variability="discrete" intervalVariability="constant" '
    'intervalDecimal="0.1"/><Int32 name="counted" valueReference="41" causality="local" variability="discrete" '
    'clocks="40"/>'
)


@pytest.mark.parametrize(
    ("version", "change", "note"),
    [
        (
            2,
            (SLAVE, SLAVE + 'needsExecutionTool="true" '),
            "needs the tool that exported it on the machine that runs it (needsExecutionTool)",
        ),
        (
            2,
            (SLAVE, SLAVE + 'canRunAsynchronuously="true" '),
            "may answer a step before it is done (canRunAsynchronuously): a run in which it does so fails",
        ),
        (
            2,
            ("<ModelVariables>", '<DefaultExperiment startTime="5"/><ModelVariables>'),
            "its own experiment begins at 5 s (DefaultExperiment); runs begin at 0 s",
        ),
        (
            3,
            ("</ModelVariables>", CLOCK + "</ModelVariables>"),
            "its clock tick does not tick: variables of a clock keep their values",
        ),
        (3, (SLAVE, SLAVE + 'canHandleVariableCommunicationStepSize="false" maxOutputDerivativeOrder="1" '), None),
    ],
)
def test_what_a_run_does_not_do_is_noted_by_check_and_by_the_run(bucket, orch, write, version, change, note):
    path = write(alone(bucket(version, change)))
    expected = [f"one: {note}"] if note else []
    assert orch("check", path, "--json").json["notes"] == expected
    answer = orch("run", path)
    assert answer.code == 0, answer.err
    assert [line.removeprefix("note: ") for line in answer.err.splitlines() if line.startswith("note: ")] == expected


def test_an_fmu_is_shown_with_its_default_experiment(bucket, orch):
    fmu = bucket(2, ("<ModelVariables>", EXPERIMENT + "<ModelVariables>"))
    assert "startTime 0, stopTime 1, tolerance 1e-5" in orch("fmus", fmu).out
    assert orch("fmus", fmu, "--json").json["default_experiment"]["tolerance"] == "1e-5"


@pytest.mark.parametrize("loop", ["compiled", "python"])
def test_steps_are_of_one_length_also_of_a_component_with_a_period_of_its_own(
    bucket, write, tmp_path, loop, monkeypatch
):
    monkeypatch.setenv("ORCH_LOOP", loop)
    fixed = bucket(3, (SLAVE, SLAVE + 'canHandleVariableCommunicationStepSize="false" '))
    table = alone(fixed, step=0.03)
    table["master"]["stop_time"] = 0.06
    table["components"]["two"] = {"fmu": str(fixed), "start": "fmu"}
    run = orchestrator.run(write(table), results=tmp_path)
    assert (run["one.steps"][-1], run["two.steps"][-1]) == (2, 6)


def test_a_quantity_is_also_that_of_the_declared_type(resolve, tmp_path):
    path = paper_fmu(tmp_path / "turns.fmu", [("psi", "Real", "output", None, "rad")])
    with zipfile.ZipFile(path) as archive:
        xml = archive.read("modelDescription.xml").decode()
    kind = '<SimpleType name="Heading"><Real quantity="angle"/></SimpleType></TypeDefinitions>'
    xml = xml.replace("</TypeDefinitions>", kind).replace("<Real unit", '<Real declaredType="Heading" unit')
    plan = resolve(alone(with_description(path, xml)))
    assert plan.angles == {"one.psi"}
