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

import hashlib
import json
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import StoreError, no_such_file
from ...fmu.archive import DAMAGED

FORMAT, FORMAT_VERSION = "orch-checkpoint", 1
ABOUT, VALUES = "checkpoint.json", "values.json"


@dataclass(frozen=True)
class Checkpoint:
    """One that was read.  `about`, `components`: the two JSON files, components by name; `states`: serialized, by
    component; `fresh`: components that are reinitialized instead of going on."""

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
        fresh = f"; reinitialized: {', '.join(self.fresh)}" if self.fresh else ""
        return f"run {self.run_id} at t = {self.time:.10g} s{fresh}"


def path_of(record: Path, time: float) -> Path:
    """Where the checkpoint of a record lies.  time: s."""
    return record.with_name(f"{record.stem}.at-{repr(time).removesuffix('.0')}.checkpoint")


def plain(kind: str, value: Any) -> Any:
    """A value as JSON holds it, every bit."""
    if kind == "string":
        return value.decode("utf-8", "surrogateescape")
    return value.hex() if kind == "binary" else value.item()


def value_of(kind: str, plain: Any) -> Any:
    """What `plain` gave, as it was."""
    if kind == "string":
        return plain.encode("utf-8", "surrogateescape")
    return bytes.fromhex(plain) if kind == "binary" else plain


def digest_of(values: bytes, states: Iterable[bytes]) -> str:
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
                raise StoreError(f"{path} is not a checkpoint of orch")
            about = json.loads(archive.read(ABOUT))
            if about["format"] != FORMAT:
                raise StoreError(f"{path} is not a checkpoint of orch")
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
        what = "damaged" if zipfile.is_zipfile(path) else "not a checkpoint of orch, or one that was cut off"
        raise StoreError(f"{path} is {what}: {error}") from None
    except (*DAMAGED, KeyError, TypeError) as error:
        raise StoreError(f"{path} is not a checkpoint of orch, or damaged: {error}") from None
    if about.get("digest") != digest_of(values, states):
        raise StoreError(f"{path} is damaged: its content does not have the digest that it names")
    names = [component["name"] for component in components]
    return Checkpoint(path, about, dict(zip(names, components, strict=True)), dict(zip(names, states, strict=True)))
