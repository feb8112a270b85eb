"""From a model's source to its FMU: what is built, when, and what a user hears of mistakes in his file."""

import os
import re
import shutil

import pytest

import fmu_files
import orchestrator
from experiments import EXPERIMENTS, merged, single
from orchestrator.models import catalogue

EXAMPLES = EXPERIMENTS.parent / "examples"
SHIPPED = {"native", "python"} | {f"{name}.{kind}" for name in catalogue.shipped() for kind in ("fmu", "json")}

CLOCK = fmu_files.model("clock")


@pytest.fixture
def fresh(orch, tmp_path):
    """The command with a build folder of the test's own, which holds the shipped models."""
    shutil.copytree(catalogue.build_folder(), tmp_path / "build", ignore=lambda _, names: set(names) - SHIPPED)

    def run(*arguments, **options):
        return orch(*arguments, env={**os.environ, "ORCH_BUILD": str(tmp_path / "build")}, **options)

    return run


@pytest.fixture
def model(tmp_path):
    """model(name, source) writes name.py in the test's folder."""

    def write(name, source):
        path = tmp_path / f"{name}.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(source, encoding="utf-8")
        return path

    return write


def helper(offset):
    return fmu_files.model("offset/helper").replace("OFFSET = 1", f"OFFSET = {offset}")


def built(folder):
    """When the models that are not shipped were built."""
    found = (folder / "build" / "python").glob("*.fmu")
    return {path.name: path.stat().st_mtime_ns for path in found if path.name not in SHIPPED}


def last(answer, folder):
    assert answer.code == 0, answer.err
    with orchestrator.open_run(folder / answer.json["file"]) as run:
        return {name: run[name][-1] for name in run.signals}


# --- When -------------------------------------------------------------------------------------------------------------


def test_what_is_up_to_date_is_not_built_again(fresh, model, tmp_path):
    path = model("mine", CLOCK)
    first = fresh("build", path)
    assert (first.code, first.err) == (0, "building mine\n")
    assert first.out == "build/python/mine.fmu\n"
    before = built(tmp_path)
    second = fresh("build", path)
    assert (second.code, second.err, second.out) == (0, "", first.out)
    assert built(tmp_path) == before
    assert fresh("build", "mine").err == ""  # a built model has a name
    assert fresh("build", path, "--force").err == "building mine\n"
    assert built(tmp_path) != before


def test_a_file_with_the_name_of_a_library_module_does_not_stop_a_build(fresh, model):
    model("json", "raise SystemExit('shadowed')\n")
    assert fresh("build", model("mine", CLOCK)).code == 0


def test_only_what_has_changed_is_built(fresh, model, tmp_path):
    for name in ("first", "second"):
        model(name, fmu_files.model("offset/offset"))
    model("helper", helper(1))
    model("third", CLOCK)
    names = [f"{name}.py" for name in ("first", "second", "third")]
    assert fresh("build", *names).code == 0
    model("third", CLOCK + "\n# a remark\n")
    assert fresh("build", *names).err == "building third\n"
    model("helper", helper(2))
    assert fresh("build", *names).err == "building first\nbuilding second\n"
    assert fresh("build", *names).err == ""


def test_the_same_source_gives_the_same_bytes(fresh, orch, model, tmp_path):
    path = model("mine", fmu_files.model("waves"))
    other = {**os.environ, "ORCH_BUILD": str(tmp_path / "other")}
    for options in ([path, "pid"], ["pid", "--python"]):
        answer, again = fresh("build", *options, "--force"), orch("build", *options, env=other)
        assert (answer.code, again.code) == (0, 0)
        for one, two in zip(answer.out.split(), again.out.split(), strict=True):
            assert (tmp_path / one).read_bytes() == (tmp_path / two).read_bytes()


