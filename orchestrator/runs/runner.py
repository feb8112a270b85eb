"""An experiment from file to record: the path that every command takes."""

from __future__ import annotations

import glob
import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import h5py

from ..errors import RunError, StoreError
from ..plan.plan import Plan
from ..records.file.access import UNREADABLE, being_written, is_taken
from ..records.file.format import ID_LENGTH
from ..records.file.recorder import writing
from ..records.file.run import Run
from ..records.store.folder import Store
from ..simulation.bursts import Bursts
from ..simulation.initialization import initialize
from ..simulation.master import run as run_master
from ..simulation.observer import Observer
from ..simulation.system import Context, System
from ..watch import interruptible
from . import half_step
from .checkpoint.file import Checkpoint
from .checkpoint.observer import CheckpointObserver, paths_of, ticks_of
from .checkpoint.resume import resume
from .prepare import prepare


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """How a run ended, and its record."""

    run_id: str
    file: Path
    status: str
    wall_time: float
    real_time_factor: float
    metrics: Mapping[str, float]
    warnings: Sequence[str] = ()
    error: str = ""
    ended_at: float  # s, until when its metrics are
    stopped_at: float | None = None
    repeated: bool = True  # False: the record existed already
    added: Sequence[str] = ()  # metrics for which a completed record was repeated, as it did not have them
    checkpoints: Sequence[Path] = ()
    last_inputs: Mapping[str, Any] = field(default_factory=dict)  # of the component that failed
    timing: Mapping[str, Any] = field(default_factory=dict)  # as the record has it


def run(
    path: str | Path | None = None,
    set: Mapping[str, Any] | None = None,
    swap: Mapping[str, str] | None = None,
    output: str | Path | None = None,
    results: str | Path = "results",
    force: bool = False,
    packaging: str = "auto",
    checkpoint_at: Sequence[float] = (),
    start_from: str | Path | None = None,
) -> Run:
    """Run an experiment; returns the open record.

    set: {dotted key: value} laid over the file.  swap: {component: FMU}.  output: the file to write, instead of one in
    the store `results`.  force: run again although a completed record exists.  packaging: of named models, "native",
    "python", or "auto": native where there is a C compiler.  checkpoint_at: times [s] at which the run is saved beside
    its record.  start_from: a checkpoint to go on from, where no path need be given.
    Raises ExperimentError where it cannot run, StoreError where a checkpoint cannot be read, RunError, with `.run` open
    on the record, where it fails, and KeyboardInterrupt at Ctrl-C, when the record is closed.
    """
    plan = prepare(path, set, swap, packaging=packaging, start_from=start_from)
    result = execute(plan, output, results, force, checkpoints=ticks_of(plan, checkpoint_at))
    if result.status == "interrupted":
        raise KeyboardInterrupt(f"{result.file}: {result.error}")
    record = Run(result.file)
    if result.status == "failed":
        raise RunError(f"{result.file}: {result.error}", record)
    return record


