"""orch: a co-simulation bench for underwater-vehicle control.

import orchestrator as orch
run = orch.run("experiments/gripping_currents.toml", set={"master.stop_time": 10.0})
run["vehicle1.eta.x"]          # numpy array; run["vehicle1.eta"] is (N, 6)
run.to_dataframe()             # pandas, indexed by time
orch.open_run("last")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .errors import ExperimentError, FmuError, OrchError, RunError, StoreError
from .version import __version__

if TYPE_CHECKING:
    from .records.file.run import Run
    from .records.store.folder import open_run
    from .runs.runner import run

__all__ = [
    "ExperimentError",
    "FmuError",
    "OrchError",
    "Run",
    "RunError",
    "StoreError",
    "__version__",
    "open_run",
    "run",
]


def __getattr__(name: str) -> Any:
    """Import the rest when it is asked for: the command line needs little of it, and fast."""
    import importlib

    homes = {"run": "runs.runner", "Run": "records.file.run", "open_run": "records.store.folder"}
    if name not in homes:
        raise AttributeError(f"module 'orchestrator' has no attribute {name!r}")
    return getattr(importlib.import_module(f".{homes[name]}", __name__), name)
