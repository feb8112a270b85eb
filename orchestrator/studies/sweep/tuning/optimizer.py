"""Searches the parameters of each controller with optuna: the same number of trials, the same draws, the same seeds.

At the end the tuned and the default parameters meet in an ordinary sweep on draws that no trial has seen.
"""

from __future__ import annotations

import hashlib
import json
import logging
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ....errors import ExperimentError, OrchError, StoreError
from ....experiment.experiment import load
from ....records.file.provenance import git_commit
from ....simulation.loop import Interrupt
from ....simulation.master import interruptible
from ..design import study
from ..design.matrix import Run
from ..design.study import Job, Study
from ..engine import cluster, worker
from ..engine import scheduler as engine
from ..engine.scheduler import Ended
from ..engine.storage import Storage
from ..engine.worker import Line
from . import search
from .search import Search
from .trials import Trials, Tuned

FOLDER = "_tune"  # in the store, which ignores it: thousands of runs that nobody looks for
MISSING = 'tuning needs optuna; pip install "orch[sweep,tune]"'

Told = Callable[[str, int, int, float], None]  # controller, trials that ended, of how many, the best objective


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
    path: str | Path,
    set: Mapping[str, Any] | None,
    swap: Mapping[str, str] | None,
    packaging: str,
    spec: Search,
    note: Callable[[str], None],
) -> Study:
    """The sweep that trials are drawn from: the controllers, each with the middle of its space, on the first draws."""
    changed = _replaced(path, set, swap, spec, list(spec.spaces), [_middle(s) for s in spec.spaces.values()])
    return study.prepare(path, {**changed, "sweep.draws": spec.draws}, swap, packaging, note)


def _replaced(
    path: str | Path,
    set: Mapping[str, Any] | None,
    swap: Mapping[str, str] | None,
    spec: Search,
    fmus: list[str],
    parameters: list[dict[str, Any]],
    titles: list[str] | None = None,
) -> dict[str, Any]:
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
    client: Any,
    job: Job,
    made: Study,
    spec: Search,
    folder: Path,
    pressed: Interrupt,
    told: Told,
    note: Callable[[str], None],
) -> list[Tuned]:
    """All controllers at once, each a sequence of trials."""
    from distributed import wait
    from distributed.scheduler import KilledWorker

    optuna = _optuna()
    patient = {"connect_args": {"timeout": 60}}  # s
    storage = optuna.storages.RDBStorage(f"sqlite:///{folder / 'study.sqlite'}", engine_kwargs=patient)
    token = cluster.token()
    searches = {fmu: Trials(optuna, storage, fmu, space, made, spec, note) for fmu, space in spec.spaces.items()}
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


def _write(folder: Path, spec: Search, tuned: list[Tuned]) -> None:
    """A fragment for each controller's experiment, and one for a sweep of all."""
    for one in tuned:
        lines = [
            f"# Tuned by orch: {_objective(spec)} {one.best:.6g}, with the defaults {one.default:.6g}.",
            f"[components.{spec.component}]",
            f"fmu = {json.dumps(one.fmu)}",
            f"parameters = {_toml(one.parameters)}",
        ]
        _save(folder / f"{Path(one.fmu).stem}.toml", lines)
    key = f"components.{spec.component}"
    _save(
        folder / "tuned.toml",
        [
            "# Tuned by orch: each controller with its parameters, to be swept.",
            "[sweep]",
            f'zip = [["{key}.fmu", "{key}.parameters"]]',
            "",
            "[sweep.vary]",
            f'"{key}.fmu" = {_toml([one.fmu for one in tuned])}',
            f'"{key}.parameters" = [',
            *(f"    {_toml(one.parameters)}," for one in tuned),
            "]",
        ],
    )


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
    path: str | Path,
    set: Mapping[str, Any] | None,
    swap: Mapping[str, str] | None,
    packaging: str,
    spec: Search,
    tuned: list[Tuned],
    note: Callable[[str], None],
) -> Study:
    """The sweep of tuned and default parameters on draws that no trial has seen."""
    both: list[tuple[str, str, dict[str, Any]]] = [(one.fmu, one.fmu, {}) for one in tuned]
    both += [(f"{one.fmu} tuned", one.fmu, dict(one.parameters)) for one in tuned if one.parameters]
    titles, fmus, parameters = [b[0] for b in both], [b[1] for b in both], [b[2] for b in both]
    changed = _replaced(path, set, swap, spec, fmus, parameters, titles)
    held = {"sweep.draws": spec.held_out, "sweep.skip": spec.draws}
    return study.prepare(path, {**changed, **held}, swap, packaging, note)
