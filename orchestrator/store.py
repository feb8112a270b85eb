"""The record of a run: one HDF5 file, written while the run goes on, readable without this project.

    Recorder   writes it: an observer of the loop
    Run        a read-only handle on one
    Store      the folder that holds them, found by run id

The format is described in docs/record.md.
"""

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
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from .errors import StoreError, did_you_mean
from .master import Block, Outcome
from .wiring import Plan

if TYPE_CHECKING:
    import pandas as pd

FORMAT = "orch-run"
FORMAT_VERSION = 1
CHUNK_ROWS = 1024
FLUSH_SECONDS = 1.0
ID_LENGTH = 10
PACKAGES = ("orch", "numpy", "h5py", "FMPy", "pythonfmu", "casadi")


class Recorder:
    """Writes a record.  Rows reach the disk at least every second of wall time, a time only when its row is there.

    Raises StoreError where the file cannot be written.
    """

    def __init__(self, path: Path, plan: Plan, run_id: str):
        self.path, self._plan = path, plan
        self._waiting: list[Block] = []
        self._rows = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # v108: later formats mark an open file so that it does not open after a kill.
            self.file = h5py.File(path, "w", libver=("earliest", "v108"), track_order=True)
            self._create(run_id)
            self.file.flush()
        except OSError as error:
            self.abandon()
            raise _cannot_write(path, error) from None
        self._began = self._flushed = time.monotonic()

    def rows(self, block: Block) -> None:
        if block.ticks[0] == 0:
            self._began = time.monotonic()
        self._waiting.append(block)
        if time.monotonic() - self._flushed >= FLUSH_SECONDS:
            self.flush()

    def progress(self, tick: int) -> None:
        pass

    def flush(self) -> None:
        """Write what is waiting: first every signal, then, when those are on disk, the times."""
        blocks, self._waiting = self._waiting, []
        self._flushed = time.monotonic()
        if not blocks:
            return
        ticks = [tick for block in blocks for tick in block.ticks]
        first, last = self._rows, self._rows + len(ticks)
        try:
            for kind, datasets in self._datasets.items():
                values = np.concatenate([block.values[kind] for block in blocks])
                for column, dataset in enumerate(datasets):
                    dataset.resize((last,))
                    dataset[first:last] = values[:, column]
            self.file.flush()
            grid = self._plan.experiment.grid
            self._time.resize((last,))
            self._time[first:last] = [grid.time(tick) for tick in ticks]
            self.file.flush()
        except OSError as error:
            raise _cannot_write(self.path, error) from None
        self._rows = last

    def finish(self, outcome: Outcome) -> tuple[float, float]:
        """Write the last rows and how the run ended; the file stays open for metrics.

        Returns wall time [s] and real-time factor.
        """
        self.flush()
        wall_time = time.monotonic() - self._began
        simulated = self._plan.experiment.grid.time(outcome.ticks)
        factor = simulated / wall_time if wall_time else math.inf
        attributes: dict[str, Any] = {
            "error": outcome.error,
            "wall_time": wall_time,
            "real_time_factor": factor,
            "warnings": json.dumps(outcome.warnings),
        }
        for name in ("failed_at", "stopped_at"):
            if getattr(outcome, name) is not None:
                attributes[name] = getattr(outcome, name)
        with self._writing():
            self.file.attrs.update(attributes)
        return wall_time, factor

    def close(self, status: str, metrics: Mapping[str, float] | None = None) -> None:
        """The last thing written is the status."""
        with self._writing():
            self.file.attrs["metrics"] = json.dumps(finite(metrics or {}))
            self.file.flush()
            self.file.attrs["status"] = status
            self.file.close()

    def abandon(self) -> None:
        """Let go of a file that can no longer be written; what was flushed stays readable."""
        with contextlib.suppress(Exception):
            self.file.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:  # h5py: RuntimeError from a failed close
            raise _cannot_write(self.path, error) from None

    def _create(self, run_id: str) -> None:
        plan, file = self._plan, self.file
        experiment = plan.experiment
        file.attrs.update(
            {
                "format": FORMAT, "format_version": FORMAT_VERSION, "run_id": run_id, "title": experiment.title,
                "status": "running", "error": "", "created": _now(), "wall_time": math.nan,
                "real_time_factor": math.nan, "algorithm": experiment.master.algorithm,
                "step": experiment.master.step, "experiment": str(experiment.path.stem),
                "experiment_toml": experiment.text, "experiment_resolved": json.dumps(plan.resolved),
                "versions": json.dumps(versions()), "git_commit": git_commit(experiment.path.parent),
                "Conventions": "CF-1.11", "digest": plan.digest, "command": json.dumps(sys.argv),
                "platform": platform.platform(), "pid": os.getpid(), "hostname": socket.gethostname(),
                "metrics": "{}", "warnings": "[]", "timing": "{}",
            }
        )  # fmt: skip
        if experiment.master.seed is not None:
            file.attrs["seed"] = experiment.master.seed
        rows = min(CHUNK_ROWS, plan.steps // plan.stride + 1)
        self._time = _dataset(file, "time", np.float64, rows)
        self._time.make_scale("time")
        self._time.attrs.update({"units": "s", "long_name": "simulated time"})
        for part in plan.parts:
            group = file.create_group(part.name, track_order=True)
            group.attrs.update(
                {"fmu": part.fmu_name, "fmu_sha256": part.fmu.sha256, "fmi_version": part.fmu.fmi_version,
                 "packaging": part.fmu.packaging, "parameters": json.dumps(dict(part.parameters))}
            )  # fmt: skip
        self._datasets: dict[str, list[Any]] = {}
        dtypes = {"real": np.float64, "integer": np.int32, "boolean": np.int8, "string": h5py.string_dtype()}
        references = []
        for component, variable in plan.recorded:
            dataset = _dataset(file[component], variable.name, dtypes[variable.kind], rows)
            attributes = {"units": variable.unit or "1", "long_name": variable.description or variable.name,
                          "causality": variable.causality}  # fmt: skip
            dataset.attrs.update(attributes)
            _attach_scale(dataset, self._time)
            references.append((dataset.ref, 0))
            self._datasets.setdefault(variable.kind, []).append(dataset)
        if references:  # the other half of attach_scale, for all signals at once
            kind = np.dtype([("dataset", h5py.ref_dtype), ("dimension", np.int32)])
            self._time.attrs.create("REFERENCE_LIST", np.array(references, dtype=kind))


def _dataset(group: Any, name: str, dtype: Any, rows: int) -> Any:
    checksum = dtype is not None and h5py.check_string_dtype(np.dtype(dtype)) is None
    return group.create_dataset(
        name, shape=(0,), maxshape=(None,), dtype=dtype, chunks=(rows,), fletcher32=checksum, track_order=True
    )


def _attach_scale(dataset: Any, scale: Any) -> None:
    """Write DIMENSION_LIST directly: h5py's attach_scale takes quadratic time in the number of signals."""
    value = np.empty((1,), dtype=object)
    value[0] = np.array([scale.ref], dtype=h5py.ref_dtype)
    dataset.attrs.create("DIMENSION_LIST", value, dtype=h5py.vlen_dtype(h5py.ref_dtype))


class Run:
    """A read-only handle on a record.

    run["vehicle1.eta.x"] is its (N,) array, run["vehicle1.eta"] the (N, 6) array of a vector, run.time the times [s].
    Raises StoreError where the file is no record.
    """

    def __init__(self, path: str | Path, file: h5py.File | None = None):
        self.path = Path(path)
        try:
            self.file = file or h5py.File(self.path, "r", locking=False)
            is_record = self.file.attrs.get("format") == FORMAT
        except OSError as error:
            raise StoreError(f"{path} cannot be read: {_first_line(error)}") from None
        if not is_record:
            raise StoreError(f"{path} is no record of a run")
        self._length = len(self.file["time"])

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.file.close()

    def __getitem__(self, name: str) -> Any:
        if name in self.signals:
            return self._read(name)
        axes = [s for s in self.signals if s.startswith((name + ".", name + "[")) and "." not in s[len(name) + 1 :]]
        if not axes:
            near = did_you_mean(name, sorted({s.rpartition(".")[0] for s in self.signals}), "recorded")
            raise KeyError(f"{self.path} has no signal {name!r}{near}")
        return np.column_stack([self._read(axis) for axis in axes])

    def _read(self, name: str) -> Any:
        component, _, variable = name.partition(".")
        try:
            return self.file[component][variable][: self._length]
        except OSError as error:
            raise StoreError(f"{self.path}: {name} cannot be read: {_first_line(error)}") from None

    @property
    def time(self) -> Any:
        return self.file["time"][: self._length]

    @property
    def signals(self) -> list[str]:
        """Names of all recorded variables, components in order."""
        if not hasattr(self, "_signals"):
            self._signals = [
                f"{component}.{variable}"
                for component, group in self.file.items()
                if isinstance(group, h5py.Group)
                for variable in group
            ]
        return self._signals

    def units(self, name: str) -> str:
        component, _, variable = name.partition(".")
        return str(self.file[component][variable].attrs["units"])

    @property
    def attributes(self) -> dict[str, Any]:
        """The root attributes, JSON decoded."""
        decoded = {}
        for name, value in self.file.attrs.items():
            is_json = name in ("experiment_resolved", "versions", "metrics", "warnings", "timing", "command")
            decoded[name] = json.loads(value) if is_json else value.item() if isinstance(value, np.generic) else value
        return decoded

    @property
    def status(self) -> str:
        """completed, failed, interrupted, running, or "interrupted (killed)" where nobody writes it any more."""
        status = str(self.file.attrs["status"])
        return "interrupted (killed)" if status == "running" and not is_locked(self.path) else status

    @property
    def run_id(self) -> str:
        return str(self.file.attrs["run_id"])

    @property
    def metrics(self) -> dict[str, float]:
        return {name: math.nan if v is None else float(v) for name, v in self.attributes["metrics"].items()}

    def to_dataframe(self) -> pd.DataFrame:
        """All signals as columns, indexed by time [s]."""
        import pandas as pd

        return pd.DataFrame({name: self._read(name) for name in self.signals}, index=pd.Index(self.time, name="time"))


class Store:
    """A folder of records: FOLDER/<experiment>/<run id>.h5."""

    def __init__(self, folder: str | Path = "results"):
        self.folder = Path(folder)

    def records(self) -> list[Path]:
        """All records, oldest first; folders that begin with _ are ignored."""
        found = [p for p in self.folder.glob("*/*.h5") if not p.parent.name.startswith("_")]
        return sorted(found, key=lambda p: (p.stat().st_mtime_ns, p))

    def find(self, run: str) -> Path:
        """The record that RUN means: a run id, a unique prefix of one, a file, or "last".

        Raises StoreError where it means none, or several.
        """
        if Path(run).is_file():
            return Path(run)
        records = self.records()
        if run == "last":
            if not records:
                raise StoreError(f"{self.folder} holds no record; run an experiment first")
            return records[-1]
        found = [p for p in records if p.stem == run] or [p for p in records if p.stem.startswith(run)]
        if len(found) == 1:
            return found[0]
        if found:
            raise StoreError(f"{run!r} means several records: {', '.join(map(str, found[:6]))}; give more of the id")
        near = did_you_mean(run, [p.stem for p in records], "there are")
        raise StoreError(f"no record {run!r} in {self.folder}{near}")

    def place(self, experiment: str, digest: str) -> tuple[str, Path]:
        """Run id and file of a digest; a file of another digest with the same prefix lengthens the id."""
        for length in range(ID_LENGTH, len(digest) + 1):
            run_id = digest[:length]
            path = self.folder / experiment / f"{run_id}.h5"
            if not path.exists() or _digest_of(path) in ("", digest):
                return run_id, path
        raise AssertionError("two digests cannot share all their digits")


def is_locked(path: Path) -> bool:
    """Whether a process is writing the file: HDF5 holds a lock on it."""
    try:
        with h5py.File(path, "r", locking=True):
            return False
    except BlockingIOError:
        return True
    except OSError:
        return False


def writer_of(path: Path) -> str:
    """Who writes a record, as a phrase."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            return f"process {file.attrs['pid']} on {file.attrs['hostname']}"
    except (OSError, KeyError):
        return "another process"


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide the numbers."""
    import importlib.metadata

    found = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[package] = importlib.metadata.version(package)
    return found


def git_commit(folder: Path) -> str:
    """The commit that the experiment's folder is at, with "-dirty" where files differ from it; "" without git."""
    command = ["git", "-C", str(folder), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def finite(metrics: Mapping[str, float]) -> dict[str, float | None]:
    """The metrics as JSON can hold them: null for what is no number."""
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}


def _digest_of(path: Path) -> str:
    try:
        with h5py.File(path, "r", locking=False) as file:
            return str(file.attrs.get("digest", ""))
    except OSError:
        return ""


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _cannot_write(path: Path, error: BaseException) -> StoreError:
    number = getattr(error, "errno", None)
    reason = os.strerror(number) if number else _first_line(error)
    return StoreError(f"{path} cannot be written: {reason}")


def _first_line(error: BaseException) -> str:
    return str(error).partition("\n")[0]




def open_run(run: str | Path, results: str | Path = "results") -> Run:
    """Open a record: a run id, a unique prefix of one, a file, or "last" in the store `results`.

    Raises StoreError where there is none.
    """
    return Run(Store(results).find(str(run)))
