"""Experiments, FMUs and records spoiled at random are refused with an error message, or run; ORCH_FUZZ=10 tries 10 000,
2 000 and 1 000 of them.

A mutant that breaks a rule is tried again, alone, by `python tests/peers/mutants experiments --only NUMBER`; what
it shows gets a test of its own below.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from experiments import merged
from fmu_files import PROBE_VARIABLES, paper_fmu

PEERS = Path(__file__).parent / "peers"
FUZZ = int(os.environ.get("ORCH_FUZZ", "1"))
EXPERIMENTS = 500 if FUZZ == 1 else 1000 * FUZZ
RECORDS = 100 if FUZZ == 1 else 100 * FUZZ
ARCHIVES = 500 if FUZZ == 1 else 200 * FUZZ


def mutants(tmp_path, *arguments):
    """What the process says that tries them."""
    (tmp_path / "work").mkdir()
    (tmp_path / "tmp").mkdir()
    command = [sys.executable, PEERS / "mutants", *map(str, arguments)]
    done = subprocess.run(
        command,
        cwd=tmp_path / "work",
        capture_output=True,
        text=True,
        errors="replace",
        env={**os.environ, "TMPDIR": str(tmp_path / "tmp")},
    )
    assert done.returncode == 0, f"{done.stdout[-5000:]}\n{done.stderr[-5000:]}"
    return done.stdout


def test_spoiled_experiments_are_refused_with_a_message_or_run(shipped, tmp_path):
    said = mutants(tmp_path, "experiments", "--count", EXPERIMENTS)
    assert f"0 of {EXPERIMENTS} mutants" in said
    assert "check 0" in said
    assert "run 0" in said


def test_spoiled_fmus_are_refused_with_a_message_or_read(shipped, tmp_path):
    (tmp_path / "given").mkdir()
    paper_fmu(tmp_path / "given" / "paper.fmu", PROBE_VARIABLES)
    said = mutants(tmp_path, "archives", "--count", ARCHIVES, "--given", tmp_path / "given")
    assert f"0 of {ARCHIVES} mutants" in said
    assert "check 0" in said


def test_spoiled_records_are_refused_with_a_message_or_read(shipped, tmp_path):
    said = mutants(tmp_path, "records", "--count", RECORDS)
    assert f"0 of {RECORDS} mutants" in said
    assert "show 0" in said
    assert "show 2" in said


# --- What mutants have found ------------------------------------------------------------------------------------------

DEEP = "a." * 500


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = " + "[" * 5000, "cannot be read as TOML"),
        (f"a = {'9' * 5000}", "cannot be read as TOML"),
        (f"a = 0x{'f' * 5000}", "a: is a whole number that does not fit 64 bits"),
        (f"a = {'[' * 40}{']' * 40}", "a: is nested more than 32 levels deep"),
        (f"{DEEP}a = 1", "is nested more than 32 levels deep"),
        ('title = "a\\u0000b"', "title: contains the character NUL"),
        ('"a\\u0000b" = 1', "its name contains the character NUL"),
        (f"[master]\nstep = 1{'0' * 400}", "master.step: is a whole number that does not fit 64 bits"),
    ],
)
def test_what_no_experiment_can_hold_is_reported(orch, tmp_path, text, words):
    (tmp_path / "mine.toml").write_text(text)
    for command in ("check", "run"):
        answer = orch(command, "mine.toml")
        assert (answer.code, words in answer.err) == (2, True), answer.err[:1000]


@pytest.mark.parametrize("value", ["[" * 5000, "9" * 5000, "1" + "0" * 400, "[" * 300 + "]" * 300])
def test_what_no_option_can_hold_is_reported(orch, write, spiral, value):
    answer = orch("check", write(spiral), "--set", f"components.vehicle.parameters.m={value}")
    assert answer.code == 2
    assert "1 problem\n" in answer.err


def test_more_steps_than_can_be_counted_are_refused(problems, spiral):
    changes = {"components.controller.step": 1e200, "master.stop_time": 1e100, "master.step": 1e-3}
    found = dict(problems(merged(spiral, changes)))
    assert "is over 9e+15 times master.step" in found["components.controller.step"]
    assert "is over 9e+15 times master.step" in found["master.stop_time"]


def test_a_swap_drops_parameters_that_are_none(orch, write, spiral):
    answer = orch("check", write(merged(spiral, {"components.controller.parameters": 3})), "--swap", "controller=pid")
    assert answer.code == 0, answer.err


@pytest.mark.parametrize(
    "key",
    [
        "master step",
        "master..step",
        ".master.step",
        "master.step.",
        'master."step',
        "",
        "  ",
    ],
)
def test_an_option_that_is_no_key_sets_nothing(problems, spiral, key):
    (found,) = problems(spiral, set={key: 0.001})
    assert found == (f"--set {key}", "is not a dotted key, such as master.stop_time")
