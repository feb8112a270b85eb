"""One run of a sweep, from its plan to its record."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ....arrays import Reals, Table, Tables
from ....plan.plan import Plan
from ....records.file.format import ID_LENGTH
from ....records.file.recorder import Recorder, writing
from ....runs import half_step
from ....simulation.bursts import Bursts
from ....simulation.master import run as run_master
from ....simulation.observer import Block, Interrupt, Observer
from ....simulation.system import FmuSource, System

DECIMATED = 500  # rows of a decimated record, the first not counted, at most


def perform(
    plan: Plan, path: Path, keep: str, facts: Mapping[str, str], interrupt: Interrupt, source: FmuSource
) -> Recorder:
    """Run a plan into a record at `path`.  Returns the finished record, with its outcome and metrics.

    keep: which rows, "full", "decimated" (every n-th) or "metrics" (none).  Metrics are those of all rows.
    facts: root attributes that are known already.  Raises OrchError where nothing started.
    """
    signals = MetricSignals(plan)
    kept = reduced(plan, keep)
    known = {**facts, "digest": plan.digest, "experiment_resolved": json.dumps(plan.resolved)}
    if keep != "full":
        known["kept"] = keep
    with (
        System.open(plan, interrupt.is_set, source=source) as system,
        writing(path, kept, plan.digest[:ID_LENGTH], facts=known, signals=signals) as record,
    ):
        writers: list[Observer] = [] if keep == "metrics" else [_EveryNth(record, plan, kept)]
        bursts = Bursts(system)
        record.outcome = run_master(system, [signals, *writers], interrupt, bursts=bursts)
        record.flush()
        half_step.judge(plan, record.outcome, bursts, interrupt, source)
    return record


def reduced(plan: Plan, keep: str) -> Plan:
    """The plan whose rows are those that are kept."""
    if keep == "full":
        return plan
    if keep == "metrics":
        return replace(plan, recorded=())
    record = plan.experiment.record
    n = next(n for n in range(1, plan.steps // plan.stride + 1) if _divides(n, plan.steps // plan.stride))
    every = plan.experiment.grid.time(n * plan.stride)
    return replace(plan, experiment=replace(plan.experiment, record=replace(record, every=every)))


def _divides(n: int, rows: int) -> bool:
    return rows % n == 0 and rows // n <= DECIMATED


def rows_of(plan: Plan, keep: str, stopped_at: float | None) -> int:
    """How many rows a complete record has.  stopped_at: when an FMU ended the run [s], None where none did."""
    if keep == "metrics":
        return 0
    kept = reduced(plan, keep)
    ticks = plan.steps
    if stopped_at is not None:
        ticks = round(stopped_at / plan.experiment.master.step)
    return ticks // kept.stride + 1


class MetricSignals(Observer):
    """The signals that the metrics need, in memory, at every row; see `arrays.Signals`."""

    def __init__(self, plan: Plan):
        specs = plan.experiment.metrics.values()
        ends = {str(spec[end]) for spec in specs for end in ("signal", "reference") if end in spec}
        self._grid = plan.experiment.grid
        self._units: dict[str, str] = {}
        self._angles: set[str] = set()
        self._column: dict[str, tuple[str, int]] = {}  # {signal: its kind, and its column among those chosen}
        self._chosen: dict[str, list[int]] = {}  # {kind: columns of a block}
        count: dict[str, int] = {}
        for component, variable in plan.recorded:
            name, kind = f"{component}.{variable.name}", variable.kind
            index = count[kind] = count.get(kind, -1) + 1
            if name in ends or name.rpartition(".")[0] in ends:
                chosen = self._chosen.setdefault(kind, [])
                self._column[name] = kind, len(chosen)
                self._units[name] = variable.unit or "1"
                if variable.is_angle:
                    self._angles.add(name)
                chosen.append(index)
        self._ticks: list[int] = []
        self._blocks: dict[str, list[Table]] = {kind: [] for kind in self._chosen}
        self._joined: Tables = {}

    def rows(self, block: Block) -> None:
        self._ticks += block.ticks
        for kind, chosen in self._chosen.items():
            self._blocks[kind].append(block.values[kind][:, chosen])

    @property
    def signals(self) -> list[str]:
        return list(self._column)

    @cached_property
    def time(self) -> Reals:
        if not self._ticks:
            return np.empty(0)
        times: Reals = self._grid.times(0, self._ticks[-1] + 1)[self._ticks]
        return times

    def __getitem__(self, name: str) -> Table:
        kind, column = self._column[name]
        if kind not in self._joined:
            self._joined[kind] = np.ascontiguousarray(np.concatenate(self._blocks[kind]).T)
        values: Table = self._joined[kind][column]
        return values

    def units(self, name: str) -> str:
        return self._units[name]

    def is_angle(self, name: str) -> bool:
        return name in self._angles


class _EveryNth(Observer):
    """Passes every n-th row to the recorder."""

    def __init__(self, recorder: Recorder, plan: Plan, kept: Plan):
        self._recorder, self._stride, self._all = recorder, kept.stride, kept.stride == plan.stride

    def rows(self, block: Block) -> None:
        if self._all:
            return self._recorder.rows(block)
        chosen = [i for i, tick in enumerate(block.ticks) if tick % self._stride == 0]
        if chosen:
            values = {kind: rows[chosen] for kind, rows in block.values.items()}
            self._recorder.rows(Block([block.ticks[i] for i in chosen], values))
        return None
