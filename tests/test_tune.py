"""Tuning: equal budgets, studies that go on, fragments that run, held-out draws."""

import tomllib
from pathlib import Path

import pytest

FMU = "components.controller.fmu"
SPACE = {"K_p.x": {"distribution": "loguniform", "low": 10.0, "high": 1000.0}}


@pytest.fixture
def tuning(spiral):
    """A second of the spiral; the gains of two controllers are searched."""
    spiral["master"]["stop_time"] = 1.0
    spiral["metrics"] = {"rmse_x": spiral["metrics"]["rmse_x"]}
    velocity = {"distribution": "direction", "axes": ["x", "y"], "low": 0.0, "high": 0.5}
    spiral["sweep"] = {
        "seed": 3,
        "vary": {FMU: ["pid", "mfsosmc"], "components.current.parameters.velocity": velocity},
        "tune": {
            "objective": "rmse_x",
            "trials": 6,
            "draws": 4,
            "held_out": 3,
            "search": {"pid": SPACE, "mfsosmc": {"K_d.x": {**SPACE["K_p.x"], "low": 100.0}}},
        },
    }
    spiral["sweep"]["draws"] = 2
    return spiral


def test_all_problems_of_a_search_are_reported_at_once(orch, tuning, write):
    tuning["sweep"]["tune"] |= {"objective": "rmse_y", "trials": 0, "goal": "minimise", "budget": 3}
    bad = {"K_p.x": {"distribution": "normal"}, "K_p.y": SPACE["K_p.x"] | {"low": 0}}
    tuning["sweep"]["tune"]["search"]["pid"] = bad
    for command in ("tune", "run", "check"):
        assert_problems(orch(command, write(tuning)))


def assert_problems(answer):
    assert answer.code == 2
    for words in (
        "no metric 'rmse_y'; did you mean 'rmse_x'",
        "at least 1",
        "did you mean 'minimize'",
        "unknown key",
        "no distribution 'normal'",
        "a logarithm needs a positive number",
    ):
        assert answer.err.count(words) == 1


def test_a_search_needs_neither_draws_nor_lists_of_a_sweep(orch, tuning, write):
    del tuning["sweep"]["draws"]
    del tuning["sweep"]["vary"][FMU]
    tuning["sweep"]["tune"]["component"] = "controller"
    path = write(tuning)
    assert orch("check", path).code == 0
    answer = orch("sweep", path, "--dry-run")
    assert answer.code == 2
    assert "sweep.draws: is missing" in answer.err


def test_a_parameter_that_the_controller_lacks_is_reported(orch, tuning, write):
    tuning["sweep"]["tune"]["search"]["pid"] = {"K_q.x": SPACE["K_p.x"]}
    answer = orch("tune", write(tuning))
    assert answer.code == 2
    assert "no parameter 'K_q.x'" in answer.err


@pytest.mark.slow
def test_a_study_that_goes_on_ends_as_one_that_was_not_interrupted(orch, tuning, write, tmp_path):
    path = write(tuning)
    whole = orch("tune", path, "--results", "whole", "--json").json
    assert orch("tune", path, "--results", "parts", "--set", "sweep.tune.trials=2", "--json").code == 0
    parts = orch("tune", path, "--results", "parts", "--json").json
    assert parts["controllers"] == whole["controllers"]
    assert [one["trials"] for one in whole["controllers"]] == [6, 6]
    for one in whole["controllers"]:
        assert one["best"] <= one["default"]  # the defaults are the first trial
    # The fragments are experiments' and sweeps' own language.
    folder = Path(whole["folder"])
    pid = tomllib.loads((folder / "pid.toml").read_text())["components"]["controller"]
    assert pid == {"fmu": "pid", "parameters": whole["controllers"][0]["parameters"]}
    fragment = tomllib.loads((folder / "tuned.toml").read_text())["sweep"]
    assert fragment["vary"][FMU] == ["pid", "mfsosmc"]
    # The comparison is on draws that no trial has seen: 4, 5 and 6.
    lines = Path(whole["final"]["table"]).read_text().splitlines()
    assert {line.split(",")[1] for line in lines[1:]} == {"4", "5", "6"}
    comparison = orch("compare", "--sweep", whole["final"]["sweep_id"], "--results", "whole", "--json").json
    assert comparison["by"] == "title"
    assert comparison["contenders"] == ["pid", "mfsosmc", "pid tuned", "mfsosmc tuned"]
