"""orch compare: metrics side by side, what differs, which is best."""

import csv
import io
import json
import os
import shutil
import subprocess
import time

import h5py
import pytest

import orchestrator
from commands import ORCH
from experiments import merged, single, toml
from orchestrator.metrics import METRICS, smaller_is_better
from orchestrator.views.tables import latex

METRICS_OF_WAVES = {
    "far_x": {"of": "max_abs", "signal": "one.eta.x"},
    "far_y": {"of": "max_abs", "signal": "one.eta.y", "unit": "cm"},
    "heading": {"of": "rms", "signal": "one.eta.psi", "unit": "deg"},
    "end_z": {"of": "final", "signal": "one.eta.z"},
    "never": {"of": "settling_time", "signal": "one.ramp", "band": 0.01},
}
RUNS = {  # name: place, heading
    "near": ([1.0, 3.0, -5.0], 0.2),
    "far": ([2.0, 3.0, -6.0], 0.1),
    "farther": ([-3.0, 3.00001, -7.0], 0.3),
}


def table(place=(1.0, 3.0, -5.0), heading=0.2):
    experiment = single("waves", place=list(place), heading=heading)
    return {"title": "Waves & co.", **experiment, "metrics": METRICS_OF_WAVES}


def run(folder, experiment, name="waves.toml"):
    path = folder / name
    path.write_text("\n".join(f"{key} = {toml(value)}" for key, value in experiment.items()), encoding="utf-8")
    with orchestrator.run(path, results=folder / "results") as record:
        return record.run_id, record.path


@pytest.fixture(scope="module")
def store(models, tmp_path_factory):
    """Three completed runs of one experiment; `store.ids`: {name: run id}."""
    folder = tmp_path_factory.mktemp("compare")
    ids = {name: run(folder, table(*parameters))[0] for name, parameters in RUNS.items()}
    return type("Store", (), {"folder": folder, "ids": ids})


@pytest.fixture
def compare(orch, store):
    """compare("near", "far", ...): the names of RUNS stand for their ids."""
    return lambda *arguments, **options: orch(
        "compare", *(store.ids.get(a, a) for a in arguments), cwd=store.folder, **options
    )


def rows(text):
    """{first word of a line: its other words}"""
    return {words[0]: words[1:] for words in map(str.split, text.splitlines()) if words}


def changed(record, target, attributes):
    """A copy of a record with other attributes."""
    shutil.copy(record, target)
    with h5py.File(target, "r+") as file:
        file.attrs.update({k: json.dumps(v) if isinstance(v, (dict, list)) else v for k, v in attributes.items()})
    return target


def test_the_smallest_error_is_marked_and_what_has_no_direction_is_not(compare, store):
    answer = compare("near", "far", "--metrics", "far_x", "--metrics", "end_z")
    assert answer.code == 0, answer.err
    found = rows(answer.out)
    assert found["run"] == ["what", "differs", "far_x", "end_z"]
    assert found[store.ids["near"]][-2:] == ["1.000*", "-5.000"]
    assert found[store.ids["far"]][-2:] == ["2.000", "-6.000"]
    assert "[m]" in answer.out.splitlines()[1]


def test_more_metrics_than_runs_stand_below_each_other(compare, store):
    found = rows(compare("near", "far").out)
    assert found["metric"] == ["unit", store.ids["near"], store.ids["far"]]
    assert found["far_x"] == ["m", "1.000*", "2.000"]
    assert found["far_y"] == ["cm", "300.0", "300.0"]  # equal: none is best
    assert found["heading"] == ["deg", "11.46", "5.730*"]
    assert found["never"] == ["s", "never", "never"]


def test_what_never_happens_is_told_from_what_has_no_number(compare, store, tmp_path):
    near = store.folder / "results" / "waves" / f"{store.ids['near']}.h5"
    empty = changed(near, tmp_path / "empty.h5", {"metrics_never": [], "run_id": "empty"})
    answer = compare("far", empty, "--metrics", "never")
    found = rows(answer.out)
    assert (found[store.ids["far"]][-1], found["empty"][-1]) == ("never", "-")
    assert "- no number: no sample in its window, or no value" in answer.out
    lines = compare("far", empty, "--metrics", "never", "--format", "csv").out.splitlines()
    assert [line.split(",")[-2] for line in lines] == ["never [s]", "inf", ""]


