"""Checkpoints: a run saved at a time, from which others go on.

A checkpoint is a zip archive, uncompressed: `checkpoint.json` says what it is and holds the experiment, `values.json`
what the components had computed and were given, `states/<n>` the serialized state of component n as its FMU wrote it.
Its digest is that of the values and states: the same run saved again gives the same digest.

    checkpoint.json  format, format_version, digest, run_id, time [s], tick, created, versions, experiment (its path),
                     experiment_toml, changes, master
    values.json      [component]: name, fmu, fmu_sha256, packaging, period, parameters, start, and by variable:
                     values (in the table), given (the inputs), computed (outputs that are not visible yet among them)
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import io
import json
import os
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import FmuError, StoreError, no_such_file
from ...fmu.archive import DAMAGED
from ...instances.instance import CallFailed
from ...simulation.stepper import ComponentFailed, Stepper

if TYPE_CHECKING:
    from ...simulation.system import System

FORMAT, FORMAT_VERSION = "orch-checkpoint", 1
ABOUT, VALUES = "checkpoint.json", "values.json"


@dataclass(frozen=True)
class Checkpoint:
    """One that was read.  `about`, `components`: the two JSON files, components by name; `states`: serialized, by
    component; `fresh`: components that begin anew instead of going on."""

    path: Path
    about: Mapping[str, Any]
    components: Mapping[str, Mapping[str, Any]]
    states: Mapping[str, bytes]
    fresh: tuple[str, ...] = ()

    @property
    def tick(self) -> int:
        return int(self.about["tick"])

    @property
    def time(self) -> float:
        """s"""
        return float(self.about["time"])

    @property
    def run_id(self) -> str:
        return str(self.about["run_id"])

    @property
    def summary(self) -> dict[str, Any]:
        """What decides the numbers of a run that goes on from here."""
        return {
            "run_id": self.run_id,
            "time": self.time,
            "checkpoint_sha256": self.about["digest"],
            "fresh": list(self.fresh),
        }

    @property
    def attributes(self) -> dict[str, Any]:
        """What the record of such a run says of it."""
        return {"from_run": self.run_id, "from_time": self.time, "from_file": str(self.path.resolve())}

    def __str__(self) -> str:
        anew = f"; begun anew: {', '.join(self.fresh)}" if self.fresh else ""
        return f"run {self.run_id} at t = {self.time:.10g} s{anew}"


def path_of(record: Path, time: float) -> Path:
    """Where the checkpoint of a record lies.  time: s."""
    return record.with_name(f"{record.stem}.at-{repr(time).removesuffix('.0')}.checkpoint")


def save(system: System, tick: int, run_id: str, path: Path) -> None:
    """Write the checkpoint of a running system.

    Raises ComponentFailed where a component does not give its state, StoreError where the file cannot be written.
    """
    from ...records.file.provenance import versions

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
        "digest": _digest(values.encode(), states),
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
        name: _plain(kinds[name], tables[kinds[name]][place])
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
        "values": values,
        "given": _of_buffers(stepper.inputs),
        "computed": _of_buffers(stepper.outputs),
    }


def _of_buffers(exchanges: Sequence[Any]) -> dict[str, Any]:
    return {
        variable.name: _plain(e.kind, value)
        for e in exchanges
        for variable, value in zip(e.variables, e.buffer, strict=True)
    }


def _plain(kind: str, value: Any) -> Any:
    """A value as JSON holds it, every bit."""
    if kind == "string":
        return value.decode("utf-8", "surrogateescape")
    return value.hex() if kind == "binary" else value.item()


def value_of(kind: str, plain: Any) -> Any:
    """What `_plain` gave, as it was."""
    if kind == "string":
        return plain.encode("utf-8", "surrogateescape")
    return bytes.fromhex(plain) if kind == "binary" else plain


def _digest(values: bytes, states: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for content in (values, *states):
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()


def open_checkpoint(path: str | Path) -> Checkpoint:
    """Raises StoreError where it is none, damaged, or of another format."""
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
                raise StoreError(f"{path} is no checkpoint of orch")
            about = json.loads(archive.read(ABOUT))
            if about["format"] != FORMAT:
                raise StoreError(f"{path} is no checkpoint of orch")
            if about["format_version"] != FORMAT_VERSION:
                raise StoreError(
                    f"{path} is a checkpoint of format {about['format_version']}, and this orch reads "
                    f"format {FORMAT_VERSION}: make it again with this orch"
                )
            values = archive.read(VALUES)
            components = json.loads(values)
            states = [archive.read(f"states/{number}") for number in range(len(components))]
    except FileNotFoundError:
        raise StoreError(f"{path}: {no_such_file(path, '.checkpoint')}") from None
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror or error}") from None
    except zipfile.BadZipFile as error:
        what = "damaged" if zipfile.is_zipfile(path) else "no checkpoint of orch, or one that was cut off"
        raise StoreError(f"{path} is {what}: {error}") from None
    except (*DAMAGED, KeyError, TypeError) as error:
        raise StoreError(f"{path} is no checkpoint of orch, or damaged: {error}") from None
    if about.get("digest") != _digest(values, states):
        raise StoreError(f"{path} is damaged: its content does not have the digest that it names")
    names = [component["name"] for component in components]
    return Checkpoint(path, about, dict(zip(names, components, strict=True)), dict(zip(names, states, strict=True)))
