"""What a worker does: a batch of runs, one after the other, each into a record of its own."""

from __future__ import annotations

import functools
import json
import platform
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py

from ....errors import OrchError, StoreError
from ....plan.plan import Plan
from ....plan.resolve import resolve
from ....records.file.access import UNREADABLE
from ....records.file.marks import Standing, kinds_of
from ....records.file.provenance import versions
from ....records.file.run import Run
from ....watch import Interrupt, interruptible
from ..design.matrix import DesignPoint
from ..design.prepared import ID_LENGTH, SweepJob
from . import fmu_cache
from .fmu_cache import FmuCache
from .one_run import last_tick, perform, rows_of
from .storage import Storage

COMPLETED, FAILED, MISSING = "completed", "failed", "missing"


@dataclass(frozen=True)
class PointResult:
    """How one run of a sweep ended.

    metrics: those that have a sample, inf where what one is the time of never happens, nan where one has no value.
    stopped_at: when an FMU ended it before its stop time [s]; warnings: their kinds, see `records.file.marks`.
    seconds: of wall time; fresh: False where its record existed.
    """

    index: int
    run_id: str = ""
    status: str = MISSING
    error: str = ""
    metrics: Mapping[str, float] = field(default_factory=dict)
    stopped_at: float | None = None
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    fresh: bool = True

    @property
    def standing(self) -> Standing:
        """Whether its numbers may be compared, and why not."""
        return Standing(status=self.status, stopped_at=self.stopped_at, kinds=self.warnings)


_interrupts: dict[str, Interrupt] = {}
_one_at_a_time = threading.Lock()  # a Dask worker may have several threads, but FMUs are not thread-safe


def batch(token: str, job: SweepJob, points: Sequence[DesignPoint], stop_at_failure: bool) -> list[PointResult]:
    """Run each, unless its record exists, verified and complete; those after an interruption are left out.

    token: of the process that asks for them, see `interrupt`.
    """
    interrupt = _interrupts.setdefault(token, Interrupt())
    storage = Storage(job.folder)
    results: list[PointResult] = []
    for point in points:
        if interrupt.is_set():
            break
        began = time.perf_counter()
        try:
            with _one_at_a_time, interruptible(interrupt, f"run {point.index} of the sweep: "):
                result = _run(job, point, fmu_cache.of_this_process(), storage, interrupt)
        except KeyboardInterrupt:
            break
        except OrchError as error:  # this run cannot start, or its record cannot be written
            result = PointResult(point.index, status=FAILED, error=" ".join(str(error).split()))
        if result.status == "interrupted":
            break
        results.append(replace(result, seconds=time.perf_counter() - began))
        if stop_at_failure and result.status == FAILED:
            break
    return results


def interrupt(token: str) -> None:
    """End the runs that a process has asked for, now and in future."""
    _interrupts.setdefault(token, Interrupt()).set()


def _run(job: SweepJob, point: DesignPoint, cache: FmuCache, storage: Storage, interrupt: Interrupt) -> PointResult:
    plan = plan_of(job, point, cache, storage)
    run_id = plan.digest[:ID_LENGTH]
    name = f"{run_id}.h5"
    if storage.exists(name):
        stored = _stored(storage, name, plan, job.keep)
        if stored is not None:
            return replace(stored, index=point.index, run_id=run_id)
    known = {**_here(), **job.facts, "sweep": storage.address.rpartition("-")[2]}
    with storage.scratch(name) as path:
        record = perform(plan, path, job.keep, known, interrupt, cache)
        if interrupt.is_set():  # its loops may not have been compared with shorter steps: it would count as right
            return PointResult(point.index, status="interrupted")
        storage.put(path, name)
    outcome = record.outcome
    return PointResult(
        point.index,
        run_id,
        outcome.status,
        outcome.error,
        _sampled(plan, record.metrics, outcome.ticks) if outcome.status == COMPLETED else {},
        outcome.stopped_at if outcome.ticks < plan.steps else None,
        kinds_of(outcome.warnings),
    )


def plan_of(job: SweepJob, point: DesignPoint, cache: FmuCache, storage: Storage) -> Plan:
    """The plan of a run, made of the sweep's own FMUs under the names that the experiment gives them."""
    experiment = job.experiment(point)
    places = {c.name: str(cache.fmu(storage, job.fmus[c.fmu])) for c in experiment.components if c.fmu}
    fetched = tuple(replace(c, fmu=places.get(c.name, c.fmu)) for c in experiment.components)
    plan = resolve(replace(experiment, components=fetched), {}, {}, cache.read)
    names = {c.name: c.fmu for c in experiment.components}
    components = tuple(replace(component, fmu_name=names[component.name]) for component in plan.components)
    return replace(plan, experiment=experiment, components=components)


def _sampled(plan: Plan, metrics: Mapping[str, float], last: int) -> dict[str, float]:
    """Those metrics that have a sample.  last: the tick at which the run ended."""
    return {name: value for name, value in metrics.items() if plan.has_sample(name, last)}


def _stored(storage: Storage, name: str, plan: Plan, keep: str) -> PointResult | None:
    """The result in a record that is complete, of this very run, and with these metrics and rows; else None.

    All rows are read, so that HDF5 verifies their checksums.
    """
    try:
        with storage.opened(name) as opened, h5py.File(opened, "r", **_lockless(opened)) as file:
            facts = file.attrs
            if facts["status"] != COMPLETED or facts["digest"] != plan.digest or facts.get("kept", "full") != keep:
                return None
            if json.loads(facts["experiment_resolved"])["metrics"] != _as_json(plan.resolved["metrics"]):
                return None
            rows, last = len(file["time"]), last_tick(plan, facts.get("stopped_at"))
            if rows != rows_of(plan, keep, last):
                return None
            record = Run(Path(name), file)
            if record.metrics_of != "steps":
                return None
            signals = record.signals
            if bool(signals) != (keep != "metrics") or any(len(record[name]) != rows for name in signals):
                return None
            if set(metrics := record.metrics) != set(plan.experiment.metrics):
                return None
            standing = record.standing
            return PointResult(
                0,
                status=COMPLETED,
                metrics=_sampled(plan, metrics, last),
                stopped_at=standing.stopped_at,
                warnings=standing.kinds,
                fresh=False,
            )
    except (StoreError, *UNREADABLE):
        return None


def _lockless(opened: Any) -> dict[str, bool]:
    return {"locking": False} if isinstance(opened, str) else {}


def _as_json(value: Any) -> Any:
    return json.loads(json.dumps(value))


@functools.cache
def _here() -> dict[str, str]:
    """Root attributes that the records of this process share."""
    return {"versions": json.dumps(versions()), "platform": platform.platform()}
