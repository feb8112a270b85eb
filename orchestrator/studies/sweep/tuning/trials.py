"""The trials of one controller: which runs the next trial needs, and whether it is pruned.

The first trial is the controller's defaults.  A trial runs its draws in quarters, and is pruned where the mean so far
is worse than the median of the earlier trials at that point, or where a run cannot be judged: it fails, ends early,
warns that its numbers are wrong, or has no number.  The sampler of trial n is seeded by
the sweep's seed and n alone, so that a study that was interrupted goes on as if it had not been.
"""

from __future__ import annotations

import hashlib
import math
import warnings
from collections import Counter
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any

from ....experiment.tune import Space
from ....fmu.fmu import read
from ....fmu.values import flatten
from ....runs.prepare import Report
from ..design.matrix import DesignPoint
from ..design.prepared import PreparedSweep
from ..engine.worker import PointResult
from .designs import SearchDesign

RUNGS = 4  # looks at a trial, at most, before it is complete
NO_NUMBER = "no number of the objective"
STARTUP = 5  # trials at random before the sampler learns from them

Asking = Generator[list[DesignPoint], dict[int, PointResult], None]  # yields runs, is sent how they ended


@dataclass(frozen=True, kw_only=True)
class TunedController:
    """The result for one controller.

    default, best: objectives on the trials' draws, nan where no trial completed.  refused: {why a trial was pruned at a
    run that cannot be judged: how many were, now}.
    """

    fmu: str
    parameters: Mapping[str, Any]
    default: float
    best: float
    trials: int
    pruned: int
    refused: Mapping[str, int]


class ControllerSearch:
    """The trials of one controller, a study of optuna's."""

    def __init__(
        self,
        optuna: Any,
        storage: Any,
        fmu: str,
        prepared: PreparedSweep,
        search: SearchDesign,
        report: Report,
    ):
        spec = search.spec
        self._optuna, self._space, self._spec, self._fmu = optuna, spec.spaces[fmu], spec, fmu
        self._fixed, self._metrics = search.controllers[fmu].fixed, prepared.experiment.metrics
        self._refused: Counter[str] = Counter()
        self._key = f"components.{spec.component}"
        self._draws = [point.values for point in prepared.points if point.values[f"{self._key}.fmu"] == fmu]
        self._seed = prepared.spec.seed
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # experimental parts of optuna say that they are
            self._study = optuna.create_study(
                storage=storage,
                study_name=fmu,
                direction=spec.goal,
                load_if_exists=True,
                pruner=optuna.pruners.MedianPruner(n_startup_trials=4),
            )
        states = optuna.trial.TrialState
        self._ended = states.COMPLETE, states.PRUNED
        for trial in self._study.get_trials(deepcopy=False, states=(states.RUNNING, states.WAITING)):
            if trial.state == states.WAITING:
                trial = self._study.ask()
            self._study.tell(trial.number, state=states.FAIL)  # its process was interrupted
        self._defaults = _defaults(prepared, self._space, fmu, self._fixed)
        outside = [name for name, value in self._defaults.items() if not _lies_in(self._space[name], value)]
        if outside:
            report(f"{fmu}: the defaults of {', '.join(outside)} lie outside the space, so no trial begins with them")
            self._defaults = {}

    @property
    def ended(self) -> int:
        return len(self._study.get_trials(deepcopy=False, states=self._ended))

    @property
    def best(self) -> float:
        completed = self._study.get_trials(deepcopy=False, states=self._ended[:1])
        return float(self._study.best_value) if completed else math.nan

    def run(self) -> Asking:
        """Yields the runs that the next trial needs, is sent how they ended; returns when all trials have ended."""
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

    def _judge(self, trial: Any, parameters: dict[str, Any]) -> Asking:
        """Run a trial's draws, rung by rung."""
        values: list[float] = []
        rung = -(-len(self._draws) // RUNGS)
        state = self._optuna.trial.TrialState
        while len(values) < len(self._draws):
            chosen = range(len(values), min(len(values) + rung, len(self._draws)))
            results = yield [
                DesignPoint(i, i, {**self._draws[i], f"{self._key}.parameters": {**self._fixed, **parameters}})
                for i in chosen
            ]
            why = [reason for i in chosen for reason in self._reasons(results[i])]
            if why:
                self._refused.update(set(why))
                self._study.tell(trial, state=state.PRUNED)
                return
            values += [self._spec.value(results[i].metrics) for i in chosen]
            trial.report(math.fsum(values) / len(values), len(values))
            if len(values) < len(self._draws) and trial.should_prune():
                self._study.tell(trial, state=state.PRUNED)
                return
        self._study.tell(trial, math.fsum(values) / len(values))

    def _reasons(self, result: PointResult) -> list[str]:
        """Why a run cannot be judged; [] where it can."""
        of = [self._metrics[name]["of"] for name in self._spec.objective]
        why = list(dict.fromkeys(reason for kind in of for reason in result.standing.reasons_of(kind)))
        return why or ([] if math.isfinite(self._spec.value(result.metrics)) else [NO_NUMBER])

    def tuned(self) -> TunedController:
        complete = self._study.get_trials(deepcopy=False, states=self._ended[:1])
        best = self._study.best_trial if complete else None
        first = next((t for t in complete if self._defaults and t.params == self._defaults), None)
        return TunedController(
            fmu=self._fmu,
            parameters=dict(best.params) if best else {},
            default=float(first.value) if first else math.nan,
            best=self.best,
            trials=self.ended,
            pruned=self.ended - len(complete),
            refused=dict(self._refused),
        )


def _suggest(trial: Any, name: str, entry: Mapping[str, Any]) -> Any:
    match entry["distribution"]:
        case "choice":
            return trial.suggest_categorical(name, entry["values"])
        case "integer":
            return trial.suggest_int(name, entry["low"], entry["high"])
    return trial.suggest_float(name, entry["low"], entry["high"], log=entry["distribution"] == "loguniform")


def _defaults(prepared: PreparedSweep, space: Space, fmu: str, fixed: Mapping[str, Any]) -> dict[str, Any]:
    """What the parameters that are searched are before: as the experiment fixes them, or the FMU itself has them; {}
    where one of them is no single number."""
    described = read(prepared.files[prepared.fmus[fmu]])
    given, _ = flatten(described, ("parameter", "structuralParameter"), fixed)
    defaults = {}
    for name, entry in space.items():
        if name not in described.variables:
            return {}
        start = given.get(name, described.variables[name].initial)
        defaults[name] = int(start) if entry["distribution"] == "integer" else start
    return defaults


def _lies_in(entry: Mapping[str, Any], value: Any) -> bool:
    if entry["distribution"] == "choice":
        return value in entry["values"]
    return bool(entry["low"] <= value <= entry["high"])
