"""Going on from a checkpoint: whether an experiment can, and the system as it was then."""

from __future__ import annotations

import contextlib
import json
import os
import signal
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import ExperimentError, FmuError, Problem
from ...experiment import experiment as experiments
from ...instances.fmi2 import CallFailed
from ...simulation.component import Member, MemberFailed, failing
from ...simulation.initialization import SWEEPS, AlgebraicLoop, exchange, read
from .file import Checkpoint, open_checkpoint, value_of

if TYPE_CHECKING:
    from ...plan.plan import Part, Plan
    from ...simulation.system import System


def prepare(
    start: str | Path,
    path: str | Path | None,
    set: Mapping[str, Any],
    swap: Mapping[str, str],
    told: Callable[[str], None] = lambda _: None,
    packaging: str = "auto",
) -> Plan:
    """The plan of a run that goes on from a checkpoint, its stale models built.

    start: the checkpoint.  path: the experiment; without one, that of the checkpoint, with `set` and `swap` laid over
    what was laid over it then.  swap: components that begin anew.  packaging: of those; the others keep theirs.
    Raises StoreError where the checkpoint cannot be read, ExperimentError where the two do not fit.
    """
    from ...models import build
    from ...plan.resolve import resolve

    checkpoint = open_checkpoint(start)
    if path is not None:
        loaded = experiments.load(path, set, swap)
    else:
        about = checkpoint.about
        kept = {key: value for key, value in about["changes"]["set"].items() if _component_of(key) not in swap}
        loaded = experiments.parse(
            Path(about["experiment"]), about["experiment_toml"], {**kept, **set}, {**about["changes"]["swap"], **swap}
        )
    known = build.known()
    packagings = {c.fmu: packaging for c in loaded.components if c.fmu in known}
    for c in loaded.components:
        if c.fmu in known and c.name not in swap and c.name in checkpoint.components:
            packagings[c.fmu] = checkpoint.components[c.name]["packaging"]
    built: dict[str, Path] = {}
    unbuilt: dict[str, str] = {}
    for kind in sorted({*packagings.values()}):
        try:
            built |= build.build(sorted(name for name, its in packagings.items() if its == kind), told, packaging=kind)
        except build.BuildError as error:
            built |= error.built
            unbuilt |= error.reasons
    return attach(resolve(loaded, built, unbuilt), checkpoint, swap)


def _component_of(key: str) -> str:
    """The component that a dotted key is about, or ""."""
    parts = experiments.split_key(key)
    return parts[1] if len(parts) > 1 and parts[0] == "components" else ""


def attach(plan: Plan, checkpoint: Checkpoint, fresh: Iterable[str]) -> Plan:
    """The plan as it goes on from a checkpoint.  fresh: components that begin anew.

    Raises ExperimentError, with every reason why it cannot.
    """
    names = [part.name for part in plan.parts]
    checkpoint = replace(checkpoint, fresh=tuple(sorted(set(fresh))))
    saved, problems = checkpoint.about["master"], []
    master, here = plan.experiment.master, f"{checkpoint.path}"
    for key in ("step", "algorithm"):
        if getattr(master, key) != saved[key]:
            problems.append(
                Problem(
                    f"master.{key}",
                    f"is {getattr(master, key)}, and was {saved[key]} in the run of "
                    f"{here}: a run goes on with what it began with",
                )
            )
    if not problems and plan.steps <= checkpoint.tick:
        problems.append(
            Problem(
                "master.stop_time",
                f"is {master.stop_time:.10g} s, where {here} already is at "
                f"t = {checkpoint.time:.10g} s; --set master.stop_time=... goes further",
            )
        )
    for name in checkpoint.components:
        if name not in names:
            problems.append(Problem(f"components.{name}", f"is missing; {here} has it"))
    driven: dict[str, set[str]] = {name: set() for name in names}
    needed: dict[str, set[str]] = {name: set() for name in names}
    for link in plan.links:
        driven[link.sink].add(link.input.name)
        needed[link.source].add(link.output.name)
    for component, variable in plan.recorded:
        needed[component].add(variable.name)
    for part in plan.parts:
        if part.name not in checkpoint.components:
            problems.append(
                Problem(f"components.{part.name}", f"is not in {here}, which has: {', '.join(checkpoint.components)}")
            )
        elif part.name in checkpoint.fresh:
            problems += _unfit_fresh(part, checkpoint, plan)
        else:
            problems += _unfit(part, checkpoint, driven[part.name], needed[part.name])
    if problems:
        raise ExperimentError(plan.experiment.path, problems)
    return replace(plan, origin=checkpoint)


def _unfit_fresh(part: Part, checkpoint: Checkpoint, plan: Plan) -> list[Problem]:
    if checkpoint.tick % part.period == 0:
        return []
    grid = plan.experiment.grid
    return [
        Problem(
            f"components.{part.name}.step",
            f"{checkpoint.time:.10g} s is within a step of {part.name}, of "
            f"{grid.time(part.period):.10g} s, so it cannot begin there",
        )
    ]


