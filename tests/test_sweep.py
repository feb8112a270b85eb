"""Sweeps: the design, the runs on Dask's processes, what resuming finds, and the statistics."""

import contextlib
import csv
import io
import json
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pandas
import pytest
from scipy import stats

import orchestrator
from commands import DEADLINE, ORCH
from orchestrator.errors import ExperimentError
from orchestrator.experiment.sweep import read
from orchestrator.studies.sweep.design.matrix import points
from orchestrator.studies.sweep.engine.table import read as read_table
from orchestrator.studies.sweep.results import analysis, figures

FMU = "components.controller.fmu"
FAST = "components.current.parameters.velocity"
MASS = "components.vehicle.parameters.m"
UNIFORM = {"distribution": "uniform", "low": 8.0, "high": 12.0}
DIRECTION = {"distribution": "direction", "axes": ["x", "y"], "low": 0.0, "high": 1.0}


@pytest.fixture
def sweep(spiral):
    """The short spiral with a [sweep]: two controllers, three draws of current and mass."""
    spiral["metrics"] = {name: spiral["metrics"][name] for name in ("rmse_x", "rms_T1")}
    spiral["sweep"] = {"draws": 3, "seed": 7, "vary": {FMU: ["pid", "mfsosmc"], FAST: DIRECTION, MASS: UNIFORM}}
    return spiral


def design_of(**changes):
    spec, problems = read({"draws": 16, "vary": {MASS: UNIFORM, FAST: DIRECTION}, **changes})
    assert problems == []
    return [dict(point.values) for point in points(spec)]


# --- the design -----------------------------------------------------------------------------------------------------


def test_every_controller_meets_the_same_draws(orch, sweep, write):
    runs = orch("sweep", write(sweep), "--dry-run", "--json").json["runs"]
    assert [run["values"][FMU] for run in runs] == ["pid", "mfsosmc"] * 3
    for one, other in zip(runs[::2], runs[1::2], strict=True):
        assert one["draw"] == other["draw"]
        assert {**one["values"], FMU: ""} == {**other["values"], FMU: ""}


def test_a_sweep_whose_metrics_would_stay_empty_says_so_before_it_begins(orch, sweep, write):
    sweep["metrics"]["rmse_x"]["after"] = 7.0
    answer = orch("sweep", write(sweep), "--dry-run")
    assert "note: no sample falls into the window of rmse_x: the run goes from 0 to 0.05 s" in answer.err
    assert "rms_T1" not in answer.err


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_more_draws_begin_with_the_same_ones(method):
    assert design_of(design=method, draws=64)[:16] == design_of(design=method)


@pytest.mark.parametrize("method", ["random", "lhs", "sobol"])
def test_the_order_of_the_keys_does_not_matter(method):
    assert design_of(design=method, vary={FAST: DIRECTION, MASS: UNIFORM}) == design_of(design=method)


def test_skipped_draws_are_those_that_would_have_come_first():
    assert design_of(skip=5, draws=11) == design_of()[5:]


def test_another_seed_gives_other_draws():
    assert not {run[MASS] for run in design_of(seed=1)} & {run[MASS] for run in design_of(seed=2)}


def test_the_draws_of_a_seed_are_these_for_good():
    # Streams are raw bits of PCG64, which numpy promises to keep; a change here makes every sweep another one.
    first = design_of(seed=1)[0]
    assert first[MASS] == 11.05282132698173
    direction = {"x": 0.18384754573744558, "y": -0.08363662417330071}
    assert first[FAST] == pytest.approx(direction, rel=1e-14)  # a libm's cosine


