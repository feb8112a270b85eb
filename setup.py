"""The wheel carries the models' sources and the experiments inside the package, for `orch build` to find."""

import shutil
from pathlib import Path

from setuptools import setup
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


setup(cmdclass={"build_py": BuildWithModels})
