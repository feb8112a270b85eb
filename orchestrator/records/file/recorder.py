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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ...errors import StoreError
from ...fmu.variables import DTYPES
from ...metrics import finite
from ...plan.plan import Plan
from ...simulation.observer import Block, Observer, Outcome
from ...warning import kinds_of
from .access import being_written, first_line, patiently
from .datasets import TIME, Signal, attach_scales, image, signals_of
from .format import HEARD
from .hdf5 import LIBVER, describe, image_of, in_memory, restate
from .provenance import attributes_of

FLUSH_SECONDS = 1.0
ROOM = 1 << 16  # bytes kept free in the file for its last attributes
SIGNATURE = 8  # bytes
STATED_END = 40  # place of the end-of-file address, 8 bytes, in a superblock of version 0
STATES = hasattr(os, "pwrite")  # not on Windows, where HDF5 would miss its place in the file
HEADER = 1 << 12  # bytes that a signal takes without its values, and a node of its index, at most


class Recorder(Observer):
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
        signals, self._most = signals_of(plan), plan.steps // plan.stride + 1
        with in_memory(image(tuple(component.name for component in plan.components), signals, self._most)) as file:
            _describe(file, plan, attributes)
            content = image_of(file)
        _claim(path, content)
        self._end = len(content)
        try:
            self.file = patiently(lambda: h5py.File(path, "r+", libver=LIBVER))
            with self._writing():
                _reserve(self.file.id.get_vfd_handle(), path, self._end + ROOM)
            self._datasets = {s: h5py.h5d.open(self.file.id, s.path.encode()) for s in (TIME, *signals)}
            self._signals: dict[str, list[Signal]] = {}  # by kind, in the order of a block's columns
            for signal in signals:
                self._signals.setdefault(signal.kind, []).append(signal)
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
        with self._room(self._size(self._datasets, last, blocks)):
            for kind, signals in self._signals.items():
                rows = np.concatenate([block.values[kind] for block in blocks])
                columns, column = np.ascontiguousarray(rows.T), 0
                for signal in signals:
                    self._append(signal, first, columns[column : column + signal.width])
                    column += signal.width
        times = self._plan.experiment.grid.times(ticks[0], ticks[-1] + 1)
        with self._room(self._size([TIME], last)):
            self._append(TIME, first, times[np.array(ticks) - ticks[0]][np.newaxis])
        self._rows, self.ticks = last, ticks[-1]

    def finish(self, outcome: Outcome) -> tuple[float, float]:
        """Write how the run ended; the file stays open for metrics.  Returns wall time [s] and real-time factor."""
        wall_time = time.monotonic() - self._began
        grid = self._plan.experiment.grid
        simulated = grid.time(outcome.ticks) - grid.time(self._plan.first)
        factor = simulated / wall_time if wall_time else math.inf
        known: dict[str, str | float] = {
            "error": outcome.error,
            "wall_time": wall_time,
            "real_time_factor": factor,
            "warnings": json.dumps(outcome.warnings),
            "warning_kinds": json.dumps(kinds_of(outcome.warnings)),
            "timing": json.dumps(outcome.timing),
        }
        attributes: dict[str, Any] = {}
        calculated = {component: json.dumps(values) for component, values in outcome.calculated.items()}
        for name in ("failed_at", "stopped_at"):
            if getattr(outcome, name) is not None:
                attributes[name] = getattr(outcome, name)
        if outcome.last_inputs:
            attributes["last_inputs"] = json.dumps({k: str(v) if v != v else v for k, v in outcome.last_inputs.items()})
        heard = sum(16 + values.nbytes for values_of in outcome.heard.values() for _, values in values_of)
        texts = [*map(str, (*known.values(), *attributes.values())), *calculated.values()]
        with self._room(2 * sum(map(len, texts)) + HEADER * (1 + len(calculated)) + 2 * heard):
            restate(self.file, known)
            describe(self.file, attributes)
            for component, text in calculated.items():
                restate(self.file[component], {"calculated": text})
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
                attach_scales(values, [times, axis])

    def close(self, status: str, metrics: Mapping[str, float] | None = None) -> None:
        """The last thing written is the status."""
        text = json.dumps(finite(metrics or {}))
        with self._room(len(text) if metrics else 0):
            restate(self.file, {"metrics": text})
        with self._room(0):
            restate(self.file, {"status": status})
        with self._writing():
            self.file.close()
            with self.path.open("r+b") as file:
                file.seek(STATED_END)
                file.truncate(int.from_bytes(file.read(8), "little"))

    def abandon(self) -> None:
        """Let go of a file that can no longer be written; what was flushed stays readable."""
        with contextlib.suppress(Exception):
            self.file.close()

    @contextlib.contextmanager
    def _room(self, size: int) -> Iterator[None]:
        """Reserve room on the disk for `size` bytes and ROOM more, write, flush; ROOM stays.

        Beyond the end that the file states nothing can be read, and HDF5 states it last of all.  The end of the room is
        stated first, so that a kill in the middle of a flush costs nothing.
        """
        with self._writing():
            descriptor = self.file.id.get_vfd_handle()
            if size:
                _reserve(descriptor, self.path, self._end + size + ROOM)
            stated = os.fstat(descriptor).st_size
            _state_end(descriptor, stated)
            yield
            self.file.flush()
            end = _stated_end(descriptor) if STATES else self.file.id.get_filesize()
            self._end = end if end != stated else self._end  # HDF5 states it where it has changed
            _state_end(descriptor, self._end)
            if size:
                os.ftruncate(descriptor, self._end + ROOM)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:  # h5py: RuntimeError from a failed flush
            raise _cannot_write(self.path, error) from None

    def _size(self, signals: Iterable[Signal], last: int, blocks: Sequence[Block] = ()) -> int:
        """How many bytes the rows up to `last` take at most: new chunks, their places in the index, texts."""
        values = 0
        for signal in signals:
            chunk = signal.chunk(self._most)
            chunks = -(-last // chunk[0]) - -(-self._rows // chunk[0])
            values += chunks * (math.prod(chunk) * np.dtype(DTYPES[signal.kind]).itemsize + HEADER)
        texts = [text for block in blocks if "string" in block.values for text in block.values["string"].flat]
        return values + sum(len(text) + 32 for text in texts)

    def _append(self, signal: Signal, first: int, columns: Any) -> None:
        """Write rows from `first` on, to the new end.  columns: (values of a row, rows)."""
        dataset, shape = self._datasets[signal], (columns.shape[1], *signal.shape)
        values = columns[0] if not signal.shape else np.ascontiguousarray(columns.T).reshape(shape)
        dataset.set_extent((first + shape[0], *signal.shape))
        if values.dtype.kind == "O":
            h5py.Dataset(dataset)[first:] = values
            return
        if values.dtype.kind == "b":  # HDF5 turns no truth into a number
            values = values.view(np.int8)
        # What h5py's dataset[first:] does, in a third of the time.
        space = dataset.get_space()
        space.select_hyperslab((first,) + (0,) * len(signal.shape), shape)
        dataset.write(h5py.h5s.create_simple(shape), space, values)


def _describe(file: h5py.File, plan: Plan, attributes: Mapping[str, Any]) -> None:
    describe(file, attributes)
    for component in plan.components:
        facts = {
            "fmu": component.fmu_name,
            "fmu_sha256": component.fmu.sha256,
            "fmi_version": component.fmu.fmi_version,
            "packaging": component.fmu.packaging,
            "parameters": json.dumps(dict(component.parameters)),
        }
        if any(v.causality == "calculatedParameter" for v in component.fmu.variables.values()):
            facts["calculated"] = "{}"
        describe(file[component.name], facts)


def _claim(path: Path, content: bytes) -> None:
    """Create the file, which no one else may have, where there is ROOM after the content.  Raises StoreError.

    HDF5's signature, the first bytes, is written last: until then it is no record for anybody.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            file = path.open("xb")
        except FileExistsError:
            raise being_written(path) from None
        try:
            with file:
                _reserve(file.fileno(), path, len(content) + ROOM)
                file.seek(SIGNATURE)
                file.write(content[SIGNATURE:])
                file.seek(0)
                file.write(content[:SIGNATURE])
                file.truncate(len(content))  # HDF5 would do that, and later
        except OSError:
            path.unlink()
            raise
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
    os.ftruncate(descriptor, size)


def _stated_end(descriptor: int) -> int:
    """Where a file ends by its superblock."""
    return int.from_bytes(os.pread(descriptor, 8, STATED_END), "little")


def _state_end(descriptor: int, end: int) -> None:
    if STATES:
        os.pwrite(descriptor, end.to_bytes(8, "little"), STATED_END)


def _cannot_write(path: Path, error: BaseException) -> StoreError:
    number = getattr(error, "errno", None)
    reason = os.strerror(number) if number else first_line(error)
    return StoreError(f"{path} cannot be written: {reason}")