@pytest.mark.parametrize("method", ["random", "lhs", "sobol"])
def test_distributions_are_what_they_say(method):
    vary = {
        "a.uniform": UNIFORM,
        "a.loguniform": {"distribution": "loguniform", "low": 0.01, "high": 100.0},
        "a.normal": {"distribution": "normal", "mean": 1.0, "std": 0.2},
        "a.integer": {"distribution": "integer", "low": 1, "high": 4},
        "a.choice": {"distribution": "choice", "values": ["x", "y"]},
        "a.direction": {"distribution": "direction", "axes": ["x", "y", "z"], "low": 0.5, "high": 1.0},
    }
    runs = design_of(design=method, draws=1024, vary=vary)
    column = {key: [run[key] for run in runs] for key in vary}
    # 1 024 draws of a known distribution: a Kolmogorov-Smirnov test refuses one seed of a thousand.
    assert stats.kstest(column["a.uniform"], stats.uniform(8, 4).cdf).pvalue > 1e-3
    assert stats.kstest(np.log10(column["a.loguniform"]), stats.uniform(-2, 4).cdf).pvalue > 1e-3
    assert stats.kstest(column["a.normal"], stats.norm(1, 0.2).cdf).pvalue > 1e-3
    vectors = np.array([list(value.values()) for value in column["a.direction"]])
    lengths = np.linalg.norm(vectors, axis=1)
    assert stats.kstest(lengths, stats.uniform(0.5, 0.5).cdf).pvalue > 1e-3
    for axis in (vectors / lengths[:, None]).T:  # each coordinate of a direction on the sphere is uniform
        assert stats.kstest(axis, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    assert set(column["a.integer"]) == {1, 2, 3, 4}
    assert stats.binomtest(column["a.choice"].count("x"), 1024).pvalue > 1e-3


def test_a_latin_hypercube_has_one_draw_in_each_cell():
    masses = [run[MASS] for run in design_of(design="lhs", draws=20)]
    assert sorted(int((mass - 8) / 4 * 20) for mass in masses) == list(range(20))


def test_zipped_lists_change_together(orch, sweep, write):
    sweep["sweep"]["vary"]["master.step"] = [1e-3, 5e-4]
    sweep["sweep"]["zip"] = [[FMU, "master.step"]]
    runs = orch("sweep", write(sweep), "--dry-run", "--json", "--set", "sweep.draws=1").json["runs"]
    assert [(run["values"][FMU], run["values"]["master.step"]) for run in runs] == [("pid", 1e-3), ("mfsosmc", 5e-4)]


def test_all_problems_of_a_sweep_are_reported_at_once(orch, sweep, write):
    sweep["sweep"] |= {"draw": 3, "design": "sobl", "zip": [["nobody"]]}
    sweep["sweep"]["vary"] |= {"master.seed": {"distribution": "unifrm"}, MASS: {**UNIFORM, "low": 20.0}, FMU: []}
    for command in ("sweep", "check"):
        answer = orch(command, write(sweep))
        assert answer.code == 2
        assert "5 problems" not in answer.err
        for words in (
            "did you mean 'draws'",
            "did you mean 'sobol'",
            "did you mean 'uniform'",
            "not below high = 12.0",
            "is an empty list",
            "no list 'nobody'",
        ):
            assert words in answer.err


def test_a_run_checks_the_sweep_of_its_experiment_from_python_too(orch, sweep, write):
    sweep["sweep"]["draws"] = "many"
    path = write(sweep)
    sentence = "sweep.draws: is 'many'; give a whole number, at least 1"
    for command in ("run", "check", "sweep"):
        answer = orch(command, path)
        assert answer.code == 2
        assert answer.err.count(sentence) == 1
    with pytest.raises(ExperimentError, match=re.escape(sentence)):
        orchestrator.run(path)
    assert not any(Path(path).parent.glob("results*"))


def test_keys_that_would_overwrite_each_other_are_refused(orch, sweep, write):
    sweep["sweep"]["vary"] |= {f"{FAST}.x": UNIFORM, 'components."vehicle".parameters.m': [9.0, 11.5]}
    answer = orch("check", write(sweep))
    assert answer.code == 2
    assert answer.err.count("keep one of them") == 2
    assert f"lies in '{FAST}', which varies too" in answer.err
    assert f"is '{MASS}' in other words" in answer.err


def test_a_distribution_that_is_not_a_name_is_reported(orch, sweep, write):
    sweep["sweep"]["vary"][MASS] = {"distribution": {"uniform": 1}}
    answer = orch("check", write(sweep))
    assert answer.code == 2
    assert "distribution: is {'uniform': 1}, not a text" in answer.err


def test_problems_of_a_combination_say_where(orch, sweep, write):
    sweep["sweep"]["vary"][FMU] = ["pid", "pidd"]
    sweep["sweep"]["vary"]["components.vehicl.parameters.m"] = UNIFORM
    answer = orch("sweep", write(sweep))
    assert answer.code == 2
    assert "no FMU 'pidd'; did you mean 'pid'" in answer.err
    assert "no component 'vehicl'; did you mean 'vehicle'" in answer.err
    assert not any(Path(write(sweep)).parent.glob("results*"))


def test_what_varies_cannot_be_set_beside_it(orch, sweep, write):
    answer = orch("sweep", write(sweep), "--set", f"{MASS}=3", "--swap", "controller=pid")
    assert answer.code == 2
    assert answer.err.count("varies in the sweep") == 2


# --- runs -----------------------------------------------------------------------------------------------------------


def table_of(folder):
    return next(Path(folder).glob("*/table.csv")).read_bytes()


def test_a_sweep_is_ordinary_runs_and_is_not_repeated(orch, sweep, write, tmp_path):
    path = write(sweep)
    with socket.socket() as other, contextlib.suppress(OSError):
        other.bind(("127.0.0.1", 8787))  # Dask's own port; another sweep may have it
        other.listen()
        answer = orch("sweep", path, "--json")
    assert answer.err == ""
    done = answer.json
    assert (done["completed"], done["failed"], done["missing"], done["reused"]) == (6, 0, 0, 0)
    lines = Path(done["table"]).read_text().splitlines()
    cells = dict(zip(lines[0].split(","), lines[4].split(","), strict=True))
    assert (cells[FMU], cells["draw"], cells["status"]) == ("mfsosmc", "1", "completed")
    drawn = [f"{key}={cells[key]}" for key in cells if key.startswith((FAST, MASS))]
    alone = orch(
        "run",
        path,
        "--json",
        "--results",
        "alone",
        "--swap",
        f"controller={cells[FMU]}",
        *(word for text in drawn for word in ("--set", text)),
    ).json
    assert alone["run_id"] == cells["run_id"]
    assert {name: repr(value) for name, value in alone["metrics"].items()} == {n: cells[n] for n in alone["metrics"]}
    listed = {run["run_id"] for run in orch("list", "--json").json}
    assert listed == {line.split(",")[6] for line in lines[1:]}
    again = orch("sweep", path, "--json").json
    assert (again["sweep_id"], again["reused"]) == (done["sweep_id"], 6)
    assert Path(again["table"]).read_text().splitlines() == lines


def test_the_table_tells_never_no_value_and_no_sample_apart(orch, sweep, write, tmp_path):
    sweep["sweep"] |= {"draws": 1, "vary": {FMU: ["pid", "mfsosmc"]}}
    power = {"of": "mean_power", "signal": "allocation.u", "max_power": 390.0}
    sweep["metrics"] |= {
        "never": {"of": "settling_time", "signal": "vehicle.eta.x", "band": 1e-9},
        "no_value": {**power, "after": 0.05},  # of one sample
        "no_sample": {**power, "after": 7.0},
        "between": {**power, "after": 0.011, "before": 0.019, "every": 0.01},
    }
    path = write(sweep)
    done = orch("sweep", path, "--json").json
    content = Path(done["table"]).read_bytes()
    for row in csv.DictReader(content.decode().splitlines()):
        assert [row[name] for name in ("never", "no_value", "no_sample", "between")] == ["inf", "nan", "", ""]
    frame = pandas.read_csv(done["table"], dtype={"run_id": str})
    kept = orchestrator.open_run(frame["run_id"][0], tmp_path / "results").metrics
    assert (frame["never"] == np.inf).all()
    assert frame["no_value"].isna().all()
    assert frame["rms_T1"][0] == kept["rms_T1"]
    assert kept["never"] == np.inf
    table = read_table(str(tmp_path / "results"), Path(done["folder"]).name)
    assert table.unsampled == {(run, name) for run in "01" for name in ("no_sample", "between")}
    assert [row["rms_T1"] for row in table.rows] == frame["rms_T1"].tolist()
    assert [row["never"] for row in table.rows] == [np.inf, np.inf]
    assert np.isnan([row["no_value"] for row in table.rows]).all()
    # The same from the records alone, and in every other text.
    Path(done["table"]).unlink()
    again = orch("sweep", path, "--json").json
    assert again["reused"] == 2
    assert Path(again["table"]).read_bytes() == content
    note = "no sample falls into the window of between, no_sample in 2 runs"
    assert note in orch("compare", "--sweep", "last", "--json").json["notes"]
    shown = [line.split() for line in orch("show", frame["run_id"][0]).out.splitlines()]
    assert ["never", "never", "s"] in shown
    assert ["no_value", "no", "value", "W"] in shown
    assert ["between", "no", "sample", "in", "its", "window", "W"] in shown


def test_a_record_whose_metrics_are_of_its_rows_is_run_again(orch, sweep, write):
    sweep["sweep"] |= {"draws": 1, "vary": {FMU: ["pid", "mfsosmc"]}}
    path = write(sweep)
    done = orch("sweep", path, "--json").json
    for record in Path(done["folder"]).glob("*.h5"):  # as the first format has them
        with h5py.File(record, "r+") as file:
            del file.attrs["metrics_of"]
            file.attrs["metrics"] = json.dumps({"rmse_x": 0.0, "rms_T1": 0.0})
    content = Path(done["table"]).read_bytes()
    again = orch("sweep", path, "--json").json
    assert again["reused"] == 0
    assert Path(again["table"]).read_bytes() == content


@pytest.mark.parametrize("name", ["run", "draw", "run_id", "status", "error", FMU])
def test_a_metric_named_like_another_column_of_the_table_is_refused(orch, sweep, write, name):
    sweep["metrics"][name] = sweep["metrics"]["rms_T1"]
    answer = orch("sweep", write(sweep), "--dry-run")
    assert answer.code == 2
    assert f"metrics.{name}: is the name of another column" in answer.err


@pytest.mark.slow
def test_only_verified_complete_records_count_as_there(orch, sweep, write, tmp_path):
    path = write(sweep)
    done = orch("sweep", path, "--json").json
    before = table_of("results" and tmp_path / "results")
    records = sorted(Path(done["folder"]).glob("*.h5"))
    with records[0].open("r+b") as file:
        file.truncate(records[0].stat().st_size // 2)
    with h5py.File(records[1], "r+") as file:
        file.attrs["status"] = "failed"
    with h5py.File(records[2], "r+") as file:
        file.attrs["digest"] = "0" * 64
    with h5py.File(records[3], "r+") as file:
        file["vehicle/eta.x"].resize((2,))
    records[4].unlink()
    with h5py.File(records[5]) as file:
        chunk = file["vehicle/eta.x"].id.get_chunk_info(0)
    with records[5].open("r+b") as file:
        file.seek(chunk.byte_offset)
        damaged = bytes([file.read(1)[0] ^ 1])
        file.seek(chunk.byte_offset)
        file.write(damaged)
    Path(done["table"]).unlink()
    again = orch("sweep", path, "--json").json
    assert (again["completed"], again["reused"]) == (6, 0)
    assert table_of(tmp_path / "results") == before


@pytest.mark.slow
def test_what_is_kept_does_not_change_the_numbers(orch, sweep, write, tmp_path):
    sweep["master"]["stop_time"] = 6.0
    sweep["sweep"]["draws"] = 1
    path = write(sweep)
    tables, rows = {}, {}
    for keep in ("full", "decimated", "metrics"):
        done = orch("sweep", path, "--json", "--set", f"sweep.keep={keep}", "--results", keep).json
        tables[keep] = table_of(tmp_path / keep)
        with h5py.File(next(Path(done["folder"]).glob("*.h5"))) as file:
            rows[keep] = len(file["time"])
            assert file.attrs.get("kept", "full") == keep
            assert file["time"][-1:].tolist() in ([], [6.0])
    assert tables["full"] == tables["decimated"] == tables["metrics"]
    assert rows == {"full": 601, "decimated": 301, "metrics": 0}
    again = orch("sweep", path, "--json", "--set", "sweep.keep=full", "--results", "metrics").json
    assert again["reused"] == 0


@pytest.mark.slow
def test_a_run_that_fails_is_recorded_and_stops_no_other(orch, probe, write, tmp_path):
    parameters = {"mode": [1, 0, 9], "at": [0.02, 0.03]}
    table = {
        "master": {"stop_time": 0.05, "step": 0.01},
        "components": {"probe": {"fmu": str(probe), "start": "fmu"}},
        "metrics": {"last": {"of": "final", "signal": "probe.y"}},
        "sweep": {"vary": {f"components.probe.parameters.{n}": v for n, v in parameters.items()}},
    }
    path = write(table)
    answer = orch("sweep", path, "--json")
    assert answer.code == 3
    assert (answer.json["completed"], answer.json["failed"]) == (4, 2)
    text = Path(answer.json["table"]).read_text()
    assert text.count("the probe lost its mind") == 2
    failed = [run for run in orch("list", "--json").json if run["status"] == "failed"]
    assert len(failed) == 2
    fast = orch("sweep", path, "--json", "--fail-fast", "--workers", "1", "--results", "fast")
    assert fast.code == 3
    assert fast.json["status"] == "stopped"
    assert fast.json["missing"] > 0


def long(sweep, write, draws=24):
    """A sweep of `draws` x 2 runs, of about 0.1 s each."""
    sweep["master"]["stop_time"] = 60.0
    sweep["metrics"] = {"rmse_x": sweep["metrics"]["rmse_x"]}
    sweep["sweep"] |= {"draws": draws, "keep": "metrics"}
    return write(sweep)


def begin(path, results, *more, **how):
    return subprocess.Popen(
        [ORCH, "sweep", path, "--results", results, "--json", *more],
        **how,
        cwd=Path(path).parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_records(folder, n):
    until = time.monotonic() + DEADLINE
    while len(list(Path(folder).glob("*/*.h5"))) < n:
        assert time.monotonic() < until, "no record appears"
        time.sleep(0.02)


@pytest.mark.slow
def test_a_sweep_interrupted_and_resumed_ends_with_the_same_table(orch, sweep, write, tmp_path):
    path = long(sweep, write)
    assert orch("sweep", path, "--results", "whole").code == 0
    process = begin(path, "parts")
    wait_for_records(tmp_path / "parts", 7)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    first = json.loads(out)
    assert 0 < first["completed"] < 48
    again = orch("sweep", path, "--results", "parts", "--json").json
    assert again["reused"] == first["completed"]
    assert table_of(tmp_path / "parts") == table_of(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="finds the worker in /proc")
def test_ctrl_c_while_workers_start_ends_a_sweep_in_order(sweep, write):
    path = long(sweep, write)
    process = begin(path, "results", start_new_session=True)
    until = time.monotonic() + DEADLINE
    while not workers_of(process.pid):
        assert time.monotonic() < until, "no worker appears"
        time.sleep(0.005)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the workers, too
    out, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert json.loads(out)["status"] == "interrupted"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="finds the worker in /proc")
def test_a_worker_killed_in_the_middle_loses_nothing(orch, sweep, write, tmp_path):
    path = long(sweep, write)
    assert orch("sweep", path, "--results", "whole").code == 0
    process = begin(path, "killed")
    wait_for_records(tmp_path / "killed", 7)
    os.kill(workers_of(process.pid)[0], signal.SIGKILL)
    out, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 0, err
    assert json.loads(out)["completed"] == 48
    assert table_of(tmp_path / "killed") == table_of(tmp_path / "whole")
    assert not list((tmp_path / "killed").glob("*/.part*"))


def workers_of(pid):
    """The processes that a sweep has started and that run FMUs."""
    children = [int(n) for task in Path(f"/proc/{pid}/task").iterdir() for n in (task / "children").read_text().split()]
    return [n for n in children if "spawn_main" in Path(f"/proc/{n}/cmdline").read_text()]


@pytest.mark.slow
def test_a_second_process_leaves_a_running_sweep_alone(orch, sweep, write, tmp_path):
    path = long(sweep, write)
    process = begin(path, "results")
    wait_for_records(tmp_path / "results", 1)
    answer = orch("sweep", path)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=DEADLINE)
    assert answer.code == 2
    assert f"process {process.pid} runs this sweep" in answer.err


@pytest.mark.slow
def test_a_cluster_started_by_hand_gives_the_same_table(orch, sweep, write, tmp_path):
    path = long(sweep, write, draws=6)
    assert orch("sweep", path, "--results", "here").code == 0
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    dask = [sys.executable, "-m", "dask"]
    commands = [[*dask, "scheduler", "--host", address, "--no-dashboard"]]
    commands += [[*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]] * 2
    log = (tmp_path / "dask.log").open("w")
    processes = [subprocess.Popen(command, cwd=tmp_path, stdout=log, stderr=log) for command in commands]
    try:
        on_folder = orch("sweep", path, "--results", "there", "--scheduler", address, "--json")
        assert on_folder.code == 0, on_folder.err + (tmp_path / "dask.log").read_text()
        by_url = orch("sweep", path, "--results", (tmp_path / "url").as_uri(), "--scheduler", address)
        assert by_url.code == 0, by_url.err
    finally:
        for process in processes:
            process.kill()
            process.wait(DEADLINE)
        log.close()
    assert table_of(tmp_path / "there") == table_of(tmp_path / "url") == table_of(tmp_path / "here")


@pytest.mark.slow
def test_memory_stays_flat_over_runs(python, sweep, write, tmp_path):
    """In the process of a worker: what the first runs take is kept, what follows adds nothing."""
    path = write({**sweep, "sweep": {**sweep["sweep"], "draws": 150}})
    answer = python(f"""
import os
from orchestrator.studies.sweep.design import prepared
from orchestrator.studies.sweep.engine import scheduler, worker
from orchestrator.studies.sweep.engine.storage import Storage

sweep = prepared.prepare({str(path)!r})
job = sweep.job({str(tmp_path / "m")!r}, {{"git_commit": "", "command": "[]"}})
storage = Storage(job.folder)
os.makedirs(job.folder)
scheduler.lay_out(sweep, storage)
points = sweep.points


def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def libraries():
    return len({{line.split()[-1] for line in open("/proc/self/maps") if line.rstrip().endswith(".so")}})


worker.batch("t", job, points[:100], False)
before = resident(), libraries()
worker.batch("t", job, points[100:], False)
print(resident() - before[0], libraries() - before[1])
""")
    grown, libraries = map(float, answer.out.split())
    # 200 runs: an FMU that stayed loaded would add five libraries a run, of 0.1 MB each and more.
    assert libraries == 0
    assert grown < 4.0


# --- statistics -----------------------------------------------------------------------------------------------------

A = [1.0, 2.0, 4.0, 3.0, 5.0, 2.5, 3.5, 1.5]
B = [1.5, 2.75, 5.5, 3.25, 6.25, 3.0, 4.5, 1.5]
C = [3.0, 1.0, 2.0, 5.0, 4.0, 6.0, 0.5, 2.0]


MASSES = range(8, 99)


def known(folder, runs, lists=None, draws=8, **metric):
    """A sweep with known numbers, as files; returns its folder.

    runs: its rows, each {"key": cell, ...} with "draw", "rmse" and what else the table has; lists: as in sweep.json.
    """
    folder = folder / "results" / "known-0123456789"
    folder.mkdir(parents=True)
    lists = lists or [[[FMU], [["a"], ["b"], ["c"]]]]
    keys = [key for key in dict.fromkeys(key for run in runs for key in run) if "." in key]
    description = {
        "format": "orch-sweep",
        "format_version": 1,
        "sweep_id": "0123456789",
        "experiment": "known",
        "title": "Known",
        "experiment_toml": "title = 'Known'",
        "changes": {},
        "draws": draws,
        "skip": 0,
        "design": "random",
        "seed": 1,
        "keep": "metrics",
        "keys": keys,
        "labels": {key: key.removeprefix("components.").replace("parameters.", "") for key in keys},
        "lists": lists,
        "distributions": {},
        "fmus": {},
        "metrics": [{"name": "rmse", "of": "rmse", "unit": "m", "ranked": True, **metric}],
    }
    (folder / "sweep.json").write_text(json.dumps(description))
    with (folder / "table.csv").open("w", newline="") as file:
        names = ["run", "draw", *keys, "run_id", "status", "rmse", "stopped_at", "warnings", "error"]
        table = csv.DictWriter(file, names, restval="")
        table.writeheader()
        table.writerows({"run": i, "run_id": f"r{i}", "status": "completed", **run} for i, run in enumerate(runs))
    return folder


def duel(*columns, key=FMU, names="abcdef", **changes):
    """Rows of contenders with these numbers, draw by draw; in place of a number, a dictionary of facts of its run."""
    runs = []
    for draw, values in enumerate(zip(*columns, strict=True)):
        for name, value in zip(names, values, strict=False):
            facts = value if isinstance(value, dict) else {"rmse": value}
            runs.append({key: name, MASS: MASSES[draw], "draw": draw, **facts})
    return runs


FAILS = {"status": "failed", "error": "it broke"}


@pytest.fixture
def judged(tmp_path):
    """A sweep of three controllers with known numbers, as files."""
    runs = [
        {FMU: name, MASS: 8 + i, "components.vehicle.parameters.d": i * i % 7, "draw": i, "rmse": value}
        for i, row in enumerate(zip(A, B, C, strict=True))
        for name, value in zip("abc", row, strict=True)
    ]
    last = {MASS: 9, "components.vehicle.parameters.d": 9, "draw": 8}
    runs += [{FMU: "a", **last, "rmse": 9.0}, {FMU: "b", **last, **FAILS}, {FMU: "c", **last, **FAILS}]
    return known(tmp_path, runs)


def statistics_of(orch):
    """{contender: its summary}, of the only metric, and all of the JSON"""
    statistics = orch("compare", "--sweep", "last", "--json").json
    return {s["contender"]: s for s in statistics["summaries"]}, statistics


def test_statistics_are_those_of_scipy(orch, judged):
    statistics = orch("compare", "--sweep", "0123", "--json").json
    a, b = statistics["summaries"][:2]
    assert (a["n"], a["mean"], a["median"]) == (9, np.mean([*A, 9.0]), 3.0)
    assert b["std"] == pytest.approx(np.std(B, ddof=1), rel=1e-12)
    assert b["ci95"][0] < b["mean"] < b["ci95"][1]
    pairs = {(p["first"], p["second"]): p for p in statistics["pairs"]}
    numbers = {"a": A, "b": B, "c": C}
    raw = {pair: stats.wilcoxon(np.subtract(*(numbers[n] for n in pair)), zero_method="pratt").pvalue for pair in pairs}
    for pair, p in pairs.items():
        assert p["n"] == 8  # the draw that two controllers did not survive is no pair
        assert p["p"] == pytest.approx(raw[pair], rel=1e-12)
        assert p["difference"] == pytest.approx(np.mean(numbers[pair[0]]) - np.mean(numbers[pair[1]]), rel=1e-12)
    smallest, middle, largest = sorted(raw.values())
    corrected = [p["p_holm"] for p in sorted(statistics["pairs"], key=lambda p: p["p"])]
    holm = np.minimum(1, np.maximum.accumulate([3 * smallest, 2 * middle, largest]))
    assert corrected == pytest.approx(holm, rel=1e-12)
    assert pairs["a", "b"]["effect"] == -1.0  # a is smaller wherever they differ
    assert pairs["a", "b"]["smaller"] == ("a" if pairs["a", "b"]["p_holm"] < 0.05 else None)
    assert statistics["failures"] == {"a": 0, "b": 1, "c": 1}
    assert orch("compare", "--sweep", "last", "--json").json == statistics


def test_a_sweep_is_compared_in_markdown_and_latex(orch, judged, tmp_path):
    assert orch("compare", "--sweep", "known", "-o", "t.md").code == 0
    lines = (tmp_path / "t.md").read_text().splitlines()
    head = "| metric | controller.fmu | n | mean | 95 % interval | std | median | success | common draws |"
    assert lines[0] == head
    assert re.match(r"\| rmse \[m\] \| a \| 9 \| 3\.500 \|", lines[2])
    assert lines[2].endswith("| 9 of 9 (70 .. 100 %) | **2.812 (n 8)** |")  # of the eight draws that all have
    assert re.match(r"\| rmse \[m\] \| c \| 8 \| 2\.938 \|", lines[4])
    assert lines[4].endswith("| 8 of 9 (57 .. 98 %) | 2.938 (n 8) |")
    assert any("left out of the statistics: b 1, c 1" in line for line in lines)
    text = orch("compare", "--sweep", "known", "--format", "latex").out
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 2
    assert r"\textbf{2.812 (n 8)}" in text
    assert orch("compare", "--sweep", "known", "--no-pairs").out.count("first") == 0


def test_a_contender_that_never_settles_in_some_draws_does_not_win_over_one_that_always_does(orch, tmp_path):
    always = [10.0 + 0.1 * k for k in range(20)]
    sometimes = [9.0 if k < 13 else math.inf for k in range(20)]
    known(tmp_path, duel(always, sometimes), of="settling_time", unit="s")
    summaries, statistics = statistics_of(orch)
    a, b = summaries["a"], summaries["b"]
    assert (a["n"], b["n"], b["draws"], b["lost"]) == (20, 13, 20, {"never": 7})
    p, n, z = 13 / 20, 20, stats.norm.ppf(0.975)  # Wilson (1927)
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + (z / (2 * n)) ** 2)
    assert b["success_ci95"] == pytest.approx([(middle + sign * half) / (1 + z * z / n) for sign in (-1, 1)])
    assert b["common"] == {"n": 13, "mean": 9.0}
    assert (a["best"], b["best"]) == (False, False)
    (pair,) = statistics["pairs"]
    assert (pair["n"], pair["numbers"], pair["fewer"]) == (20, 13, "b")
    ranked = [10.0 + 0.1 * k - 9.0 if k < 13 else -1000.0 for k in range(20)]  # any large number has the worst rank
    assert pair["p"] == pytest.approx(stats.wilcoxon(ranked, zero_method="pratt").pvalue, rel=1e-12)
    assert pair["difference"] == pytest.approx(np.mean(always[:13]) - 9.0)
    text = unwrapped(orch("compare", "--sweep", "last").out)
    assert "never, the worst rank in tests and in no mean: rmse of b in 7 of 20 draws" in text
    assert "13 of 20 (43 .. 82 %)" in text


