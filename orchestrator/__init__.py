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


_HOMES = {"run": "runs.runner", "Run": "records.file.run", "open_run": "records.store.folder"}


def __getattr__(name: str) -> Any:
    """Import the rest at its first use: the command line needs little of it, and fast."""
    import importlib

    if name not in _HOMES:
        raise AttributeError(f"module 'orchestrator' has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    """What completion offers: the public names."""
    return __all__