def _unfit(part: Part, checkpoint: Checkpoint, driven: set[str], needed: set[str]) -> list[Problem]:
    """Why a component cannot go on from its saved state."""
    was, key = checkpoint.components[part.name], f"components.{part.name}"
    hint = f"--swap {part.name}=FMU begins it anew"
    if part.live or part.fmu.sha256 != was["fmu_sha256"]:
        return [
            Problem(
                f"{key}.fmu",
                f"{part.fmu_name} ({part.fmu.sha256[:10]}) is not the FMU of the checkpoint, "
                f"{was['fmu']} ({was['fmu_sha256'][:10]}); {hint}",
            )
        ]
    problems = []
    if part.period != was["period"]:
        words = f"is {part.period} steps of the master, and was {was['period']}; {hint}"
        problems.append(Problem(f"{key}.step", words))
    for what, now in (("parameters", part.parameters), ("start", part.start)):
        now, then = json.loads(json.dumps(dict(now))), was[what]
        for name in sorted({*now, *then}):
            if now.get(name) != then.get(name):
                words = f"is {_shown(now.get(name))}, and was {_shown(then.get(name))} in the checkpoint; {hint}"
                problems.append(Problem(f"{key}.{what}.{name}", words))
    given = {element.name for name in driven for element in part.fmu.elements(part.fmu.variables[name])}
    for name in sorted(set(was["given"]) - given):
        problems.append(Problem(f'connections."{part.name}.{name}"', "is missing: it was connected in the checkpoint"))
    if checkpoint.tick % part.period and (unknown := sorted(needed - {*was["values"], *was["computed"]})):
        words = f"the checkpoint lies within a step of it, and was made without its {', '.join(unknown)}"
        problems.append(Problem(key, f"{words}: neither record nor connect them, or make it again with them"))
    return problems


def _shown(value: Any) -> str:
    return "the FMU's own" if value is None else str(value)


def resume(system: System) -> list[str]:
    """Initialize an opened system from the checkpoint of its plan, in place of `System.initialize`.

    Components go on from their saved states; fresh ones are initialized at the time of the checkpoint with the values
    of the others.  Returns what there is to say.  Raises MemberFailed, or AlgebraicLoop.
    """
    checkpoint = system.plan.origin
    assert checkpoint is not None
    fresh = [member for member in system.members if member.part.name in checkpoint.fresh]
    for member in system.members:
        if member.part.name not in checkpoint.fresh:
            _go_on(system, member, checkpoint)
    for member in fresh:
        with failing(member):
            member.instance.setup(checkpoint.time, *_initial(system, member))
    _settle(system, fresh)
    for member in fresh:
        with failing(member):
            member.instance.begin()
        read(member)
    for member in system.members:
        if words := member.not_finite():
            raise MemberFailed(member, words)
    return []


def _initial(system: System, member: Member) -> tuple[float | None, dict[str, Any]]:
    """Stop time [s], where its last step ends there, and values to begin with."""
    plan, part = system.plan, member.part
    stop_time = plan.experiment.master.stop_time if plan.steps % part.period == 0 else None
    return stop_time, {**part.parameters, **part.start}


def _go_on(system: System, member: Member, checkpoint: Checkpoint) -> None:
    """Initialize a component as it began, with its last inputs, then put its state and its values back."""
    was = checkpoint.components[member.part.name]
    with failing(member):
        member.instance.setup(0.0, *_initial(system, member))
        _put_back(member.inputs, was["given"])
        for set_ in member.sets:
            member.instance.check(set_())
        member.instance.begin()
        state = checkpoint.states[member.part.name]
        if name := _kills(member, state):
            words = f"its FMU crashes ({name}) when given the state that another process saved; it may hold addresses"
            raise MemberFailed(member, f"{words}: let the component begin anew, --swap {member.part.name}=FMU")
        try:
            member.instance.restore(state)
        except (CallFailed, FmuError) as error:
            raise MemberFailed(member, f"its state cannot be restored: {error}") from None
    read(member)  # of what is recorded or connected only now
    _put_back(member.inputs, was["given"])
    _put_back(member.outputs, was["computed"])
    for name, value in was["values"].items():
        if (place := system.places.get((member.part.name, name))) is not None:
            kind = member.part.fmu.variables[name].kind
            system.tables[kind][place] = value_of(kind, value)


def _kills(member: Member, state: bytes) -> str:
    """The signal that ends a process, forked from this one, in which the state is restored; "" where none does."""
    if member.instance.batched or not hasattr(os, "fork"):  # in a process of its own it costs nothing but that
        return ""
    process = os.fork()
    if process == 0:
        with contextlib.suppress(BaseException):
            member.instance.restore(state)
        os._exit(0)
    _, status = os.waitpid(process, 0)
    return signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else ""


def _put_back(exchanges: Sequence[Any], values: Mapping[str, Any]) -> None:
    for e in exchanges:
        for place, variable in enumerate(e.variables):
            if variable.name in values:
                e.buffer[place] = value_of(e.kind, values[variable.name])


def _settle(system: System, fresh: Sequence[Member]) -> None:
    """Give fresh components their inputs until their outputs agree."""
    for _ in range(SWEEPS):
        before = {kind: table.copy() for kind, table in system.tables.items()}
        for member in fresh:
            exchange(member)
        if all(np.array_equal(before[kind], table) for kind, table in system.tables.items()):
            return
    names = ", ".join(member.part.name for member in fresh)
    raise AlgebraicLoop(f"the initial values of {names} do not settle in {SWEEPS} sweeps: they depend on each other")