def test_the_best_is_judged_at_the_digits_that_are_shown(compare):
    found = compare("near", "far", "farther", "--metrics", "far_y", "--json").json
    assert found["runs"][2]["metrics"]["far_y"] == pytest.approx(300.001)
    assert found["metrics"][0]["best"] == []  # 300.0 three times
    best = compare("near", "farther", "--metrics", "far_x", "--json").json["metrics"][0]
    assert best["better"] == "smaller"


def test_json_holds_every_number_in_full_and_null_for_none(compare, store):
    answer = compare("near", "far", "--json")
    first, second = answer.json["runs"]
    assert (first["run_id"], second["run_id"]) == (store.ids["near"], store.ids["far"])
    assert first["status"] == "completed"
    assert first["metrics"]["far_x"] == 1.0
    assert first["metrics"]["never"] is None
    columns = {column["name"]: column for column in answer.json["metrics"]}
    assert columns["far_x"]["best"] == [store.ids["near"]]
    assert columns["end_z"]["better"] is None
    assert columns["end_z"]["best"] == []
    assert columns["heading"]["unit"] == "deg"


def test_runs_are_found_by_glob_prefix_file_and_last_each_once(compare, store):
    ids = store.ids
    by_file = compare("results/wav*/*.h5", "--json").json["runs"]
    assert {e["run_id"] for e in by_file} == set(ids.values())
    assert len(by_file) == 3
    by_id = compare("waves/*", "far", "last", "--json").json["runs"]
    assert len(by_id) == 3
    mixed = compare(ids["near"][:8], f"results/waves/{ids['far']}.h5", "--json").json["runs"]
    assert [e["run_id"] for e in mixed] == [ids["near"], ids["far"]]
    answer = compare("nothing*")
    assert answer.code == 2
    assert "no record fits 'nothing*', neither a .h5 file here nor a run id in results" in answer.err


def test_a_glob_that_fits_no_metric_names_the_nearest(compare):
    answer = compare("near", "far", "--metrics", "farx")
    assert answer.code == 2
    assert "no metric of these runs fits 'farx'; did you mean 'far_x'?" in answer.err


def test_runs_are_distinguished_by_parameters_models_and_experiments(compare, store, tmp_path):
    labels = [e["label"] for e in compare("near", "far", "--json").json["runs"]]
    assert labels == ["one.heading = 0.2, one.place = (1, 3, -5)", "one.heading = 0.1, one.place = (2, 3, -6)"]
    clock = merged(single("clock"), {"metrics": {"late": {"of": "max_abs", "signal": "one.y"}}})
    slower = merged(clock, {"master.stop_time": 0.06})
    paths = [run(tmp_path, *what)[1] for what in [(clock,), (slower,), (table(),), (table(heading=0.5),)]]
    labels = [e["label"] for e in compare(*paths, "--json").json["runs"]]
    assert labels == [
        "clock, stop_time = 0.05 s",
        "clock, stop_time = 0.06 s",
        "waves, stop_time = 0.05 s, one.heading = 0.2",
        "waves, stop_time = 0.05 s, one.heading = 0.5",
    ]
    _, other = run(tmp_path, clock, "other.toml")
    found = compare(paths[0], paths[2], other, "--json").json["runs"]
    assert [e["label"] for e in found] == ["waves, clock", "waves, waves", "other"]
    assert [e["name"] for e in found] == [str(paths[0]), paths[2].stem, str(other)]  # two runs of one id


def test_a_run_without_a_metric_has_an_empty_cell(compare, store, tmp_path):
    other, _ = run(tmp_path, merged(table(), {"metrics": {"late": {"of": "final", "signal": "one.ramp"}}}))
    near = store.folder / "results" / "waves" / f"{store.ids['near']}.h5"
    answer = compare(near, tmp_path / "results" / "waves" / f"{other}.h5", "--format", "csv", "--metrics", "*a*")
    first, second = csv.DictReader(io.StringIO(answer.out))
    assert (first["late [m]"], second["late [m]"]) == ("", "0.1")
    assert (first["far_x [m]"], second["far_x [m]"]) == ("1.0", "")


@pytest.mark.parametrize("status", ["failed", "interrupted", "running"])
def test_a_run_that_did_not_complete_is_shown_and_never_the_best(compare, store, tmp_path, status):
    near = store.folder / "results" / "waves" / f"{store.ids['near']}.h5"
    broken = changed(near, tmp_path / "broken.h5", {"status": status, "metrics": {"far_x": 0.001}, "run_id": "broken"})
    answer = compare("far", broken, "--metrics", "far_x")
    found = rows(answer.out)
    assert found[store.ids["far"]][-1] == "2.000*"
    assert found["broken"][-1] == "0.001000†"
    assert f"({'interrupted (killed)' if status == 'running' else status})" in answer.out