def unwrapped(text):
    return " ".join(text.split())


def test_a_contender_does_not_win_because_its_bad_draws_fail(orch, tmp_path, write):
    """y = gain * a: gain 2 is twice as bad in every common draw, and fails where a > 0.6."""
    a = [k / 20 for k in range(1, 21)]
    known(tmp_path, duel(a, [2 * x if x <= 0.6 else FAILS for x in a]))
    summaries, statistics = statistics_of(orch)
    assert summaries["a"]["best"]
    assert summaries["b"]["lost"] == {"failed": 8}
    assert summaries["a"]["common"] == {"n": 12, "mean": pytest.approx(np.mean(a[:12]))}
    (pair,) = statistics["pairs"]
    assert (pair["n"], pair["effect"], pair["smaller"]) == (12, -1.0, "a")


def test_a_third_contender_that_fails_does_not_take_away_the_draws_in_which_another_is_bad(orch, tmp_path):
    """b is half as bad as a but in two draws, in which it is fifty times as bad, and in which c fails."""
    a = [1.0 + 0.1 * k for k in range(12)]
    b = [0.5 * x if k not in (3, 7) else 50.0 * x for k, x in enumerate(a)]
    folder = known(tmp_path, duel(a, b, [0.8 * x if k not in (3, 7) else FAILS for k, x in enumerate(a)]))
    summaries, _ = statistics_of(orch)
    assert summaries["b"]["common"]["mean"] < summaries["a"]["common"]["mean"]  # on the ten draws of all
    assert not any(s["best"] for s in summaries.values())
    shutil.rmtree(folder)
    known(tmp_path, duel(a, [0.5 * x for x in a], [0.8 * x if k not in (3, 7) else FAILS for k, x in enumerate(a)]))
    summaries, _ = statistics_of(orch)
    assert summaries["b"]["best"]


