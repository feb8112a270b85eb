"""Searches the parameters of each controller with optuna: the same number of trials, the same draws, the same seeds.

At the end an ordinary sweep compares the tuned and the default parameters on draws that no trial has seen.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import logging
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ....errors import ExperimentError, OrchError, StoreError
from ....experiment import toml
from ....experiment.sweep import read as read_sweep
from ....experiment.tune import TuneSpec
from ....experiment.tune import read as read_tune
from ....files import write_text
from ....records.file.provenance import git_commit
from ....runs.prepare import Report, load_experiment
from ....watch import Interrupt, interruptible
from ..design.matrix import DesignPoint
from ..design.prepared import ID_LENGTH, PreparedSweep, SweepJob, prepare_as
from ..engine import cluster, worker
from ..engine import scheduler as engine
from ..engine.scheduler import SweepResult
from ..engine.storage import Storage
from ..engine.worker import PointResult
from . import designs
from .designs import SearchDesign
from .trials import ControllerSearch, TunedController

if TYPE_CHECKING:
    from distributed import Client, Future

TUNED = "tuned.toml"
FOLDER = "_tune"  # in the store, whose lists leave out such names: thousands of runs of no interest by themselves
MISSING = 'tuning needs optuna; pip install "orch[sweep,tune]"'

TrialEnded = Callable[[str, int, int, float], None]  # controller, trials that ended, of how many, the best objective


@dataclass(frozen=True)
class TuneResult:
    """folder: of the study and the fragments; notes: what a user should know; final: the sweep on held-out draws, None
    where it was interrupted."""

    tune_id: str
    folder: Path
    tuned: list[TunedController]
    notes: list[str]
    final: SweepResult | None


def tune(
    path: str | Path,
    set: Mapping[str, Any] | None = None,
    swap: Mapping[str, str] | None = None,
    packaging: str = "auto",
    results: str = "results",
    scheduler: str | None = None,
    workers: int | None = None,
    report: Report = lambda _: None,
    trial_ended: TrialEnded = lambda *_: None,
    runs_ended: engine.RunsEnded = lambda *_: None,
) -> TuneResult:
    """Tune, and compare.  report: called with what a user should know; trial_ended, runs_ended: with the progress.

    Raises ExperimentError with all problems, OrchError without optuna or Dask.
    """
    _optuna()
    experiment = load_experiment(path, set, swap)
    spec, problems = read_tune(experiment.sweep, experiment.metrics)
    problems = [problem for problem in problems if problem not in experiment.problems]
    if problems or any(problem.key.startswith("sweep") for problem in experiment.problems):
        raise ExperimentError(path, [*experiment.problems, *problems])
    search, problems = designs.design(spec, read_sweep(experiment.sweep)[0], experiment.changes["set"])
    if problems:
        raise ExperimentError(path, [*experiment.problems, *problems])
    experiment = replace(experiment, changes={**experiment.changes, "set": search.set})
    trials = prepare_as(experiment, search.trials(), packaging, report)
    notes = [*search.notes, *trials.notes]
    for note in notes:
        report(f"note: {note}")
    if "://" in results:
        raise StoreError(f"--results {results}: the study is a database; give a folder of this machine")
    tune_id = _identity(trials, spec)
    folder = Path(results).resolve() / FOLDER / f"{experiment.path.stem}-{tune_id}"
    storage = Storage(str(folder))
    facts = {"git_commit": git_commit(experiment.path.parent), "command": json.dumps(sys.argv)}
    job = replace(trials.job(results, facts), folder=storage.address, keep="metrics")
    with engine.locked(storage), interruptible() as pressed:
        engine.lay_out(trials, storage)
        with cluster.client(scheduler, workers) as client:
            if scheduler is None:
                client.run(cluster.ignore_ctrl_c)
            tuned = _search(client, job, trials, search, folder, pressed, trial_ended, report)
    if pressed.is_set():
        return TuneResult(tune_id, folder, tuned, notes, None)
    _write(folder, search, tuned)
    for note in (note for one in tuned for note in _remarks(one)):
        notes.append(note)
        report(f"note: {note}")
    comparison = search.comparison({one.fmu: one.parameters for one in tuned})
    final = prepare_as(experiment, comparison, packaging, report)
    swept = engine.sweep(final, results, scheduler, workers, runs_ended=runs_ended)
    return TuneResult(tune_id, folder, tuned, notes, swept)


def _remarks(one: TunedController) -> Iterator[str]:
    """What a user should know of a controller's trials."""
    for why, n in one.refused.items():
        yield f"{one.fmu}: {n} trials do not count: {why}"
    if not one.parameters:
        yield f"{one.fmu}: no trial completed, so it is not tuned"


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise OrchError(MISSING) from None
    optuna.logging.set_verbosity(logging.ERROR)
    return optuna


