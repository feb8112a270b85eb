"""The attributes of a record that are known before the run starts."""

from __future__ import annotations

import contextlib
import datetime
import json
import math
import os
import platform
import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...plan.plan import Plan
from .format import FORMAT, FORMAT_VERSION

PACKAGES = ("orch", "numpy", "h5py", "FMPy", "pythonfmu", "casadi")


def attributes_of(plan: Plan, run_id: str, facts: Mapping[str, Any]) -> dict[str, Any]:
    """{attribute: value}.  facts: those that are known already, in place of those that would be determined here."""
    experiment = plan.experiment
    attributes = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "run_id": run_id,
        "title": experiment.title,
        "status": "running",
        "error": "",
        "created": _now(),
        "wall_time": math.nan,
        "real_time_factor": math.nan,
        "algorithm": experiment.master.algorithm,
        "step": experiment.master.step,
        "experiment": experiment.path.stem,
        "experiment_toml": experiment.text,
        "experiment_resolved": json.dumps(plan.resolved),
        "versions": facts["versions"] if "versions" in facts else json.dumps(versions()),
        "git_commit": facts["git_commit"] if "git_commit" in facts else git_commit(experiment.path.parent),
        "Conventions": "CF-1.11",
        "digest": plan.digest,
        "command": json.dumps(sys.argv),
        "platform": platform.platform(),
        "pid": os.getpid(),
        "hostname": socket.gethostname(),
        "metrics": "{}",
        "metrics_never": "[]",
        "metrics_of": "steps",
        "metric_units": json.dumps(
            {s: plan.units[s] for spec in experiment.metrics.values() if (s := spec["signal"]) in plan.units}
        ),
        "warnings": "[]",
        "warning_kinds": "[]",
        "timing": "{}",
        "experiment_path": str(experiment.path.resolve()),
        "changes": json.dumps(experiment.changes),
        "model_descriptions": json.dumps(
            {component.fmu.sha256: component.fmu.description_xml for component in plan.components}
        ),
    }
    if experiment.master.seed is not None:
        attributes["seed"] = experiment.master.seed
    if plan.origin:
        attributes |= plan.origin.attributes
    return {**attributes, **facts}


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide the numbers."""
    import importlib.metadata

    result = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            result[package] = importlib.metadata.version(package)
    return result


def git_commit(folder: Path) -> str:
    """The commit of the experiment's folder, with "-dirty" if files differ from it; "" without git."""
    command = ["git", "-C", str(folder), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
