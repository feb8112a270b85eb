"""What [sweep.tune] asks for: for each controller a space of parameters, one objective, one budget for all.

[sweep.tune]
objective = { rmse_x = 1.0, power = 0.001 }     # weights of metrics; or the name of one
trials = 40                                     # of each controller
draws = 8                                       # that a trial is judged on
held_out = 50                                   # other draws, for the comparison at the end
[sweep.tune.search.pid]                         # the parameters of this FMU, as in [sweep.vary]
"K_p.x" = { distribution = "loguniform", low = 10.0, high = 1000.0 }
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ....errors import Problem, did_you_mean
from ....experiment.experiment import split_key
from ..design.matrix import distribution_problems

KEYS = ("objective", "goal", "component", "trials", "draws", "held_out", "search")
GOALS = ("minimize", "maximize")
SEARCHABLE = ("uniform", "loguniform", "integer", "choice")


@dataclass(frozen=True)
class Search:
    """objective: {metric: weight}; component: whose FMU varies; spaces: {FMU: {parameter: its distribution}}."""

    objective: Mapping[str, float]
    goal: str
    component: str
    trials: int
    draws: int
    held_out: int
    spaces: Mapping[str, Mapping[str, Mapping[str, Any]]]

    def value(self, metrics: Mapping[str, float | None]) -> float:
        """The objective of a run; nan where a metric has no number."""
        found = ((weight, metrics.get(name)) for name, weight in self.objective.items())
        return sum(weight * (math.nan if number is None else number) for weight, number in found)


def read(sweep: Mapping[str, Any], metrics: Mapping[str, Any]) -> tuple[Search, list[Problem]]:
    """The search that [sweep] asks for, and everything that is wrong with it.  metrics: those of the experiment."""
    reader = _Reader()
    return reader.search(sweep, metrics), reader.problems


class _Reader:
    def __init__(self) -> None:
        self.problems: list[Problem] = []

    def problem(self, key: str, sentence: str) -> None:
        self.problems.append(Problem(f"sweep.tune.{key}" if key else "sweep.tune", sentence))

    def search(self, sweep: Mapping[str, Any], metrics: Mapping[str, Any]) -> Search:
        table = sweep.get("tune", {})
        if not isinstance(table, dict) or not table:
            self.problem("", "is missing; give it objective, trials, draws, held_out and a search for each controller")
            return Search({}, GOALS[0], "", 1, 1, 1, {})
        for key in table:
            if key not in KEYS:
                self.problem(key, f"unknown key{did_you_mean(key, KEYS)}")
        goal = table.get("goal", GOALS[0])
        if goal not in GOALS:
            self.problem("goal", f"no {goal!r}{did_you_mean(str(goal), GOALS)}")
        return Search(
            self.objective(table, metrics),
            str(goal),
            self.component(table, sweep),
            self.whole(table, "trials"),
            self.whole(table, "draws"),
            self.whole(table, "held_out"),
            self.spaces(table.get("search")),
        )

    def objective(self, table: Mapping[str, Any], metrics: Mapping[str, Any]) -> dict[str, float]:
        given = table.get("objective")
        weights = {given: 1.0} if isinstance(given, str) else given
        if not isinstance(weights, dict) or not weights:
            said = "is missing" if given is None else f"is {given!r}"
            self.problem("objective", f"{said}; name a metric, or give a table of metrics and their weights")
            return {}
        for name, weight in weights.items():
            if name not in metrics:
                self.problem("objective", f"no metric {name!r}{did_you_mean(name, metrics)}")
            if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not math.isfinite(weight):
                self.problem(f"objective.{name}", f"is {weight!r}, not a finite number")
        return weights

    def component(self, table: Mapping[str, Any], sweep: Mapping[str, Any]) -> str:
        """Named, or the one whose FMU varies."""
        vary = sweep.get("vary", {})
        keys = vary if isinstance(vary, dict) else {}
        varying = [p[1] for key in keys if len(p := split_key(key)) == 3 and p[0] == "components" and p[2] == "fmu"]
        given = table.get("component", varying[0] if len(varying) == 1 else None)
        if not isinstance(given, str):
            why = "is missing" if given is None else f"is {given!r}"
            self.problem("component", f"{why}; name the component whose parameters are tuned")
            return ""
        return given

    def whole(self, table: Mapping[str, Any], key: str) -> int:
        value = table.get(key)
        if isinstance(value, int) and not isinstance(value, bool) and value > 0:
            return value
        self.problem(key, ("is missing" if value is None else f"is {value!r}") + "; give a whole number, at least 1")
        return 1

    def spaces(self, table: Any) -> dict[str, dict[str, Any]]:
        if not isinstance(table, dict) or not table:
            self.problem(
                "search",
                "is missing; give each controller a table of the parameters to tune, such as [sweep.tune.search.pid]",
            )
            return {}
        for fmu, space in table.items():
            if not isinstance(space, dict) or not space:
                self.problem(f"search.{fmu}", "is no table of parameters and their distributions")
                continue
            for name, entry in space.items():
                key = f'tune.search.{fmu}."{name}"'
                if not isinstance(entry, dict) or entry.get("distribution") not in SEARCHABLE:
                    said = entry.get("distribution") if isinstance(entry, dict) else entry
                    hint = did_you_mean(str(said), SEARCHABLE)
                    self.problems.append(Problem(f"sweep.{key}", f"no distribution {said!r}{hint}"))
                else:
                    self.problems += distribution_problems(key, entry)
        return {fmu: space for fmu, space in table.items() if isinstance(space, dict)}
