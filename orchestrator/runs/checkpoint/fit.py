"""Whether an experiment can go on from a checkpoint."""

from __future__ import annotations

import json
from collections.abc import Iterable, Set
from dataclasses import replace
from typing import Any

from ...errors import ExperimentError, Problem
from ...plan.plan import Component, Plan
from .file import Checkpoint


def attach(plan: Plan, checkpoint: Checkpoint, fresh: Iterable[str]) -> Plan:
    """The plan as it goes on from a checkpoint.  fresh: components that are reinitialized there.

    Raises ExperimentError, with every reason why it cannot.
    """
    checkpoint = replace(checkpoint, fresh=tuple(sorted(set(fresh))))
    problems = _problems_of_master(plan, checkpoint)
    names = [component.name for component in plan.components]
    problems += [
        Problem(f"components.{name}", f"is missing; {checkpoint.path} has it")
        for name in checkpoint.components
        if name not in names
    ]
    driven, needed = _uses(plan)
    for component in plan.components:
        if component.name not in checkpoint.components:
            has = ", ".join(checkpoint.components)
            problems.append(Problem(f"components.{component.name}", f"is not in {checkpoint.path}, which has: {has}"))
        elif component.name in checkpoint.fresh:
            problems += _problems_of_fresh(component, checkpoint, plan)
        else:
            problems += _problems_of_saved(component, checkpoint, driven[component.name], needed[component.name])
    if problems:
        raise ExperimentError(plan.experiment.path, problems)
    return replace(plan, origin=checkpoint)


def _problems_of_master(plan: Plan, checkpoint: Checkpoint) -> list[Problem]:
    was, now, here = checkpoint.about["master"], plan.experiment.master, checkpoint.path
    problems = [
        Problem(
            f"master.{key}",
            f"is {getattr(now, key)}, and was {was[key]} in the run of {here}: a run goes on with what it began with",
        )
        for key in ("step", "algorithm")
        if getattr(now, key) != was[key]
    ]
    if not problems and plan.steps <= checkpoint.tick:
        words = (
            f"is {now.stop_time:.10g} s, where {here} already is at t = {checkpoint.time:.10g} s; "
            "--set master.stop_time=... goes further"
        )
        problems.append(Problem("master.stop_time", words))
    return problems


def _uses(plan: Plan) -> tuple[dict[str, set[str]], dict[str, set[str]]]:
    """By component: the variables that connections drive, and those that are connected further or recorded."""
    driven: dict[str, set[str]] = {component.name: set() for component in plan.components}
    needed: dict[str, set[str]] = {component.name: set() for component in plan.components}
    for connection in plan.connections:
        driven[connection.sink].add(connection.input.name)
        needed[connection.source].add(connection.output.name)
    for name, variable in plan.recorded:
        needed[name].add(variable.name)
    return driven, needed


def _problems_of_fresh(component: Component, checkpoint: Checkpoint, plan: Plan) -> list[Problem]:
    if checkpoint.tick % component.period == 0:
        return []
    step = plan.experiment.grid.time(component.period)
    words = f"{checkpoint.time:.10g} s is within a step of {component.name}, of {step:.10g} s, so it cannot begin there"
    return [Problem(f"components.{component.name}.step", words)]


def _problems_of_saved(
    component: Component, checkpoint: Checkpoint, driven: Set[str], needed: Set[str]
) -> list[Problem]:
    """Why a component cannot go on from its saved state.  driven, needed: see `_uses`."""
    was, key = checkpoint.components[component.name], f"components.{component.name}"
    hint = f"--swap {component.name}=FMU reinitializes it"
    if component.live or component.fmu.sha256 != was["fmu_sha256"]:
        words = (
            f"{component.fmu_name} ({component.fmu.sha256[:10]}) is not the FMU of the checkpoint, "
            f"{was['fmu']} ({was['fmu_sha256'][:10]}); {hint}"
        )
        return [Problem(f"{key}.fmu", words)]
    problems = []
    if component.period != was["period"]:
        words = f"is {component.period} steps of the master, and was {was['period']}; {hint}"
        problems.append(Problem(f"{key}.step", words))
    if component.tolerance != was.get("tolerance", component.tolerance):  # orch 0.1.0 saved none
        words = f"is {_shown(component.tolerance)}, and was {_shown(was['tolerance'])} in the checkpoint; {hint}"
        problems.append(Problem(f"{key}.tolerance", words))
    for what, values in (("parameters", component.parameters), ("start", component.start)):
        now, then = json.loads(json.dumps(dict(values))), was[what]
        problems += [
            Problem(
                f"{key}.{what}.{name}",
                f"is {_shown(now.get(name))}, and was {_shown(then.get(name))} in the checkpoint; {hint}",
            )
            for name in sorted({*now, *then})
            if now.get(name) != then.get(name)
        ]
    given = {element.name for name in driven for element in component.fmu.elements(component.fmu.variables[name])}
    problems += [
        Problem(f'connections."{component.name}.{name}"', "is missing: it was connected in the checkpoint")
        for name in sorted(set(was["given"]) - given)
    ]
    if checkpoint.tick % component.period and (unknown := sorted(needed - {*was["values"], *was["computed"]})):
        words = (
            f"the checkpoint lies within a step of it, and was made without its {', '.join(unknown)}: neither record "
            "nor connect them, or make it again with them"
        )
        problems.append(Problem(key, words))
    return problems


def _shown(value: Any) -> str:
    return "the FMU's own" if value is None else str(value)
