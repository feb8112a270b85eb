"""Writes the record of a run: one HDF5 file, written while the run goes on.  The format is described in docs/record.md.

HDF5 does not survive a write that fails: the file no longer opens, the process may crash.  So room on the disk is
reserved before anything is written, and a little of it is always left for saying why a run ended.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from .errors import StoreError
from .hdf5 import attach, create, describe
from .loop import Block
from .master import Outcome
from .metrics import finite
from .plan import Plan
from .provenance import attributes_of
from .store import HEARD, being_written, first_line, patiently
from .variables import DTYPES, Variable

CHUNK_ROWS = 1024
FLUSH_SECONDS = 1.0
ROOM = 1 << 16  # bytes kept free in the file for its last attributes
HEADER = 1 << 12  # bytes that a signal takes without its values, and a node of its index, at most
REFERENCE = np.dtype([("dataset", h5py.ref_dtype), ("dimension", np.int32)])
STORED = {"boolean": np.int8, "truth": np.int8, "string": h5py.string_dtype()}  # the others as they are


class Recorder:
    """Writes a record.  Rows reach the disk at least every second of wall time, a time only when its row is there.

    Raises StoreError where the file is there already or cannot be written.
    """

    def __init__(self, path: Path, plan: Plan, run_id: str, facts: Mapping[str, Any] | None = None):
        """facts: root attributes that are known already, in place of those that would be found out."""
        self.path, self._plan = path, plan
        self._waiting: list[Block] = []
        self._rows = 0
        self.ticks = plan.first  # of the last row on disk
        attributes = attributes_of(plan, run_id, facts or {})
        size = HEADER * (2 + len(plan.parts) + len(plan.recorded)) + 4 * sum(len(str(v)) for v in attributes.values())
        _claim(path, size + ROOM)
        try:
            # v108: later formats mark an open file so that it does not open after a kill.
            self.file = patiently(lambda: h5py.File(path, "w", libver=("earliest", "v108"), track_order=True))
            with self._room(size):
                self._create(attributes)
        except BaseException:
            self.abandon()
            path.unlink(missing_ok=True)
            raise
        self._began = self._flushed = time.monotonic()

    def rows(self, block: Block) -> None:
        if block.ticks[0] == self._plan.first:
            self._began = time.monotonic()
        self._waiting.append(block)
        if time.monotonic() - self._flushed >= FLUSH_SECONDS:
            self.flush()

    def progress(self, tick: int) -> None:
        if tick >= self._plan.steps and time.monotonic() - self._began > FLUSH_SECONDS:
            self.flush()  # now: a paced run still has time

    def flush(self) -> None:
        """Write what is waiting: first every signal, then, when those are on disk, the times."""
        blocks, self._waiting = self._waiting, []
        self._flushed = time.monotonic()
        if not blocks:
            return
        ticks = [tick for block in blocks for tick in block.ticks]
        first, last = self._rows, self._rows + len(ticks)
        with self._room(self._size(last, blocks)):
            for kind, datasets in self._datasets.items():
                rows = np.concatenate([block.values[kind] for block in blocks])
                columns, column = np.ascontiguousarray(rows.T), 0
                for dataset in datasets:
                    n = math.prod(dataset.shape[1:])
                    _append(dataset, first, columns[column : column + n])
                    column += n
            self.file.flush()
            grid = self._plan.experiment.grid
            _append(self._time, first, np.array([[grid.time(tick) for tick in ticks]]))
        self._rows, self.ticks = last, ticks[-1]

    def finish(self, outcome: Outcome) -> tuple[float, float]:
        """Write how the run ended; the file stays open for metrics.  Returns wall time [s] and real-time factor."""
        wall_time = time.monotonic() - self._began
        grid = self._plan.experiment.grid
        simulated = grid.time(outcome.ticks) - grid.time(self._plan.first)
        factor = simulated / wall_time if wall_time else math.inf
        attributes: dict[str, Any] = {
            "error": outcome.error,
            "wall_time": wall_time,
            "real_time_factor": factor,
            "warnings": json.dumps(outcome.warnings),
            "timing": json.dumps(outcome.timing),
        }
        calculated = {component: json.dumps(values) for component, values in outcome.calculated.items()}
        for name in ("failed_at", "stopped_at"):
            if getattr(outcome, name) is not None:
                attributes[name] = getattr(outcome, name)
        if outcome.last_inputs:
            attributes["last_inputs"] = json.dumps({k: str(v) if v != v else v for k, v in outcome.last_inputs.items()})
        heard = sum(16 + values.nbytes for values_of in outcome.heard.values() for _, values in values_of)
        texts = [*map(str, attributes.values()), *calculated.values()]
        with self._room(2 * sum(map(len, texts)) + HEADER * len(calculated) + 2 * heard):
            self.file.attrs.update(attributes)
            for component, text in calculated.items():
                self.file[component].attrs["calculated"] = text
            self._keep_heard(outcome)
        return wall_time, factor

    def _keep_heard(self, outcome: Outcome) -> None:
        """What components heard from outside, wherever it changed."""
        for component, heard in outcome.heard.items():
            if heard:
                group = self.file.create_group(f"{HEARD}/{component}")
                times = group.create_dataset("time", data=np.array([t for t, _ in heard]), fletcher32=True)
                times.make_scale("time")
                values = group.create_dataset("values", data=np.array([values for _, values in heard]), fletcher32=True)
                axis = group.create_dataset("values_dim1", data=np.arange(1, values.shape[1] + 1))
                axis.make_scale("values_dim1")
                _attach_scales(values, [times, axis])

    def close(self, status: str, metrics: Mapping[str, float] | None = None) -> None:
        """The last thing written is the status."""
        text = json.dumps(finite(metrics or {}))
        with self._room(len(text) if metrics else 0):
            self.file.attrs["metrics"] = text
            self.file.flush()
            self.file.attrs["status"] = status
        with self._writing():
            size = self.file.id.get_filesize()
            self.file.close()
            if self.path.stat().st_size > size:
                os.truncate(self.path, size)

    def abandon(self) -> None:
        """Let go of a file that can no longer be written; what was flushed stays readable."""
        with contextlib.suppress(Exception):
            self.file.close()

    @contextlib.contextmanager
    def _room(self, size: int) -> Iterator[None]:
        """Reserve room on the disk for `size` bytes and ROOM more, write, flush; ROOM stays."""
        with self._writing():
            descriptor, end = self.file.id.get_vfd_handle(), self.file.id.get_filesize
            if size:
                _reserve(descriptor, self.path, end() + size + ROOM)
            yield
            self.file.flush()
            if size:
                os.ftruncate(descriptor, end() + ROOM)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:  # h5py: RuntimeError from a failed flush
            raise _cannot_write(self.path, error) from None

    def _size(self, last: int, blocks: list[Block]) -> int:
        """How many bytes the rows up to `last` take at most: new chunks, their places in the index, texts."""
        datasets = [self._time, *(dataset for group in self._datasets.values() for dataset in group)]
        values = 0
        for dataset in datasets:
            rows = dataset.chunks[0]
            chunks = -(-last // rows) - -(-self._rows // rows)
            values += chunks * (math.prod(dataset.chunks) * dataset.dtype.itemsize + HEADER)
        texts = [text for block in blocks if "string" in block.values for text in block.values["string"].flat]
        return int(values) + sum(len(text) + 32 for text in texts)

    def _create(self, attributes: Mapping[str, Any]) -> None:
        plan, file = self._plan, self.file
        describe(file, attributes)
        rows = plan.steps // plan.stride + 1
        self._time = _dataset(file, "time", np.dtype(np.float64), rows)
        self._time.make_scale("time")
        self._time.attrs.update({"units": "s", "long_name": "simulated time"})
        for part in plan.parts:
            group = file.create_group(part.name, track_order=True)
            describe(
                group,
                {"fmu": part.fmu_name, "fmu_sha256": part.fmu.sha256, "fmi_version": part.fmu.fmi_version,
                 "packaging": part.fmu.packaging, "parameters": json.dumps(dict(part.parameters))},
            )  # fmt: skip
        self._datasets: dict[str, list[Any]] = {}
        references = []
        for component, variable, shape in _datasets_of(plan):
            group, name = file[component], variable.array if shape else variable.name
            dataset = _dataset(group, name, np.dtype(STORED.get(variable.kind, DTYPES[variable.kind])), rows, shape)
            attributes = {"units": variable.unit or "1", "long_name": variable.description or name,
                          "causality": variable.causality}  # fmt: skip
            describe(dataset, attributes)
            scales = [group.create_dataset(f"{name}_dim{i}", data=np.arange(1, n + 1)) for i, n in enumerate(shape, 1)]
            for i, scale in enumerate(scales, 1):
                scale.make_scale(f"{name}_dim{i}")
                scale.attrs.create("REFERENCE_LIST", np.array([(dataset.ref, i)], dtype=REFERENCE))
            _attach_scales(dataset, [self._time, *scales])
            references.append((dataset.ref, 0))
            self._datasets.setdefault(variable.kind, []).append(dataset)
        if references:  # the other half of attach_scale, for all signals at once
            self._time.attrs.create("REFERENCE_LIST", np.array(references, dtype=REFERENCE))


def _datasets_of(plan: Plan) -> Iterator[tuple[str, Variable, tuple[int, ...]]]:
    """Component, first variable and shape of each dataset: an array that is recorded whole is one."""
    recorded = {(component, variable.name) for component, variable in plan.recorded}
    fmus = {part.name: part.fmu for part in plan.parts}
    for component, variable in plan.recorded:
        if not all((component, element.name) in recorded for element in fmus[component].elements(variable)):
            yield component, variable, ()
        elif not variable.element:
            yield component, variable, variable.shape


def _claim(path: Path, size: int) -> None:
    """Create the file, which no one else may have, where there is room for `size` bytes.  Raises StoreError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)
        except FileExistsError:
            raise being_written(path) from None
        try:
            _reserve(descriptor, path, size)
        except OSError:
            os.close(descriptor)
            path.unlink()
            raise
        os.close(descriptor)
    except OSError as error:
        raise _cannot_write(path, error) from None