def test_a_run_builds_what_has_changed(fresh, model, write, tmp_path):
    path = model("mine", CLOCK)
    fresh("build", path)
    experiment = write(single("mine"))
    assert fresh("run", experiment).err == ""
    model("mine", CLOCK.replace("round(t + h, 9)", "7.0"))
    answer = fresh("run", experiment)
    assert answer.err == "building mine\n"
    assert answer.out.startswith("mine ")
    assert "already in the store" not in answer.out  # other bytes, another run


def test_an_fmu_whose_source_is_gone_still_runs(fresh, model, write, tmp_path):
    model("mine", CLOCK)
    fresh("build", "mine.py")
    (tmp_path / "mine.py").unlink()
    assert last(fresh("run", write(single("mine")), "--json"), tmp_path)["one.n"] == 5.0


# --- Mistakes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("x = (1,\n", "line 1: '(' was never closed"),
        ("\n\nraise ValueError('not today')\n", "line 3: ValueError: not today"),
        ("\nimport nothing_of_that_name\n", "line 2: ModuleNotFoundError: No module named 'nothing_of_that_name'"),
        ("x = 1\n", "one class derived from Model or PythonModel; this one has none"),
        (CLOCK + fmu_files.model("relay"), "this one has Clock, Relay"),
        (CLOCK.replace("def do_step", "def step"), "this one has none"),
        (CLOCK.replace('"m"', '"furlong"'), "unit 'furlong': 'furlong' is unknown; known: 1, -, %, m, mm"),
        (CLOCK.replace('"m"', '"m s"'), "unit 'm s': 'm s' is not a symbol with an exponent"),
    ],
)
def test_a_mistake_in_a_model_is_reported_with_file_and_line(fresh, model, tmp_path, source, words):
    path = model("mine", source)
    answer = fresh("build", path)
    assert (answer.code, answer.out) == (2, "")
    assert f"{path} cannot be built: " in answer.err
    assert words in answer.err
    assert built(tmp_path) == {}


def test_an_equation_with_a_mistake_is_reported_with_its_line(fresh, model):
    answer = fresh("build", model("mine", fmu_files.model("mistaken")))
    assert answer.code == 2
    assert "line 11: AttributeError: " in answer.err
    assert "'nu'" in answer.err


def test_a_mistake_in_one_model_leaves_the_others(fresh, model, tmp_path):
    model("good", CLOCK)
    model("bad", "x = ")
    answer = fresh("build", "bad.py", "good.py")
    assert answer.code == 2
    assert "bad.py cannot be built" in answer.err
    assert set(built(tmp_path)) == {"good.fmu"}


def test_a_mistake_in_a_model_is_a_problem_of_the_experiment(fresh, model, write, tmp_path):
    fresh("build", model("mine", CLOCK))
    model("mine", CLOCK.replace("self.n + (h > 0)", "self.n +"))
    answer = fresh("run", write(merged(single("mine"), {"master.algorithm": "jakobi"})))
    assert answer.code == 2
    assert "2 problems" in answer.err
    assert "components.one.fmu: " in answer.err
    assert "mine.py cannot be built: line " in answer.err
    assert not (tmp_path / "results").exists()


def test_the_name_of_a_shipped_model_is_refused(fresh, model, tmp_path):
    answer = fresh("build", model("pid", CLOCK))
    assert answer.code == 2
    assert "'pid' is the name of a model that comes with orch; rename the file" in answer.err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("pdi", "no model 'pdi'; did you mean 'pid'?"),
        ("mime.py", "no file 'mime.py'; did you mean 'mine.py'?"),
        ("my-model.py", "'my-model' cannot name a model; use letters, digits and _"),
    ],
)
def test_what_cannot_be_built_says_why(fresh, model, name, words):
    model("mine", CLOCK)
    model("my-model", CLOCK)
    answer = fresh("build", name)
    assert answer.code == 2
    assert words in answer.err