def execute(
    plan: Plan,
    output: str | Path | None = None,
    results: str | Path = "results",
    force: bool = False,
    observers: Sequence[Observer] = (),
    context: Context | None = None,
    checkpoints: Sequence[int] = (),
) -> RunResult:
    """Run a resolved plan into its record, unless a completed one exists.

    context: {component: what a builtin may need of the run}.  checkpoints: ticks at which to save it, see
    `checkpoint.observer.ticks_of`.  Raises OrchError where nothing started.
    """
    run_id, final = _place(plan, output, results)
    due = paths_of(plan, checkpoints, final)
    force = force or not all(path.is_file() for path in due.values())
    added: list[str] = []
    if output is None and not force and _status(final) == "completed":
        added = not_stored(final, plan)
        if not added:
            return _recall(run_id, final, plan)
    _refuse_second_writer(final)
    with interruptible() as interrupt, System.open(plan, interrupt.is_set, context) as system:
        # An earlier record stays until the new one is completed.
        path = _beside(final) if final.exists() else final
        _refuse_second_writer(final)  # one may have begun since, or even ended; one that begins now finds `path` taken
        if output is None and not force and _status(final) == "completed":
            added = not_stored(final, plan)
            if not added:
                return _recall(run_id, final, plan)
        saver = CheckpointObserver(system, run_id, due)
        with writing(path, plan, run_id) as record:
            begin = partial(resume, plan.origin) if isinstance(plan.origin, Checkpoint) else initialize
            bursts = Bursts(system)
            watching = [record, *observers, saver]
            record.outcome = run_master(system, watching, interrupt, begin, bursts, record.outcome)
            record.outcome.warnings += saver.warnings()
            record.flush()
            half_step.judge(plan, record.outcome, bursts, interrupt)
    outcome = record.outcome
    if outcome.status == "completed" and path != final:
        if added:
            _refuse_other_rows(final, path)
        os.replace(path, final)
        path = final
    return RunResult(
        run_id=run_id,
        file=path,
        status=outcome.status,
        wall_time=record.wall_time,
        real_time_factor=record.real_time_factor,
        metrics=record.metrics,
        warnings=outcome.warnings,
        error=outcome.error,
        ended_at=plan.experiment.grid.time(outcome.ticks),
        stopped_at=outcome.stopped_at,
        added=added,
        checkpoints=saver.saved,
        last_inputs=outcome.last_inputs,
        timing=outcome.timing,
    )


def _place(plan: Plan, output: str | Path | None, results: str | Path) -> tuple[str, Path]:
    if output is not None:
        path = Path(output)
        if path.is_dir() or (path.exists() and path.stat().st_size and not h5py.is_hdf5(path)):
            raise StoreError(f"{path} exists and is not a record; it is left as it is: give --output another name")
        return plan.digest[:ID_LENGTH], path
    return Store(results).place(plan.experiment.path.stem, plan.digest)


def _status(path: Path) -> str:
    if not path.exists():
        return ""
    try:
        with Run(path) as record:
            return record.status
    except (StoreError, *UNREADABLE):
        return "unreadable"


def _recall(run_id: str, path: Path, plan: Plan) -> RunResult:
    """The record that exists already, with those of its metrics that the file asks for today."""
    with Run(path) as record:
        attributes, stored = record.attributes, record.metrics
        return RunResult(
            run_id=run_id,
            file=path,
            status=record.status,
            wall_time=attributes["wall_time"],
            real_time_factor=attributes["real_time_factor"],
            metrics={name: stored[name] for name in plan.experiment.metrics},
            warnings=record.warnings,
            error=attributes["error"],
            ended_at=record.ended_at,
            stopped_at=attributes.get("stopped_at"),
            repeated=False,
            timing=attributes["timing"],
        )


def not_stored(path: Path, plan: Plan) -> list[str]:
    """The metrics that a completed record does not have with the definition that they have in the plan."""
    with Run(path) as record:
        stored, definitions = record.metrics, record.resolved.get("metrics", {})
        of_steps = record.metrics_of == "steps"
    wanted = plan.resolved["metrics"]
    return [n for n, spec in wanted.items() if not of_steps or n not in stored or definitions.get(n) != spec]


def _refuse_other_rows(earlier: Path, repeated: Path) -> None:
    """Raises StoreError, and leaves both records, where they do not have the same rows."""
    from ..records.compare.bits import compare  # most runs are not repeated

    with Run(earlier) as then, Run(repeated) as now:
        if difference := compare(then, now, ends=False):
            raise StoreError(
                f"{earlier} was repeated for metrics that it does not have, and the rows are not the same; it stays as "
                f"it was, beside the repeated one, {repeated}\n{difference}"
            )


def _refuse_second_writer(path: Path) -> None:
    for other in [path, *path.parent.glob(f"{glob.escape(path.stem)}.*{path.suffix}")]:
        if other.exists() and is_taken(other):
            raise being_written(other)


def _beside(path: Path) -> Path:
    """A free name next to a record that exists."""
    return next(p for n in itertools.count(2) if not (p := path.with_name(f"{path.stem}.{n}{path.suffix}")).exists())
