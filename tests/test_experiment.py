"""The experiment file: what is read from it, what is wrong with it, and what --set and --swap change."""

import pytest

from experiments import EXPERIMENTS, merged
from orchestrator.experiment.timegrid import TimeGrid

FAULTS = {
    "titel": "a slip",
    "master.step": 0.00035,
    "master.algorithm": "gauss-seidl",
    "components.controller.fmu": "pdi",
    "components.vehicle.parameters": {"eta_0": [1, 2, 3], "mass": 12.0},
    "components.allocation.step": 0.0005,
    "components.current.colour": "blue",
    "connections.vehicle.u": "allocation.uu",
    "connections.vehicel.v_c": "current.v_c",
    "connections.vehicle.v_c": None,
    "record.every": 0.0071,
    "record.signals": ["vehicle.*", "vehicel.*"],
    "metrics": {
        "one": {"of": "rmsee", "signal": "vehicle.eta.x"},
        "two": {"of": "rms", "signal": "vehicle.eta.xx"},
        "three": {"of": "rms", "signal": "vehicle.eta.x", "unit": "deg"},
    },
}
FAULTY_KEYS = {
    "titel": "title",
    "master.algorithm": "gauss-seidel",
    "components.controller.fmu": "pid",
    "components.vehicle.parameters.eta_0": "6 axes",
    "components.vehicle.parameters.mass": "it has:",
    "components.allocation.step": "0.00035 or 0.0007",
    "components.current.colour": "parameters",
    'connections."vehicle.u"': "allocation.u",
    'connections."vehicel.v_c"': "vehicle",
    "components.vehicle": "v_c",
    "record.every": "multiple",
    "record.signals": "vehicle",
    "metrics.one.of": "rmse",
    "metrics.two.signal": "vehicle.eta.x",
    "metrics.three.unit": "mm",
}  # key: what its message must offer


@pytest.mark.parametrize("command", ["check", "run"])
def test_all_faults_of_a_file_are_reported_at_once_and_nothing_is_written(orch, write, spiral, tmp_path, command):
    path = write(merged(spiral, FAULTS))
    answer = orch(command, path)
    assert (answer.code, answer.out) == (2, "")
    head, *lines = answer.err.splitlines()
    assert head == f"{path}: {len(lines)} problems"
    for key, offer in FAULTY_KEYS.items():
        found = [line for line in lines if line.strip().startswith(f"{key}: ")]
        assert len(found) >= 1, f"{key} is not reported:\n{answer.err}"
        assert any(offer in line for line in found), (offer, found)
    assert list(tmp_path.iterdir()) == [path]


def test_the_problems_come_as_json_too(orch, write, spiral):
    answer = orch("check", write(merged(spiral, FAULTS)), "--json")
    assert answer.code == 2
    assert set(FAULTY_KEYS) <= {problem["key"] for problem in answer.json["problems"]}


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"mastr": {"step": 1.0}}, "mastr", "did you mean 'master'"),
        ({"title": 3}, "title", "3, not a text"),
        ({"master.stoptime": 3}, "master.stoptime", "did you mean 'stop_time'"),
        ({"master.stop_time": None}, "master.stop_time", "is missing"),
        ({"master.step": None}, "master.step", "is missing"),
        ({"master.step": 0}, "master.step", "is 0; give a positive number"),
        ({"master.step": "1e-3"}, "master.step", "'1e-3'"),
        ({"master.stop_time": True}, "master.stop_time", "is True"),
        ({"master.stop_time": -1.0}, "master.stop_time", "positive"),
        ({"master.stop_time": 0.0505}, "master.stop_time", "try 0.05 or 0.051"),
        ({"master.algorithm": "jakobi"}, "master.algorithm", "did you mean 'jacobi'"),
        ({"master.algorithm": ["jacobi"]}, "master.algorithm", "not a text"),
        ({"master.seed": 1.5}, "master.seed", "1.5, not a whole number"),
        ({"master.seed": 10**30}, "master.seed", "does not fit 64 bits"),
        ({"master": 3}, "master", "is 3, not a table"),
        ({"components": {}}, "components", "has none"),
        ({"components": 3}, "components", "is 3, not a table"),
        ({"components.vehicle": "bluerov2_thesis"}, "components.vehicle", "not a table"),
        ({"components.my vehicle": {"fmu": "pid"}}, "components.my vehicle", "letters, digits and _"),
        ({"components.time": {"fmu": "ocean_current"}}, "components.time", "another name"),
        ({"components.current.fmu": None}, "components.current.fmu", "is missing"),
        ({"components.current.fmu": ""}, "components.current.fmu", "is missing"),
        ({"components.current.fmu": 7}, "components.current.fmu", "7, not a text"),
        ({"components.current.parameter": {}}, "components.current.parameter", "did you mean 'parameters'"),
        ({"components.current.parameters": [1]}, "components.current.parameters", "not a table"),
        ({"components.current.start": "all"}, "components.current.start", '"fmu"'),
        ({"components.current.step": 0.0025}, "components.current.step", "try 0.002 or 0.003"),
        ({"connections.controller": {"eta": "vehicle.eta"}}, 'connections."controller"', "in quotes"),
        ({"connections.controller.eta": 3}, 'connections."controller.eta"', "is 3"),
        ({"record.evry": 0.01}, "record.evry", "did you mean 'every'"),
        ({"record.every": 0.0015}, "record.every", "try 0.001 or 0.002"),
        ({"record.every": 0.02}, "record.every", "does not divide master.stop_time = 0.05"),
        ({"record.signals": "*"}, "record.signals", "list of globs"),
        ({"record.signals": ["vehicle.etta"]}, "record.signals", "did you mean 'vehicle.eta'"),
        ({"record.inputs": "yes"}, "record.inputs", "true or false"),
        ({"metrics": [1]}, "metrics", "not a table"),
        ({"metrics.rmse_x": "rmse"}, "metrics.rmse_x", "not a table"),
    ],
)
def test_a_fault_names_its_key_its_value_and_the_way_out(problems, spiral, changes, key, words):
    found = problems(merged(spiral, changes))
    assert any(k == key and words in sentence for k, sentence in found), found


