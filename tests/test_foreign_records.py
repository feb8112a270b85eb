"""A record is as foreign as an FMU: what none may hold is refused with the name of the attribute or the data set.

Every command reads each of these records in this process, through the entry that `orch` has.
"""

import json
import shutil

import h5py
import numpy as np
import pytest

import orchestrator
from experiments import single, toml
from fmu_files import SOURCES
from orchestrator.cli.main import execute
from orchestrator.errors import FmuError
from orchestrator.models import build
from orchestrator.records.file.run import Run

SIGNAL = "vehicle/one.x"


@pytest.fixture(scope="module")
def good(_build_folder, tmp_path_factory):
    """A short record that every command takes."""
    fmu = build.build([str(SOURCES / "erratic.py")])["erratic"]
    folder = tmp_path_factory.mktemp("good")
    table = single(fmu, name="vehicle", seed=1) | {"metrics": {"m": {"of": "rms", "signal": "vehicle.one.x"}}}
    (folder / "mine.toml").write_text("\n".join(f"{key} = {toml(value)}" for key, value in table.items()))
    with orchestrator.run(folder / "mine.toml", output=folder / "good.h5") as run:
        assert run.status == "completed"
    return folder / "good.h5"


@pytest.fixture
def every(good, tmp_path, monkeypatch, capsys):
    """every(change) spoils a copy of the record by change(file), and gives {command: (code, what it said)}."""
    monkeypatch.chdir(tmp_path)

    def run(change):
        folder = tmp_path / "results" / "mine"
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "bad.h5"
        shutil.copy(good, path)
        shutil.copy(good, folder / "good.h5")
        with h5py.File(path, "r+") as file:
            change(file)
        answers = {}
        for command in (
            ("show", path),
            ("list",),
            ("list", "--json"),
            ("plot", path, "-o", "a.svg"),
            ("compare", path, good),
            ("compare", good, path, "--plot", "b.svg"),
            ("report", path, "-o", "a.html"),
            ("diff", good, path),
            ("rerun", path, "--verify"),
            *(("export", path, "-o", f"a.{suffix}") for suffix in ("csv", "parquet", "mat", "nc", "mcap", "tlog")),
            ("prune", "--status", "corrupt", "--yes"),
        ):
            code = execute([str(word) for word in command])
            said = capsys.readouterr()
            text = said.out + said.err
            assert "Traceback" not in text, (command, text[-3000:])
            answers.setdefault(command[0], (code, text))  # the first of each
        return answers

    return run


def external(file):
    del file[SIGNAL]
    file[SIGNAL] = h5py.ExternalLink("/etc/passwd", "/")


def soft(file):
    del file[SIGNAL]
    file[SIGNAL] = h5py.SoftLink("/vehicle/one.y")


def linked_group(file):
    del file["vehicle"]
    file["vehicle"] = h5py.SoftLink("/")


def endless(file):
    file["vehicle/again"] = file["vehicle"]


def endless_time(file):
    del file["time"]
    file.create_dataset("time", shape=(10**12,), dtype="f8", chunks=(1024,))


def endless_contiguous(file):
    del file["time"]
    file.create_dataset("time", shape=(10**12,), dtype="f8")


def virtual(file):
    layout = h5py.VirtualLayout(shape=(len(file["time"]),), dtype="f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", shape=(len(file["time"]),))
    del file[SIGNAL]
    file.create_virtual_dataset(SIGNAL, layout)


def elsewhere(file):
    del file[SIGNAL]
    file.create_dataset(SIGNAL, shape=file["time"].shape, dtype="f8", external=[("/etc/hostname", 0, 1 << 20)])


def compound(file):
    put(file, np.zeros(len(file["time"]), dtype=[("a", "f8"), ("b", "i4")]))


def references(file):
    put(file, np.array([file.ref] * len(file["time"]), dtype=h5py.ref_dtype))


def put(file, values):
    del file[SIGNAL]
    file[SIGNAL] = values


def attribute(name, value):
    def change(file):
        file.attrs[name] = value

    change.__name__ = f"{name}-{str(value)[:20]}"
    return change


def resolved(key, value):
    """experiment_resolved with another value at a dotted key."""

    def change(file):
        facts = json.loads(file.attrs["experiment_resolved"])
        *above, last = key.split(".")
        node = facts
        for part in above:
            node = node[int(part) if part.isdecimal() else part]
        node[last] = value
        file.attrs["experiment_resolved"] = json.dumps(facts)

    change.__name__ = f"resolved-{key}"
    return change


