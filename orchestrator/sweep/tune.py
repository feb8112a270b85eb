"""Searches the parameters of each controller with optuna: the same number of trials, the same draws, the same seeds.

The first trial of each is its defaults.  A trial runs its draws in quarters, and is pruned where the mean so far is
worse than the median of the earlier trials at that point, or where a run fails.  The sampler of trial n is seeded by
the sweep's seed and n alone, so a study that was interrupted goes on as if it had not been.  At the end the tuned and
the default parameters meet in an ordinary sweep on draws that no trial has seen.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import sys
import warnings
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import ExperimentError, OrchError, StoreError
from ..experiment import load
from ..loop import Interrupt
from ..master import interruptible
from ..provenance import git_commit
from . import cluster, engine, search, study, worker
from .design import Run
from .engine import Ended
from .search import Search
from .storage import Storage
from .study import Job, Study
from .worker import COMPLETED, Line

FOLDER = "_tune"  # in the store, which ignores it: thousands of runs that nobody looks for
RUNGS = 4  # looks at a trial, at most, before it is complete
STARTUP = 5  # trials at random before the sampler learns from them
MISSING = 'tuning needs optuna; pip install "orch[sweep,tune]"'

Told = Callable[[str, int, int, float], None]  # controller, trials that ended, of how many, the best objective


@dataclass(frozen=True)
class Tuned:
    """What came of one controller.  default, best: objectives on the trials' draws, nan where no trial completed."""

    fmu: str
    parameters: Mapping[str, Any]
    default: float
    best: float
    trials: int
    pruned: int


@dataclass(frozen=True)
class Outcome:
    """folder: of the study and the fragments; final: the sweep on held-out draws, None where it was interrupted."""

    tune_id: str
    folder: Path
    tuned: list[Tuned]
    final: Ended | None


def tune(
    path: str | Path,
    set: Mapping[str, Any] | None = None,
    swap: Mapping[str, str] | None = None,
    packaging: str = "auto",
    results: str = "results",
    scheduler: str | None = None,
    workers: int | None = None,
    note: Callable[[str], None] = lambda _: None,
    told: Told = lambda *_: None,
    swept: engine.Told = lambda *_: None,
) -> Outcome:
    """Tune, and compare.  note: called with what a user should know; told, swept: with the progress.

    Raises ExperimentError with all problems, OrchError without optuna or Dask.
    """
    _optuna()
    asked = load(path, set, swap)
    spec, problems = search.read(asked.sweep, asked.metrics)
    if problems:
        raise ExperimentError(path, [*asked.problems, *problems])
    made = _study(path, set, swap, packaging, spec, note)
    if "://" in results:
        raise StoreError(f"--results {results}: the study is a database; give a folder of this machine")
    tune_id = _identity(made, spec)
    folder = Path(results).resolve() / FOLDER / f"{made.experiment.path.stem}-{tune_id}"
    storage = Storage(str(folder))
    facts = {"git_commit": git_commit(made.experiment.path.parent), "command": json.dumps(sys.argv)}
    job = replace(made.job(results, facts), folder=storage.address, keep="metrics")
    with engine.locked(storage), interruptible() as pressed:
        engine.lay_out(made, storage)
        with cluster.client(scheduler, workers) as client:
            if scheduler is None:
                client.run(cluster.deaf)
            tuned = _search(client, job, made, spec, folder, pressed, told, note)
    if pressed.is_set():
        return Outcome(tune_id, folder, tuned, None)
    _write(folder, spec, tuned)
    final = _compare(path, set, swap, packaging, spec, tuned, note)
    return Outcome(tune_id, folder, tuned, engine.sweep(final, results, scheduler, workers, told=swept))


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise OrchError(MISSING) from None
    optuna.logging.set_verbosity(logging.ERROR)
    return optuna


def _study(
    path: str | Path, set: Mapping[str, Any] | None, swap: Mapping[str, str] | None, packaging: str, spec: Search,
    note: Callable[[str], None],
) -> Study:  # fmt: skip
    """The sweep that trials are drawn from: the controllers, each with the middle of its space, on the first draws."""
    changed = _replaced(path, set, swap, spec, list(spec.spaces), [_middle(s) for s in spec.spaces.values()])
    return study.prepare(path, {**changed, "sweep.draws": spec.draws}, swap, packaging, note)


