"""One run of a sweep, from its experiment to its record."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ....plan.plan import Plan
from ....records.file.format import ID_LENGTH
from ....records.file.recorder import Recorder, writing
from ....simulation.master import run as run_master
from ....simulation.observer import Block, Interrupt, Observer
from ....simulation.system import FmuSource, System

DECIMATED = 500  # rows of a decimated record, the first not counted, at most


@dataclass(frozen=True)
class Performed:
    """How a run ended.  metrics: {} unless it completed."""

    status: str
    error: str
    metrics: Mapping[str, float]


def perform(
    plan: Plan, path: Path, keep: str, facts: Mapping[str, str], interrupt: Interrupt, source: FmuSource
) -> Performed:
    """Run a plan into a record at `path`.

    keep: "full"; "decimated", with every n-th row; or "metrics", without rows.  Metrics are those of all rows.
    A record that cannot be written any further makes the run a failed one.  Raises OrchError where nothing started.
    """
    rows = Rows(plan)
    kept = reduced(plan, keep)
    known = {**facts, "digest": plan.digest, "experiment_resolved": json.dumps(plan.resolved)}
    if keep != "full":
        known["kept"] = keep
    with (
        System.open(plan, interrupt.is_set, source=source) as system,
        writing(path, kept, plan.digest[:ID_LENGTH], facts=known, signals=rows) as record,
    ):
        writers: list[Observer] = [] if keep == "metrics" else [_Sieve(record, plan, kept)]
        record.outcome = run_master(system, [rows, *writers], interrupt)
    return Performed(record.outcome.status, record.outcome.error, record.metrics)


def reduced(plan: Plan, keep: str) -> Plan:
    """The plan of the rows that are kept."""
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
    """How many rows a whole record has."""
    if keep == "metrics":
        return 0
    kept = reduced(plan, keep)
    ticks = plan.steps
    if stopped_at is not None:
        ticks = round(stopped_at / plan.experiment.master.step)
    return ticks // kept.stride + 1


class Rows(Observer):
    """The signals that metrics are made of, in memory: what `metrics.evaluate` needs of a record."""

    def __init__(self, plan: Plan):
        specs = plan.experiment.metrics.values()
        ends = {str(spec[end]) for spec in specs for end in ("signal", "reference") if end in spec}
        self._grid, self._units, self._column = plan.experiment.grid, {}, {}
        self._chosen: dict[str, list[int]] = {}
        count: dict[str, int] = {}
        for component, variable in plan.recorded:
            name, kind = f"{component}.{variable.name}", variable.kind
            index = count[kind] = count.get(kind, -1) + 1
            if name in ends or name.rpartition(".")[0] in ends:
                chosen = self._chosen.setdefault(kind, [])
                self._column[name] = kind, len(chosen)
                self._units[name] = variable.unit or "1"
                chosen.append(index)
        self._ticks: list[int] = []
        self._blocks: dict[str, list[Any]] = {kind: [] for kind in self._chosen}
        self._joined: dict[str, Any] = {}

    def rows(self, block: Block) -> None:
        self._ticks += block.ticks
        for kind, chosen in self._chosen.items():
            self._blocks[kind].append(block.values[kind][:, chosen])

    @property
    def signals(self) -> list[str]:
        return list(self._column)

    @property
    def time(self) -> Any:
        if "" not in self._joined:
            self._joined[""] = self._grid.times(0, self._ticks[-1] + 1)[self._ticks] if self._ticks else np.empty(0)
        return self._joined[""]

    def __getitem__(self, name: str) -> Any:
        kind, column = self._column[name]
        if kind not in self._joined:
            self._joined[kind] = np.ascontiguousarray(np.concatenate(self._blocks[kind]).T)
        return self._joined[kind][column]

    def units(self, name: str) -> str:
        return str(self._units[name])


class _Sieve(Observer):
    """Hands every n-th row on to the recorder."""

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
