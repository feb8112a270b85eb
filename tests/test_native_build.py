"""Native packaging from outside: it agrees with Python packaging, runs in masters of others, finds compilers or does
without, and cross-builds."""

import json
import os
import struct
import subprocess
import sys
import tomllib
import zipfile

import fmpy
import numpy as np
import pytest

import fmu_files
import orchestrator
from commands import ORCH
from experiments import EXPERIMENTS
from fmu_files import COMPILER, needs_compiler
from orchestrator.fmu.fmu import platform_folder, read
from orchestrator.models import build, catalogue

SHIPPED = sorted(EXPERIMENTS.rglob("*.toml"))
MODEL = "ocean_current"  # the smallest
X86_64_LINUX = sys.platform == "linux" and platform_folder()[0] == "linux64"

every_experiment = pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)


@pytest.fixture(scope="session")
def native(_build_folder):
    """{name: FMU} of all shipped models."""
    return build.build(catalogue.shipped(), packaging="native")


@pytest.fixture
def fresh(orch, tmp_path):
    """The command with an empty build folder; `fresh(..., CC=...)` sets the environment."""

    def run(*arguments, **environment):
        return orch(*arguments, env={**os.environ, "ORCH_BUILD": str(tmp_path / "build"), **environment})

    return run


@pytest.fixture
def cross(tmp_path):
    """cross(name, target, ...) runs `orch build` with all the time that zig's first build for Windows takes."""
    pytest.importorskip("ziglang")

    def run(name, *targets):
        options = [option for target in targets for option in ("--target", target)]
        done = subprocess.run(
            [ORCH, "build", name, *options],
            cwd=tmp_path,
            env={**os.environ, "ORCH_BUILD": str(tmp_path / "build")},
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture
def broken(tmp_path):
    """A compiler that fails, and notes each call in the file `calls` beside it."""
    script = tmp_path / "cc"
    script.write_text(f'#!/bin/sh\necho once >> "{tmp_path}/calls"\necho "error: no headers" >&2\nexit 1\n')
    script.chmod(0o755)
    return script


# --- The packagings agree ---------------------------------------------------------------------------------------------


def assert_packagings_agree(path, folder, step, ticks):
    """Both run the same start of an experiment, every step recorded."""
    stop_time = round(ticks * step, 9)
    changes = {"master.step": step, "master.stop_time": stop_time, "record.every": step, "record.signals": ["*"]}
    runs = [
        orchestrator.run(path, set=changes, results=folder / packaging, packaging=packaging)
        for packaging in ("native", "python")
    ]
    native, python = runs
    assert native.signals == python.signals
    assert len(native.time) == ticks + 1
    for name in native.signals:
        if X86_64_LINUX:
            assert native[name].tobytes() == python[name].tobytes(), name
        else:
            np.testing.assert_allclose(native[name], python[name], rtol=1e-9, atol=1e-9, err_msg=name)
    for run in runs:
        run.close()


def step_of(path):
    return tomllib.loads(path.read_text())["master"]["step"]


@needs_compiler
@every_experiment
def test_both_packagings_give_the_same_bits(native, path, tmp_path):
    assert_packagings_agree(path, tmp_path, step_of(path), 60)


@pytest.mark.slow
@needs_compiler
@every_experiment
def test_both_packagings_give_the_same_bits_over_seconds(native, path, tmp_path):
    step = max(step_of(path), 1e-4)
    assert_packagings_agree(path, tmp_path, step, round(3.0 / step))


# --- Masters of others ------------------------------------------------------------------------------------------------

LIBCOSIM = """
import json, sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

found = {}
for path, reference, _ in json.loads(sys.stdin.read()):
    execution, observer = CosimExecution.from_step_size(10_000_000), CosimObserver.create_last_value()
    slave = execution.add_local_slave(CosimLocalSlave(path, "one"))
    execution.add_observer(observer)
    assert execution.simulate_until(100_000_000)
    found[path] = observer.last_real_values(slave, [reference])[0]
open("found.json", "w").write(json.dumps(found))
"""
ECOS = """
import json, sys
from ecospy import EcosLib, EcosSimulation, EcosSimulationStructure

EcosLib.set_log_level("err")
found = {}
for path, _, output in json.loads(sys.stdin.read()):
    with EcosSimulationStructure() as structure:
        structure.add_model("one", path)
        with EcosSimulation(step_size=0.01, structure=structure) as simulation:
            simulation.init()
            simulation.step(10)
            found[path] = simulation.get_real("one::" + output)
open("found.json", "w").write(json.dumps(found))
"""


@needs_compiler
@pytest.mark.parametrize(("package", "script"), [("libcosimpy", LIBCOSIM), ("ecospy", ECOS)])
def test_every_native_fmu_gives_the_same_in_another_master(python, native, tmp_path, package, script):
    pytest.importorskip(package, exc_type=(ImportError, OSError))  # OSError: a library that it needs is missing
    asked, expected = [], {}
    for path in native.values():
        result = fmpy.simulate_fmu(str(path), stop_time=0.1, output_interval=0.01)
        output = max(result.dtype.names[1:], key=lambda column: abs(result[column][-1]))
        asked.append((str(path), read(path).variables[output].reference, output))
        expected[str(path)] = result[output][-1]
    answer = python(script, input=json.dumps(asked))
    assert answer.code == 0, answer.err
    found = json.loads((tmp_path / "found.json").read_text())
    assert found == pytest.approx(expected, rel=1e-12)  # masters sum or multiply steps to a time
    assert sum(value != 0.0 for value in expected.values()) > 5


# --- Compilers --------------------------------------------------------------------------------------------------------

NO_COMPILER = "so the models become Python FMUs; for faster ones install gcc or clang, or pip "


def experiment(write):
    return write({"master": {"stop_time": 0.02, "step": 0.01}, "components": {"current": {"fmu": MODEL}}})


def test_without_a_compiler_runs_use_python_fmus_and_say_so_when_they_build(fresh, write, tmp_path):
    path = experiment(write)
    first = fresh("run", path, CC="/nonexistent/cc")
    assert first.code == 0, first.err
    reason, building = first.err.splitlines()
    assert reason.startswith("no C compiler was found (CC is '/nonexistent/cc'), " + NO_COMPILER)
    assert building == f"building {MODEL}"
    assert [file.parent.name for file in (tmp_path / "build").rglob("*.fmu")] == ["python"]
    second = fresh("run", path, "--force", CC="/nonexistent/cc")
    assert (second.code, second.err) == (0, "")


def test_a_compiler_that_fails_is_done_without_and_not_tried_again(fresh, write, broken, tmp_path):
    path = experiment(write)
    first = fresh("run", path, CC=str(broken))
    assert first.code == 0, first.err
    assert first.err.splitlines() == [
        f"building {MODEL}",
        f"the C compiler fails (error: no headers), so these become Python FMUs: {MODEL}",
    ]
    second = fresh("run", path, "--force", CC=str(broken))
    assert (second.code, second.err) == (0, "")
    assert (tmp_path / "calls").read_text() == "once\n"


def test_native_fmus_are_demanded_of_a_compiler_that_fails(fresh, broken):
    answer = fresh("build", MODEL, "--native", CC=str(broken))
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.endswith(f"{MODEL}.py cannot be built: error: no headers\n")


def test_native_fmus_are_demanded_without_a_compiler(fresh, write):
    for arguments in (("build", MODEL, "--native"), ("run", experiment(write), "--packaging", "native")):
        answer = fresh(*arguments, CC="/nonexistent/cc")
        assert answer.code == 2
        assert "no C compiler was found (CC is '/nonexistent/cc'); for native FMUs install gcc or clang" in answer.err
    err = fresh("run", EXPERIMENTS / "spiral_pid.toml", "--packaging", "native", CC="/nonexistent/cc").err
    assert err.count("no C compiler was found") == 1  # not once a component


@needs_compiler
def test_a_compiler_that_works_again_is_used(fresh, write, broken, tmp_path):
    fresh("run", experiment(write), CC=str(broken))
    answer = fresh("run", experiment(write), "--force", CC=COMPILER)
    assert (answer.code, answer.err) == (0, f"building {MODEL}\n")
    assert (tmp_path / "build" / "native" / f"{MODEL}.fmu").exists()


@needs_compiler
def test_a_compiler_may_be_named_with_options(fresh, tmp_path):
    answer = fresh("build", MODEL, "--native", CC=f"{COMPILER} -O1")
    assert (answer.code, answer.out) == (0, f"build/native/{MODEL}.fmu\n")


@needs_compiler
def test_the_packaging_can_be_chosen_for_each_run(fresh, write, tmp_path):
    path, folder = experiment(write), tmp_path / "build"
    for packaging in ("native", "python"):
        answer = fresh("run", path, "--packaging", packaging, "--json")
        assert answer.code == 0, answer.err
        assert (folder / packaging / f"{MODEL}.fmu").exists()
    assert len(list((tmp_path / "results").rglob("*.h5"))) == 2  # other FMUs, other runs


@needs_compiler
def test_plain_python_has_no_native_packaging(fresh, write, tmp_path):
    (tmp_path / "mine.py").write_text(fmu_files.model("clock"))
    sentence = "mine.py cannot be built: ValueError: a PythonModel runs in Python only and has no native packaging"
    answer = fresh("build", "mine.py", "--native")
    assert (answer.code, answer.out) == (2, "")
    assert sentence in answer.err
    fresh("build", "mine.py")
    path = write({"master": {"stop_time": 0.02, "step": 0.01}, "components": {"one": {"fmu": "mine"}}})
    answer = fresh("run", path, "--packaging", "native")
    assert answer.code == 2
    assert f"components.one.fmu: {tmp_path}/{sentence}" in answer.err


def test_ziglang_compiles_where_there_is_nothing_else(fresh, tmp_path):
    pytest.importorskip("ziglang")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").symlink_to(sys.executable)
    found = []
    for folder in ("one", "other"):
        answer = fresh("build", MODEL, "--native", PATH=str(tmp_path / "bin"), CC="", ORCH_BUILD=str(tmp_path / folder))
        assert (answer.code, answer.out) == (0, f"{folder}/native/{MODEL}.fmu\n"), answer.err
        found.append(tmp_path / folder / "native" / f"{MODEL}.fmu")
    assert found[0].read_bytes() == found[1].read_bytes()
    result = fmpy.simulate_fmu(str(found[0]), start_values={"velocity.x": 0.5}, stop_time=0.1)
    assert result["v_c.x"][-1] == 0.5


# --- Other platforms --------------------------------------------------------------------------------------------------


def library(path, member):
    with zipfile.ZipFile(path) as archive:
        (found,) = [name for name in archive.namelist() if name.startswith("binaries/")]
        assert found == member
        return archive.read(found)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["x86_64-windows", "aarch64-linux", "x86_64-macos"])