def test_a_contender_with_fewer_successes_is_not_the_best_though_its_rest_is_better(orch, tmp_path):
    known(tmp_path, duel([2.0 + 0.1 * k for k in range(20)], [1.0 + 0.1 * k if k % 4 else FAILS for k in range(20)]))
    summaries, statistics = statistics_of(orch)
    assert not any(s["best"] for s in summaries.values())
    assert (statistics["pairs"][0]["smaller"], statistics["pairs"][0]["fewer"]) == ("b", "b")
    text = unwrapped(orch("compare", "--sweep", "last").out)
    assert "b §" in text
    assert "§ smaller where it has a number, and has one in fewer draws than the other" in text


@pytest.mark.parametrize(
    ("facts", "why"),
    [
        ({"stopped_at": 2.0}, "ended early"),
        ({"warnings": "other unstable"}, "warned: unstable at this step"),
        ({"warnings": "rows"}, "metrics of its rows, not of every step"),
    ],
)
def test_runs_that_ended_early_or_warned_are_counted_marked_and_never_the_best(orch, tmp_path, facts, why):
    good = [2.0 + 0.1 * k for k in range(20)]
    bad = [{"rmse": 0.1 + 0.01 * k, **(facts if k < 4 else {})} for k in range(20)]
    known(tmp_path, duel(good, bad, [5.0 + k for k in range(20)]))
    summaries, statistics = statistics_of(orch)
    assert summaries["b"]["lost"] == {why: 4}
    assert summaries["b"]["marked"]
    assert summaries["b"]["n"] == 16
    assert not summaries["b"]["best"]
    assert not summaries["a"]["best"] or summaries["a"]["draws"] == summaries["a"]["n"]
    assert statistics["footnotes"] == [f"4 of the 20 draws of b {why}"]
    for form, mark in (("table", "†"), ("markdown", "†"), ("latex", r"\textsuperscript{\dag}")):
        text = unwrapped(orch("compare", "--sweep", "last", "--format", form).out)
        assert f"0.2150{mark}" in text
        assert f"{mark} not in the numbers, and never the best: 4 of the 20 draws of b {why}" in text
    rows = list(csv.DictReader(io.StringIO(orch("compare", "--sweep", "last", "--format", "csv").out.split("\n\n")[0])))
    assert [row["marked"] for row in rows] == ["", f"4 {why}", ""]


