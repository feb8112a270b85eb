"""The sweeps that a search consists of: its trials, the comparison at the end, and the one that tuned.toml holds.

A search takes the draws of [sweep] in their order: after `skip` those that trials are judged on, then those that are
held out.  Lists that do not belong to the tuned component are scenarios: each draw meets every value of theirs, in a
trial as in the comparison.  Keys that are zipped with the component's FMU go with their controller.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ....errors import Problem
from ....experiment import toml
from ....experiment.keys import split_key
from ....experiment.sweep import Group, SweepSpec
from ....experiment.tune import Space, TuneSpec
from ..design import matrix

Row = tuple[str, Mapping[str, Any]]  # an FMU, and the parameters that were found for it
SEARCHED = "is searched in sweep.tune.search, too; keep one of them"


@dataclass(frozen=True, kw_only=True)
class ControllerDesign:
    """A controller as the experiment has it.  fixed: parameters that it begins with; zipped: {key: value} that goes
    with it."""

    fmu: str
    fixed: Mapping[str, Any]
    zipped: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class SearchDesign:
    """swept: the [sweep] of the experiment; scenarios: it without what belongs to the component; set: {dotted key:
    value} of the command line without what is among the parameters of controllers now; notes: what a user should know.
    """

    spec: TuneSpec
    swept: SweepSpec
    scenarios: SweepSpec
    controllers: Mapping[str, ControllerDesign]
    set: Mapping[str, Any]
    notes: Sequence[str]

    def trials(self) -> SweepSpec:
        """The sweep that trials are drawn from: each controller with some value of each searched parameter."""
        rows = [(c.fmu, _middle(self.spec.spaces[c.fmu])) for c in self.controllers.values()]
        return replace(self._of(rows), draws=self.spec.draws)

    def comparison(self, tuned: Mapping[str, Mapping[str, Any]]) -> SweepSpec:
        """Defaults against what was found, on the draws that are held out.  tuned: {FMU: parameters}."""
        rows: list[Row] = [(fmu, {}) for fmu in tuned]
        rows += [(fmu, found) for fmu, found in tuned.items() if found]
        titles = [*tuned, *(f"{fmu} tuned" for fmu, found in tuned.items() if found)]
        return self._held_out(self._of(rows, titles))

    def tuned(self, tuned: Mapping[str, Mapping[str, Any]]) -> SweepSpec:
        """What was found, on the draws that are held out.  tuned: {FMU: parameters}."""
        return self._held_out(self._of([*tuned.items()]))

    def parameters(self, fmu: str, found: Mapping[str, Any]) -> dict[str, Any]:
        """All that a controller is given."""
        return {**self.controllers[fmu].fixed, **found}

    def _held_out(self, sweep: SweepSpec) -> SweepSpec:
        """The sweep on the draws after those of the trials."""
        return replace(sweep, draws=self.spec.held_out, skip=self.swept.skip + self.spec.draws)

    def _of(self, rows: Sequence[Row], titles: Sequence[str] = ()) -> SweepSpec:
        """A sweep of controllers with parameters over the scenarios."""
        key = f"components.{self.spec.component}"
        lists: dict[str, list[Any]] = {"title": list(titles)} if titles else {}
        lists[f"{key}.fmu"] = [fmu for fmu, _ in rows]
        lists[f"{key}.parameters"] = [self.parameters(fmu, found) for fmu, found in rows]
        for name in next(iter(self.controllers.values())).zipped:
            lists[name] = [self.controllers[fmu].zipped[name] for fmu, _ in rows]
        group = tuple(lists), tuple(zip(*lists.values(), strict=True))
        return replace(self.scenarios, lists=(group, *self.scenarios.lists))


def design(spec: TuneSpec, swept: SweepSpec, set: Mapping[str, Any]) -> tuple[SearchDesign, list[Problem]]:
    """The sweeps of a search, and why there cannot be one.

    swept: the [sweep] of the experiment; set: {dotted key: value} of the command line.
    """
    own = ["components", spec.component, "fmu"], ["components", spec.component, "parameters"]
    groups = {keys: [split_key(key) for key in keys] for keys, _ in swept.lists}
    of_fmu: Group = next((group for group in swept.lists if own[0] in groups[group[0]]), ((), ()))
    problems = [
        Problem(f'sweep.vary."{key}"', f"is set by the search; zip it with components.{spec.component}.fmu")
        for keys, _ in swept.lists
        for key, parts in zip(keys, groups[keys], strict=True)
        if parts == own[1] and keys != of_fmu[0]
    ]
    controllers: dict[str, ControllerDesign] = {}
    for fmu, space in spec.spaces.items():
        controllers[fmu], wrong = _controller(fmu, spec, of_fmu, set)
        problems += wrong
        varying = [*swept.distributions, *(key for keys, _ in swept.lists for key in keys)]
        problems += [
            Problem(f'sweep.vary."{key}"', SEARCHED)
            for key in varying
            if (name := _within(key, spec.component)) and _overlaps(name, space)
        ]
    titles = [group for group in swept.lists if group[0] == ("title",)]
    left_out = [row[groups[of_fmu[0]].index(own[0])] for row in of_fmu[1]] if of_fmu[0] else []
    left_out = [str(fmu) for fmu in left_out if fmu not in spec.spaces]
    scenarios = replace(swept, lists=tuple(_untitled(group) for group in swept.lists if group not in (of_fmu, *titles)))
    notes = [f"{', '.join(left_out)}: left out, for sweep.tune.search does not name them"] if left_out else []
    notes += [
        f"{' and '.join(keys)}: each draw meets all {len(rows)} values, in every trial and in the comparison"
        for keys, rows in scenarios.lists
    ]
    found = SearchDesign(
        spec=spec,
        swept=swept,
        scenarios=scenarios,
        controllers=controllers,
        set={key: value for key, value in set.items() if not _within(key, spec.component)},
        notes=notes,
    )
    return found, [*dict.fromkeys(problems), *([] if problems else _not_held_out(found))]


def _untitled(group: Group) -> Group:
    """Lists that change together, without titles: the comparison gives runs titles of its own."""
    keys, rows = group
    kept = [i for i, key in enumerate(keys) if key != "title"]
    return tuple(keys[i] for i in kept), tuple(tuple(row[i] for i in kept) for row in rows)


def _controller(
    fmu: str, spec: TuneSpec, of_fmu: Group, set: Mapping[str, Any]
) -> tuple[ControllerDesign, list[Problem]]:
    """A controller with what the list of FMUs zips with it.  of_fmu: the group of that list, empty without one."""
    keys = [tuple(split_key(key)) for key in of_fmu[0]]
    own = ("components", spec.component)
    rows = [dict(zip(keys, row, strict=True)) for row in of_fmu[1]]
    rows = [row for row in rows if row[(*own, "fmu")] == fmu]
    others = [key for key, parts in zip(of_fmu[0], keys, strict=True) if parts not in ((*own, "fmu"), ("title",))]
    where, problems = f"sweep.tune.search.{fmu}", []
    if len(rows) > 1:
        problems.append(Problem(where, f"{len(rows)} rows of sweep.vary have this FMU; keep the one that is meant"))
    if not rows and others:
        problems.append(Problem(where, f"is not in the list of FMUs, which {', '.join(others)} are zipped with"))
    row = rows[0] if rows else {}
    fixed = row.get((*own, "parameters"), {})
    if not isinstance(fixed, dict):
        problems.append(Problem(f'sweep.vary."components.{spec.component}.parameters"', f"has {fixed!r}, no table"))
        fixed = {}
    fixed = {**fixed, **{name: value for key, value in set.items() if (name := _within(key, spec.component))}}
    zipped = {
        key: row[tuple(split_key(key))] for key in others if row and tuple(split_key(key)) != (*own, "parameters")
    }
    return ControllerDesign(fmu=fmu, fixed=fixed, zipped=zipped), problems


def _within(key: str, component: str) -> str:
    """The name of the parameter of a component that a dotted key sets; "" where it sets none."""
    parts = split_key(key)
    return ".".join(parts[3:]) if parts[:3] == ["components", component, "parameters"] else ""


def _overlaps(parameter: str, space: Space) -> bool:
    """Whether a search sets a parameter, an axis of it, or the vector that it is an axis of."""
    return any(f"{name}.".startswith(f"{parameter}.") or f"{parameter}.".startswith(f"{name}.") for name in space)


def _not_held_out(search: SearchDesign) -> list[Problem]:
    """Draws of the comparison that are draws of the trials, too: of distributions that have few values."""
    trials, held_out = set(_drawn(search.trials())), _drawn(search.tuned({fmu: {} for fmu in search.spec.spaces}))
    again = [values for values in held_out if values in trials]
    if not again:
        return []
    words = f"{len(again)} of {len(held_out)} draws have the very values of draws that trials are judged on"
    hint = "; give the distributions more values, or another sweep.seed"
    if not search.swept.distributions:
        words = "no value in sweep.vary is a distribution: there is one draw, and trials are judged on it"
        hint = '; vary what may change, such as "master.seed", by a distribution'
    return [Problem("sweep.tune.held_out", words + hint)]


def _drawn(spec: SweepSpec) -> list[str]:
    """The values of each draw of a sweep, as text."""
    alone = replace(spec, lists=())
    return [json.dumps(point.cells, sort_keys=True, default=str) for point in matrix.points(alone)]


def _middle(space: Space) -> dict[str, Any]:
    """Some value of each parameter, to check that it is one."""
    return {name: d["values"][0] if d["distribution"] == "choice" else d["low"] for name, d in space.items()}


def as_toml(spec: SweepSpec) -> str:
    """A sweep as the [sweep] of an experiment."""
    zipped = [list(keys) for keys, _ in spec.lists if len(keys) > 1]
    table: dict[str, Any] = {"draws": spec.draws, "skip": spec.skip, "design": spec.design, "seed": spec.seed}
    table |= {"keep": spec.keep, **({"zip": zipped} if zipped else {})}
    vary = {key: [row[i] for row in rows] for keys, rows in spec.lists for i, key in enumerate(keys)}
    lines = ["[sweep]", *(f"{key} = {toml.inline(value)}" for key, value in table.items()), "", "[sweep.vary]"]
    for key, values in vary.items():
        lines += [f"{toml.inline(key)} = [", *(f"    {toml.inline(value)}," for value in values), "]"]
    lines += [f"{toml.inline(key)} = {toml.inline(value)}" for key, value in spec.distributions.items()]
    return "\n".join(lines) + "\n"
