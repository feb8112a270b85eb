"""Runs saved and gone on from: bit for bit, or with another component."""

import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

import orchestrator
from experiments import merged, single
from fmu_files import COMPILER, SOURCES, compile_fmu, needs_compiler, paper_fmu

ABLE = ('canGetAndSetFMUstate="true"', 'canSerializeFMUstate="true"')


@pytest.fixture(scope="session")
def buckets(tmp_path_factory):
    """{version of FMI: the FMU of fmus/bucket.c}, and one that saves addresses."""
    if COMPILER is None:
        return {}

    def bucket(version, *flags):
        path = tmp_path_factory.mktemp("bucket") / "bucket.fmu"
        description = (SOURCES / f"bucket{version}.xml").read_text()
        return compile_fmu(path, "bucket.c", description, "-O1", *flags, version=version)

    return {2: bucket(2), 3: bucket(3, "-DFMI3"), "addresses": bucket(2, "-DADDRESSES")}


@pytest.fixture
def pair(buckets):
    """A fast bucket of FMI 2.0 and a slow one of FMI 3.0, each filled by the other."""
    return {
        "master": {"stop_time": 0.04, "step": 0.001},
        "components": {"fast": {"fmu": str(buckets[2])}, "slow": {"fmu": str(buckets[3]), "step": 0.005}},
        "connections": {"fast.u": "slow.y", "slow.u": "fast.y"},
    }


def same_from(branch, whole, time):
    """Every row of the branch is the row of the whole run at that time, from `time` on."""
    rows = whole.time >= time
    assert branch.time[0] == time
    assert branch.signals == whole.signals
    assert branch.time.tolist() == whole.time[rows].tolist()
    for name in whole.signals:
        assert np.array_equal(branch[name], whole[name][rows]), name


def halves(experiment, time, tmp_path, **options):
    """The whole run, and the one from its checkpoint at `time`."""
    whole = orchestrator.run(experiment, results=tmp_path / "results", checkpoint_at=[time], **options)
    checkpoint = whole.path.with_name(f"{whole.path.stem}.at-{time}.checkpoint")
    return whole, checkpoint, orchestrator.run(start_from=checkpoint, results=tmp_path / "results")


@pytest.mark.parametrize("loop", ["compiled", "python"])
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_what_goes_on_from_a_checkpoint_is_the_rest_of_the_run_bit_for_bit(
    shipped, spiral, write, tmp_path, monkeypatch, algorithm, loop
):
    if loop == "python":
        monkeypatch.setenv("ORCH_LOOP", "python")
    changes = {
        "master.algorithm": algorithm,
        "components.controller.step": 0.005,
        "record": {"every": 0.001},
        "components.reference.step": 0.01,
        "master.stop_time": 0.06,
    }
    path = write(merged(spiral, changes))
    whole, _, branch = halves(path, 0.023, tmp_path)  # within a step of the controller and one of the reference
    same_from(branch, whole, 0.023)
    assert branch.run_id != whole.run_id


def test_python_fmus_go_on_bit_for_bit(shipped, spiral, write, tmp_path):
    changes = {"components.vehicle.step": 0.002, "record": {"every": 0.001}, "master.stop_time": 0.03}
    whole, _, branch = halves(write(merged(spiral, changes)), 0.013, tmp_path, packaging="python")
    same_from(branch, whole, 0.013)
    assert branch.file["vehicle"].attrs["packaging"] == "python"


@needs_compiler
@pytest.mark.parametrize("isolation", ["none", "process"])
@pytest.mark.parametrize("signals", [["*"], ["*", "!fast.words"]])
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_fmus_of_both_versions_go_on_within_the_process_and_in_one_of_their_own(
    pair, write, tmp_path, algorithm, signals, isolation
):
    changes = {
        "master.algorithm": algorithm,
        "components.fast.isolation": isolation,
        "record": {"signals": signals},
        "components.slow.isolation": isolation,
    }
    whole, _, branch = halves(write(merged(pair, changes)), 0.013, tmp_path)
    same_from(branch, whole, 0.013)
    assert branch["slow.steps"][-1] == 8  # it has counted on
    assert len(set(whole["fast.y"].tolist())) == len(whole.time)


def test_fmus_of_pythonfmu_go_on_where_they_say_that_they_can(orch, foreign, write, tmp_path):
    able = tmp_path / "able.fmu"
    with zipfile.ZipFile(foreign.north) as archive, zipfile.ZipFile(able, "w") as copy:
        for name in archive.namelist():
            content = archive.read(name)
            if name == "modelDescription.xml":
                for flag in ABLE:
                    content = content.replace(flag.replace("true", "false").encode(), flag.encode())
            copy.writestr(name, content)
    table = merged(single(able), {"components.two": {"fmu": str(able), "start": "fmu", "isolation": "process"}})
    whole, _, branch = halves(write(table), 0.03, tmp_path)
    same_from(branch, whole, 0.03)
    assert branch["one.s"][-1] == "nord 4"
    answer = orch("run", write(single(foreign.north), "not.toml"), "--checkpoint-at", 0.02)
    assert answer.code == 2
    assert "no canGetAndSetFMUstate, no canSerializeFMUstate" in answer.err


