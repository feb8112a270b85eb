"""Finding runs: filters, the cache, what is corrupt or running; telling runs apart; clearing them away."""

import csv
import io
import json
import os
import shutil
import subprocess
import time

import h5py
import pytest
from click.testing import CliRunner

from commands import ORCH, poll
from experiments import merged, single
from orchestrator import open_run
from orchestrator.cli.main import orch as cli
from orchestrator.records.compare.vehicles import vehicles
from orchestrator.records.store import filters
from orchestrator.records.store.index import NAME
from orchestrator.records.store.query import WhereError, parse

RUN = {
    "run_id": "a1",
    "experiment": "spiral",
    "status": "completed",
    "step": 0.001,
    "seed": 1,
    "metrics": {"rmse_x": 0.15, "far": None},
    "components": {
        "controller": {"fmu": "pid", "parameters": {"K_p.z": 90.0, "on": True, "lambda": 2.0, "T[1,2]": 3.0}},
    },
}
OTHER = {"run_id": "b2", "metrics": {"extra": 1.0}}


# --- The language -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "source",
    [
        "metrics.rmse_x < 0.2",
        "metrics.rmse_x >= .15",
        "step == 1e-3",
        "components.controller.fmu == 'pid'",
        'components.controller.fmu == "pid" and metrics.rmse_x < 0.2',
        "components.controller.parameters.K_p.z > 89",
        "status == 'failed' or status == 'completed'",
        "not status == 'failed'",
        "experiment like 'sp*'",
        "components.controller.fmu in ['lyapunov', 'pid']",
        "components.controller.fmu not in ['lyapunov']",
        "run_id not like 'b*'",
        "(step < 1 or step > 2) and not (step > 1)",
        "components.controller.parameters.on",
        "components.controller.parameters.on == true",
        "metrics.rmse_x > -1 and 0 < metrics.rmse_x",
        "'pi' in 'pid'",
        "0 < metrics.rmse_x <= 0.15 < 1",
        "(metrics.rmse_x) < (1) and components.controller.fmu in ('pid', 'lyapunov')",
        "components.controller.parameters.lambda == 2 and components.controller.parameters.T[1,2] == 3",
        "seed == 1 and seed like 1 and -1 < seed",
        "status=='completed'and(step<1)",
    ],
)
def test_an_expression_chooses(source):
    assert parse(source).choose([RUN]) == [RUN]


@pytest.mark.parametrize(
    "source",
    [
        "metrics.rmse_x > 0.2",
        "components.controller.fmu != 'pid'",
        "status == 'failed' or step > 1",
        "metrics.extra > 0",
        "not metrics.extra > 0",
        "metrics.extra == 2 or not metrics.extra == 2",
        "metrics.extra",
    ],
)
def test_an_expression_does_not_choose_a_run_that_lacks_a_name_or_fails_it(source):
    assert RUN not in parse(source).choose([RUN, OTHER])


@pytest.mark.parametrize(
    ("source", "sentence", "column"),
    [
        ("metrics.rmse_x <", "missing before the end", 16),
        ("(step < 1", ") is missing", 9),
        ("step < 1 step", "is not expected here", 9),
        ("step ; 1", "';' belongs to no name", 5),
        ("and step", "missing before and", 0),
        ("step not 3", "not is followed by in or like", 9),
        ("metrics.rmse_y < 1", "no run has 'metrics.rmse_y'; did you mean 'metrics.rmse_x'?", 0),
        ("run_id < 3", "compares a text with a number", 7),
        ("step in 3", "in is followed by a list", 5),
        ("__import__('os')", "is not expected here", 10),
        ("step == 'a", '"\'" belongs to no name', 8),
        ("", "missing before the end", 0),
        ("step < 1 and (step > 2 step)", "follows another; join conditions by and, or, items by a comma", 14),
        ("step < 1)", "')' is not expected here", 8),
        ("run_id in ['a1', 'b2'", "] is missing", 21),
        ("run_id in ['a1' 'b2']", "follows another", 11),
        ("run_id like not 'b*'", "'like' is not expected here", 7),
        ("step + 1 < 2", "belongs to no name", 5),
        ("step - 1 < 2", "'-' is not expected here", 5),
        ("metrics [1] < 2", "'[' is not expected here", 8),
        ("['a1']", "a list is no condition", 0),
        ("metrics < 1", "compares a list with a number", 8),
        ("step == 1j", "is not expected here", 8),
        ("(" * 300 + "step" + ")" * 300, "nested too deeply", 0),
        ("not " * 3000 + "step", "nested too deeply", 0),
    ],
)
def test_a_mistake_is_pointed_at(source, sentence, column):
    with pytest.raises(WhereError) as caught:
        parse(source).choose([RUN])
    first, shown, mark = str(caught.value).split("\n")
    assert sentence in first
    assert shown[2:] == source
    assert mark.index("^") - 2 == column


