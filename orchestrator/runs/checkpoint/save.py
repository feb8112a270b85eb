"""Writes the checkpoint of a running system."""

from __future__ import annotations

import contextlib
import datetime
import io
import json
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...errors import FmuError, StoreError
from ...instances.instance import CallFailed
from ...records.file.provenance import versions
from ...simulation.stepper import ComponentFailed, Getter, Setter, Stepper
from ...simulation.system import System
from .file import ABOUT, FORMAT, FORMAT_VERSION, VALUES, digest_of, plain


def save(system: System, tick: int, run_id: str, path: Path) -> None:
    """Write the checkpoint of a running system.

    Raises ComponentFailed where a component does not give its state, StoreError where the file cannot be written.
    """
    plan = system.plan
    experiment, states, components = plan.experiment, [], []
    for stepper in system.steppers:
        try:
            states.append(stepper.instance.save())
        except (CallFailed, FmuError) as error:
            raise ComponentFailed(stepper, f"its state cannot be saved: {error}") from None
        components.append(_facts(system, stepper))
    values = json.dumps(components)
    about = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "digest": digest_of(values.encode(), states),
        "run_id": run_id,
        "time": experiment.grid.time(tick),
        "tick": tick,
        "created": datetime.datetime.now(datetime.UTC).isoformat(),
        "versions": versions(),
        "experiment": str(experiment.path.resolve()),
        "experiment_toml": experiment.text,
        "changes": dict(experiment.changes),
        "master": plan.resolved["master"],
    }
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr(ABOUT, json.dumps(about, indent=1))
        archive.writestr(VALUES, values)
        for number, state in enumerate(states):
            archive.writestr(f"states/{number}", state)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with beside.open("wb") as file:
            file.write(content.getbuffer())
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise StoreError(f"{path} cannot be written: {error.strerror or error}") from None


def _facts(system: System, stepper: Stepper) -> dict[str, Any]:
    component, tables = stepper.component, system.tables
    kinds = {v.name: v.kind for v in component.fmu.variables.values()}
    values = {
        name: plain(kinds[name], tables[kinds[name]][place])
        for (owner, name), place in system.places.items()
        if owner == component.name
    }
    return {
        "name": component.name,
        "fmu": component.fmu_name,
        "fmu_sha256": component.fmu.sha256,
        "packaging": component.fmu.packaging,
        "period": component.period,
        "parameters": dict(component.parameters),
        "start": dict(component.start),
        "tolerance": component.tolerance,
        "values": values,
        "given": _of_buffers(stepper.setters),
        "computed": _of_buffers(stepper.getters),
    }


def _of_buffers(calls: Sequence[Setter] | Sequence[Getter]) -> dict[str, Any]:
    return {
        variable.name: plain(call.kind, value)
        for call in calls
        for variable, value in zip(call.variables, call.buffer, strict=True)
    }
