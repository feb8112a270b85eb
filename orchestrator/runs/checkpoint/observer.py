"""Checkpoints of a run: whether and when they can be taken, and taking them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from ...errors import ExperimentError, Problem
from ...plan.plan import Component, Plan
from ...simulation.observer import Observer
from ...simulation.system import System
from .file import path_of
from .save import save

ABLE = ("canGetAndSetFMUstate", "canSerializeFMUstate")


class CheckpointObserver(Observer):
    """Saves a system at some ticks: the only observer that has the system itself.  due: {tick: file}."""

    def __init__(self, system: System, run_id: str, due: Mapping[int, Path]):
        self._system, self._run_id, self._due = system, run_id, due
        self.saved: list[Path] = []

    def limit(self, tick: int, last: int) -> int:
        return min((due for due in self._due if tick < due < last), default=last)

    def progress(self, tick: int) -> None:
        if tick in self._due and self._due[tick] not in self.saved:
            save(self._system, tick, self._run_id, self._due[tick])
            self.saved.append(self._due[tick])

    def warnings(self) -> list[str]:
        """One for each checkpoint that the run did not reach."""
        return [
            f"no checkpoint at t = {self._system.plan.experiment.grid.time(tick):.10g} s: the run ended before"
            for tick, path in self._due.items()
            if path not in self.saved
        ]


def paths_of(plan: Plan, ticks: Iterable[int], record: Path) -> dict[int, Path]:
    """{tick: file} of the checkpoints of a run, beside its record."""
    return {tick: path_of(record, plan.experiment.grid.time(tick)) for tick in sorted(ticks)}


def ticks_of(plan: Plan, times: Iterable[float]) -> list[int]:
    """The ticks of the times [s] at which checkpoints are asked for.

    Raises ExperimentError where a time is none of the run's, or naming all components that cannot be saved.
    """
    experiment, problems, ticks = plan.experiment, [], set()
    grid, master = experiment.grid, experiment.master
    for time in times:
        key = f"--checkpoint-at {time:.10g}"
        if not math.isfinite(time):
            problems.append(Problem(key, "is not a time"))
        elif (tick := grid.ticks(time)) is None:
            near = " or ".join(f"{t:.10g}" for t in grid.nearest(time))
            problems.append(Problem(key, f"is not a multiple of master.step = {master.step:g} s; try {near}"))
        elif tick <= plan.first:
            begins = f"the run begins at t = {grid.time(plan.first):.10g} s"
            problems.append(Problem(key, f"{begins}: nothing can be saved before its first step"))
        elif tick > plan.steps:
            problems.append(Problem(key, f"is after master.stop_time = {master.stop_time:.10g} s"))
        else:
            ticks.add(tick)
    if ticks or problems:
        problems += [
            Problem(f"components.{component.name}", f"its state cannot be saved: {words}")
            for component in plan.components
            if (words := _unable(component))
        ]
    if problems:
        raise ExperimentError(experiment.path, problems)
    return sorted(ticks)


def _unable(component: Component) -> str:
    """Why a component cannot be saved, or ""."""
    if component.live:
        return f"{component.fmu_name} runs inside orch, and what it does comes from outside"
    if missing := [name for name in ABLE if not component.fmu.capabilities[name]]:
        return f"{component.fmu_name} declares no {', no '.join(missing)}"
    return ""