# --- The list ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def store(orch, write, models, tmp_path):
    """Four runs: two that completed, one that failed, one of another experiment."""
    path = write(single("waves"), "sea.toml")
    table = merged(single("waves"), {"metrics": {"far": {"of": "final", "signal": "one.ramp"}}})
    path = write(table, "sea.toml")
    orch("run", path)
    orch("run", path, "--set", "master.stop_time=0.1")
    orch("run", write(single("moody")), env={**os.environ, "MOOD": "bad"})
    orch("run", write(single("clock"), "time.toml"))
    return tmp_path / "results"


def listed(orch, *arguments):
    answer = orch("list", "--json", *arguments)
    assert answer.code == 0, answer.err
    return answer.json


def test_runs_are_listed_newest_first_in_80_columns(orch, store):
    lines = orch("list").out.splitlines()
    assert lines[0].split() == ["run", "id", "experiment", "status", "created", "real", "time", "factor"]
    assert [line.split()[1] for line in lines[1:]] == ["time", "mine", "sea", "sea"]
    assert all(len(line) <= 80 for line in lines)


def test_filters_and_columns_and_order(orch, store):
    assert {run["experiment"] for run in listed(orch, "--experiment", "s*")} == {"sea"}
    assert [run["status"] for run in listed(orch, "--status", "failed")] == ["failed"]
    assert len(listed(orch, "--where", "metrics.far > 0.15")) == 1
    assert len(listed(orch, "--since", "1h")) == len(listed(orch, "--before", "2999-01-01")) == 4
    assert listed(orch, "--since", "2999-01-01") == listed(orch, "--before", "1w") == []
    assert [run["metrics"]["far"] for run in listed(orch, "--sort", "metrics.far")[:2]] == pytest.approx([0.1, 0.2])
    assert len(listed(orch, "--limit", "3")) == 3
    text = orch("list", "--csv", "--columns", "metrics.far", "--experiment", "sea").out
    assert [float(row["metrics.far"]) for row in csv.DictReader(io.StringIO(text))] == pytest.approx([0.2, 0.1])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--status", "complete"), "did you mean 'completed'"),
        (("--since", "yesterday"), "is no time"),
        (("--sort", "metrics.near"), "--sort: no run has 'metrics.near'; did you mean"),
        (("--columns", "metrics.fat"), "did you mean 'metrics.far'"),
    ],
)
def test_a_filter_that_means_nothing_is_reported(orch, store, arguments, words):
    answer = orch("list", *arguments)
    assert (answer.code, words in answer.err) == (2, True), answer.err


def test_an_empty_store_has_no_runs(orch):
    answer = orch("list")
    assert (answer.code, answer.out, answer.err) == (0, "", "no run in results\n")


def test_the_cache_is_used_and_deleted_and_damaged_without_harm(orch, store):
    first = listed(orch)
    assert (store / NAME).exists()
    assert listed(orch) == first
    (store / NAME).write_bytes(b"no database" * 100)
    assert listed(orch) == first
    (store / NAME).unlink()
    assert listed(orch) == first


def test_runs_that_ended_early_or_warned_are_marked_in_the_list(orch, store, tmp_path):
    first, second = (run for run in listed(orch) if run["experiment"] == "sea")
    assert (first["marks"], first["metrics_never"]) == ("", [])
    with h5py.File(tmp_path / first["file"], "r+") as file:
        file.attrs["stopped_at"] = 0.04
        file.attrs["metrics"], file.attrs["metrics_never"] = json.dumps({"far": None}), json.dumps(["far"])
    with h5py.File(tmp_path / second["file"], "r+") as file:
        file.attrs["warnings"], file.attrs["warning_kinds"] = json.dumps(["it is wrong"]), json.dumps(["unstable"])
    assert [run["run_id"] for run in listed(orch, "--where", "metrics.far > 5")] == [first["run_id"]]
    last = listed(orch, "--experiment", "sea", "--sort", "metrics.far", "--reverse")[0]
    assert last["run_id"] == first["run_id"]
    text = orch("list", "--experiment", "sea", "--columns", "metrics.far").out
    assert text.count("completed†") == 2
    lines = {line.split()[0]: line.split() for line in text.splitlines()}
    assert lines[first["run_id"]][-1] == "never†"
    assert lines[second["run_id"]][-1] == "0.1†"
    words = "† not to be compared: 1 ended early, 1 warned: unstable at this step; --columns marks says which"
    assert words in " ".join(text.split())
    rows = csv.DictReader(io.StringIO(orch("list", "--csv", "--columns", "metrics.far", "--experiment", "sea").out))
    found = {row["run_id"]: (row["marks"], row["metrics.far"]) for row in rows}
    assert found[first["run_id"]] == ("ended early at 0.04 s", "inf")
    assert found[second["run_id"]][0] == "warned: unstable at this step"
    assert len(listed(orch, "--where", "marks == ''")) == 2
    assert "†" not in orch("list", "--experiment", "time").out