def test_what_a_model_prints_does_not_disturb_its_build(fresh, model):
    answer = fresh("build", model("mine", 'print("{}")\n' + CLOCK))
    assert (answer.code, answer.out) == (0, "build/python/mine.fmu\n")


# --- Modules of one name ----------------------------------------------------------------------------------------------


def test_two_models_with_different_modules_of_one_name_each_use_their_own(fresh, model, write, tmp_path):
    """All Python FMUs of a process share one interpreter: with plain imports the second would use the first's."""
    for name, offset in (("north", 10), ("south", 200)):
        model(f"{name}/{name}", fmu_files.model("offset/offset"))
        model(f"{name}/helper", helper(offset))
    assert fresh("build", "north/north.py", "south/south.py").code == 0
    table = single("north", name="north")
    for names in (["north", "south", "again"], ["south", "north", "again"]):
        fmus = {"north": "north", "south": "south", "again": "north"}
        table["components"] = {name: {"fmu": fmus[name]} for name in names}
        found = last(fresh("run", write(table), "--json"), tmp_path)
        # each rounds t + h and two sums
        assert found["north.y"] == found["again.y"] == pytest.approx(20.05, abs=1e-13)
        assert found["south.y"] == pytest.approx(400.05, abs=1e-13)


def test_a_model_may_bring_a_package_of_its_own(fresh, model, write, tmp_path):
    model("parts/__init__", "from .inner import VALUE\n")
    model("parts/inner", "import numpy as np\nfrom parts.deeper import BASE\n\nVALUE = float(np.sqrt(BASE))\n")
    model("parts/deeper", "BASE = 49.0\n")
    source = CLOCK.replace("from uuv", "import parts\nfrom uuv").replace("round(t + h, 9)", "parts.VALUE")
    fresh("build", model("mine", source))
    shutil.rmtree(tmp_path / "parts")  # what it needs is in the FMU
    (tmp_path / "mine.py").unlink()
    assert last(fresh("run", write(single("mine")), "--json"), tmp_path)["one.y"] == 7.0


# --- The example and the templates ------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_an_example_builds_and_flies(fresh, write, spiral, tmp_path, path):
    assert fresh("build", path).code == 0
    spiral["master"]["stop_time"] = 1.0
    answer = fresh("run", write(spiral), "--swap", f"controller={path.stem}", "--json")
    assert answer.code == 0, answer.err
    with orchestrator.open_run(tmp_path / answer.json["file"]) as run:
        error = abs(run["vehicle.eta.z"] - run["reference.eta_d.z"])
        assert error[-1] < 0.8 * error[0]  # a metre at the start, on its way to nothing


def test_the_example_is_short():
    assert len((EXAMPLES / "pd_numpy.py").read_text().splitlines()) <= 25


def test_a_new_controller_builds_runs_and_is_listed(fresh, write, spiral, tmp_path):
    answer = fresh("new", "controller", "my_first")
    assert answer.code == 0
    assert answer.out.splitlines()[0] == "my_first.py"
    assert "orch build my_first.py" in answer.out
    assert fresh("build", "my_first.py").code == 0
    run = fresh(
        "run",
        write(spiral),
        "--swap",
        "controller=my_first",
        "--json",
        "--set",
        "components.controller.parameters.K_p=90",
    )
    assert run.code == 0, run.err
    assert abs(last(run, tmp_path)["controller.tau.Z"]) > 0.0
    assert {fmu["name"] for fmu in fresh("fmus", "--json").json} == {*catalogue.shipped(), "my_first"}
    assert fresh("new", "controller", "my_first").code == 2  # what is there stays


def test_what_a_new_controller_says_to_do_next_works(fresh, tmp_path):
    answer = fresh("new", "controller", "mine")
    commands = [
        command.strip() for line in answer.out.splitlines()[1:] for command in line.partition(":")[2].split("&&")
    ]
    assert len(commands) == 3
    for command in commands:
        program, *arguments = command.split()
        assert program == "orch"
        extra = ["--set", "master.stop_time=0.05", "--set", "record.every=0.05"] if arguments[0] == "run" else []
        done = fresh(*arguments, *extra)
        assert done.code == 0, done.err


