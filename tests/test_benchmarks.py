"""The benchmarks run, and what they compare is the same simulation."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fmu_files import needs_compiler

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


@pytest.mark.slow
@needs_compiler
def test_the_speed_table_compares_runs_with_the_same_bits(tmp_path):
    command = [sys.executable, BENCHMARKS / "speed.py", "--quick", "--json", tmp_path / "speed.json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "| the same C in one function |" in done.stdout
    (same,) = [line for line in done.stdout.splitlines() if "| gauss-seidel |" in line and "same C" in line]
    assert "105 of 105" in same
    assert json.loads((tmp_path / "speed.json").read_text())["tables"]


@pytest.mark.slow
@needs_compiler
def test_a_formation_of_vehicles_runs(tmp_path):
    command = [sys.executable, BENCHMARKS / "large.py", "--vehicles", "2", "10", "--repeats", "1"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    rows = [line.split("|") for line in done.stdout.splitlines() if line.startswith(("| 2 |", "| 10 |"))]
    assert [row[2].strip() for row in rows] == ["9", "41"]


@pytest.mark.slow
def test_a_store_of_records_is_searched(tmp_path):
    command = [sys.executable, BENCHMARKS / "store.py", "--records", "50"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "50 records" in done.stdout
    assert "list --where a parameter" in done.stdout
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_sweep_is_measured(tmp_path):
    command = [sys.executable, BENCHMARKS / "sweep.py", "--draws", "4", "--repeats", "1", "--runs", "20"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert lines[0].startswith("12 runs: ")
    assert lines[0].endswith("the same table")
    assert [line.partition(":")[0] for line in lines[1:4]] == [
        f"a run beyond its stepping, keep = '{keep}'" for keep in ("metrics", "decimated", "full")
    ]
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_isolation_is_measured(tmp_path):
    command = [sys.executable, BENCHMARKS / "isolation.py", "1"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert [line.partition(":")[0] for line in done.stdout.splitlines()] == [f"{n} isolated" for n in range(1, 5)]


@pytest.mark.slow
def test_the_detector_judges_a_fixed_set_of_runs_as_they_are(tmp_path):
    """Six wrong and four right ones, with and without noise, currents and periods of their own."""
    command = [
        sys.executable,
        BENCHMARKS / "detector.py",
        "--runs",
        "10",
        "--seed",
        "7",
        "--json",
        tmp_path / "runs.json",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "| wrong: an rms changes by more than 20 % at half the step | 6 | 6 | 0 |" in done.stdout
    assert "| right: by no more than 20 % | 4 | 0 | 4 |" in done.stdout
    assert "misses: 0 of 6, " in done.stdout
    assert "false alarms: 0 of 4, " in done.stdout
    assert "of 4 with periods of their own, the cause is named right in 4" in done.stdout
    runs = json.loads((tmp_path / "runs.json").read_text())
    assert {word for run in runs for word in ("noise", "current", "jacobi") if word in run["draw"]} == {
        "noise",
        "current",
        "jacobi",
    }