def _identity(trials: PreparedSweep, spec: TuneSpec) -> str:
    """What makes two studies the same: not the number of trials, which more may be added to."""
    text = json.dumps([trials.sweep_id, spec.objective, spec.goal, spec.draws, spec.spaces], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:ID_LENGTH]


def _search(
    client: Client,
    job: SweepJob,
    prepared: PreparedSweep,
    search: SearchDesign,
    folder: Path,
    pressed: Interrupt,
    trial_ended: TrialEnded,
    report: Report,
) -> list[TunedController]:
    """Search all controllers at once, each in a sequence of trials."""
    from distributed import wait
    from distributed.scheduler import KilledWorker

    optuna, spec = _optuna(), search.spec
    patient = {"connect_args": {"timeout": 60}}  # s
    storage = optuna.storages.RDBStorage(f"sqlite:///{folder / 'study.sqlite'}", engine_kwargs=patient)
    token = cluster.token()
    searches = {fmu: ControllerSearch(optuna, storage, fmu, prepared, search, report) for fmu in spec.spaces}
    asking = {fmu: one.run() for fmu, one in searches.items()}
    asked = {fmu: next(generator, None) for fmu, generator in asking.items()}
    answers: dict[str, dict[int, PointResult]] = {fmu: {} for fmu in searches}
    submitted: dict[Future[list[PointResult]], tuple[str, DesignPoint]] = {}

    def submit(fmu: str) -> None:
        for point in asked[fmu] or ():
            submitted[client.submit(worker.batch, token, job, [point], False, pure=False)] = fmu, point

    for fmu in searches:
        submit(fmu)
    while submitted and not pressed.is_set():
        try:
            wait(list(submitted), timeout=0.2, return_when="FIRST_COMPLETED")
        except TimeoutError:
            continue
        for future in [future for future in submitted if future.done()]:
            fmu, point = submitted.pop(future)
            try:
                results = future.result()
            except KilledWorker:
                results = []
            answers[fmu][point.index] = results[0] if results else PointResult(point.index, status=worker.FAILED)
            if len(answers[fmu]) == len(asked[fmu] or ()):
                got, answers[fmu] = answers[fmu], {}
                try:
                    asked[fmu] = asking[fmu].send(got)
                    submit(fmu)
                except StopIteration:
                    asked[fmu] = None
                trial_ended(fmu, searches[fmu].ended, spec.trials, searches[fmu].best)
    if pressed.is_set():
        cluster.end(client, token)
        with contextlib.suppress(TimeoutError):
            wait(list(submitted), timeout=cluster.PATIENCE)
    return [one.tuned() for one in searches.values()]


def _write(folder: Path, search: SearchDesign, tuned: list[TunedController]) -> None:
    """A fragment for each controller's experiment, and one for a sweep of all."""
    spec, first = search.spec, search.swept.skip
    seen = f"draws {first} to {first + spec.draws - 1} of sweep.seed = {search.swept.seed}"
    for one, name in zip(tuned, _names(one.fmu for one in tuned), strict=True):
        default = f", with the defaults {one.default:.6g}" if math.isfinite(one.default) else ""
        remark = f"# Tuned by orch: {_objective(spec)} {one.best:.6g}{default}, on {seen}:\n"
        remark += f"# compare it on others, such as those from sweep.skip = {first + spec.draws} on.\n"
        if not one.parameters:
            remark = f"# Not tuned: no trial completed on {seen}.\n"
        parameters = search.parameters(one.fmu, one.parameters)
        table = {"components": {spec.component: {"fmu": one.fmu, "parameters": parameters}}}
        write_text(folder / f"{name}.toml", remark + toml.write(table))
    remark = "# Tuned by orch: each controller with its parameters, in place of the experiment's [sweep].\n"
    remark += f"# The search was judged on {seen}, which skip leaves out.\n"
    write_text(folder / TUNED, remark + designs.as_toml(search.tuned({one.fmu: one.parameters for one in tuned})))


def _names(fmus: Iterable[str]) -> list[str]:
    """A file name for each FMU, without suffix."""
    names: list[str] = []
    for stem in (Path(fmu).stem for fmu in fmus):
        others = itertools.chain([stem], (f"{stem}_{k}" for k in itertools.count(2)))
        names.append(next(name for name in others if name not in names and f"{name}.toml" != TUNED))
    return names


def _objective(spec: TuneSpec) -> str:
    return " + ".join(name if w == 1.0 else f"{w:g} {name}" for name, w in spec.objective.items())