def _reserve(descriptor: int, path: Path, size: int) -> None:
    """Make the file `size` bytes long, with blocks behind them.  Raises OSError where the disk is full."""
    if hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(descriptor, 0, size)
            return
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):  # not every file system can
                raise
    if shutil.disk_usage(path.parent).free < size - os.fstat(descriptor).st_size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _dataset(group: Any, name: str, dtype: Any, rows: int, shape: tuple[int, ...] = ()) -> Any:
    """An empty dataset of at most `rows`, each of a `shape`.

    Bounded, for h5netcdf looks through all signals to learn the length of an unlimited dimension: minutes for 500.
    """
    chunk = max(1, min(rows, CHUNK_ROWS // max(1, math.prod(shape))))
    return create(
        group, name, shape=(0, *shape), maxshape=(rows, *shape), dtype=dtype, chunks=(chunk, *shape),
        fletcher32=h5py.check_string_dtype(dtype) is None, track_order=True,
    )  # fmt: skip


def _append(dataset: Any, first: int, columns: Any) -> None:
    """Write rows from `first` on, to the new end.  columns: (values of a row, rows)."""
    last = first + columns.shape[1]
    values = columns[0] if dataset.ndim == 1 else np.ascontiguousarray(columns.T).reshape(-1, *dataset.shape[1:])
    dataset.id.set_extent((last, *dataset.shape[1:]))
    if values.dtype.kind == "O":
        dataset[first:last] = values
        return
    if values.dtype.kind == "b":  # HDF5 turns no truth into a number
        values = values.view(np.int8)
    # What h5py's dataset[first:last] does, in a third of the time.
    space = dataset.id.get_space()
    space.select_hyperslab((first,) + (0,) * (values.ndim - 1), values.shape)
    dataset.id.write(h5py.h5s.create_simple(values.shape), space, values)


def _attach_scales(dataset: Any, scales: Sequence[Any]) -> None:
    """Write DIMENSION_LIST directly: h5py's attach_scale takes quadratic time in the number of signals."""
    value = np.empty((len(scales),), dtype=object)
    for i, scale in enumerate(scales):
        value[i] = np.array([scale.ref], dtype=h5py.ref_dtype)
    attach(dataset, "DIMENSION_LIST", value, h5py.vlen_dtype(h5py.ref_dtype))


def _cannot_write(path: Path, error: BaseException) -> StoreError:
    number = getattr(error, "errno", None)
    reason = os.strerror(number) if number else first_line(error)
    return StoreError(f"{path} cannot be written: {reason}")
