"""An experiment from file to record: the path that every command takes."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import experiment as experiments
from . import metrics
from .errors import RunError, StoreError
from .master import Observer
from .master import run as run_master
from .store import ID_LENGTH, Recorder, Run, Store, is_locked, writer_of
from .system import System
from .wiring import Plan, prepare


@dataclass(frozen=True)
class Result:
    """What `orch run` has to say."""

    run_id: str
    file: Path
    status: str
    wall_time: float
    real_time_factor: float
    metrics: Mapping[str, float]
    warnings: Sequence[str] = ()
    error: str = ""
    stopped_at: float | None = None
    repeated: bool = True  # False: the record was already there


def run(
    path: str | Path,
    set: Mapping[str, Any] | None = None,
    swap: Mapping[str, str] | None = None,
    output: str | Path | None = None,
    results: str | Path = "results",
    force: bool = False,
) -> Run:
    """Run an experiment; returns the open record.

    set: {dotted key: value} laid over the file.  swap: {component: FMU}.  output: the file to write, instead of one in
    the store `results`.  force: run again although a completed record is there.
    Raises ExperimentError where it cannot run, RunError, with `.run` open on the record, where it fails.
    """
    plan = prepare(experiments.load(path, set, swap))
    result = execute(plan, output, results, force)
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
) -> Result:
    """Run a resolved plan into its record, unless a completed one is there.  Raises OrchError where nothing started."""
    run_id, final = _place(plan, output, results)
    if output is None and not force and _status(final) == "completed":
        return _recall(run_id, final, plan)
    _refuse_second_writer(final)
    # An earlier record stays until the new one is completed.
    path = _beside(final) if final.exists() else final
    values: Mapping[str, float] = {}
    with System.open(plan) as system:
        recorder = Recorder(path, plan, run_id)
        try:
            outcome = run_master(system, [recorder, *observers])
            wall_time, factor = recorder.finish(outcome)
            if outcome.status == "completed":
                values = metrics.evaluate(Run(path, recorder.file), plan.experiment.metrics)
            recorder.close(outcome.status, values)
        except StoreError as error:
            recorder.abandon()
            raise RunError(f"{error}; the run stopped, and {path} keeps the rows written before") from None
        except BaseException:
            recorder.abandon()
            raise
    if outcome.status == "completed" and path != final:
        os.replace(path, final)
        path = final
    return Result(run_id, path, outcome.status, wall_time, factor, values, outcome.warnings, outcome.error,
                  outcome.stopped_at)  # fmt: skip


def _place(plan: Plan, output: str | Path | None, results: str | Path) -> tuple[str, Path]:
    if output is not None:
        return plan.digest[:ID_LENGTH], Path(output)
    return Store(results).place(plan.experiment.path.stem, plan.digest)


def _status(path: Path) -> str:
    if not path.exists():
        return ""
    try:
        with Run(path) as record:
            return record.status
    except (StoreError, KeyError):
        return "unreadable"


def _recall(run_id: str, path: Path, plan: Plan) -> Result:
    """The record that is already there, with the metrics that the file asks for today."""
    with Run(path) as record:
        attributes = record.attributes
        return Result(
            run_id, path, record.status, attributes["wall_time"], attributes["real_time_factor"],
            metrics.evaluate(record, plan.experiment.metrics), attributes["warnings"], attributes["error"],
            attributes.get("stopped_at"), repeated=False,
        )  # fmt: skip


def _refuse_second_writer(path: Path) -> None:
    for other in [path, *path.parent.glob(f"{path.stem}.*{path.suffix}")]:
        if other.exists() and is_locked(other):
            raise StoreError(f"{other} is being written by {writer_of(other)}; wait for it, or write to another file "
                             "with --output")  # fmt: skip


def _beside(path: Path) -> Path:
    """A free name next to a record that is there."""
    return next(p for n in itertools.count(2) if not (p := path.with_name(f"{path.stem}.{n}{path.suffix}")).exists())
