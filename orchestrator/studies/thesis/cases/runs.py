"""Runs the thesis's cases in parallel, except those that the store has."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from .... import metrics
from ....errors import OrchError, RunError, StoreError
from ....experiment.reader import load
from ....models import build, catalogue
from ....plan.plan import Plan
from ....records.file.run import Run
from ....records.store.folder import Store
from ... import processes
from .chapter5 import CASES, Case

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Record:
    """A case that has run.  metrics: those of its experiment file."""

    case: Case
    plan: Plan
    path: Path
    metrics: Mapping[str, float]
    warnings: tuple[str, ...]


def run_cases(cases: Sequence[Case], results: str | Path, tell: Tell) -> list[Record]:
    """Run what the store lacks, in parallel.  Returns the records in the order of `cases`."""
    build.build(_models(), tell)
    plans = [case.plan() for case in cases]
    store = Store(results)
    missing = {p.digest: (c, p) for c, p in zip(cases, plans, strict=True) if _completed(store, p) is None}
    counted = f"{len(missing)} of {len({plan.digest for plan in plans})} runs to do"
    tell(counted if missing else f"all {len(plans)} runs are in the store")
    jobs = [_job(case, plan, results) for case, plan in missing.values()]
    progress = Progress(len(jobs), tell)
    failed = [done for done in processes.run_all(jobs, progress.told) if done.code]
    if failed:
        message = "\n".join(f"{done.job.name}: {reason(done)}" for done in failed)
        raise (OrchError if all(done.code == OrchError.exit_code for done in failed) else RunError)(message)
    return [_record(case, plan, store) for case, plan in zip(cases, plans, strict=True)]


def _models() -> list[str]:
    """The shipped FMUs that the cases use."""
    models = {component.fmu for case in CASES.values() for component in load(case.path).components}
    return sorted(name for name in models if name in catalogue.known())


def _job(case: Case, plan: Plan, results: str | Path) -> processes.Job:
    sets = [part for key, value in case.sets.items() for part in ("--set", f"{key}={json.dumps(value)}")]
    command = ("-m", "orchestrator.cli.main", "run", str(case.path), "--json", "--results", str(results), *sets)
    return processes.Job(case.key, command, cost=plan.steps * len(plan.components))


def _completed(store: Store, plan: Plan) -> Path | None:
    """The completed record of a plan, None where it has to run."""
    _, path = store.place(plan.experiment.path.stem, plan.digest)
    if not path.exists():
        return None
    try:
        with Run(path) as run:
            return path if run.status == "completed" else None
    except (StoreError, KeyError):
        return None


def _record(case: Case, plan: Plan, store: Store) -> Record:
    path = _completed(store, plan)
    if path is None:
        raise RunError(f"{case.key}: it ran, but the store has no record of it")
    with Run(path) as run:
        warnings = tuple(run.attributes["warnings"])
        return Record(case, plan, path, metrics.evaluate(run, plan.experiment.metrics), warnings)


def reason(done: processes.Done) -> str:
    """What a run that failed said."""
    try:
        return str(json.loads(done.output)["error"])
    except (ValueError, KeyError, TypeError):
        return done.errors.strip() or f"it ended with exit code {done.code}"


class Progress:
    """A line for each job that ends, and on a terminal one that says what runs.  quiet: only the latter."""

    def __init__(self, jobs: int, tell: Tell, quiet: bool = False):
        self._jobs, self._tell, self._quiet, self._ended = jobs, tell, quiet, 0
        self._on = sys.stderr.isatty()

    def told(self, running: list[str], done: processes.Done | None) -> None:
        if done is not None:
            self._ended += 1
            self._show("")
            if not self._quiet or done.code:
                how = f"{done.seconds:.1f} s" if not done.code else f"failed with exit code {done.code}"
                self._tell(f"[{self._ended}/{self._jobs}] {done.job.name}: {how}")
        if running:
            self._show(f"[{self._ended}/{self._jobs}] running: {', '.join(running)}")
        elif self._ended == self._jobs:
            self._show("")

    def _show(self, text: str) -> None:
        if self._on:
            sys.stderr.write(f"\r\x1b[K{text[:110]}")
            sys.stderr.flush()