def trouble(kind, stop_time=0.05, step=0.01):
    """y is the time; kind 4: the FMU ends the run at 0.02 s."""
    experiment = merged(single("trouble", stop_time, step, kind=kind), {"components.one.start": {"u": 0.0}})
    return {**experiment, "metrics": {"rms_y": {"of": "rms", "signal": "one.y"}}}


@pytest.fixture
def early(models, tmp_path):
    """A run that its FMU ended at 0.02 s of 0.05 s, and one that went on: the shorter one has the smaller rms."""
    return run(tmp_path, trouble(4), "a.toml"), run(tmp_path, trouble(0), "a.toml")


def test_a_run_that_an_fmu_ended_early_is_marked_and_never_the_best(compare, early):
    (short, short_file), (whole, whole_file) = early
    answer = compare(short_file, whole_file)
    found = rows(answer.out)
    assert found[short][-1] == "0.01291†"
    assert found[whole][-1] == "0.03028*"
    assert "(ended early at 0.02 s)" in " ".join(answer.out.split())
    assert f"† not compared: {short} ended early at 0.02 s" in answer.out
    report = compare(short_file, whole_file, "--json").json
    assert report["runs"][0]["marks"] == ["ended early at 0.02 s"]
    assert report["runs"][0]["stopped_at"] == pytest.approx(0.02)
    assert report["runs"][1]["marks"] == []
    assert (report["metrics"][0]["best"], report["metrics"][0]["marked"]) == ([whole], [short])


def test_an_end_at_the_stop_time_is_no_early_one(compare, store, tmp_path):
    near = store.folder / "results" / "waves" / f"{store.ids['near']}.h5"
    for at, marks in ((0.05, []), (0.04, ["ended early at 0.04 s"])):
        ended = changed(near, tmp_path / "ended.h5", {"stopped_at": at})
        assert compare(ended, "--json").json["runs"][0]["marks"] == marks


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"warnings": ["it is wrong"], "warning_kinds": ["unstable"]}, "warned: unstable at this step"),
        ({"format_version": 1, "metrics_of": "rows"}, "metrics of its rows, not of every step"),
    ],
)
def test_a_run_whose_numbers_are_wrong_is_marked_in_every_format(compare, store, tmp_path, attributes, words):
    near = store.folder / "results" / "waves" / f"{store.ids['near']}.h5"
    wrong = changed(near, tmp_path / "wrong.h5", {**attributes, "run_id": "wrong"})
    what = ("far", wrong, "--metrics", "far_x")
    table = compare(*what).out
    assert rows(table)["wrong"][-1] == "1.000†"
    assert f"† not compared: wrong {words}" in " ".join(table.split())
    text = compare(*what, "--format", "markdown").out
    assert "| 1.000† |" in text
    assert f"wrong {words}" in text
    assert text.count("**2.000**") == 1
    text = compare(*what, "--format", "latex").out
    assert r"1.000 {\textsuperscript{\dag}}" in text
    assert words in next(line for line in text.splitlines() if r"\caption" in line)
    line = list(csv.DictReader(io.StringIO(compare(*what, "--format", "csv").out)))[1]
    assert (line["far_x [m]"], line["marks"]) == ("1.0", words)
    assert compare(*what, "--json").json["metrics"][0]["best"] == [store.ids["far"]]


def test_a_marked_run_that_is_not_like_the_others_takes_no_best_from_them(compare, store, tmp_path):
    experiment = merged(table((0.5, 0.0, 0.0)), {"master.stop_time": 0.1})
    experiment["metrics"] = {"far_x": METRICS_OF_WAVES["far_x"]}
    _, path = run(tmp_path, experiment)
    wrong = changed(path, tmp_path / "wrong.h5", {"warnings": ["it is wrong"], "warning_kinds": ["unstable"]})
    answer = compare("near", "far", wrong, "--metrics", "far_x", "--json").json
    assert (answer["metrics"][0]["best"], answer["notes"]) == ([store.ids["near"]], [])


