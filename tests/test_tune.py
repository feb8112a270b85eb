"""Tuning: equal budgets, studies that go on, fragments that run, held-out draws."""

import csv
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmu_files import SOURCES
from orchestrator import open_run
from orchestrator.experiment.sweep import read as read_sweep
from orchestrator.experiment.tune import read as read_tune
from orchestrator.models import build
from orchestrator.studies.sweep.design.matrix import points
from orchestrator.studies.sweep.tuning import designs

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
        "vary": {FMU: ["pid", "lyapunov"], "components.current.parameters.velocity": velocity},
        "tune": {
            "objective": "rmse_x",
            "trials": 6,
            "draws": 4,
            "held_out": 3,
            "search": {"pid": SPACE, "lyapunov": {"K_d.x": SPACE["K_p.x"]}},
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


@pytest.mark.usefixtures("_build_folder")
def test_an_error_of_either_sign_is_tuned_by_its_size(orch, write):
    """`one` is its bias, from -5 to 5; `other` is about 1: the best error is 0, and not -6."""
    curve = str(build.build([str(SOURCES / "curve.py")])["curve"])
    bias = {"distribution": "uniform", "low": -5.0, "high": 5.0}
    table = {
        "master": {"stop_time": 0.02, "step": 0.01},
        "components": {
            name: {"fmu": curve, "start": {"u": 0.0}, "parameters": {"bias": 1.0}} for name in ("one", "other")
        },
        "metrics": {"miss": {"of": "final", "signal": "one.y", "reference": "other.y"}},
        "sweep": {
            "seed": 1,
            "vary": {"components.other.parameters.bias": bias | {"low": 0.9, "high": 1.1}},
            "tune": {
                "objective": "miss",
                "component": "one",
                "trials": 12,
                "draws": 1,
                "held_out": 2,
                "search": {curve: {"bias": bias}},
            },
        },
    }
    answer = orch("tune", write(table), "--json")
    assert answer.code == 0, answer.err
    (controller,) = answer.json["controllers"]
    assert 0.0 <= controller["best"] < 0.2  # that of the first trial, which has the defaults, is below 0.1


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


FEW = [  # distributions of many values, and of few
    {"distribution": "uniform", "low": 8.0, "high": 12.0},
    {"distribution": "normal", "mean": 1.0, "std": 0.2},
    {"distribution": "direction", "axes": ["x", "y"], "low": 0.1, "high": 1.0},
    {"distribution": "integer", "low": 1, "high": 9},
    {"distribution": "choice", "values": ["a", "b", "c"]},
]


@given(
    skip=st.integers(0, 40),
    draws=st.integers(1, 20),
    held_out=st.integers(1, 40),
    seed=st.integers(0, 1000),
    method=st.sampled_from(["random", "lhs", "sobol"]),
    varied=st.lists(st.sampled_from(FEW), max_size=3),
    scenarios=st.booleans(),
)
@settings(deadline=None, max_examples=150)
def test_trials_and_comparison_share_no_draw_whatever_is_asked_for(
    skip, draws, held_out, seed, method, varied, scenarios
):
    vary = {f"components.vehicle.parameters.p{i}": table for i, table in enumerate(varied)}
    vary |= {"master.step": [1e-3, 5e-4]} if scenarios else {}
    table = {"skip": skip, "seed": seed, "design": method, "vary": {FMU: ["pid"], **vary}}
    tune = {"objective": "m", "component": "controller", "trials": 1, "draws": draws, "held_out": held_out}
    table["tune"] = {**tune, "search": {"pid": SPACE}}
    spec, problems = read_tune(table, {"m": {}})
    assert problems == []
    search, problems = designs.design(spec, read_sweep(table)[0], {})
    of_trials = drawn(search.trials())
    assert len(set(of_trials)) <= draws
    for sweep in (search.comparison({"pid": {"K_p.x": 20.0}}), search.tuned({"pid": {"K_p.x": 20.0}})):
        shared = set(of_trials) & set(drawn(sweep))
        assert bool(shared) == bool(problems)  # refused where the distributions have too few values
        assert len({point.draw for point in points(sweep)}) == held_out
    assert method == "lhs" or [*of_trials, *drawn(sweep)] == drawn(
        replace(sweep, skip=skip, draws=draws + held_out, lists=())
    )


def drawn(sweep):
    """The values of each draw."""
    return [str(point.cells) for point in points(replace(sweep, lists=()))]


def test_a_distribution_that_is_none_is_a_problem_of_a_search_too(orch, tuning, write):
    tuning["sweep"]["vary"]["components.vehicle.parameters.m"] = {"distribution": "uniform", "low": 9.0}
    answer = orch("tune", write(tuning))
    assert answer.code == 2
    assert 'sweep.vary."components.vehicle.parameters.m".high: is missing' in answer.err


def test_a_search_that_cannot_hold_draws_out_is_refused(orch, tuning, write, tmp_path):
    tuning["sweep"]["vary"] = {
        FMU: ["pid", "lyapunov"],
        "master.seed": {"distribution": "integer", "low": 1, "high": 3},
    }
    answer = orch("tune", write(tuning))
    assert answer.code == 2
    assert "sweep.tune.held_out: 1 of 3 draws have the very values of draws that trials are judged on" in answer.err
    del tuning["sweep"]["vary"]["master.seed"]
    del tuning["sweep"]["draws"]
    answer = orch("tune", write(tuning))
    assert answer.code == 2
    assert "no value in sweep.vary is a distribution" in answer.err
    assert not (tmp_path / "results").exists()


def test_lists_that_a_search_cannot_take_are_refused_not_dropped(orch, tuning, write):
    parameters = "components.controller.parameters"
    tuning["sweep"]["vary"][f"{parameters}.K_p.x"] = [1.0]
    answer = orch("tune", write(tuning))
    assert answer.code == 2
    assert f'sweep.vary."{parameters}.K_p.x": is searched in sweep.tune.search, too' in answer.err
    del tuning["sweep"]["vary"][f"{parameters}.K_p.x"]
    tuning["sweep"]["vary"][parameters] = [{"K_i": {"x": 1.0}}, {}]
    answer = orch("tune", write(tuning))
    assert answer.code == 2
    assert "is set by the search; zip it with components.controller.fmu" in answer.err
    tuning["sweep"]["zip"] = [[FMU, parameters]]
    tuning["sweep"]["vary"] |= {FMU: ["pid", "pid"], parameters: [{"K_i": {"x": 1.0}}, {}]}
    answer = orch("tune", write(tuning))
    assert answer.code == 2
    assert "sweep.tune.search.pid: 2 rows of sweep.vary have this FMU" in answer.err
    assert "sweep.tune.search.lyapunov: is not in the list of FMUs, which" in answer.err
    tuning["sweep"] |= {"zip": [], "vary": {FMU: ["pid"], "components.current.parameters.velocity": FEW[2]}}
    answer = orch("tune", write(tuning), "--set", "components.current.parameters.velocity.x=0.1")
    assert answer.code == 2
    assert "--set components.current.parameters.velocity.x: varies in the sweep" in answer.err


@pytest.mark.slow
@pytest.mark.parametrize("method", ["random", "lhs"])
def test_what_was_tuned_runs_as_a_sweep_on_no_draw_of_its_trials(orch, tuning, write, tmp_path, method):
    parameters = "components.controller.parameters"
    tuning["master"]["stop_time"] = 0.1
    tuning["sweep"] |= {"skip": 2, "design": method, "zip": [[FMU, parameters]]}
    listed = {FMU: ["pid", "lyapunov", "nstsmc"], parameters: [{"K_i": {"x": 2.0}}, {}, {}]}
    tuning["sweep"]["vary"] |= {**listed, "master.step": [1e-3, 5e-4]}
    answer = orch("tune", write(tuning), "--set", f"{parameters}.K_d.y=30.0", "--json")
    assert answer.code == 0, answer.err
    assert answer.json["notes"][:2] == [
        "nstsmc: left out, for sweep.tune.search does not name them",
        "master.step: each draw meets all 2 values, in every trial and in the comparison",
    ]
    folder = Path(answer.json["folder"])
    trials = [open_run(path) for path in folder.glob("*.h5")]
    seen = {velocity(run) for run in trials}
    assert len(seen) == 4
    assert {run.attributes["step"] for run in trials} == {1e-3, 5e-4}
    for run in trials:
        given = run.fact("controller", "parameters")
        assert given["K_d.y"] == 30.0
        assert (given.get("K_i.x") == 2.0) == (run.fact("controller", "fmu") == "pid")
    compared = rows_of(answer.json["final"]["table"])
    assert len(compared) == 4 * 3 * 2
    assert not {velocity(open_run(row["run_id"], tmp_path / "results")) for row in compared} & seen
    # tuned.toml in place of the experiment's [sweep], under its own seed.
    del tuning["sweep"]
    path = write(tuning)
    path.write_text(path.read_text() + "\n" + (folder / "tuned.toml").read_text())
    again = orch("sweep", path, "--results", "again", "--json")
    assert again.code == 0, again.err
    ids = [row["run_id"] for row in rows_of(again.json["table"])]
    assert sorted(ids) == sorted(row["run_id"] for row in compared if row["title"].endswith(" tuned"))


def velocity(run):
    (current,) = [c for c in run.resolved["components"] if c["name"] == "current"]
    return tuple(current["parameters"][f"velocity.{axis}"] for axis in "xy")


def rows_of(table):
    return list(csv.DictReader(Path(table).read_text().splitlines()))


@pytest.mark.slow
def test_runs_that_warn_of_their_numbers_are_not_what_a_search_is_judged_by(orch, tuning, write):
    tuning["sweep"]["tune"]["search"] = {"mfsosmc": {"K_d.x": {**SPACE["K_p.x"], "low": 100.0}}}
    tuning["sweep"]["vary"][FMU] = ["mfsosmc"]
    tuning["sweep"]["tune"]["trials"] = 2
    path = write(tuning)
    answer = orch("tune", path)  # at 1 ms it is unstable
    assert answer.code == 0, answer.err
    assert "note: mfsosmc: 2 trials do not count: warned: unstable at this step" in answer.err
    assert "note: mfsosmc: no trial completed, so it is not tuned" in answer.err
    assert ["mfsosmc", "2", "2", "-", "-"] in [line.split() for line in answer.out.splitlines()]
    (fragment,) = path.parent.glob("results/_tune/*/mfsosmc.toml")
    assert fragment.read_text().startswith("# Not tuned: no trial completed on draws 0 to 3 of sweep.seed = 3.\n")
    (table,) = path.parent.glob("results/mine-*/table.csv")
    assert {row["title"] for row in rows_of(table)} == {"mfsosmc"}


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
    assert fragment["vary"][FMU] == ["pid", "lyapunov"]
    # The comparison is on draws that no trial has seen: 4, 5 and 6.
    lines = Path(whole["final"]["table"]).read_text().splitlines()
    assert {line.split(",")[1] for line in lines[1:]} == {"4", "5", "6"}
    comparison = orch("compare", "--sweep", whole["final"]["sweep_id"], "--results", "whole", "--json").json
    assert comparison["by"] == "title"
    assert comparison["contenders"] == ["pid", "lyapunov", "pid tuned", "lyapunov tuned"]
