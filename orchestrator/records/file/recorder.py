"""Writes the record of a run: one HDF5 file, written while the run goes on.  docs/record.md describes the format."""

from __future__ import annotations

import contextlib
import json
import math
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ... import metrics
from ...errors import RunError, StoreError
from ...fmu.variables import DTYPES
from ...plan.plan import Plan
from ...simulation.observer import Block, Observer, Outcome
from ...warning import kinds_of
from ...watch import at_halt, doing
from .datasets import TIME, DatasetSpec, datasets_of, envelope_of, image
from .format import HEARD
from .hdf5 import attach_scales, create_attributes, image_of, in_memory, overwrite_attributes, write_rows
from .provenance import attributes_of
from .room import ReservedFile

FLUSH_SECONDS = 1.0
WRITING = 5.0  # s that a write has to end at a second Ctrl-C
HEADER = 1 << 12  # bytes that a dataset takes without its values, and a node of its index, at most


@contextlib.contextmanager
def writing(
    path: Path,
    plan: Plan,
    run_id: str,
    *,
    facts: Mapping[str, Any] | None = None,
) -> Iterator[Recorder]:
    """The record of a run, from its first byte to its status: the one way from a plan to a record.

    The body runs the plan, with the recorder among its observers, and leaves how it ended in `recorder.outcome`.  Then
    the rows that wait are written, how the run ended, the metrics of a completed run, and last its status.  A record
    that cannot be written any further (StoreError) makes the run a failed one, and says so.

    facts: root attributes that are known already, in place of those that would be determined here.

    Raises StoreError where the file exists or cannot be created, and RunError where not even the end of the run can be
    written.  After any other exception, what was flushed stays readable.
    """
    recorder = Recorder(path, plan, run_id, facts or {})
    try:
        try:
            with at_halt(recorder.halt):
                yield recorder
                recorder.finish()
        except StoreError as error:
            recorder.give_up(error)
    except BaseException:
        recorder.abandon()
        raise