def test_a_branch_is_saved_and_gone_on_from_with_its_changes(shipped, spiral, write, tmp_path):
    options = {"set": {"components.controller.parameters.K_p.z": 90.0}, "results": tmp_path / "results"}
    whole = orchestrator.run(write(spiral), checkpoint_at=[0.02], **options)
    first = whole.path.with_name(f"{whole.run_id}.at-0.02.checkpoint")
    branch = orchestrator.run(
        start_from=first,
        swap={"controller": "mfsosmc"},
        results=tmp_path / "results",
        set={"components.reference.step": 0.001},
        checkpoint_at=[0.03],
    )
    second = branch.path.with_name(f"{branch.run_id}.at-0.03.checkpoint")
    same_from(orchestrator.run(start_from=second, results=tmp_path / "results"), branch, 0.03)


@needs_compiler
def test_signals_that_the_first_run_did_not_record_begin_at_the_checkpoint(pair, write, tmp_path):
    whole = orchestrator.run(write(pair), results=tmp_path, checkpoint_at=[0.015])
    checkpoint = whole.path.with_name(f"{whole.run_id}.at-0.015.checkpoint")
    few = orchestrator.run(write(pair), {"record.signals": ["slow.y"]}, results=tmp_path, checkpoint_at=[0.015, 0.012])
    first, second = (few.path.with_name(f"{few.run_id}.at-{t}.checkpoint") for t in ("0.012", "0.015"))
    assert checkpoint.exists()
    branch = orchestrator.run(start_from=second, set={"record.signals": ["*"]}, results=tmp_path)
    same_from(branch, whole, 0.015)
    with pytest.raises(orchestrator.ExperimentError, match="within a step of it, and was made without its began"):
        orchestrator.run(start_from=first, set={"record.signals": ["*"]}, results=tmp_path)


@needs_compiler
def test_a_swapped_component_begins_at_the_checkpoint_with_the_values_of_the_others(pair, buckets, write, tmp_path):
    whole, checkpoint, _ = halves(write(pair), 0.015, tmp_path)
    swapped = orchestrator.run(start_from=checkpoint, swap={"fast": str(buckets[2])}, results=tmp_path)
    assert swapped["fast.began"].tolist() == [0.015] * len(swapped.time)
    assert whole["fast.began"].tolist() == [0.0] * len(whole.time)
    assert swapped["fast.steps"].tolist() == list(range(26))
    assert swapped["slow.steps"][[0, -1]].tolist() == [3, 8]
    assert swapped["slow.y"][0] == whole["slow.y"][15]
    assert swapped.attributes["experiment_resolved"]["from"]["fresh"] == ["fast"]
    slow = orchestrator.run(start_from=checkpoint, swap={"slow": str(buckets[3])}, results=tmp_path)
    assert slow["slow.began"][0] == 0.015
    within = orchestrator.run(write(pair), results=tmp_path, checkpoint_at=[0.013]).path
    with pytest.raises(orchestrator.ExperimentError, match=r"slow.step: 0.013 s is within a step of slow, of 0.005 s"):
        orchestrator.run(
            start_from=within.with_name(f"{within.stem}.at-0.013.checkpoint"),
            swap={"slow": str(buckets[3])},
            results=tmp_path,
        )


def test_another_controller_takes_over_from_a_checkpoint(orch, spiral, write, tmp_path):
    done = orch("run", write(spiral), "--checkpoint-at", 0.03, "--json").json
    [checkpoint] = done["checkpoints"]
    assert Path(checkpoint).name == f"{done['run_id']}.at-0.03.checkpoint"
    branch = orch("run", "--from", checkpoint, "--swap", "controller=mfsosmc", "--set", "master.stop_time=0.08")
    assert branch.code == 0, branch.err
    assert f"from              run {done['run_id']} at t = 0.03 s; reinitialized: controller" in branch.out
    shown = orch("show", "last")
    words = " ".join(shown.out.split())  # it may run over several lines
    assert f"run {done['run_id']} at t = 0.03 s, {checkpoint}; reinitialized: controller" in words
    facts = orch("show", "last", "--json").json
    assert facts["from_time"] == 0.03
    assert facts["from_run"] == done["run_id"]
    assert facts["from_file"] == str(tmp_path / checkpoint)
    assert facts["rows"] == 6
    again = orch("rerun", "last", "--verify")
    assert again.code == 0, again.out + again.err
    repeated = orch("run", "--from", checkpoint, "--swap", "controller=mfsosmc", "--set", "master.stop_time=0.08")
    assert "already in the store" in repeated.out