def test_a_record_that_changes_or_goes_is_seen(orch, store, tmp_path):
    gone, changed, *_ = listed(orch)
    (tmp_path / gone["file"]).unlink()
    with h5py.File(tmp_path / changed["file"], "r+") as file:
        file.attrs["metrics"] = json.dumps({"far": 7.0, "new": 1.0})
    found = listed(orch)
    assert len(found) == 3
    assert {run["run_id"]: run["metrics"] for run in found}[changed["run_id"]] == {"far": 7.0, "new": 1.0}


def test_a_corrupt_file_is_listed_and_hides_nothing(orch, store, tmp_path):
    os.truncate(tmp_path / listed(orch)[0]["file"], 600)
    (store / "sea" / "junk.h5").write_bytes(b"junk")
    found = {run["run_id"]: run for run in listed(orch)}
    assert len(found) == 5
    assert found["junk"]["status"] == "corrupt"
    assert found["junk"]["error"]
    assert [run["status"] for run in found.values()].count("corrupt") == 2


def test_a_store_that_cannot_be_written_is_listed(orch, store):
    if os.geteuid() == 0:
        (store / NAME).mkdir()  # root writes anywhere, but not a database over a folder
    else:
        store.chmod(0o555)
    try:
        assert len(listed(orch)) == 4
    finally:
        store.chmod(0o755)


def test_running_and_killed_runs_are_distinguished(orch, store, write, models, tmp_path):
    with subprocess.Popen([ORCH, "run", write(single("moody", pause=3.0), "slow.toml"), "-q"], cwd=tmp_path) as process:
        poll(lambda: any(path.stat().st_size for path in store.glob("slow/*.h5")), process)
        time.sleep(0.3)
        assert [run["status"] for run in listed(orch, "--experiment", "slow")] == ["running"]
        process.kill()
    assert [run["status"] for run in listed(orch, "--experiment", "slow")] == ["interrupted (killed)"]
    assert [run["status"] for run in listed(orch, "--status", "interrupted*")] == ["interrupted (killed)"]


@pytest.mark.slow
def test_ten_thousand_runs_are_listed_in_a_moment(orch, store, tmp_path):
    with h5py.File(tmp_path / listed(orch, "--experiment", "sea")[0]["file"], "r") as file:
        attributes = {name: value for name, value in file.attrs.items() if name != "model_descriptions"}
    many = tmp_path / "many"
    (many / "sea").mkdir(parents=True)
    for i in range(10_000):
        with h5py.File(many / "sea" / f"{i:010x}.h5", "w") as file:
            file.attrs.update({**attributes, "run_id": f"{i:010x}", "metrics": json.dumps({"far": i / 1e4})})
    took = []
    for _ in range(3):
        began = time.monotonic()
        found = listed(orch, "--results", many, "--where", "metrics.far < 0.0005", "--limit", "10")
        took.append(time.monotonic() - began)
        assert len(found) == 5
    # 7.5 s and 0.8 s where nothing else runs.
    assert took[0] < 60
    assert min(took[1:]) < 4


# --- What differs -----------------------------------------------------------------------------------------------------


def test_diff_shows_only_what_differs(orch, store):
    b, a = (run["run_id"] for run in listed(orch, "--experiment", "sea"))
    answer = orch("diff", a, b)
    assert answer.code == 1
    rows = [line.split() for line in answer.out.splitlines()[1:]]
    assert ["master.stop_time", "0.05", "0.1", "+1"] in rows
    assert {row[0] for row in rows} == {"master.stop_time", "metrics.far"}
    same = orch("diff", a, a)
    assert (same.code, same.out, same.err) == (0, "", "nothing differs but what is read from clocks\n")


