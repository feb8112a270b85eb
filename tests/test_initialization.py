"""Initial values that depend on each other in circles, and what `orch check` says of such circles."""

import math

import pytest

import orchestrator
from experiments import merged
from fmu_files import SOURCES
from orchestrator.models import build


@pytest.fixture(scope="module")
def curve(_build_folder):
    build.build([str(SOURCES / "curve.py")])


def ring(a, b, **changes):
    """a feeds b, b feeds a; c follows b."""
    table = {
        "master": {"stop_time": 0.02, "step": 0.01},
        "components": {
            "c": {"fmu": "curve"},
            "a": {"fmu": "curve", "parameters": a},
            "b": {"fmu": "curve", "parameters": b},
        },
        "connections": {"c.u": "b.y", "a.u": "b.y", "b.u": "a.y"},
    }
    return merged(table, changes)


@pytest.fixture
def first(orch, write, curve, tmp_path):
    """The first row of a run: a.y, b.y, c.y and the warnings."""

    def run(table):
        answer = orch("run", write(table), "--json")
        assert answer.code == 0, answer.err
        with orchestrator.open_run(tmp_path / answer.json["file"]) as record:
            return *(record[f"{name}.y"][0] for name in "abc"), record.attributes["warnings"]

    return run


@pytest.mark.parametrize(("gain", "newton"), [(0.5, False), (-0.6, False), (-3.0, True), (4.0, True)])
def test_a_linear_loop_is_solved_whether_or_not_it_settles_by_itself(first, gain, newton):
    """a = gain b + 1, b = a: a = 1 / (1 - gain)."""
    a, b, c, warnings = first(ring({"gain": gain, "bias": 1.0}, {}))
    # A fixed point is exact; Newton's method ends where 1e-10 is left.
    assert (a, b, c) == pytest.approx([1 / (1 - gain)] * 3, rel=1e-9)
    assert any("found by Newton's method" in words for words in warnings) == newton
    assert not newton or "a.u <- b.y <- b.u <- a.y <- a.u" in warnings[0]


def test_a_loop_of_curves_is_solved(first):
    a, b, c, _ = first(ring({"gain": 0.0, "wave": 1.0}, {"gain": 2.0, "bias": 0.1}))
    assert a == pytest.approx(math.cos(3 * b), abs=1e-9)
    assert b == pytest.approx(2 * a + 0.1, abs=1e-9)
    assert c == pytest.approx(b, abs=1e-9)


def test_a_component_that_feeds_itself_is_solved(first):
    table = ring({"gain": -2.0, "bias": 3.0}, {}, **{"connections.a.u": "a.y"})
    assert first(table)[:3] == pytest.approx([1.0, 1.0, 1.0], rel=1e-9)


def test_a_loop_without_a_solution_is_reported_variable_by_variable(orch, write, curve):
    answer = orch("run", write(ring({"bias": 1.0}, {})))
    assert answer.code == 3
    assert "an algebraic loop through a.u <- b.y <- b.u <- a.y <- a.u; " in answer.err


@pytest.mark.parametrize(
    ("algorithm", "late"),
    [
        ("gauss-seidel", [["a.u", "b.y"]]),
        ("jacobi", [["a.u", "b.y"], ["b.u", "a.y"]]),
    ],
)
def test_check_tells_of_feedthrough_cycles_and_which_values_are_late(orch, write, curve, algorithm, late):
    path = write(ring({}, {"gain": 0.5}, **{"master.algorithm": algorithm}))
    assert orch("check", path, "--json").json["cycles"] == [{"path": ["a.u", "b.y", "b.u", "a.y"], "delayed": late}]
    answer = orch("check", path)
    assert answer.code == 0
    assert "cycle: a.u <- b.y <- b.u <- a.y <- a.u" in answer.out
    assert "a.u takes b.y" in answer.out


def test_a_plant_whose_state_comes_between_is_no_cycle(orch, write, spiral):
    assert orch("check", write(spiral), "--json").json["cycles"] == []
