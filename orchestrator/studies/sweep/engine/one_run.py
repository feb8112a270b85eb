"""One run of a sweep, from its plan to its record."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ....plan.plan import Plan
from ....records.file.format import ID_LENGTH
from ....records.file.recorder import Recorder, writing
from ....runs import half_step
from ....simulation.bursts import Bursts
from ....simulation.master import run as run_master
from ....simulation.system import FmuSource, System
from ....watch import Interrupt

DECIMATED = 500  # rows of a decimated record, the first not counted, at most


def perform(
    plan: Plan, path: Path, keep: str, facts: Mapping[str, str], interrupt: Interrupt, source: FmuSource
) -> Recorder:
    """Run a plan into a record at `path`.  Returns the finished record, with its outcome and metrics.

    keep: which rows, "full", "decimated" (every n-th) or "metrics" (none).  Metrics are those of all steps.
    facts: root attributes that are known already.  Raises OrchError where nothing started.
    """
    kept = reduced(plan, keep)
    known = {**facts, "digest": plan.digest, "experiment_resolved": json.dumps(plan.resolved)}
    if keep != "full":
        known["kept"] = keep
    stepped = plan if keep == "metrics" else kept
    with (
        System.open(stepped, interrupt.is_set, source=source) as system,
        writing(path, kept, plan.digest[:ID_LENGTH], facts=known) as record,
    ):
        bursts = Bursts(system)
        writers = [] if keep == "metrics" else [record]
        record.outcome = run_master(system, writers, interrupt, bursts=bursts, outcome=record.outcome)
        record.flush()
        half_step.judge(plan, record.outcome, bursts, interrupt, source)
    return record


def reduced(plan: Plan, keep: str) -> Plan:
    """The plan whose rows are those that are kept."""
    if keep == "full":
        return plan
    if keep == "metrics":
        return replace(plan, recorded=())
    record = plan.experiment.record
    n = next(n for n in range(1, plan.steps // plan.stride + 1) if _divides(n, plan.steps // plan.stride))
    every = plan.experiment.grid.time(n * plan.stride)
    return replace(plan, experiment=replace(plan.experiment, record=replace(record, every=every)))


def _divides(n: int, rows: int) -> bool:
    return rows % n == 0 and rows // n <= DECIMATED


def last_tick(plan: Plan, stopped_at: float | None) -> int:
    """The tick at which a complete run ended.  stopped_at: when an FMU ended it [s], None where none did."""
    return plan.steps if stopped_at is None else round(stopped_at / plan.experiment.master.step)


def rows_of(plan: Plan, keep: str, last: int) -> int:
    """How many rows a complete record has.  last: the tick at which the run ended."""
    return 0 if keep == "metrics" else last // reduced(plan, keep).stride + 1
