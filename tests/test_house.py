"""The plan of the house: what the package shows, and which way its imports go."""

import tomllib
from pathlib import Path

import orchestrator

ROOT = Path(__file__).parent.parent


def test_the_public_face_is_what_the_contract_promises():
    names = {"ExperimentError", "FmuError", "OrchError", "Run", "RunError", "StoreError", "open_run", "run"}
    assert set(orchestrator.__all__) == names | {"__version__"}
    assert all(getattr(orchestrator, name) is not None for name in orchestrator.__all__)


def test_the_version_is_written_once():
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "orchestrator.version.__version__"}
