"""What the tests share: the command `orch`, experiments to change, and the FMUs of tests/fmus.

FMUs are built into a folder of the session's own, never beside the models' sources.
"""

import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

import orchestrator
from commands import DEADLINE, ORCH, Answer
from experiments import EXPERIMENTS, toml
from fmu_files import COMPILER, SOURCES, probe_fmu
from orchestrator.models import build
from orchestrator.runs.prepare import prepare


@pytest.fixture(scope="session", autouse=True)
def _build_folder(tmp_path_factory):
    os.environ["ORCH_BUILD"] = str(tmp_path_factory.mktemp("build"))
    os.environ["TMPDIR"] = str(tmp_path_factory.mktemp("tmp"))  # where killed runs leave their FMUs
    os.environ.pop("HDF5_USE_FILE_LOCKING", None)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs begin by ignoring it


@pytest.fixture(scope="session")
def shipped(_build_folder):
    """Builds the models of the experiments, so that no command says that it does."""
    return build.build(
        [
            "pid",
            "mfsosmc",
            "bluerov2_allocation",
            "bluerov2_thesis",
            "spiral_reference",
            "gripping_reference",
            "ocean_current",
        ]
    )


@pytest.fixture
def orch(shipped, tmp_path):
    """orch("run", path, ...) runs the command in the test's folder."""

    def run(*arguments, cwd=tmp_path, **options):
        done = subprocess.run(
            [ORCH, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=DEADLINE, **options
        )
        assert "Traceback" not in done.stderr, done.stderr
        return Answer(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def python(shipped, tmp_path):
    """python(script) runs a script in the test's folder, as a user's would run."""

    def run(script, **options):
        (tmp_path / "script.py").write_text(script, encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE, **options
        )
        return Answer(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def spiral():
    """A short spiral under PID as a dictionary to change; `write` makes a file of it."""
    with (EXPERIMENTS / "spiral_pid.toml").open("rb") as file:
        table = tomllib.load(file)
    table["master"]["stop_time"] = 0.05
    return table


@pytest.fixture
def write(tmp_path):
    """write(dictionary, name) makes an experiment file in the test's folder."""

    def write(table, name="mine.toml"):
        path = tmp_path / name
        path.write_text("\n".join(f"{key} = {toml(value)}" for key, value in table.items()), encoding="utf-8")
        return path

    return write


@pytest.fixture
def without_pymavlink(tmp_path):
    """A folder; a command with this in PYTHONPATH finds no pymavlink."""
    folder = tmp_path / "without"
    (folder / "pymavlink").mkdir(parents=True)
    (folder / "pymavlink" / "__init__.py").write_text("raise ImportError('not here')")
    return folder


@pytest.fixture
def resolve(shipped, write):
    """resolve(dictionary) -> the Plan, as `orch check` finds it, or ExperimentError."""

    def find(table, **options):
        return prepare(write(table), **options)

    return find


@pytest.fixture
def problems(shipped, write, tmp_path):
    """problems(dictionary) -> [(key, sentence)] of an experiment that must not start."""

    def find(table, **options):
        results = tmp_path / "nothing-comes-here"
        with pytest.raises(orchestrator.ExperimentError) as caught:
            orchestrator.run(write(table), results=results, **options)
        assert not results.exists()
        assert all(str(problem) in str(caught.value) for problem in caught.value.problems)
        return [(problem.key, problem.sentence) for problem in caught.value.problems]

    return find


@pytest.fixture(scope="session")
def models(_build_folder):
    """Builds the models that experiments of several tests name."""
    names = ("trouble", "relay", "memory", "plus", "moody", "clock", "waves", "inverse", "seam")
    return build.build([str(SOURCES / f"{name}.py") for name in names])


@pytest.fixture(scope="session")
def probe(tmp_path_factory):
    """The path of the compiled fmus/probe.c."""
    if COMPILER is None:
        pytest.skip("no C compiler")
    return probe_fmu(tmp_path_factory.mktemp("probe") / "probe.fmu")


@pytest.fixture(scope="session")
def foreign(tmp_path_factory):
    """FMUs that pythonfmu's own builder made: two with another `helper` module each, and one that fails at 0.02 s."""
    folder = tmp_path_factory.mktemp("pythonfmu")
    for name, helper in (("north", "helper"), ("south", "helper"), ("east", "east_help")):
        command = [Path(ORCH).with_name("pythonfmu"), "build", "-f", f"{name}.py", "--dest", folder, f"{helper}.py"]
        subprocess.run(command, cwd=SOURCES / "pythonfmu" / name, check=True, capture_output=True)
    return SimpleNamespace(**{path.stem.lower(): path for path in folder.glob("*.fmu")})
