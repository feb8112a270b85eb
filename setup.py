"""The compiled loop, and a wheel that carries the models' sources and the experiments, for `orch build` to find."""

import os
import shutil
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_py import build_py


class BuildWithModels(build_py):
    def run(self):
        super().run()
        if self.editable_mode:
            return
        shipped = Path(self.build_lib) / "orchestrator" / "_shipped"
        for folder in ("fmus", "experiments"):
            shutil.copytree(
                folder, shipped / folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("build", "__pycache__")
            )


LOOP = Extension(
    "orchestrator.simulation._loop",
    ["orchestrator/simulation/_loop.c"],
    extra_compile_args=[] if os.name == "nt" else ["-std=c11", "-O3", "-funroll-loops", "-ffp-contract=off"],
    define_macros=[] if os.name == "nt" else [("_POSIX_C_SOURCE", "200809L")],
    py_limited_api=True,
    optional=True,  # without a C compiler the loop in Python does the same
)

WATCH = Extension(
    "orchestrator._watch",
    ["orchestrator/_watch.c"],
    extra_compile_args=["-std=c11", "-pthread"],
    extra_link_args=["-pthread"],
    define_macros=[("_POSIX_C_SOURCE", "200809L"), ("_DARWIN_C_SOURCE", "1")],
    py_limited_api=True,
    optional=True,  # without it, what holds Python's lock hangs unseen
)

setup(cmdclass={"build_py": BuildWithModels}, ext_modules=[LOOP] if os.name == "nt" else [LOOP, WATCH])