def test_a_run_that_switches_loses_only_metrics_that_count_changes(orch, tmp_path):
    runs = duel([2.0, 3.0, 4.0], [{"rmse": 1.0 + k, "warnings": "switching"} for k in range(3)])
    known(tmp_path, runs, of="total_variation")
    assert statistics_of(orch)[0]["b"]["lost"] == {"warned: switches in every step": 3}
    shutil.rmtree(tmp_path / "results")
    known(tmp_path, runs)
    summaries, statistics = statistics_of(orch)
    assert summaries["b"]["best"]
    assert "runs with other warnings: b 3; see orch show" in statistics["notes"]


def test_draws_of_the_same_values_count_once(orch, tmp_path):
    """Thirty draws of a choice of two masses, under two contenders, are four distinct runs."""
    values = {("a", 9): 1.0, ("a", 11): 2.0, ("b", 9): 1.5, ("b", 11): 2.5}
    drawn = [9 if k % 3 else 11 for k in range(30)]
    runs = [{FMU: n, MASS: m, "draw": k, "rmse": values[n, m]} for k, m in enumerate(drawn) for n in "ab"]
    known(tmp_path, runs, draws=30)
    summaries, statistics = statistics_of(orch)
    assert [(s["n"], s["draws"], s["mean"]) for s in summaries.values()] == [(2, 2, 1.5), (2, 2, 2.0)]
    assert statistics["pairs"][0]["n"] == 2
    assert statistics["pairs"][0]["p"] == 0.5
    assert "60 runs are 4 distinct ones: values that were drawn again count once" in statistics["notes"]