def test_without_its_checkpoint_a_record_cannot_be_repeated_and_says_so(orch, spiral, write, tmp_path):
    path = write(spiral)
    [checkpoint] = orch("run", path, "--checkpoint-at", 0.03, "--json").json["checkpoints"]
    assert orch("run", path, "--from", checkpoint).code == 0
    run_id = orch("show", "last", "--json").json["run_id"]
    changes = ["--set", "components.vehicle.parameters.eta_0.x=3"]
    other = orch("run", path, *changes, "--checkpoint-at", 0.03, "--json").json
    kept = (tmp_path / checkpoint).read_bytes()
    (tmp_path / checkpoint).write_bytes((tmp_path / other["checkpoints"][0]).read_bytes())
    answer = orch("rerun", run_id, "--verify")
    assert answer.code == 2
    assert "another checkpoint" in answer.err
    (tmp_path / checkpoint).unlink()
    answer = orch("rerun", run_id, "--verify")
    assert answer.code == 2
    assert f"{Path(checkpoint).name}: no such file; did you mean {Path(other['checkpoints'][0]).name!r}?" in answer.err
    (tmp_path / checkpoint).write_bytes(kept)
    assert orch("rerun", run_id, "--verify").code == 0


def test_a_completed_run_is_repeated_only_where_its_checkpoint_is_missing(spiral, write, tmp_path, shipped):
    path, results = write(spiral), tmp_path / "results"
    first = orchestrator.run(path, results=results)
    created = first.attributes["created"], first.path.stat().st_ino
    first.close()
    second = orchestrator.run(path, results=results, checkpoint_at=[0.05])
    assert second.path.stat().st_ino != created[1]
    inode = second.path.stat().st_ino
    checkpoint = second.path.with_name(f"{second.run_id}.at-0.05.checkpoint")
    content = checkpoint.read_bytes()
    second.close()
    assert orchestrator.run(path, results=results, checkpoint_at=[0.05]).path.stat().st_ino == inode
    again = orchestrator.run(path, output=tmp_path / "twice.h5", checkpoint_at=[0.05])
    twice = again.path.with_name("twice.at-0.05.checkpoint")
    ids = [
        orchestrator.run(start_from=c, set={"master.stop_time": 0.06}, results=results).run_id
        for c in (checkpoint, twice)
    ]
    assert ids[0] == ids[1]  # the same state, whenever it was saved
    assert checkpoint.read_bytes() == content
    assert not list(results.rglob(".*"))


def test_all_components_that_cannot_be_saved_are_named_and_nothing_is_started(orch, write, tmp_path):
    paths = [paper_fmu(tmp_path / f"{name}.fmu") for name in ("mute", "dumb")]
    table = merged(single(paths[0]), {"components.two": {"fmu": str(paths[1]), "start": "fmu"}})
    answer = orch("run", write(table), "--checkpoint-at", 0.02, "--checkpoint-at", 0.025)
    assert answer.code == 2
    assert "3 problems" in answer.err
    assert "--checkpoint-at 0.025: is not a multiple of master.step = 0.01 s; try 0.02 or 0.03" in answer.err
    for component, fmu in (("one", paths[0]), ("two", paths[1])):
        words = f"components.{component}: its state cannot be saved: {fmu} declares no canGetAndSetFMUstate, no"
        assert words in answer.err
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("time", "words"),
    [
        ("0", "nothing can be saved before"),
        ("-1", "nothing can be saved before"),
        ("0.0105", "try 0.01 or 0.011"),
        ("0.06", "is after master.stop_time = 0.05 s"),
        ("nan", "is not a time"),
        ("inf", "is not a time"),
    ],
)
def test_a_checkpoint_at_a_time_that_is_none_is_refused(orch, spiral, write, tmp_path, time, words):
    answer = orch("run", write(spiral), "--checkpoint-at", time)
    assert answer.code == 2
    assert words in answer.err
    assert not (tmp_path / "results").exists()


