"""[sweep.tune]: for each controller a space of parameters to search, one objective and one budget for all.

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

from ..errors import Problem, did_you_mean
from ..metrics import METRICS, smaller_is_better
from .keys import split_key
from .schema.sections import GOALS, SEARCHABLE, TUNE
from .schema.value_types import is_number
from .sweep import distribution_problems

Space = Mapping[str, Mapping[str, Any]]  # {parameter: its distribution}


@dataclass(frozen=True, kw_only=True)
class TuneSpec:
    """A [sweep.tune] that was read.

    objective: {metric: weight}.  magnitudes: those of the metrics whose magnitude counts.  goal: one of GOALS.
    component: whose FMU varies.  trials: of each controller.  draws: that a trial is judged on.  held_out: draws of the
    comparison at the end.  spaces: {FMU: what is searched}.
    """

    objective: Mapping[str, float]
    magnitudes: frozenset[str] = frozenset()
    goal: str
    component: str
    trials: int
    draws: int
    held_out: int
    spaces: Mapping[str, Space]

    def value(self, metrics: Mapping[str, float]) -> float:
        """The objective of a run; no finite number where a metric has none."""
        values = {name: metrics.get(name, math.nan) for name in self.objective}
        return sum(
            weight * (abs(values[name]) if name in self.magnitudes else values[name])
            for name, weight in self.objective.items()
        )


def read(sweep: Mapping[str, Any], metrics: Mapping[str, Any]) -> tuple[TuneSpec, list[Problem]]:
    """The search that the table [sweep] asks for, and everything that is wrong with it.

    metrics: those of the experiment, by name.
    """
    table = sweep.get("tune", {})
    if not isinstance(table, dict) or not table:
        words = "is missing; give it objective, trials, draws, held_out and a search for each controller"
        nothing = TuneSpec(objective={}, goal=GOALS[0], component="", trials=1, draws=1, held_out=1, spaces={})
        # What is no table at all is a problem of [sweep].
        return nothing, [Problem("sweep.tune", words)] if isinstance(table, dict) else []
    values, problems = TUNE.read(table, "sweep.tune")
    objective = values.get("objective", {})
    weights = {objective: 1.0} if isinstance(objective, str) else objective
    component = values.get("component") or _varying_component(sweep)
    if not component and "component" not in table:
        words = "is missing; name the component whose parameters are tuned"
        problems.append(Problem("sweep.tune.component", words))
    spec = TuneSpec(
        objective=weights,
        magnitudes=frozenset(name for name, metric in metrics.items() if _ranks_by_magnitude(metric)),
        goal=values["goal"],
        component=component,
        trials=values.get("trials", 1),
        draws=values.get("draws", 1),
        held_out=values.get("held_out", 1),
        spaces={fmu: space for fmu, space in values.get("search", {}).items() if isinstance(space, dict)},
    )
    if "objective" in values:
        problems += _objective_problems(weights, metrics)
    if "search" in values:
        problems += _search_problems(values["search"])
    return spec, problems


def _ranks_by_magnitude(metric: Any) -> bool:
    """Whether an entry of [metrics], right or not, is better the nearer it is to zero, as an error of either sign."""
    of = metric.get("of") if isinstance(metric, dict) else None
    return isinstance(of, str) and of in METRICS and smaller_is_better(metric)


def _objective_problems(weights: Mapping[str, Any], metrics: Mapping[str, Any]) -> list[Problem]:
    key = "sweep.tune.objective"
    problems = [
        Problem(key, f"no metric {name!r}{did_you_mean(name, metrics)}") for name in weights if name not in metrics
    ]
    problems += [
        Problem(f"{key}.{name}", f"is {weight!r}, not a finite number")
        for name, weight in weights.items()
        if not is_number(weight)
    ]
    if not weights:
        problems.append(Problem(key, "is empty; name a metric, or give a table of metrics and their weights"))
    return problems


def _varying_component(sweep: Mapping[str, Any]) -> str:
    """The component whose FMU varies, "" unless it is exactly one."""
    vary = sweep.get("vary", {})
    parts = [split_key(key) for key in vary] if isinstance(vary, dict) else []
    varying = [p[1] for p in parts if len(p) == 3 and p[0] == "components" and p[2] == "fmu"]
    return varying[0] if len(varying) == 1 else ""


def _search_problems(search: Mapping[str, Any]) -> list[Problem]:
    key = "sweep.tune.search"
    problems = []
    if not search:
        words = "is empty; give each controller a table of the parameters to tune, such as [sweep.tune.search.pid]"
        problems.append(Problem(key, words))
    for fmu, space in search.items():
        if not isinstance(space, dict) or not space:
            problems.append(Problem(f"{key}.{fmu}", "is not a table of parameters and their distributions"))
            continue
        for name, entry in space.items():
            where = f'{key}.{fmu}."{name}"'
            given = entry.get("distribution") if isinstance(entry, dict) else entry
            if isinstance(entry, dict) and given in SEARCHABLE:
                problems += distribution_problems(where, entry)
            else:
                problems.append(Problem(where, f"no distribution {given!r}{did_you_mean(str(given), SEARCHABLE)}"))
    return problems