def test_a_tie_and_a_single_draw_have_no_best(orch, tmp_path):
    known(tmp_path, duel([1.0, 2.0, 3.0], [3.0, 2.0, 1.0], [4.0, 4.0, 4.0]))
    assert not any(s["best"] for s in statistics_of(orch)[0].values())
    assert "*" not in orch("compare", "--sweep", "last").out
    shutil.rmtree(tmp_path / "results")
    known(tmp_path, duel([1.0], [2.0]))
    assert not any(s["best"] for s in statistics_of(orch)[0].values())


def test_an_interval_of_few_draws_says_that_it_is_not_one_to_lean_on(orch, tmp_path):
    known(tmp_path, duel([float(k * k) for k in range(9)], [float(k) for k in range(9)]))
    assert {s["ci95_reliable"] for s in statistics_of(orch)[0].values()} == {False}
    text = unwrapped(orch("compare", "--sweep", "last").out)
    assert "‡ of fewer than 10 draws: not an interval to lean on" in text
    shutil.rmtree(tmp_path / "results")
    known(tmp_path, duel([float(k * k) for k in range(10)], [float(k) for k in range(10)]))
    assert {s["ci95_reliable"] for s in statistics_of(orch)[0].values()} == {True}
    assert "‡" not in orch("compare", "--sweep", "last").out