@pytest.fixture
def checkpoint(shipped, spiral, write, tmp_path):
    """One of a short spiral, at 0.03 s."""
    run = orchestrator.run(write(spiral), results=tmp_path / "results", checkpoint_at=[0.03])
    return run.path.with_name(f"{run.run_id}.at-0.03.checkpoint")


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"master.step": 0.002}, "master.step", "is 0.002, and was 0.001"),
        ({"master.algorithm": "jacobi"}, "master.algorithm", "is jacobi, and was gauss-seidel"),
        ({"master.stop_time": 0.03}, "master.stop_time", "already is at t = 0.03 s"),
        ({"components.controller.step": 0.005}, "components.controller.step", "is 5 steps of the master, and was 1"),
        (
            {"components.controller.fmu": "mfsosmc"},
            "components.controller.fmu",
            "--swap controller=FMU reinitializes it",
        ),
        ({"components.controller.parameters.K_p.x": 3.0}, "components.controller.parameters.K_p.x", "is 3.0, and was"),
        ({"components.more.fmu": "ocean_current"}, "components.more", "is not in"),
    ],
)
def test_an_experiment_that_does_not_fit_its_checkpoint_is_refused(
    checkpoint, spiral, write, tmp_path, changes, key, words
):
    with pytest.raises(orchestrator.ExperimentError) as caught:
        orchestrator.run(write(merged(spiral, changes)), start_from=checkpoint, results=tmp_path / "none")
    assert any(problem.key == key and words in problem.sentence for problem in caught.value.problems)
    assert not (tmp_path / "none").exists()


def test_a_connection_that_is_gone_and_a_component_that_is_gone_are_named(checkpoint, spiral, write, tmp_path):
    del spiral["components"]["current"]
    spiral["connections"].pop("vehicle.v_c")
    spiral["components"]["vehicle"]["start"] = "fmu"
    with pytest.raises(orchestrator.ExperimentError) as caught:
        orchestrator.run(write(spiral), start_from=checkpoint, results=tmp_path)
    keys = [problem.key for problem in caught.value.problems]
    assert keys == ["components.current", *(f'connections."vehicle.v_c.{axis}"' for axis in "xyz")]


def rewritten(path, name, change):
    """The archive with one of its files changed."""
    with zipfile.ZipFile(path) as archive:
        files = {n: archive.read(n) for n in archive.namelist()}
    files[name] = change(files[name])
    with zipfile.ZipFile(path, "w") as archive:
        for n, content in files.items():
            archive.writestr(n, content)


def flip(content):
    return content[:-1] + bytes([content[-1] ^ 1])


def test_a_checkpoint_that_is_damaged_or_of_another_format_is_an_error_message(orch, checkpoint, tmp_path):
    content = checkpoint.read_bytes()

    def refused(words):
        with pytest.raises(orchestrator.StoreError, match=words):
            orchestrator.run(start_from=checkpoint, results=tmp_path / "none")
        checkpoint.write_bytes(content)

    checkpoint.write_bytes(content[: len(content) // 2])
    refused("is not a checkpoint of orch")
    checkpoint.write_bytes(content[:300] + bytes([content[300] ^ 4]) + content[301:])
    refused("damaged")
    rewritten(checkpoint, "states/2", flip)
    refused("is damaged: its content does not have the digest that it names")
    rewritten(checkpoint, "values.json", lambda text: text.replace(b'"period": 1', b'"period": 2', 1))
    refused("is damaged: its content does not have the digest that it names")
    rewritten(checkpoint, "checkpoint.json", lambda text: text.replace(b'"format_version": 1', b'"format_version": 9'))
    refused("is a checkpoint of format 9, and this orch reads format 1")
    rewritten(checkpoint, "checkpoint.json", lambda text: json.dumps([1]).encode())
    refused("is not a checkpoint of orch")
    checkpoint.write_text("hello", encoding="utf-8")
    refused("is not a checkpoint of orch")
    assert orch("run", "--from", tmp_path / "nowhere.checkpoint").code == 2


@needs_compiler
def test_a_component_that_does_not_give_its_state_ends_the_run_there(orch, pair, write):
    pair["components"]["slow"]["parameters"] = {"refuses": 1.0}
    answer = orch("run", write(pair), "--checkpoint-at", 0.02)
    assert answer.code == 3
    assert "'slow' failed at t = 0.02 s: its state cannot be saved: fmi3Error" in answer.err
    assert orch("show", "last", "--json").json["rows"] == 21


def test_a_run_that_ends_before_a_checkpoint_says_that_there_is_none(orch, models, write):
    answer = orch("run", write(single("trouble", kind=4)), "--checkpoint-at", 0.01, "--checkpoint-at", 0.04)
    assert answer.code == 0
    assert "at-0.01.checkpoint" in answer.out
    assert "no checkpoint at t = 0.04 s: the run ended before" in answer.err


@needs_compiler
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_state_that_crashes_its_fmu_is_an_error_message(orch, pair, buckets, write):
    pair["components"]["fast"]["fmu"] = str(buckets["addresses"])
    done = orch("run", write(pair), "--checkpoint-at", "0.02", "--json")
    checkpoint = Path(done.json["file"]).with_suffix(".at-0.02.checkpoint")
    answer = orch("run", "--from", checkpoint)
    assert answer.code == 3
    assert "'fast' failed at t = 0.02 s: its FMU crashes (SIGSEGV)" in answer.err
    anew = orch("run", "--from", checkpoint, "--swap", f"fast={buckets['addresses']}")
    assert anew.code == 0, anew.err