class Recorder(Observer):
    """Writes the rows that it sees.  They reach the disk at least every second of wall time, a time only after its row.
    See `writing`.

    When the record is finished, `outcome`, `wall_time` [s], `real_time_factor` and `metrics` are those in it.
    """

    def __init__(self, path: Path, plan: Plan, run_id: str, facts: Mapping[str, Any]):
        self.path, self._plan = path, plan
        self.outcome = Outcome(ticks=plan.first)
        self.wall_time = self.real_time_factor = math.nan
        self.metrics: Mapping[str, float] = {}
        self._waiting: list[Block] = []
        self._writing = threading.Lock()
        self._rows, self._tick = 0, plan.first  # on disk, and of the last one of them
        specs, self._envelope, self._most = datasets_of(plan), envelope_of(plan), plan.steps // plan.stride + 1
        names = tuple(component.name for component in plan.components)
        with in_memory(image(names, (*specs, *self._envelope), self._most)) as file:
            _describe(file, plan, attributes_of(plan, run_id, facts))
            content = image_of(file)
        self._reserved = ReservedFile(path, content)
        self._file = self._reserved.file
        self._datasets = {s: h5py.h5d.open(self._file.id, s.path.encode()) for s in (TIME, *specs, *self._envelope)}
        self._specs: dict[str, list[DatasetSpec]] = {}  # by kind, in the order of a block's columns
        for spec in specs:
            self._specs.setdefault(spec.kind, []).append(spec)
        self._began = self._flushed = time.monotonic()
        self._ended: float | None = None  # when the last row was on disk

    def rows(self, block: Block) -> None:
        if block.ticks[0] == self._plan.first:
            self._began = time.monotonic()
        self._waiting.append(block)
        self._ended = None
        if time.monotonic() - self._flushed >= FLUSH_SECONDS:
            self.flush()

    def progress(self, tick: int) -> None:
        if tick >= self._plan.steps and time.monotonic() - self._began > FLUSH_SECONDS:
            self.flush()  # now: a paced run still has time

    def flush(self) -> None:
        """Write the rows that wait: first every signal, then, when those are on disk, the times."""
        blocks, self._waiting = self._waiting, []
        self._flushed = time.monotonic()
        if blocks:
            with self._written():
                self._write(blocks)
        if self._ended is None:
            self._ended = time.monotonic()

    def _write(self, blocks: Sequence[Block]) -> None:
        ticks = [tick for block in blocks for tick in block.ticks]
        first, last = self._rows, self._rows + len(ticks)
        with self._reserved.writing(self._size(self._datasets, last, blocks)):
            for kind, specs in self._specs.items():
                rows = np.concatenate([block.values[kind] for block in blocks])
                columns, column = np.ascontiguousarray(rows.T), 0
                for spec in specs:
                    values = columns[column : column + spec.width]
                    rows_of = np.ascontiguousarray(values.T).reshape(-1, *spec.shape) if spec.shape else values[0]
                    write_rows(self._datasets[spec], first, rows_of)
                    column += spec.width
            if self._envelope:
                bounds = np.concatenate([block.bounds for block in blocks])
                for i, spec in enumerate(self._envelope):
                    write_rows(self._datasets[spec], first, np.ascontiguousarray(bounds[:, :, i]))
        times = self._plan.experiment.grid.times(ticks[0], ticks[-1] + 1)
        with self._reserved.writing(self._size([TIME], last)):
            write_rows(self._datasets[TIME], first, times[np.array(ticks) - ticks[0]])
        self._rows, self._tick = last, ticks[-1]

    def finish(self) -> None:
        """Write the rows that wait, how the run ended, and its metrics; the status is written last."""
        self.flush()
        with self._written():
            self._conclude()
            self.metrics = self.outcome.metrics
            self._close()

    @contextlib.contextmanager
    def _written(self) -> Iterator[None]:
        with self._writing:
            doing(f"{self.path} is written", WRITING)
            try:
                yield
            finally:
                doing("")

    def halt(self) -> str:
        """Finish it while another thread never returns: unless that happens to write, then what was flushed stays."""
        if not self._writing.acquire(blocking=False):
            return f"{self.path}: its last rows are not written"
        self._writing.release()
        self.finish()
        return f"{self.path}: {self.outcome.error or self.outcome.status}"

    def give_up(self, error: StoreError) -> None:
        """Close a record that could not be written further, as that of a failed run.

        Raises RunError where not even that is possible.
        """
        failed_at = self._plan.experiment.grid.time(self._tick)
        self.outcome = Outcome(status="failed", ticks=self._tick, error=str(error), failed_at=failed_at)
        self.metrics = {}
        try:
            self._conclude()
            self._close()
        except StoreError:
            words = "the record holds the rows written before, and does not say how the run ended"
            raise RunError(f"{error}; {words}") from None

    def abandon(self) -> None:
        """Let go of a file that can no longer be written; what was flushed stays readable."""
        self._reserved.abandon()

    def _conclude(self) -> None:
        """Write how the run ended."""
        outcome, grid = self.outcome, self._plan.experiment.grid
        self.wall_time = (self._ended or time.monotonic()) - self._began
        simulated = grid.time(outcome.ticks) - grid.time(self._plan.first)
        self.real_time_factor = simulated / self.wall_time if self.wall_time else math.inf
        known: dict[str, str | float] = {
            "error": outcome.error,
            "wall_time": self.wall_time,
            "real_time_factor": self.real_time_factor,
            "warnings": json.dumps(outcome.warnings),
            "warning_kinds": json.dumps(kinds_of(outcome.warnings)),
            "timing": json.dumps(outcome.timing),
        }
        new: dict[str, Any] = {}
        calculated = {component: json.dumps(values) for component, values in outcome.calculated.items()}
        for name in ("failed_at", "stopped_at"):
            if getattr(outcome, name) is not None:
                new[name] = getattr(outcome, name)
        if outcome.status == "interrupted":
            new["interrupted_at"] = grid.time(outcome.ticks)
        if outcome.traceback:
            new["traceback"] = outcome.traceback
        if outcome.last_inputs:
            new["last_inputs"] = json.dumps({k: str(v) if v != v else v for k, v in outcome.last_inputs.items()})
        heard = sum(16 + values.nbytes for values_of in outcome.heard.values() for _, values in values_of)
        texts = [*map(str, (*known.values(), *new.values())), *calculated.values()]
        with self._reserved.writing(2 * sum(map(len, texts)) + HEADER * (1 + len(calculated)) + 2 * heard):
            overwrite_attributes(self._file, known)
            create_attributes(self._file, new)
            for component, text in calculated.items():
                overwrite_attributes(self._file[component], {"calculated": text})
            self._write_heard()

    def _write_heard(self) -> None:
        """Write what components heard from outside, at each change."""
        for component, heard in self.outcome.heard.items():
            if heard:
                group = self._file.create_group(f"{HEARD}/{component}")
                times = group.create_dataset("time", data=np.array([t for t, _ in heard]), fletcher32=True)
                times.make_scale("time")
                values = group.create_dataset("values", data=np.array([values for _, values in heard]), fletcher32=True)
                axis = group.create_dataset("values_dim1", data=np.arange(1, values.shape[1] + 1))
                axis.make_scale("values_dim1")
                attach_scales(values, [times, axis])

    def _close(self) -> None:
        text = json.dumps(metrics.finite(self.metrics))
        never = json.dumps([name for name, value in self.metrics.items() if value == math.inf])
        with self._reserved.writing(len(text) + len(never) if self.metrics else 0):
            overwrite_attributes(self._file, {"metrics": text, "metrics_never": never})
        with self._reserved.writing(0):
            overwrite_attributes(self._file, {"status": self.outcome.status})
        self._reserved.close()

    def _size(self, specs: Iterable[DatasetSpec], last: int, blocks: Sequence[Block] = ()) -> int:
        """How many bytes the rows up to `last` take at most: new chunks, their places in the index, texts."""
        size = 0
        for spec in specs:
            chunk = spec.chunk(self._most)
            chunks = -(-last // chunk[0]) - -(-self._rows // chunk[0])
            size += chunks * (math.prod(chunk) * np.dtype(DTYPES[spec.kind]).itemsize + HEADER)
        texts = [text for block in blocks if "string" in block.values for text in block.values["string"].flat]
        return size + sum(len(text) + 32 for text in texts)


def _describe(file: h5py.File, plan: Plan, attributes: Mapping[str, Any]) -> None:
    create_attributes(file, attributes)
    for component in plan.components:
        facts = {
            "fmu": component.fmu_name,
            "fmu_sha256": component.fmu.sha256,
            "fmi_version": component.fmu.fmi_version,
            "packaging": component.fmu.packaging,
            "parameters": json.dumps(dict(component.parameters)),
        }
        if component.fmu.data_files:
            facts["data_files"] = json.dumps(dict(component.fmu.data_files))
        if any(v.causality == "calculatedParameter" for v in component.fmu.variables.values()):
            facts["calculated"] = "{}"
        create_attributes(file[component.name], facts)