def test_diff_of_another_controller_names_it(orch, write, spiral, tmp_path):
    path = write(spiral)
    first = orch("run", path, "--json").json["run_id"]
    second = orch("run", path, "--swap", "controller=nstsmc", "--json").json["run_id"]
    found = {change["name"]: change for change in orch("diff", first, second, "--json").json}
    swapped = found["components.controller.fmu"]
    assert (swapped["before"], swapped["after"], swapped["decides"]) == ("pid", "nstsmc", True)
    assert not found["metrics.rmse_x"]["decides"]
    assert not any(name.startswith(("components.vehicle", "connections")) for name in found)


# --- Clearing away ----------------------------------------------------------------------------------------------------


def test_prune_says_what_would_go_and_deletes_when_asked(orch, store):
    dry = orch("prune", "--status", "failed")
    assert (dry.code, "1 record, " in dry.err, "would be deleted" in dry.err) == (0, True, True)
    assert len(listed(orch)) == 4
    assert orch("prune", "--status", "failed", "--yes").code == 0
    assert [run["status"] for run in listed(orch)] == ["completed"] * 3


def test_prune_needs_a_filter_and_leaves_runs_that_go_on(orch, store, write, models, tmp_path):
    assert orch("prune", "--yes").code == 2
    path = write(single("moody", pause=0.3, stop_time=5.0), "slow.toml")
    with subprocess.Popen([ORCH, "run", path, "-q"], cwd=tmp_path) as process:
        poll(lambda: any(path.stat().st_size for path in store.glob("slow/*.h5")), process)
        time.sleep(0.3)
        orch("prune", "--since", "1w", "--yes")
        assert [run["status"] for run in listed(orch)] == ["running"]
        process.kill()
    shutil.rmtree(store / "slow")
    assert listed(orch) == []


def replace(path, content, like):
    """Put other content into a file, of the size and time of the former."""
    path.write_bytes(content + bytes(like.st_size - len(content)))
    os.utime(path, ns=(like.st_mtime_ns, like.st_mtime_ns))


def test_prune_believes_the_file_and_not_what_was_listed_of_it(orch, store, tmp_path):
    failed = tmp_path / listed(orch, "--status", "failed")[0]["file"]
    good = tmp_path / listed(orch, "--experiment", "sea")[0]["file"]
    with failed.open("ab") as file:  # room for the other
        file.write(bytes(good.stat().st_size))
    assert len(listed(orch, "--status", "failed")) == 1
    replace(failed, good.read_bytes(), failed.stat())
    answer = orch("prune", "--status", "failed", "--yes")
    assert (answer.code, failed.exists()) == (2, True)
    assert f"{failed.relative_to(tmp_path)} is kept: it has changed since it was listed, and is completed" in answer.err
    assert "0 records, 0.0 MB: deleted" in answer.err


def test_prune_leaves_a_record_that_a_process_has_begun_to_write(orch, store, tmp_path):
    failed = tmp_path / listed(orch, "--status", "failed")[0]["file"]
    with h5py.File(failed, "r+"):
        answer = orch("prune", "--status", "failed", "--yes")
    assert (answer.code, failed.exists()) == (2, True)
    assert "is kept: a process writes it" in answer.err


def test_prune_leaves_what_has_replaced_a_record_since_it_was_listed(orch, store, tmp_path, monkeypatch):
    failed = tmp_path / listed(orch, "--status", "failed")[0]["file"]
    good = tmp_path / listed(orch, "--experiment", "sea")[0]["file"]
    choose = filters.choose

    def slowly(*arguments):
        found = choose(*arguments)
        shutil.copy(good, tmp_path / "new.h5")
        os.replace(tmp_path / "new.h5", failed)
        return found

    monkeypatch.setattr(filters, "choose", slowly)
    monkeypatch.chdir(tmp_path)
    answer = CliRunner().invoke(cli, ["prune", "--status", "failed", "--yes"])
    assert "completed now" in str(answer.exception)
    assert failed.read_bytes() == good.read_bytes()


def test_prune_deletes_the_others_when_one_cannot_go(orch, store, tmp_path):
    one, *others = [tmp_path / run["file"] for run in listed(orch)]
    with h5py.File(one, "r+"):
        assert orch("prune", "--since", "1d", "--yes").code == 2
    assert one.exists()
    assert not any(path.exists() for path in others)


# --- A store that others change ---------------------------------------------------------------------------------------