def test_the_only_run_that_may_be_compared_is_not_the_best_of_another_metric(compare, store, tmp_path):
    experiment = merged(table((0.5, 0.0, 0.0)), {"master.stop_time": 0.1})
    experiment["metrics"] = {"far_x": METRICS_OF_WAVES["far_x"]}
    _, path = run(tmp_path, experiment)
    wrong = changed(path, tmp_path / "wrong.h5", {"warnings": ["it is wrong"], "warning_kinds": ["unstable"]})
    answer = compare("near", wrong, "--metrics", "far_x", "--json").json
    assert answer["metrics"][0]["best"] == []
    assert "far_x is not the same in all runs: window = 0 to 0.05 s or 0 to 0.1 s" in answer["notes"][0]


def test_what_is_never_reached_is_later_than_any_time(compare, models, tmp_path):
    metrics = {"settled": {"of": "convergence_time", "signal": "one.eta.x", "band": 1.5}}
    soon, late = (run(tmp_path, {**table((x, 0.0, 0.0)), "metrics": metrics}) for x in (1.0, 2.0))
    answer = compare(soon[1], late[1], "--json").json
    assert [of["never"] for of in answer["runs"]] == [[], ["settled"]]
    assert answer["metrics"][0]["best"] == [soon[0]]
    assert compare(late[1], late[1], "--json").json["metrics"][0]["best"] == []


def test_orch_show_says_first_what_speaks_against_a_run(orch, store, tmp_path):
    near = store.folder / "results" / "waves" / f"{store.ids['near']}.h5"
    facts = {"stopped_at": 0.04, "warnings": ["wrong"], "warning_kinds": ["unstable"]}
    path = changed(near, tmp_path / "marked.h5", facts)
    first = orch("show", path).out.splitlines()[0]
    assert orch("show", path, "--json").json["marks"] == ["ended early at 0.04 s", "warned: unstable at this step"]
    assert first.endswith(": completed, ended early at 0.04 s, warned: unstable at this step")


def test_a_run_that_switches_in_every_step_has_no_best_of_what_counts_changes(compare, models, tmp_path):
    counting = {"variation": {"of": "total_variation", "signal": "one.ramp"}, "far": METRICS_OF_WAVES["far_x"]}
    paths = [run(tmp_path, {**table((k, 0.0, 0.0)), "metrics": counting})[1] for k in (1.0, 2.0)]
    switching = {"warnings": ["it switches"], "warning_kinds": ["switching"], "run_id": "switching"}
    columns = compare(changed(paths[0], tmp_path / "s.h5", switching), paths[1], "--json").json
    assert [column["marked"] for column in columns["metrics"]] == [["switching"], []]
    assert columns["metrics"][1]["best"] == ["switching"]
    assert columns["footnotes"] == ["variation of switching warned: switches in every step"]


def test_a_warning_that_is_not_of_the_numbers_is_named_below_the_table(compare, store, tmp_path):
    near = store.folder / "results" / "waves" / f"{store.ids['near']}.h5"
    warned = changed(near, tmp_path / "warned.h5", {"warnings": ["depth"], "warning_kinds": [""], "run_id": "warned"})
    answer = compare("far", warned, "--metrics", "far_x")
    assert rows(answer.out)["warned"][-1] == "1.000*"
    assert "note: warned warned of something (other): see orch show warned" in answer.out


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"master.stop_time": 0.1}, "window = 0 to 0.05 s or 0 to 0.1 s"),
        ({"master.step": 0.005}, "step = 0.005 s or 0.01 s"),
        ({"metrics.far_x.every": 0.02}, "every = 0.02 or none"),
    ],
)
def test_runs_that_are_not_alike_have_no_best(compare, store, tmp_path, changes, words):
    experiment = table((0.5, 0.0, 0.0))
    experiment["metrics"] = {"far_x": METRICS_OF_WAVES["far_x"]}
    _, path = run(tmp_path, merged(experiment, changes))
    answer = compare("near", path, "--metrics", "far_x")
    assert "*" not in answer.out
    assert f"far_x is not the same in all runs: {words}; runs that are not alike have no best" in unwrapped(answer.out)
    text = compare("near", path, "--metrics", "far_x", "--format", "latex").out
    assert r"\bfseries" not in text
    assert "Bold" not in text
    assert words in text


def unwrapped(text):
    return " ".join(text.split())


def test_one_window_is_alike_whatever_the_stop_time(compare, models, tmp_path):
    experiment = table((0.5, 0.0, 0.0))
    experiment["metrics"] = {"far_x": {**METRICS_OF_WAVES["far_x"], "before": 0.04}}
    paths = [run(tmp_path, merged(experiment, {"master.stop_time": stop}))[1] for stop in (0.05, 0.06)]
    far = merged(experiment, {"components.one.parameters.place": [1.0, 0.0, 0.0]})
    answer = compare(paths[1], run(tmp_path, far)[1], "--json").json
    assert not any("not the same" in note for note in answer["notes"])
    assert len(answer["metrics"][0]["best"]) == 1


