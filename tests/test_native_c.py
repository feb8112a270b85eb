"""The C of native FMUs, as other compilers see it: no warnings, and nothing for the sanitizers, misuse included."""

import shutil
import subprocess
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary

from fmu_files import COMPILER, needs_compiler
from orchestrator.models import build, catalogue

FMUS = sorted(catalogue.shipped())
FAST = "bluerov2_thesis"  # has parameters, calculated ones, inputs, states and outputs

pytestmark = needs_compiler
needs_cmake = pytest.mark.skipif(shutil.which("cmake") is None, reason="no CMake")

DRIVER = Path(__file__).parent / "peers" / "driver.c"  # a master that makes every call and every mistake


@pytest.fixture(scope="session")
def native(_build_folder):
    return build.build(FMUS, packaging="native")


@pytest.fixture
def sources(native, tmp_path):
    """(name) -> the folder of the FMU's C sources."""

    def unpack(name):
        return tmp_path / fmpy.extract(str(native[name]), str(tmp_path / name)) / "sources"

    return unpack


def compiled(folder, *arguments):
    command = [COMPILER, "-std=c11", *arguments, "-lm"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", [FAST, *(pytest.param(name, marks=pytest.mark.slow) for name in FMUS if name != FAST)])
def test_sanitizers_find_nothing_in_any_call_or_misuse(sources, name):
    folder = sources(name)
    shutil.copy(DRIVER, folder)
    sanitize = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1")
    done = compiled(folder, *sanitize, "-o", "driver", "driver.c")
    assert done.returncode == 0, done.stderr
    done = subprocess.run([folder / "driver"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "through\n", "")


@pytest.mark.parametrize("name", [FAST, "ocean_current", "gripping_reference"])  # the others lack inputs or states
def test_the_wrapper_compiles_without_a_warning(sources, name):
    done = compiled(
        sources(name), "-Wall", "-Wextra", "-Wshadow", "-pedantic", "-O2", "-shared", "-fPIC", "-o", "m", "fmi2.c"
    )
    # CasADi's code has parameters that it does not use.
    warnings = [line for line in done.stderr.splitlines() if "warning: " in line and "equations.h" not in line]
    assert (done.returncode, warnings) == (0, [])


@needs_cmake
def test_fmpy_compiles_the_sources_in_the_fmu_to_the_same_results(native, tmp_path):
    folder = fmpy.extract(str(native["bluerov2_thesis"]), str(tmp_path / "fmu"))
    expected = fmpy.simulate_fmu(folder, stop_time=0.5, output_interval=0.01, step_size=0.01)
    shutil.rmtree(tmp_path / "fmu" / "binaries")
    build_platform_binary(folder)
    found = fmpy.simulate_fmu(folder, stop_time=0.5, output_interval=0.01, step_size=0.01)
    # Other processors fuse multiplications and additions unless told not to.
    for column in expected.dtype.names:
        np.testing.assert_allclose(found[column], expected[column], rtol=1e-9, atol=1e-12)
