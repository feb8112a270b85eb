"""What a thesis run reaches in every communication step, by which the claims are judged.

A saturated command or a burst may last less than the 10 ms between two rows of a record.  So each case runs once more
with all its steps in memory, a block at a time, and what is kept of each 10 ms is the least and the largest value.

python -m orchestrator.studies.thesis.cases.extremes < JOB runs one of them.  JOB is a pickled dictionary: "plan", and
"path", the file to write.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ....arrays import Reals
from ....errors import RunError, StoreError
from ....instances.isolated_child import end_with_parent
from ....plan.plan import Plan
from ....runs.prepare import prepare
from ....simulation.master import run as run_master
from ....simulation.observer import Block, Observer
from ....simulation.system import System
from ....watch import interruptible
from ... import processes
from ...progress import CommandProgress
from .chapter5 import Case
from .signals import AXES, Track, distance, heading_difference, track

ROW = 0.01  # s, as the records of the cases
BLOCK = 100  # rows of 10 ms that are reduced at once
FULL = 1.0 - 1e-9  # |u| from here on is saturated; scaling by the largest command rounds
FORMAT = 1  # of the files, to be raised when Extremes changes
SIGNALS = ["vehicle*.eta", "vehicle*.nu", "vehicle*.tau", "reference*.eta_d", "reference*.eta_d_dot", "allocation*.u"]


@dataclass(frozen=True, kw_only=True)
class Extremes:
    """One vehicle.  Row k covers all steps in (time[k-1], time[k]], row 0 the start.

    time: (N,) [s].  (N, 2, 6), least and largest: eta [m, deg], error = eta - eta_d [m, deg], nu and
    off = nu - nu_d [m/s, deg/s], tau [N, N.m], u [1].  jump: (N,) largest change of a command in one step.
    saturated: (N,) steps in which a command is saturated.
    """

    time: Reals
    eta: Reals
    error: Reals
    nu: Reals
    off: Reals
    tau: Reals
    u: Reals
    jump: Reals
    saturated: Reals

    def of(self, axis: str) -> Reals:
        """(N,) largest magnitude of the error of one axis."""
        largest: Reals = magnitude(self.error)[:, AXES.index(axis)]
        return largest


@dataclass(frozen=True, kw_only=True)
class PairExtremes:
    """Two vehicles.  distance [m] and heading difference [deg]: (N, 2), least and largest."""

    one: Extremes
    two: Extremes
    distance: Reals
    heading: Reals


def magnitude(bounds: Reals) -> Reals:
    """The largest magnitude between least and largest.  bounds: (N, 2, ...).  Returns (N, ...)."""
    largest: Reals = abs(bounds).max(axis=1)
    return largest


def extremes(steps: Track, stride: int) -> Extremes:
    """The first row of `steps` by itself, then each `stride` rows together."""
    u = abs(steps.u).max(axis=1)
    jump = np.concatenate([[0.0], abs(np.diff(steps.u, axis=0)).max(axis=1)])
    return Extremes(
        time=steps.time[::stride],
        eta=_bounds(steps.eta, stride),
        error=_bounds(steps.error, stride),
        nu=_bounds(steps.nu, stride),
        off=_bounds(steps.nu - steps.nu_d, stride),
        tau=_bounds(steps.tau, stride),
        u=_bounds(steps.u, stride),
        jump=_bounds(jump, stride)[:, 1],
        saturated=_groups((u >= FULL).astype(np.float64), stride, np.sum),
    )


def pair_extremes(one: Track, two: Track, stride: int) -> PairExtremes:
    return PairExtremes(
        one=extremes(one, stride),
        two=extremes(two, stride),
        distance=_bounds(distance(one, two), stride),
        heading=_bounds(heading_difference(one, two), stride),
    )


def extremes_of(cases: Sequence[Case], folder: Path, report: Callable[[str], None]) -> dict[str, Any]:
    """{case: Extremes, PairExtremes of a gripping}; run in parallel, except what `folder` has.

    Raises OrchError where a case cannot run, RunError where one fails, StoreError where the folder cannot be written.
    """
    plans = {case.name: _plan(case) for case in cases}
    paths = {case.name: folder / f"{case.name}-{plans[case.name].digest[:12]}-{FORMAT}.npz" for case in cases}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder} cannot be written: {error.strerror}") from None
    missing = [case for case in cases if not paths[case.name].exists()]
    if missing:
        report(f"{len(missing)} of {len(cases)} runs to judge at every step")
    commands = [_command(case.key, plans[case.name], paths[case.name]) for case in missing]
    processes.run_plans(commands, CommandProgress(len(commands), report))
    return {case.name: _load(paths[case.name]) for case in cases}


class _Steps(Observer):
    """Reduces the rows of a plan that records every step."""

    def __init__(self, plan: Plan):
        self._stride = round(ROW / plan.experiment.master.step)
        self._grid = plan.experiment.grid
        self._columns: dict[str, list[int]] = {}  # {vector: columns of a block}
        for column, (component, variable) in enumerate(plan.recorded):
            self._columns.setdefault(f"{component}.{variable.name.rpartition('.')[0]}", []).append(column)
        self._numbers = ("1", "2") if "vehicle1.eta" in self._columns else ("",)
        self._rows = np.empty((0, len(plan.recorded)))
        self._tick = plan.first  # of the first of these
        self._parts: list[dict[str, Reals]] = []

    def rows(self, block: Block) -> None:
        self._rows = np.concatenate([self._rows, block.values["real"]])
        if len(self._rows) > BLOCK * self._stride:
            self._reduce()

    def arrays(self) -> dict[str, Reals]:
        """Of the whole run, by names such as "1.eta"."""
        self._reduce()
        return {name: np.concatenate([part[name] for part in self._parts]) for name in self._parts[0]}

    def _reduce(self) -> None:
        """Take all whole rows of 10 ms; the last step stays, as the one before the next row."""
        n = (len(self._rows) - 1) // self._stride * self._stride
        if not n and self._parts:
            return
        tracks = [track(_Vectors(self, n + 1), number) for number in self._numbers]
        parts = {f"{k}.": extremes(one, self._stride) for k, one in zip(self._numbers, tracks, strict=True)}
        arrays = {prefix + f.name: getattr(of, f.name) for prefix, of in parts.items() for f in fields(of)}
        if len(tracks) == 2:
            arrays["distance"] = _bounds(distance(*tracks), self._stride)
            arrays["heading"] = _bounds(heading_difference(*tracks), self._stride)
        first = 1 if self._parts else 0  # the step before belongs to the row before
        self._parts.append({name: values[first:] for name, values in arrays.items()})
        self._rows, self._tick = self._rows[n:], self._tick + n

    def vector(self, name: str, n: int) -> Reals:
        return self._rows[:n, self._columns[name]]

    def times(self, n: int) -> Reals:
        return self._grid.times(self._tick, self._tick + n)


class _Vectors:
    """The first n rows, as `signals.track` reads those of a record."""

    def __init__(self, steps: _Steps, n: int):
        self._steps, self._n = steps, n
        self.time = steps.times(n)

    def __getitem__(self, name: str) -> Reals:
        return self._steps.vector(name, self._n)


def _plan(case: Case) -> Plan:
    step = case.plan().experiment.master.step
    return prepare(case.path, {**case.sets, "record.every": step, "record.signals": SIGNALS})


def _command(name: str, plan: Plan, path: Path) -> processes.ChildCommand:
    job = pickle.dumps({"plan": plan, "path": path})
    return processes.ChildCommand(name=f"{name}, every step", arguments=("-m", __name__), stdin=job, cost=plan.steps)


def _run(plan: Plan, path: Path) -> None:
    """Run a plan and write its extremes.  Raises OrchError where it cannot run or does not complete."""
    steps = _Steps(plan)
    with interruptible() as interrupt, System.open(plan, interrupt.is_set) as system:
        outcome = run_master(system, [steps], interrupt)
    if outcome.status != "completed":
        raise RunError(outcome.error)
    partly = path.with_suffix(f".{os.getpid()}.part")
    try:
        with partly.open("wb") as file:
            np.savez(file, allow_pickle=False, **steps.arrays())
        os.replace(partly, path)
    finally:
        partly.unlink(missing_ok=True)


def _load(path: Path) -> Extremes | PairExtremes:
    with np.load(path) as arrays:
        of = {prefix: _vehicle(arrays, prefix) for prefix in (".", "1.", "2.") if f"{prefix}time" in arrays}
        if "." in of:
            return of["."]
        return PairExtremes(one=of["1."], two=of["2."], distance=arrays["distance"], heading=arrays["heading"])


def _vehicle(arrays: Any, prefix: str) -> Extremes:
    return Extremes(**{f.name: arrays[prefix + f.name] for f in fields(Extremes)})


def _bounds(values: Reals, stride: int) -> Reals:
    """Least and largest of each group.  values: (1 + n stride, ...).  Returns (1 + n, 2, ...)."""
    return np.stack([_groups(values, stride, np.min), _groups(values, stride, np.max)], axis=1)


def _groups(values: Reals, stride: int, function: Callable[..., Reals]) -> Reals:
    groups = values[1:].reshape(-1, stride, *values.shape[1:])
    return np.concatenate([values[:1], function(groups, axis=1)])


if __name__ == "__main__":
    end_with_parent(signal.SIGTERM)
    answer = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what an FMU prints is no part of the result
    _run(**pickle.load(sys.stdin.buffer))
    json.dump({}, answer)
    answer.close()