@pytest.mark.parametrize("content", [b"[master\nstep = 1", b'title = "a"\ntitle = "b"', b"title = '\xff'"])
def test_a_file_that_is_no_toml_says_so(orch, tmp_path, content):
    (tmp_path / "bad.toml").write_bytes(content)
    answer = orch("run", "bad.toml")
    assert answer.code == 2
    assert "bad.toml: 1 problem" in answer.err
    assert "cannot be read as TOML" in answer.err


def test_a_toml_fault_names_its_line(orch, tmp_path):
    (tmp_path / "bad.toml").write_text('title = "a"\n\n[master]\nstep == 1\n')
    assert "line 4" in orch("check", "bad.toml").err


def test_a_missing_file_names_the_nearest_one(orch, write, spiral):
    write(spiral, "my_spiral.toml")
    answer = orch("run", "my_sprial.toml")
    assert answer.code == 2
    assert "no such file; did you mean 'my_spiral.toml'?" in answer.err


def test_a_folder_is_no_experiment(orch, tmp_path):
    assert orch("run", tmp_path).code == 2


@pytest.mark.parametrize("path", sorted(EXPERIMENTS.glob("*.toml")), ids=lambda path: path.stem)
def test_a_shipped_experiment_has_no_problems_and_says_what_it_shows(orch, path):
    assert path.read_text().startswith("# ")
    answer = orch("check", path)
    assert (answer.code, answer.err) == (0, "")
    assert "no problems" in answer.out


# --- Ratios of times --------------------------------------------------------------------------------------------------


def test_time_is_a_whole_number_of_steps_without_rounding():
    grid = TimeGrid(1e-4)
    assert grid.ticks(40.0) == 400_000
    assert grid.ticks(0.3) == 3000
    assert grid.ticks(0.00035) is None
    assert grid.time(3000) == 0.3
    assert [grid.time(k) for k in (1, 7, 123)] == [0.0001, 0.0007, 0.0123]
    assert TimeGrid(0.1).ticks(0.3) == 3  # in binary fractions it is 2.9999999999999996
    assert TimeGrid(0.1).ticks(0.30000000001) is None


# --- --set and --swap -------------------------------------------------------------------------------------------------

SETS = {
    "master.stop_time": "0.02",
    "master.algorithm": "jacobi",
    "master.seed": "7",
    "title": "A title of words",
    "components.controller.step": "2e-3",
    "components.controller.parameters.K_p.z": "90",
    "components.vehicle.parameters.eta_0.z": "3",
    "components.current.parameters.velocity": "[0.1, 0.2, 0.3]",
    'connections."vehicle.v_c"': "current.v_c",
    "connections.'controller.nu'": '"vehicle.nu"',
    "record.signals": '["vehicle.eta", "!*.phi"]',
    "record.inputs": "false",
    "metrics.extra.of": "final",
    "metrics.extra.signal": "vehicle.eta.x",
    "metrics.rmse_x": "{ of = 'rms', signal = 'vehicle.eta.y' }",
}


