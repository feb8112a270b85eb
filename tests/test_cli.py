"""The command itself: help, mistakes in how it is called, what this machine has."""

import os
import subprocess
import sys

import pytest

import orchestrator
from commands import ORCH
from experiments import single
from orchestrator.cli.main import COMMANDS


def test_help_shows_every_command_and_examples(orch):
    answer = orch("--help")
    assert answer.code == 0
    for command in COMMANDS:
        assert f"\n  {command} " in answer.out
    assert "orch run experiments/gripping_currents.toml\n" in answer.out


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(orch, command):
    answer = orch(command, "-h")
    assert answer.code == 0
    assert answer.out.startswith(f"Usage: orch {command} ")


def test_version(orch):
    assert orch("--version").out.startswith(f"orch {orchestrator.__version__}, ")
    assert "loop in Python" in orch("--version", env={**os.environ, "ORCH_LOOP": "python"}).out


@pytest.mark.parametrize(
    "arguments",
    [
        ("runn", "a.toml"),
        ("run",),
        ("run", "a.toml", "--nope"),
        ("run", "a.toml", "b.toml"),
        ("new", "controller"),
    ],
)
def test_a_mistake_in_the_call_shows_the_usage(orch, arguments):
    answer = orch(*arguments)
    assert answer.code == 2
    assert answer.err.startswith("Usage: orch")


def test_help_comes_at_once():
    """Numbers, files and FMUs are imported by the commands that need them, for they take half a second."""
    script = """
import sys
from orchestrator.cli.main import execute

execute(["--help"])
print(sorted({"numpy", "h5py", "fmpy", "pandas", "matplotlib", "jinja2"} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("Usage: orch ")
    assert done.stdout.endswith("\n[]\n")


def test_a_command_imports_its_own_module_only():
    script = """
import sys
from orchestrator.cli.main import execute

execute(["show", "--help"])
print(sorted(name for name in sys.modules if name.startswith("orchestrator.cli.commands.")))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("['orchestrator.cli.commands.options', 'orchestrator.cli.commands.store']\n")


def test_the_package_runs_as_a_command(tmp_path):
    """As `python -m orchestrator.cli` always did."""
    done = subprocess.run([sys.executable, "-m", "orchestrator.cli", "runn"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("Usage: orch ")


def test_a_check_needs_neither_records_nor_models(write, spiral, python):
    write(spiral)
    answer = python("""
import sys
from orchestrator.cli.main import orch

orch(["check", "mine.toml"], standalone_mode=False)
print({"h5py", "casadi", "pandas"} & set(sys.modules))
""")
    assert answer.code == 0, answer.err
    assert answer.out.endswith("set()\n")


def test_a_run_does_not_import_what_only_plots_need(write, probe, tmp_path, python):
    write(single(probe))
    answer = python("""
import sys
import orchestrator as orch

orch.run("mine.toml")
print({"matplotlib", "pandas", "casadi", "pythonfmu"} & set(sys.modules))
""")
    assert (answer.code, answer.out) == (0, "set()\n"), answer.err


def test_a_reader_that_goes_away_is_no_error(tmp_path, shipped):
    """orch fmus | head -1"""
    script = f'"{ORCH}" fmus --json | head -c 1 > /dev/null; exit "${{PIPESTATUS[0]}}"'
    done = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_progress_is_for_terminals_only(orch, write, models):
    answer = orch("run", write(single("moody", pause=0.05)))
    assert (answer.code, answer.err) == (0, "")


def test_a_terminal_sees_simulated_time_real_time_factor_and_time_left(write, models, tmp_path):
    pty = pytest.importorskip("pty")
    main, side = pty.openpty()
    path = write(single("moody", pause=0.15))
    with subprocess.Popen([ORCH, "run", str(path)], cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=side) as process:
        os.close(side)
        text = b""
        while True:
            try:
                more = os.read(main, 4096)
            except OSError:  # Linux says so when the other side has closed
                break
            if not more:
                break
            text += more
    os.close(main)
    assert process.returncode == 0
    shown = text.decode()
    assert " / 0.05 s" in shown
    assert "x real time" in shown
    assert " left" in shown
    assert shown.endswith("\r\x1b[K")  # and goes


def test_doctor_says_what_this_machine_has(orch):
    answer = orch("doctor")
    assert answer.code == 0
    for word in ("Python", "platform", "packaging", "loop", "numpy", "pythonfmu", "results"):
        assert word in answer.out
    assert answer.out.rstrip().endswith("everything that orch needs is here")


def test_doctor_says_what_is_missing_for_what(tmp_path):
    """Without the optional parts, and without a compiler on the path."""
    script = """
import importlib.util, sys
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name in ("xarray", "casadi", "ziglang") else find(name, *rest)
sys.argv = ["orch", "doctor"]
from orchestrator.cli.main import main
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env={**os.environ, "PATH": "", "COLUMNS": "200"},
    )
    lines = {line[9:].split("  ")[0]: line for line in done.stdout.splitlines()[:-1]}
    assert lines["casadi"].startswith("MISSING")
    assert lines["xarray"].startswith("-")
    assert "pip install xarray" in lines["xarray"]
    assert lines["packaging"].startswith("-        packaging   python: no C compiler was found")
    assert "missing: casadi" in done.stdout


def test_doctor_as_json(orch):
    found = {finding["what"]: finding for finding in orch("doctor", "--json").json}
    assert found["Python"]["state"] == "ok"
    assert found["packaging"].keys() == {"what", "state", "detail"}


def test_check_shows_the_system_and_runs_nothing(orch, write, spiral, tmp_path):
    path = write(spiral)
    answer = orch("check", path)
    assert (answer.code, answer.err) == (0, "")
    assert f"{path}: no problems" in answer.out
    assert "0.05 s in 50 steps of 0.001 s, gauss-seidel" in answer.out
    assert "records 54 signals every 0.01 s; run id " in answer.out
    assert list(tmp_path.iterdir()) == [path]
    run_id = orch("run", path, "--json").json["run_id"]
    assert f"run id {run_id}" in answer.out


def test_check_as_json_is_the_resolved_experiment(orch, write, spiral):
    found = orch("check", write(spiral), "--json").json
    assert found["problems"] == []
    assert found["master"]["stop_time"] == 0.05
    assert ["vehicle.v_c.x", "current.v_c.x"] in found["connections"]
    assert len(found["digest"]) == 64


def test_a_terminal_without_the_letters_gets_them_spelled(orch, write, models):
    path = write({**single("clock"), "metrics": {"größe_ω": {"of": "final", "signal": "one.y"}}})
    answer = orch("run", path, env={**os.environ, "PYTHONIOENCODING": "latin-1"}, encoding="latin-1")
    assert answer.code == 0
    assert "größe_\\u03c9" in answer.out