@pytest.mark.parametrize("key", ["master.stop_time", "master.step", "metrics.rmse.after"])
def test_contenders_whose_metric_is_not_the_same_have_no_best(orch, tmp_path, key):
    runs = duel([1.0, 2.0, 3.0], [4.0, 5.0, 6.0], key=key, names=("1", "2"))
    known(tmp_path, runs, lists=[[[key], [[1], [2]]]])
    summaries, statistics = statistics_of(orch)
    assert not any(s["best"] for s in summaries.values())
    assert any("not one metric for all, since " in note for note in statistics["notes"])


def test_draws_that_meet_several_lists_are_said_to_be_no_independent_ones(orch, tmp_path):
    step = "components.vehicle.parameters.d"
    runs = [{FMU: n, step: d, MASS: m, "draw": m - 8, "rmse": m * d} for m in (8, 9, 10) for n in "ab" for d in (1, 2)]
    known(tmp_path, runs, lists=[[[FMU], [["a"], ["b"]]], [[step], [[1], [2]]]])
    notes = statistics_of(orch)[1]["notes"]
    assert any(note.startswith("each draw counts once for every value of vehicle.d: runs that share") for note in notes)
    by_step = orch("compare", "--sweep", "last", "--by", "vehicle.d", "--json").json["notes"]
    assert any(note.startswith("each draw counts once for every value of controller.fmu: ") for note in by_step)


def test_figures_count_the_draws_that_have_no_number(orch, tmp_path):
    values = [9.0 + k if k < 13 else math.inf for k in range(20)]
    known(tmp_path, duel([10.0 + k for k in range(20)], values), of="settling_time", unit="s")
    for kind in ("box", "ecdf", "heatmap"):
        over = ("--over", "vehicle.m", "--over", "controller.fmu") if kind == "heatmap" else ()
        answer = orch("compare", "--sweep", "last", "--plot", "f.svg", "--kind", kind, *over)
        assert answer.code == 0, answer.err
        assert "b 13/20" in (tmp_path / "f.svg").read_text(encoding="utf-8")
    analysed = analysis.analyse(read_table(str(tmp_path / "results"), "known-0123456789"))
    (axes,) = figures.figure(analysed, "ecdf").axes
    assert [line.get_ydata().max() for line in axes.lines] == [1.0, 13 / 20]


def test_errors_of_either_sign_are_ranked_by_their_size(orch, tmp_path):
    known(tmp_path, duel([-3.0, 3.0, -3.0, 3.0], [0.1, 0.2, 0.1, 0.2]), of="final")
    summaries, statistics = statistics_of(orch)
    assert (summaries["a"]["mean"], summaries["b"]["mean"]) == (3.0, pytest.approx(0.15))
    assert summaries["b"]["best"]
    assert statistics["pairs"][0]["effect"] == 1.0
    assert "|rmse| [m]" in orch("compare", "--sweep", "last").out


def test_means_of_angles_are_taken_on_the_circle(orch, tmp_path):
    """Headings around north and around south, where numbers jump."""
    north, south = [350.0, 10.0, 20.0, 340.0], [179.0, -179.0, -178.0, 178.0]
    known(tmp_path, duel(north, south), of="heading_difference", unit="deg", ranked=False, turn=360.0)
    summaries, statistics = statistics_of(orch)
    assert summaries["a"]["mean"] == pytest.approx(0.0, abs=1e-12)
    assert abs(summaries["b"]["mean"]) == pytest.approx(180.0)
    assert summaries["a"]["std"] == pytest.approx(np.std([-10, 10, 20, -20], ddof=1))
    low, high = summaries["b"]["ci95"]
    assert low < summaries["b"]["mean"] < high
    assert high - low < 4.0
    assert abs(statistics["pairs"][0]["difference"]) == pytest.approx(180.0, abs=2.0)


