"""The envelope of a record: the least and the greatest value between rows, against the run that records every step."""

import os
from itertools import pairwise

import numpy as np
import pytest

import orchestrator
from experiments import merged, single
from fmu_files import needs_compiler

STEP = 1e-3  # s
DIRECT = ["allocation.u.T1", "controller.tau.X", "vehicle.tau.X", "vehicle.specific_force.x"]
STATES = ["vehicle.eta.x", "vehicle.nu.u", "reference.eta_d.x", "current.v_c.x"]


def between(full, name, thin):
    """(N, 2): least and greatest of a signal of the full run over (time[k-1], time[k]] of a thin one."""
    ends = np.searchsorted(full.time, thin.time)
    first = int(ends[0])
    parts = [full[name][first : first + 1], *(full[name][a + 1 : b + 1] for a, b in pairwise(ends))]
    return np.array([[part.min(), part.max()] for part in parts])


def check(thin, full, names):
    """That the envelopes are those of the full run to the last bit, and the rows, too."""
    for name in names:
        envelope = thin.envelope(name)
        assert envelope.shape == (len(thin.time), 2)
        assert envelope.tobytes() == between(full, name, thin).tobytes(), name
        assert (envelope[0] == thin[name][0]).all()
        assert ((envelope[:, 0] <= thin[name]) & (thin[name] <= envelope[:, 1])).all()


@pytest.fixture
def chattering(spiral):
    """A relay at a step that is too long for it."""
    return merged(
        spiral, {"components.controller.fmu": "mfsosmc", "components.controller.parameters": {}, "metrics": {}}
    )


@pytest.fixture
def pairs(write, chattering, tmp_path):
    """pairs(changes, **options): the run of a table with rows 7 steps apart, and the one that records every step."""

    def run(changes, table=chattering, every=0.007, **options):
        table = merged(table, {"master.stop_time": 0.07, **changes})
        thin = orchestrator.run(write(merged(table, {"record.every": every})), output=tmp_path / "thin.h5", **options)
        full = orchestrator.run(write(merged(table, {"record.every": STEP})), output=tmp_path / "full.h5", **options)
        return thin, full

    return run


@pytest.mark.parametrize("loop", ["compiled", "python"])
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
@pytest.mark.parametrize("packaging", ["native", "python"])
def test_the_envelope_is_least_and_greatest_of_the_steps_since_the_row_before(
    pairs, monkeypatch, loop, algorithm, packaging
):
    monkeypatch.setenv("ORCH_LOOP", loop)
    thin, full = pairs({"master.algorithm": algorithm}, packaging=packaging)
    check(thin, full, DIRECT)
    assert (np.ptp(thin.envelope("allocation.u.T1")[1:], axis=1) > 0.1).all()  # it chatters


def test_components_of_longer_periods_have_it_too(pairs):
    thin, full = pairs({"components.controller.step": 0.002, "components.reference.step": 0.005})
    check(thin, full, DIRECT)


def test_by_default_it_is_of_outputs_that_depend_on_an_input_at_once(pairs):
    thin, full = pairs({})
    assert all(thin.envelope(name) is not None for name in DIRECT)
    assert all(thin.envelope(name) is None for name in STATES)
    assert all(full.envelope(name) is None for name in DIRECT)  # nothing is between its rows
    assert thin.signals == full.signals


def test_globs_say_of_what(pairs):
    thin, full = pairs({"record.envelope": ["vehicle.eta", "reference.eta_d.?", "allocation.u.T[12]"]})
    names = ["vehicle.eta.psi", "vehicle.eta.x", "reference.eta_d.z", "allocation.u.T1", "allocation.u.T2"]
    check(thin, full, names)
    assert all(thin.envelope(name) is None for name in ("allocation.u.T3", "vehicle.nu.u", "controller.tau.X"))


def test_false_means_none(pairs):
    thin, _ = pairs({"record.envelope": False})
    assert "_envelope" not in thin.file
    assert all(thin.envelope(name) is None for name in DIRECT)


