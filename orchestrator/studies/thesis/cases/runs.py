"""Runs the thesis's cases in parallel, except those that the store has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ....errors import RunError, StoreError
from ....experiment.reader import load
from ....plan.plan import Plan
from ....records.file.run import Run
from ....records.store.folder import Store
from ....runs.prepare import Report, build_models
from ....runs.runner import not_stored
from ... import processes
from ...progress import CommandProgress
from .chapter5 import CASES, Case


@dataclass(frozen=True, kw_only=True)
class CaseRecord:
    """A case that has run.  metrics: those of its experiment file."""

    case: Case
    plan: Plan
    path: Path
    metrics: Mapping[str, float]
    warnings: tuple[str, ...]


def run_cases(cases: Sequence[Case], results: str | Path, report: Report) -> list[CaseRecord]:
    """Run what the store lacks, in parallel.  Returns the records in the order of `cases`.

    report: called with each model that is built and each case that has run.
    Raises OrchError where a case cannot run, RunError where one fails.
    """
    build_models({c.fmu: "auto" for case in CASES.values() for c in load(case.path).components}, report)
    plans = [case.plan() for case in cases]
    store = Store(results)
    missing = {p.digest: (c, p) for c, p in zip(cases, plans, strict=True) if _completed(store, p) is None}
    counted = f"{len(missing)} of {len({plan.digest for plan in plans})} runs to do"
    report(counted if missing else f"all {len(plans)} runs are in the store")
    commands = [processes.command_of(case.key, plan, results) for case, plan in missing.values()]
    processes.run_plans(commands, CommandProgress(len(commands), report))
    return [_record(case, plan, store) for case, plan in zip(cases, plans, strict=True)]


def _completed(store: Store, plan: Plan) -> Path | None:
    """The completed record of a plan with all of its metrics, None where it has to run."""
    _, path = store.place(plan.experiment.path.stem, plan.digest)
    if not path.exists():
        return None
    try:
        with Run(path) as run:
            return path if run.status == "completed" and not not_stored(path, plan) else None
    except (StoreError, KeyError):
        return None


def _record(case: Case, plan: Plan, store: Store) -> CaseRecord:
    path = _completed(store, plan)
    if path is None:
        raise RunError(f"{case.key}: its run completed, but the store has no record of it")
    with Run(path) as run:
        warnings = tuple(run.attributes["warnings"])
        return CaseRecord(case=case, plan=plan, path=path, metrics=run.metrics, warnings=warnings)