@pytest.mark.parametrize("kind", ["box", "ecdf", "parallel", "heatmap"])
def test_figures_of_angles_have_no_seam(tmp_path, kind):
    """Headings within two degrees of south, which are up to 358 apart as numbers, and one run that failed."""
    runs = duel([179.0, -179.0, -178.5, 178.0], [178.5, -178.0, 179.5, FAILS])
    runs = [run | {"components.vehicle.parameters.d": 1} for run in runs]  # the other factor of a heat map
    folder = known(tmp_path, runs, of="heading_difference", unit="deg", ranked=False, turn=360.0)
    judged = analysis.analyse(read_table(str(folder.parent), folder.name))
    for name, n in (("a", 4), ("b", 3)):
        numbers = figures.values(judged, name, judged.columns[0])
        assert len(numbers) == n
        assert np.ptp(numbers) < 4.0
    axes = figures.figure(judged, kind).axes
    if kind == "box":
        low, high = axes[0].get_ylim()
        assert high - low < 5.0
    if kind == "ecdf":
        low, high = axes[0].get_xlim()
        assert high - low < 5.0
    if kind == "parallel":
        low, high = (float(end) for end in axes[0].get_xticklabels()[-1].get_text().partition("\n")[2].split(" .. "))
        assert high - low < 5.0
    if kind == "heatmap":
        cells = [axis.images[0].get_array().compressed() for axis in axes[:2]]
        assert [len(cell) for cell in cells] == [4, 3]  # the failed one has an x
        assert np.ptp(np.concatenate([cell[np.isfinite(cell)] for cell in cells])) < 5.0


def test_which_metrics_are_angles_is_in_the_sweep(orch, sweep, write):
    sweep["metrics"] = {
        "heading": {"of": "final", "signal": "vehicle.eta.psi", "unit": "deg"},
        "error_psi": {"of": "final", "signal": "vehicle.eta.psi", "reference": "reference.eta_d.psi"},
        "depth": {"of": "final", "signal": "vehicle.eta.z"},
    }
    answer = orch("sweep", write(sweep), "--set", "sweep.draws=1", "--json")
    assert answer.code == 0, answer.err
    folder = answer.json["folder"]
    metrics = json.loads((Path(folder) / "sweep.json").read_text())["metrics"]
    assert [(m["name"], m["turn"]) for m in metrics] == [("heading", 360.0), ("error_psi", 0.0), ("depth", 0.0)]


def test_a_sweep_whose_fmu_ends_early_says_so_in_its_table_and_its_report(orch, models, write, tmp_path):
    """The contender that its FMU ends at 0.02 s of 0.05 s has the smaller rms in every draw."""
    path = write(
        {
            "master": {"stop_time": 0.05, "step": 0.01},
            "components": {"one": {"fmu": "trouble", "start": {"u": 0.0}}},
            "metrics": {"rms_y": {"of": "rms", "signal": "one.y"}},
            "sweep": {
                "draws": 6,
                "vary": {
                    "components.one.parameters.kind": [0, 4],
                    "components.one.parameters.at": {"distribution": "uniform", "low": 0.015, "high": 0.025},
                },
            },
        }
    )
    done = orch("sweep", path, "--json")
    assert done.json["marked"] == {"ended early": 6}
    table = Path(done.json["table"])
    content = table.read_bytes()
    rows = list(csv.DictReader(content.decode().splitlines()))
    assert {row["stopped_at"] for row in rows[::2]} == {""}
    assert {float(row["stopped_at"]) for row in rows[1::2]} <= {0.02, 0.03}
    again = orch("sweep", path)
    assert "12: 12 completed, of which 6 ended early, 0 failed, 0 missing" in again.out
    assert table.read_bytes() == content  # of reused records, too
    text = orch("compare", "--sweep", "last").out
    assert "6 of the 6 draws of 4 ended early" in unwrapped(text)
    assert "*" not in text


def test_a_name_that_a_sweep_lacks_is_answered_with_the_nearest_one(orch, judged):
    for arguments, words in [
        (["--sweep", "0123456798"], "did you mean '0123456789'"),
        (["--sweep", "last", "--metrics", "rsme"], "did you mean 'rmse'"),
        (["--sweep", "last", "--by", "controler.fmu"], "did you mean 'controller.fmu'"),
        (["--sweep", "last", "--plot", "x.png", "--kind", "heatmap", "--over", "vehicle.n"], "did you mean 'vehicle."),
    ]:
        answer = orch("compare", *arguments)
        assert answer.code == 2
        assert words in answer.err


@pytest.mark.slow
def test_a_sweep_is_drawn_and_reported(orch, judged, tmp_path):
    for kind in ("box", "violin", "ecdf", "heatmap", "parallel"):
        answer = orch("compare", "--sweep", "last", "--plot", f"{kind}.png", "--kind", kind)
        assert answer.code == 0, answer.err
        assert (tmp_path / f"{kind}.png").read_bytes()[:4] == b"\x89PNG"
    assert orch("report", "--sweep", "last", "-o", "one.html").code == 0
    assert orch("report", "--sweep", "last", "-o", "two.html").code == 0
    text = (tmp_path / "one.html").read_text()
    assert text == (tmp_path / "two.html").read_text()
    assert text.count("<svg") == 4
    assert "<b>2.812 (n 8)</b>" in text
    assert "c 8/9" in text
    assert "left out of the statistics: b 1, c 1" in text
    assert not re.search(r"(src|href)=\"https?:", text)


def test_without_dask_the_message_says_what_to_install(python, sweep, write):
    path = write(sweep)
    answer = python(f"""
import sys
sys.modules["distributed"] = None
from orchestrator.studies.sweep.design import prepared
from orchestrator.studies.sweep.engine import scheduler
from orchestrator.errors import OrchError
sweep = prepared.prepare({str(path)!r})
try:
    scheduler.sweep(sweep, "results")
except OrchError as error:
    print(error)
""")
    assert 'pip install "orch[sweep]"' in answer.out