@needs_compiler
def test_an_isolated_component_has_the_same(pairs, chattering):
    thin, full = pairs({"components.allocation.isolation": "process", "components.vehicle.isolation": "process"})
    check(thin, full, DIRECT)


@pytest.mark.parametrize("loop", ["compiled", "python"])
def test_a_run_that_fails_between_rows_has_it_up_to_its_last_row(orch, write, models, tmp_path, loop):
    table = merged(single("trouble", stop_time=0.12, kind=1, at=0.08), {"components.one.start": {"u": 0.0}})
    table |= {"record": {"every": 0.03, "envelope": ["one.y"]}}
    answer = orch("run", write(table), "-o", "failed.h5", env={**os.environ, "ORCH_LOOP": loop})
    assert answer.code == 3
    with orchestrator.open_run(tmp_path / "failed.h5") as run:
        assert run.time.tolist() == [0.0, 0.03, 0.06]
        np.testing.assert_allclose(run.envelope("one.y"), [[0.0, 0.0], [0.01, 0.03], [0.04, 0.06]], rtol=1e-12)


@pytest.mark.parametrize("loop", ["compiled", "python"])
def test_what_goes_on_from_a_checkpoint_has_that_of_the_whole_run(write, chattering, tmp_path, monkeypatch, loop):
    """But in its first row, before which there is none, and since which the next one counts."""
    monkeypatch.setenv("ORCH_LOOP", loop)
    table = merged(chattering, {"master.stop_time": 0.07, "record.every": 0.007})
    full = orchestrator.run(write(merged(table, {"record.every": STEP}), "full.toml"), output=tmp_path / "full.h5")
    times = [0.028, 0.031]  # at a row, and between two
    whole = orchestrator.run(write(table), results=tmp_path / "results", checkpoint_at=times)
    for time in times:
        checkpoint = whole.path.with_name(f"{whole.path.stem}.at-{time}.checkpoint")
        branch = orchestrator.run(start_from=checkpoint, results=tmp_path / "results")
        assert branch.time[0] == time
        check(branch, full, DIRECT)
        later = slice(1 if time == 0.028 else 2, None)
        for name in DIRECT:
            rows = np.searchsorted(whole.time, branch.time[later])
            assert branch.envelope(name)[later].tobytes() == whole.envelope(name)[rows].tobytes()


def test_a_sweep_keeps_it_and_thinner_rows_have_a_wider_one(orch, write, chattering, tmp_path):
    table = merged(chattering, {"master.stop_time": 5.04, "record.every": 0.007})
    lists = {"vary": {"components.current.parameters.velocity": [[0.0, 0.0, 0.0]]}}
    metrics = {"x": {"of": "final", "signal": "vehicle.eta.x"}}
    for keep in ("full", "decimated"):
        path = write({**table, "metrics": metrics, "sweep": {"keep": keep, **lists}}, f"{keep}.toml")
        answer = orch("sweep", path, "--workers", "1", "--json")
        assert answer.json["completed"] == 1, answer.err
    full = orchestrator.run(write(merged(table, {"record.every": STEP}), "all.toml"), output=tmp_path / "all.h5")
    records = {keep: next(tmp_path.glob(f"results/{keep}-*/*.h5")) for keep in ("full", "decimated")}
    with orchestrator.open_run(records["full"]) as kept, orchestrator.open_run(records["decimated"]) as thinned:
        assert len(thinned.time) < len(kept.time) == 721
        check(kept, full, DIRECT)
        check(thinned, full, DIRECT)


def test_it_costs_no_row_where_every_row_is_a_step(pairs):
    thin, full = pairs({"record.envelope": ["vehicle.eta"]}, every=STEP)
    assert thin.envelope("vehicle.eta.x") is None
    assert thin.time.tobytes() == full.time.tobytes()


def test_a_glob_that_matches_nothing_is_a_problem(problems, chattering):
    ((key, sentence),) = problems(merged(chattering, {"record.envelope": ["vehicle.etta"]}))
    assert key == "record.envelope"
    assert "'vehicle.etta' matches no recorded signal; did you mean 'vehicle.eta" in sentence