def without(name):
    def change(file):
        del file.attrs[name]

    change.__name__ = f"without-{name}"
    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (external, "/vehicle/one.x is a link"),
        (soft, "/vehicle/one.x is a link"),
        (linked_group, "/vehicle is a link"),
        (endless, "groups deep"),
        (virtual, "/vehicle/one.x has its values in another file"),
        (elsewhere, "/vehicle/one.x has its values in another file"),
        (compound, "/vehicle/one.x holds neither numbers nor texts"),
        (references, "/vehicle/one.x holds neither numbers nor texts"),
        (lambda file: put(file, 1.0), "/vehicle/one.x has no rows"),
        (lambda file: put(file, np.zeros(1)), "/vehicle/one.x has 1 rows"),
        (lambda file: put(file, h5py.Empty("f8")), "/vehicle/one.x has no rows"),
        (lambda file: put(file, np.zeros(9, "g")), "/vehicle/one.x holds neither numbers nor texts"),
    ],
)
def test_a_signal_that_no_record_has_is_refused_by_its_name(every, change, words):
    answers = every(change)
    for command in ("plot", "report", "export"):
        assert (answers[command][0] != 0, words in answers[command][1]) == (True, True), answers[command]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (endless_time, "/time states 1000000000000 rows"),
        (endless_contiguous, "/time states 1000000000000 rows"),
        (attribute("metrics", "{"), "the attribute metrics is no JSON"),
        (attribute("metrics", "[" * 100_000), "the attribute metrics is no JSON"),
        (attribute("metrics", '{"m": "x"}'), "the attribute metrics m: is no number"),
        (
            attribute("metrics", '{"m": 1e-3, "\\u001b[2J": 1}'),
            "which the attribute experiment_resolved does not define",
        ),
        (attribute("metrics", 3.0), "the attribute metrics is no text"),
        (attribute("metrics", np.zeros(5)), "the attribute metrics is no text"),
        (attribute("warnings", '{"a": 1}'), "the attribute warnings is no list"),
        (attribute("warning_kinds", '["unstable"]'), "warning_kinds does not go with"),
        (attribute("versions", '["a"]'), "the attribute versions is no table"),
        (attribute("command", '{"a": "b"}'), "the attribute command is no list"),
        (attribute("timing", '{"components": {"a": 1}}'), "the attribute timing components.a is no table"),
        (attribute("experiment_resolved", "{}"), "the attribute experiment_resolved has no master"),
        (attribute("experiment_resolved", "9" * 5000), "the attribute experiment_resolved is no JSON"),
        (attribute("experiment_resolved", '{"a": ' + "[" * 300 + "]" * 300 + "}"), "nested more than 64"),
        (attribute("experiment_resolved", '{"a": "\\ud800"}'), "the attribute experiment_resolved is no JSON"),
        (attribute("status", "well"), "the attribute status is 'well'"),
        (attribute("created", "yesterday"), "the attribute created is no time"),
        (attribute("step", "fast"), "the attribute step is no number"),
        (attribute("step", 0.0), "the attribute step is 0"),
        (attribute("wall_time", "x"), "the attribute wall_time is no number"),
        (attribute("stopped_at", "x"), "the attribute stopped_at is no number"),
        (attribute("format_version", 9), "the attribute format_version is 9"),
        (attribute("title", np.bytes_(b"\xff\xfe")), ""),
        (attribute("pid", 1.5), "the attribute pid is no whole number"),
        (attribute("run_id", 7), "the attribute run_id is no text"),
        (without("digest"), "the attribute digest is missing"),
        (without("metrics"), "the attribute metrics is missing"),
        (resolved("master.stop_time", "x"), "experiment_resolved master.stop_time: is no number"),
        (resolved("components", {}), "experiment_resolved components is no list"),
        (resolved("components.0.parameters", 3), "components[0].parameters is no table"),
        (resolved("connections", [["a"]]), "connections[0]: is no input"),
        (resolved("record.every", None), "record.every: is no number"),
        (resolved("metrics.m", {"of": "nonsense", "signal": "a"}), "metrics.m: names no metric"),
        (resolved("metrics.m", {"of": "rms", "signal": "vehicle.one.x", "after": "x"}), "its after is no number"),
    ],
)
def test_what_no_record_says_is_refused_by_the_name_of_the_attribute(every, change, words):
    answers = every(change)
    for command in ("show", "plot", "compare", "report", "diff", "export", "rerun"):
        code, said = answers[command]
        if words:
            assert (code != 0, words in said) == (True, True), (command, said)


def test_what_others_added_to_a_record_is_left_alone(every):
    def annotate(file):
        file.attrs["note"] = "a good one"
        file.attrs["numbers"] = np.arange(5)
        file.attrs["reference"] = file.ref
        file["vehicle"].attrs["colour"] = np.array(["red"], dtype=h5py.string_dtype())

    answers = every(annotate)
    assert not any(code for code, _ in answers.values())


def test_nothing_outside_a_record_is_read(every, tmp_path):
    """A link to another record, whose values would pass as the run's own."""

    def link(file):
        with h5py.File(tmp_path / "other.h5", "w") as other:
            other["x"] = np.full(len(file["time"]), 4242.0)
        del file[SIGNAL]
        file[SIGNAL] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/x")

    assert not any("4242" in said for _, said in every(link).values())
    assert not (tmp_path / "a.csv").exists()


@pytest.mark.parametrize(
    ("xml", "words"),
    [('<!DOCTYPE a [<!ENTITY b "ccc">]><a>&b;</a>', "has a document type"), ("<a", "cannot be read")],
)
def test_a_model_description_that_is_not_one_is_refused(every, good, tmp_path, xml, words):
    with h5py.File(good) as file:
        digest = file["vehicle"].attrs["fmu_sha256"]
    every(attribute("model_descriptions", json.dumps({digest: xml})))
    shutil.copy(good, tmp_path / "bad.h5")
    with h5py.File(tmp_path / "bad.h5", "r+") as file:
        file.attrs["model_descriptions"] = json.dumps({digest: xml})
    with Run(tmp_path / "bad.h5") as run, pytest.raises(FmuError, match=words):
        run.description("vehicle")