def test_a_branch_from_a_checkpoint_is_not_compared_with_a_run_from_the_beginning(orch, spiral, write):
    spiral["metrics"] = {"rmse_x": {**spiral["metrics"]["rmse_x"], "after": 0.03}}
    spiral["master"]["step"] = 1e-4
    path = write(spiral)
    whole = orch("run", path, "--json", "--checkpoint-at", "0.02").json
    more = ("--from", whole["checkpoints"][0], "--swap", "controller=mfsosmc")
    branch = orch("run", path, "--json", *more).json
    answer = orch("compare", whole["run_id"], branch["run_id"])
    assert "*" not in answer.out
    assert f"from = run {whole['run_id']} at 0.02 s" in unwrapped(answer.out)


def test_a_failed_run_has_its_row(compare, models, tmp_path):
    path = tmp_path / "trouble.toml"
    experiment = merged(single("trouble", kind=1), {"components.one.start": {"u": 0.0}})
    path.write_text("\n".join(f"{key} = {toml(value)}" for key, value in experiment.items()), encoding="utf-8")
    with pytest.raises(orchestrator.RunError) as caught:
        orchestrator.run(path, results=tmp_path / "results")
    answer = compare("near", caught.value.run.path, "--metrics", "far_x")
    assert answer.code == 0, answer.err
    assert rows(answer.out)[caught.value.run.run_id] == ["(failed)", "trouble"]
    caught.value.run.close()


def test_runs_without_metrics_say_so(compare, tmp_path):
    _, path = run(tmp_path, single("waves"))
    answer = compare(path)
    assert answer.code == 0
    assert "no run has metrics" in answer.out


def test_metrics_that_share_a_name_but_not_a_meaning_are_noted(compare, store, tmp_path):
    changes = {"metrics.far_x.after": 0.02, "metrics.heading.unit": "rad"}
    _, path = run(tmp_path, merged(table((1.0, 0.0, 0.0)), changes))
    answer = compare("near", path)
    assert "note: far_x is not the same in all runs: after = 0.02 or none" in answer.out
    found = [line.split()[:2] for line in answer.out.splitlines() if line.startswith("heading")]
    assert found == [["heading", "deg"], ["heading", "rad"]]  # never in one column


def test_the_terminal_table_fits_80_columns(compare, store, tmp_path):
    paths = [run(tmp_path, table((k, 0.5, 1e-5 * k), 1e-3 * k))[1] for k in range(1, 5)]
    for some in (paths, paths * 2, [*paths, store.folder / f"results/waves/{store.ids['near']}.h5"]):
        answer = compare(*some, env={**os.environ, "COLUMNS": "80"})
        assert answer.code == 0, answer.err
        assert max(map(len, answer.out.splitlines())) <= 80
        assert all(path.stem in answer.out for path in some)


def test_markdown_has_the_best_in_bold(compare, store):
    lines = compare("near", "far", "farther", "--format", "markdown", "--metrics", "far_x").out.splitlines()
    assert lines[0] == "| run | what differs | far\\_x [m] |"
    assert lines[1] == "| --- | --- | ---: |"
    assert lines[2].startswith(f"| {store.ids['near']} | one.heading = 0.2, one.place = (1, 3, -5) |")
    assert lines[2].endswith("| **1.000** |")
    assert lines[3].endswith("| 2.000 |")
    across = compare("near", "far", "--format", "markdown").out.splitlines()
    assert "| far\\_x | m | **1.000** | 2.000 |" in across


def test_csv_has_a_line_a_run_in_full_precision(compare, store):
    lines = list(csv.reader(io.StringIO(compare("near", "farther", "--format", "csv").out)))
    assert lines[0] == [
        "run",
        "experiment",
        "what differs",
        "status",
        "far_x [m]",
        "far_y [cm]",
        "heading [deg]",
        "end_z [m]",
        "never [s]",
        "marks",
    ]
    assert len(lines) == 3
    assert lines[2][:2] == [store.ids["farther"], "waves"]
    assert lines[2][3:6] == ["completed", "3.0", repr(3.00001 * 100.0)]
    assert lines[2][-2:] == ["inf", ""]