def _replaced(
    path: str | Path, set: Mapping[str, Any] | None, swap: Mapping[str, str] | None, spec: Search, fmus: list[str],
    parameters: list[dict[str, Any]], titles: list[str] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """`set` for a sweep of controllers with parameters, in place of the lists of the file; its distributions stay."""
    table = load(path, set, swap).sweep
    drawn = {key: value for key, value in table.get("vary", {}).items() if isinstance(value, dict)}
    lists: dict[str, Any] = {"title": titles} if titles else {}
    lists |= {f"components.{spec.component}.fmu": fmus, f"components.{spec.component}.parameters": parameters}
    kept = {key: value for key, value in table.items() if key not in ("vary", "zip")}
    return {**(set or {}), "sweep": {**kept, "vary": {**lists, **drawn}, "zip": [list(lists)]}}


def _middle(space: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Some value of each parameter, to check that it is one."""
    return {name: d["values"][0] if d["distribution"] == "choice" else d["low"] for name, d in space.items()}


def _identity(made: Study, spec: Search) -> str:
    """What makes two studies the same: not the number of trials, which more may be added to."""
    text = json.dumps([made.sweep_id, spec.objective, spec.goal, spec.draws, spec.spaces], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[: study.ID_LENGTH]


def _search(
    client: Any, job: Job, made: Study, spec: Search, folder: Path, pressed: Interrupt, told: Told,
    note: Callable[[str], None],
) -> list[Tuned]:  # fmt: skip
    """All controllers at once, each a sequence of trials."""
    from distributed import wait
    from distributed.scheduler import KilledWorker

    optuna = _optuna()
    patient = {"connect_args": {"timeout": 60}}  # s
    storage = optuna.storages.RDBStorage(f"sqlite:///{folder / 'study.sqlite'}", engine_kwargs=patient)
    token = cluster.token()
    searches = {
        fmu: _Trials(optuna, storage, fmu, space, made, spec, job, note) for fmu, space in spec.spaces.items()
    }
    asking = {fmu: one.run() for fmu, one in searches.items()}
    asked = {fmu: next(generator, None) for fmu, generator in asking.items()}
    answers: dict[str, dict[int, Line]] = {fmu: {} for fmu in searches}
    flying: dict[Any, tuple[str, Run]] = {}

    def submit(fmu: str) -> None:
        for run in asked[fmu] or ():
            flying[client.submit(worker.batch, token, job, [run], False, pure=False)] = fmu, run

    for fmu in searches:
        submit(fmu)
    while flying and not pressed.is_set():
        try:
            wait(list(flying), timeout=0.2, return_when="FIRST_COMPLETED")
        except TimeoutError:
            continue
        for future in [future for future in flying if future.done()]:
            fmu, run = flying.pop(future)
            try:
                lines = future.result()
            except KilledWorker:
                lines = []
            answers[fmu][run.index] = lines[0] if lines else Line(run.index, status=worker.FAILED)
            if len(answers[fmu]) == len(asked[fmu] or ()):
                got, answers[fmu] = answers[fmu], {}
                try:
                    asked[fmu] = asking[fmu].send(got)
                    submit(fmu)
                except StopIteration:
                    asked[fmu] = None
                told(fmu, searches[fmu].ended, spec.trials, searches[fmu].best)
    if pressed.is_set():
        client.run(worker.interrupt, token)
        wait(list(flying), timeout=cluster.PATIENCE)
    return [one.tuned() for one in searches.values()]


class _Trials:
    """The study of one controller."""

    def __init__(
        self, optuna: Any, storage: Any, fmu: str, space: Mapping[str, Mapping[str, Any]], made: Study, spec: Search,
        job: Job, note: Callable[[str], None],
    ):  # fmt: skip
        self._optuna, self._space, self._spec, self._fmu = optuna, space, spec, fmu
        self._key = f"components.{spec.component}"
        self._draws = [run.values for run in made.design.runs() if run.values[f"{self._key}.fmu"] == fmu]
        self._seed = made.design.seed
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # experimental parts of optuna say that they are
            self._study = optuna.create_study(
                storage=storage, study_name=fmu, direction=spec.goal, load_if_exists=True,
                pruner=optuna.pruners.MedianPruner(n_startup_trials=4),
            )  # fmt: skip
        states = optuna.trial.TrialState
        self._ended = states.COMPLETE, states.PRUNED
        for trial in self._study.get_trials(deepcopy=False, states=(states.RUNNING, states.WAITING)):
            if trial.state == states.WAITING:
                trial = self._study.ask()
            self._study.tell(trial.number, state=states.FAIL)  # it was interrupted
        self._defaults = _defaults(made, spec, fmu)
        outside = [name for name, value in self._defaults.items() if not _lies_in(self._space[name], value)]
        if outside:
            note(f"{fmu}: the defaults of {', '.join(outside)} lie outside of what is searched, which begins elsewhere")
            self._defaults = {}

    @property
    def ended(self) -> int:
        return len(self._study.get_trials(deepcopy=False, states=self._ended))

    @property
    def best(self) -> float:
        completed = self._study.get_trials(deepcopy=False, states=self._ended[:1])
        return float(self._study.best_value) if completed else math.nan

    def run(self) -> Generator[list[Run], dict[int, Line], None]:
        """Asks for runs, is sent how they ended; returns when all trials have ended."""
        while (number := self.ended) < self._spec.trials:
            # One start for all controllers, and the same one when the study is resumed.
            digest = hashlib.sha256(f"{self._seed}/trial/{number}".encode()).digest()
            self._study.sampler = self._optuna.samplers.TPESampler(
                seed=int.from_bytes(digest[:4], "big"), n_startup_trials=STARTUP
            )
            if number == 0 and self._defaults:
                self._study.enqueue_trial(self._defaults)
            trial = self._study.ask()
            parameters = {name: _suggest(trial, name, entry) for name, entry in self._space.items()}
            yield from self._judge(trial, parameters)

    def _judge(self, trial: Any, parameters: dict[str, Any]) -> Generator[list[Run], dict[int, Line], None]:
        """Run a trial's draws, rung by rung."""
        values: list[float] = []
        rung = -(-len(self._draws) // RUNGS)
        state = self._optuna.trial.TrialState
        while len(values) < len(self._draws):
            chosen = range(len(values), min(len(values) + rung, len(self._draws)))
            lines = yield [Run(i, i, {**self._draws[i], f"{self._key}.parameters": parameters}) for i in chosen]
            values += [self._spec.value(lines[i].metrics) if lines[i].status == COMPLETED else math.nan for i in chosen]
            if not all(map(math.isfinite, values)):
                self._study.tell(trial, state=state.PRUNED)
                return
            trial.report(math.fsum(values) / len(values), len(values))
            if len(values) < len(self._draws) and trial.should_prune():
                self._study.tell(trial, state=state.PRUNED)
                return
        self._study.tell(trial, math.fsum(values) / len(values))

    def tuned(self) -> Tuned:
        complete = self._study.get_trials(deepcopy=False, states=self._ended[:1])
        best = self._study.best_trial if complete else None
        first = next((t for t in complete if self._defaults and t.params == self._defaults), None)
        return Tuned(self._fmu, dict(best.params) if best else {}, float(first.value) if first else math.nan, self.best,
                     self.ended, self.ended - len(complete))  # fmt: skip


def _suggest(trial: Any, name: str, entry: Mapping[str, Any]) -> Any:
    match entry["distribution"]:
        case "choice":
            return trial.suggest_categorical(name, entry["values"])
        case "integer":
            return trial.suggest_int(name, entry["low"], entry["high"])
    return trial.suggest_float(name, entry["low"], entry["high"], log=entry["distribution"] == "loguniform")


def _defaults(made: Study, spec: Search, fmu: str) -> dict[str, Any]:
    """What the FMU itself has for the parameters that are searched; {} where one of them is no single number."""
    from ..fmu import read

    described = read(made.files[made.fmus[fmu]])
    found = {}
    for name, entry in spec.spaces[fmu].items():
        if name not in described.variables:
            return {}
        start = described.variables[name].initial
        found[name] = int(start) if entry["distribution"] == "integer" else start
    return found


def _lies_in(entry: Mapping[str, Any], value: Any) -> bool:
    if entry["distribution"] == "choice":
        return value in entry["values"]
    return bool(entry["low"] <= value <= entry["high"])


def _write(folder: Path, spec: Search, tuned: list[Tuned]) -> None:
    """A fragment for each controller's experiment, and one for a sweep of all."""
    for one in tuned:
        lines = [f"# Tuned by orch: {_objective(spec)} {one.best:.6g}, with the defaults {one.default:.6g}.",
                 f"[components.{spec.component}]", f"fmu = {json.dumps(one.fmu)}",
                 f"parameters = {_toml(one.parameters)}"]  # fmt: skip
        _save(folder / f"{Path(one.fmu).stem}.toml", lines)
    key = f"components.{spec.component}"
    _save(folder / "tuned.toml", [
        "# Tuned by orch: each controller with its parameters, to be swept.", "[sweep]",
        f'zip = [["{key}.fmu", "{key}.parameters"]]', "", "[sweep.vary]",
        f'"{key}.fmu" = {_toml([one.fmu for one in tuned])}',
        f'"{key}.parameters" = [', *(f"    {_toml(one.parameters)}," for one in tuned), "]",
    ])  # fmt: skip


def _objective(spec: Search) -> str:
    return " + ".join(name if w == 1.0 else f"{w:g} {name}" for name, w in spec.objective.items())


def _save(path: Path, lines: list[str]) -> None:
    try:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise StoreError(f"{path} cannot be written: {error.strerror}") from None


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items()) + " }" if value else "{}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


def _compare(
    path: str | Path, set: Mapping[str, Any] | None, swap: Mapping[str, str] | None, packaging: str, spec: Search,
    tuned: list[Tuned], note: Callable[[str], None],
) -> Study:  # fmt: skip
    """The sweep of tuned and default parameters on draws that no trial has seen."""
    both: list[tuple[str, str, dict[str, Any]]] = [(one.fmu, one.fmu, {}) for one in tuned]
    both += [(f"{one.fmu} tuned", one.fmu, dict(one.parameters)) for one in tuned if one.parameters]
    titles, fmus, parameters = [b[0] for b in both], [b[1] for b in both], [b[2] for b in both]
    changed = _replaced(path, set, swap, spec, fmus, parameters, titles)
    held = {"sweep.draws": spec.held_out, "sweep.skip": spec.draws}
    return study.prepare(path, {**changed, **held}, swap, packaging, note)