def only_eta(spiral):
    table = merged(spiral, {"metrics": {"rmse_x": {"of": "rms", "signal": "vehicle.eta.x"}}})
    table["components"]["vehicle"]["parameters"] = {"eta_0": [2, -1, 1, 0, 0, 0]}
    return table


def test_set_changes_every_kind_of_key(orch, write, spiral):
    options = [option for key, value in SETS.items() for option in ("--set", f"{key}={value}")]
    answer = orch("check", write(only_eta(spiral)), "--json", *options)
    assert answer.code == 0, answer.err
    plan = answer.json
    components = {component["name"]: component for component in plan["components"]}
    assert plan["title"] == "A title of words"
    assert plan["master"] == {"stop_time": 0.02, "step": 1e-3, "algorithm": "jacobi", "seed": 7}
    assert components["controller"]["period"] == 2
    assert components["controller"]["parameters"] == {"K_p.z": 90.0}
    # One axis of a list: the others stay.
    assert [components["vehicle"]["parameters"][f"eta_0.{axis}"] for axis in ("x", "y", "z")] == [2.0, -1.0, 3.0]
    assert components["current"]["parameters"] == {"velocity.x": 0.1, "velocity.y": 0.2, "velocity.z": 0.3}
    assert plan["record"]["signals"] == [f"vehicle.eta.{axis}" for axis in ("x", "y", "z", "theta", "psi")]
    assert plan["metrics"] == {
        "rmse_x": {"of": "rms", "signal": "vehicle.eta.y"},
        "extra": {"of": "final", "signal": "vehicle.eta.x"},
    }


def test_python_takes_the_same_changes_as_values(problems, spiral):
    found = problems(spiral, set={"master.step": 0.0003, "components.controler.step": 1e-3, "recrod.every": 1})
    keys = ["--set components.controler.step", "recrod", "master.stop_time", "record.every"]
    assert [key for key, _ in found] == keys


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("components.controler.fmu=pid", "no component 'controler'; did you mean 'controller'?"),
        ("mastr.step=1", "did you mean 'master'"),
        ("master.step.x=1", "unknown key; did you mean 'step'"),
        (".=1", "not a dotted key"),
        ("master.step", "write --set KEY=VALUE"),
        ("=1", "write --set KEY=VALUE"),
    ],
)
def test_a_set_that_makes_no_sense_says_why(orch, write, spiral, option, words):
    answer = orch("run", write(spiral), "--set", option)
    assert answer.code == 2
    assert words in answer.err


@pytest.mark.parametrize("swap", ["controler=pid", "controller=pdi", "controller"])
def test_a_swap_that_makes_no_sense_says_why(orch, write, spiral, swap):
    answer = orch("run", write(spiral), "--swap", swap)
    assert answer.code == 2
    assert "did you mean" in answer.err or "write --swap COMPONENT=FMU" in answer.err


@pytest.mark.parametrize("components", [3, [1], {"controller": 3}])
def test_set_and_swap_meet_a_file_without_components(problems, spiral, components):
    changes = {"set": {"components.controller.parameters.K_p": 1.0}, "swap": {"controller": "pid"}}
    assert problems(merged(spiral, {"components": components}), **changes)


def test_a_swap_drops_parameters_but_not_those_that_are_set_for_the_new_fmu(orch, write, spiral):
    table = merged(spiral, {"components.controller.parameters": {"K_p": {"z": 90.0}}})
    answer = orch(
        "check",
        write(table),
        "--swap",
        "controller=mfsosmc",
        "--json",
        "--set",
        "components.controller.parameters.t_b=2.5",
    )
    assert answer.code == 0, answer.err
    (controller,) = [c for c in answer.json["components"] if c["name"] == "controller"]
    assert controller["parameters"] == {"t_b": 2.5}
    assert "dropped its parameters K_p" in orch("check", write(table), "--swap", "controller=mfsosmc").out


def test_a_swap_names_a_file_relative_to_where_the_user_is(orch, shipped, write, spiral, tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "mine.fmu").write_bytes(shipped["pid"].read_bytes())
    answer = orch("check", write(spiral), "--swap", "controller=mine.fmu", cwd=tmp_path / "here")
    assert answer.code == 0, answer.err