def test_a_record_that_vanishes_hides_no_other(orch, store):
    """What a vanished file does at the worst moment, a link that leads nowhere does at every moment."""
    for folder in ("mine", "sea", "time"):
        (store / folder / "0.h5").symlink_to("nowhere.h5")
        (store / folder / "loop.h5").symlink_to("loop.h5")
    (store / "away").symlink_to("nowhere")
    (store / "file").write_text("no folder")
    assert len(listed(orch)) == 4
    assert orch("show", "last").code == 0


def test_a_store_that_is_no_folder_has_no_runs_and_a_forbidden_one_says_so(orch, store, tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    answer = orch("list", "--results", "loop")
    assert (answer.code, answer.err.splitlines()[0][:24]) == (2, "loop cannot be read: Too")
    assert orch("list", "--results", "sea.toml").err == "no run in sea.toml\n"


# --- What is connected to what ----------------------------------------------------------------------------------------


AXES = ("x", "y", "z", "phi", "theta", "psi")


@pytest.fixture
def wired(orch, write, spiral):
    """wired(axes of the vehicle's eta that go into the controller's, in order) -> run id."""

    def record(*sources):
        connections = {k: v for k, v in spiral["connections"].items() if k != "controller.eta"}
        pairs = zip(AXES, sources, strict=True)
        connections |= {f"controller.eta.{axis}": f"vehicle.eta.{source}" for axis, source in pairs if source}
        start = {"controller.eta." + axis: 0.0 for axis, source in zip(AXES, sources, strict=True) if not source}
        table = merged(spiral, {"connections": connections})
        table["components"]["controller"]["start"] = {k.removeprefix("controller."): v for k, v in start.items()}
        answer = orch("run", write(table), "--json")
        assert answer.code == 0, answer.err
        return answer.json["run_id"]

    return record


def test_diff_sees_axes_that_are_crossed_and_axes_that_are_missing(orch, wired):
    straight = wired(*AXES)
    for others, names in (
        (("x", "y", "z", "theta", "phi", "psi"), {"phi", "theta"}),
        (("x", "y", "z", "phi", "theta", None), {"psi"}),
    ):
        answer = orch("diff", straight, wired(*others), "--json")
        assert answer.code == 1
        found = {c["name"]: (c["before"], c["after"]) for c in answer.json if c["name"].startswith("connections")}
        assert names <= {name.rpartition(".")[2] for name in found}
        assert found["connections.controller.eta." + min(names)][0] == "vehicle.eta." + min(names)


def test_a_scaled_connection_is_compared_drawn_and_reported(orch, write, spiral, tmp_path):
    """Its vehicle is driven by what arrives, not by what was sent."""
    straight = orch("run", write(spiral), "--json").json["run_id"]
    table = merged(spiral, {"connections.vehicle.u": {"from": "allocation.u", "gain": 0.5}})
    scaled = orch("run", write(table), "--json").json["file"]
    answer = orch("diff", straight, scaled, "--json")
    (change,) = (c for c in answer.json if c["name"].startswith("connections"))
    assert (change["before"], change["after"]) == ("allocation.u", "0.5 * allocation.u")
    for command in (("plot", scaled, "-o", "a.svg"), ("report", scaled, "-o", "a.html")):
        assert orch(*command).code == 0
    with open_run(tmp_path / scaled) as run:
        (vehicle,) = vehicles(run)
        assert vehicle.u["T3"].tolist() == (0.5 * run["allocation.u.T3"]).tolist()


def test_the_exit_code_of_diff_is_that_of_the_digests(orch, store, tmp_path):
    path = tmp_path / listed(orch, "--experiment", "time")[0]["file"]
    other = shutil.copy(path, tmp_path / "other.h5")
    with h5py.File(other, "r+") as file:
        file.attrs["digest"] = "0" * 64
    answer = orch("diff", path, other)
    assert (answer.code, answer.out) == (1, "")
    assert answer.err == "the digests differ: something that decides the numbers is not the same, and is not listed\n"
    with h5py.File(other, "r+") as file:  # the same FMU by another name
        resolved = json.loads(file.attrs["experiment_resolved"])
        resolved["components"][0]["fmu"] = "copy.fmu"
        file.attrs.update({"experiment_resolved": json.dumps(resolved), "digest": h5py.File(path).attrs["digest"]})
    answer = orch("diff", path, other, "--json")
    assert (answer.code, [(c["after"], c["decides"]) for c in answer.json]) == (0, [("copy.fmu", False)])