def test_latex_is_for_siunitx_and_booktabs(compare, store):
    text = compare("near", "far", "farther", "--format", "latex", "--metrics", "far_*").out
    assert r"\begin{tabular}{llS[table-format = 1.3]S[table-format = 3.1]}" in text
    assert r"\toprule" in text
    assert r"Waves \& co." in text
    assert r"Run & What differs & {far\_x} & {far\_y} \\" in text
    assert r"&  & {(\unit{\metre})} & {(\unit{\centi\metre})} \\" in text
    assert r"\bfseries 1.000" in text
    across = compare("near", "far", "--format", "latex").out
    assert rf"Metric & Unit & {{{store.ids['near']}}} & {{{store.ids['far']}}} \\" in across
    assert r"far\_x & \unit{\metre} & \bfseries 1.000 & 2.000 \\" in across
    assert r"never & \unit{\second} & {never} & {never} \\" in across


@pytest.mark.parametrize(
    ("unit", "macros"),
    [
        ("m", r"\unit{\metre}"),
        ("m/s2", r"\unit{\metre\per\second\squared}"),
        ("N.m", r"\unit{\newton\metre}"),
        ("(m)2.s", r"\unit{\metre\squared\second}"),
        ("%", r"\unit{\percent}"),
        ("", ""),
        ("deg.s2", r"\unit{\degree\second\squared}"),
        ("furlong_x", r"\unit{\text{furlong\_x}}"),
    ],
)
def test_units_of_fmus_are_units_of_siunitx(unit, macros):
    assert latex.unit(unit) == macros


def test_number_formats_leave_room_for_every_number_of_a_column():
    assert latex.number_format(["1.395e-05", "12.50", "", "-"]) == "2.3e-99"
    assert latex.number_format(["-0.5000", "123"]) == "-3.4"
    assert latex.number_format([""]) == "1.0"


def test_the_name_of_the_file_says_the_format(compare, store, tmp_path):
    for name, begins in (("a.tex", "% "), ("a.md", "| "), ("a.csv", "run,"), ("a.txt", "run  ")):
        target = tmp_path / "new" / name
        answer = compare("near", "far", "--metrics", "far_x", "-o", target)
        assert answer.code == 0, answer.err
        assert answer.out.strip().endswith(name)
        assert target.read_text(encoding="utf-8").startswith(begins)
    assert compare("near", "--format", "csv", "-o", tmp_path / "b.tex").code == 0
    assert (tmp_path / "b.tex").read_text().startswith("run,")


def test_no_run_is_written_over(compare, store, tmp_path):
    path = store.folder / "results" / "waves" / f"{store.ids['near']}.h5"
    before = path.read_bytes()
    answer = compare("near", "far", "-o", path)
    assert answer.code == 2
    assert "is already used by this command; write to another file" in answer.err
    assert path.read_bytes() == before
    (tmp_path / "file").write_text("")
    answer = compare("near", "-o", tmp_path / "file" / "table.md")
    assert answer.code == 2
    assert "cannot be written" in answer.err


def test_the_figure_holds_all_runs(compare, store, tmp_path):
    figure = tmp_path / "all.svg"
    answer = compare("near", "far", "--plot", figure, "--signals", "one.ramp", "--metrics", "far_x")
    assert answer.code == 0, answer.err
    assert answer.out.strip().endswith("all.svg")
    assert "far_x" in answer.out
    text = figure.read_text(encoding="utf-8")
    assert all(store.ids[name] in text for name in ("near", "far"))
    answer = compare("near", "--signals", "one.ramp")
    assert answer.code == 2
    assert "--plot" in answer.err


def test_every_metric_has_a_direction_or_none_on_purpose():
    unranked = {name for name in METRICS if not smaller_is_better({"of": name, "reference": "one.y"})}
    assert unranked == {"distance", "heading_difference"}
    assert not smaller_is_better({"of": "final"})  # of a signal, not of an error


@pytest.mark.slow
def test_200_runs_are_compared_within_three_seconds(store, tmp_path):
    near = store.folder / "results" / "waves" / f"{store.ids['near']}.h5"
    (tmp_path / "results" / "waves").mkdir(parents=True)
    for k in range(200):
        name = f"{k:010x}"
        changed(near, tmp_path / "results" / "waves" / f"{name}.h5", {"run_id": name})
    began = time.monotonic()
    said = subprocess.check_output([ORCH, "compare", "results/waves/*.h5", "--json"], cwd=tmp_path)
    took = time.monotonic() - began
    assert len(json.loads(said)["runs"]) == 200
    assert took < 3.0  # 0.7 s on an idle machine
