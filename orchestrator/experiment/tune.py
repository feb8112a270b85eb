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
from .keys import split_key
from .sweep import SectionReader

KEYS = ("objective", "goal", "component", "trials", "draws", "held_out", "search")
GOALS = ("minimize", "maximize")
SEARCHABLE = ("uniform", "loguniform", "integer", "choice")  # distributions

Space = Mapping[str, Mapping[str, Any]]  # {parameter: its distribution}


@dataclass(frozen=True, kw_only=True)
class TuneSpec:
    """A [sweep.tune] that was read.

    objective: {metric: weight}.  goal: one of GOALS.  component: whose FMU varies.  trials: of each controller.  draws:
    that a trial is judged on.  held_out: draws of the comparison at the end.  spaces: {FMU: what is searched}.
    """

    objective: Mapping[str, float]
    goal: str
    component: str
    trials: int
    draws: int
    held_out: int
    spaces: Mapping[str, Space]

    def value(self, metrics: Mapping[str, float | None]) -> float:
        """The objective of a run; nan where a metric has no number."""
        weighted = ((weight, metrics.get(name)) for name, weight in self.objective.items())
        return sum(weight * (math.nan if number is None else number) for weight, number in weighted)


def read(sweep: Mapping[str, Any], metrics: Mapping[str, Any]) -> tuple[TuneSpec, list[Problem]]:
    """The search that the table [sweep] asks for, and everything that is wrong with it.

    metrics: those of the experiment, by name.
    """
    reader = SectionReader("sweep.tune")
    table = sweep.get("tune", {})
    if not isinstance(table, dict) or not table:
        reader.problem("", "is missing; give it objective, trials, draws, held_out and a search for each controller")
        nothing = TuneSpec(objective={}, goal=GOALS[0], component="", trials=1, draws=1, held_out=1, spaces={})
        return nothing, reader.problems
    reader.known(table, KEYS)
    spec = TuneSpec(
        goal=reader.one_of(table, "goal", GOALS),
        objective=_objective(reader, table, metrics),
        component=_component(reader, table, sweep),
        trials=reader.whole(table, "trials", None, 1),
        draws=reader.whole(table, "draws", None, 1),
        held_out=reader.whole(table, "held_out", None, 1),
        spaces=_spaces(reader, table.get("search")),
    )
    return spec, reader.problems


def _objective(reader: SectionReader, table: Mapping[str, Any], metrics: Mapping[str, Any]) -> dict[str, float]:
    given = table.get("objective")
    weights = {given: 1.0} if isinstance(given, str) else given
    if not isinstance(weights, dict) or not weights:
        said = "is missing" if given is None else f"is {given!r}"
        reader.problem("objective", f"{said}; name a metric, or give a table of metrics and their weights")
        return {}
    for name, weight in weights.items():
        if name not in metrics:
            reader.problem("objective", f"no metric {name!r}{did_you_mean(name, metrics)}")
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not math.isfinite(weight):
            reader.problem(f"objective.{name}", f"is {weight!r}, not a finite number")
    return weights


def _component(reader: SectionReader, table: Mapping[str, Any], sweep: Mapping[str, Any]) -> str:
    """The component that is named, or the one whose FMU varies."""
    vary = sweep.get("vary", {})
    keys = vary if isinstance(vary, dict) else {}
    parts = [split_key(key) for key in keys]
    varying = [p[1] for p in parts if len(p) == 3 and p[0] == "components" and p[2] == "fmu"]
    given = table.get("component", varying[0] if len(varying) == 1 else None)
    if not isinstance(given, str):
        said = "is missing" if given is None else f"is {given!r}"
        reader.problem("component", f"{said}; name the component whose parameters are tuned")
        return ""
    return given


def _spaces(reader: SectionReader, table: Any) -> dict[str, Space]:
    if not isinstance(table, dict) or not table:
        reader.problem(
            "search",
            "is missing; give each controller a table of the parameters to tune, such as [sweep.tune.search.pid]",
        )
        return {}
    for fmu, space in table.items():
        if not isinstance(space, dict) or not space:
            reader.problem(f"search.{fmu}", "is not a table of parameters and their distributions")
            continue
        for name, entry in space.items():
            key = f'search.{fmu}."{name}"'
            if not isinstance(entry, dict) or entry.get("distribution") not in SEARCHABLE:
                said = entry.get("distribution") if isinstance(entry, dict) else entry
                reader.problem(key, f"no distribution {said!r}{did_you_mean(str(said), SEARCHABLE)}")
            else:
                reader.distribution(key, entry)
    return {fmu: space for fmu, space in table.items() if isinstance(space, dict)}