def test_an_fmu_is_built_for_another_platform(cross, tmp_path, target):
    assert cross("bluerov2_thesis", target) == f"build/{target}/bluerov2_thesis.fmu\n"
    path = tmp_path / "build" / target / "bluerov2_thesis.fmu"
    if target == "x86_64-windows":
        content = library(path, "binaries/win64/bluerov2_thesis.dll")
        (header,) = struct.unpack_from("<I", content, 0x3C)
        assert content[:2] == b"MZ"
        assert content[header : header + 6] == b"PE\0\0" + (0x8664).to_bytes(2, "little")
    elif target == "aarch64-linux":
        content = library(path, "binaries/linux64/bluerov2_thesis.so")
        assert content[:5] == b"\x7fELF\x02"
        assert struct.unpack_from("<H", content, 18) == (183,)  # EM_AARCH64
    else:
        content = library(path, "binaries/darwin64/bluerov2_thesis.dylib")
        assert content[:8] == struct.pack("<II", 0xFEEDFACF, 0x01000007)  # 64-bit Mach-O, x86-64
    for function in (b"fmi2Instantiate", b"fmi2DoStep", b"fmi2GetDirectionalDerivative", b"fmi2DeSerializeFMUstate"):
        assert function + b"\0" in content


@pytest.mark.slow
def test_one_fmu_is_built_for_several_platforms(cross, tmp_path):
    path = tmp_path / "build" / "x86_64-linux+x86_64-windows" / f"{MODEL}.fmu"
    contents = []
    for targets in (("x86_64-windows", "x86_64-linux"), ("x86_64-linux", "x86_64-windows")):
        assert tmp_path / cross(MODEL, *targets).strip() == path
        contents.append(path.read_bytes())
    assert contents[0] == contents[1]
    with zipfile.ZipFile(path) as archive:
        found = sorted(name for name in archive.namelist() if name.startswith("binaries/"))
    assert found == [f"binaries/linux64/{MODEL}.so", f"binaries/win64/{MODEL}.dll"]


@pytest.mark.parametrize(
    ("targets", "words"),
    [
        (["x86_64-widows"], "no target 'x86_64-widows'; did you mean 'x86_64-windows'?"),
        (["x86_64-linux", "aarch64-linux"], "x86_64-linux and aarch64-linux share a folder in FMI 2.0"),
    ],
)
def test_a_target_that_cannot_be_says_why(fresh, tmp_path, targets, words):
    answer = fresh("build", MODEL, *(option for target in targets for option in ("--target", target)))
    assert (answer.code, answer.out) == (2, "")
    assert words in answer.err
    assert not list(tmp_path.rglob("*.fmu"))


def test_targets_and_python_fmus_exclude_each_other(fresh):
    answer = fresh("build", MODEL, "--python", "--target", "x86_64-windows")
    assert answer.code == 2
    assert "--target is for native FMUs" in answer.err