def test_a_new_experiment_runs(fresh, tmp_path):
    answer = fresh("new", "experiment", "first_try")
    assert answer.out.splitlines()[0] == "first_try.toml"
    assert fresh("check", "first_try.toml").code == 0
    assert fresh("run", "first_try.toml", "--set", "master.stop_time=0.05").code == 0
    first, second = (tmp_path / "first_try.toml").read_text().splitlines()[:2]
    assert first.startswith("#:schema file://")  # for editors
    assert second.startswith("# first_try: ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("controller", "pid"), "'pid' is the name of a model that comes with orch"),
        (("controller", "my-first"), "'my-first' cannot be the name; use letters, digits and _"),
        (("experiment", "a/b"), "'a/b' cannot be the name"),
        (("vehicle", "mine"), "'vehicle' is not one of 'controller', 'experiment'"),
    ],
)
def test_a_new_file_that_cannot_be_says_why(orch, tmp_path, arguments, words):
    answer = orch("new", *arguments)
    assert answer.code == 2
    assert words in answer.err
    assert list(tmp_path.iterdir()) == []


# --- Listing ----------------------------------------------------------------------------------------------------------


def test_an_fmu_shows_its_variables_units_and_defaults(orch, shipped):
    answer = orch("fmus", "bluerov2_allocation")
    assert answer.code == 0
    for word in (
        "bluerov2_allocation: ",
        "inputs",
        "tau (X Y Z K M N)",
        "N, N.m",
        "outputs",
        "u (T1 T2 T3 T4 T5 T6)",
        "max_thrust",
        "calculated parameters",
        "T[6,6]",
        "canGetAndSetFMUstate",
    ):
        assert word in answer.out, word


def test_an_fmu_as_json_lists_every_variable(orch, probe):
    found = orch("fmus", probe, "--json").json
    assert found["name"] == "probe"
    assert found["packaging"] == "native"
    variables = {variable["name"]: variable for variable in found["variables"]}
    assert variables["u"] == {
        "name": "u",
        "type": "Real",
        "causality": "input",
        "unit": "m",
        "start": "1.5",
        "description": "a number in",
    }
    assert [name for name, variable in variables.items() if variable["type"] == "String"] == ["text", "words"]


def test_an_unknown_fmu_is_reported_with_the_nearest_one(orch):
    answer = orch("fmus", "mfsosm")
    assert answer.code == 2
    assert "did you mean 'mfsosmc'" in answer.err


def test_a_broken_fmu_does_not_hide_the_others(fresh, tmp_path):
    fresh("build", "pid")
    (tmp_path / "build" / "python" / "broken.fmu").write_text("not a zip")
    answer = fresh("fmus")
    assert "pid" in answer.out
    assert "broken.fmu is not an FMU: not a zip file" in answer.err
    assert answer.code == 0


@pytest.mark.parametrize("folder", ["/dev/null", "/proc/nowhere"])
def test_a_build_folder_that_cannot_be_written_is_reported_once(orch, folder):
    answer = orch("build", "pid", "mfsosmc", env={**os.environ, "ORCH_BUILD": folder})
    assert answer.code == 2
    *before, sentence = answer.err.splitlines()
    assert before == ["building pid", "building mfsosmc"]
    assert re.match(f"the folder of built FMUs, {folder}/(native|python), cannot be written: [A-Z]", sentence)


def test_a_model_that_ends_the_build_is_reported_by_its_last_words(fresh, model):
    answer = fresh("build", model("mine", "import sys\nprint('so long', file=sys.stderr)\nsys.exit('and farewell')\n"))
    assert answer.code == 2
    assert answer.err.endswith("mine.py cannot be built: the build stopped: and farewell\n")
