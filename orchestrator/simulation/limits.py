"""Watches the values of a run against the limits that FMUs declare: what a model is valid for."""

from __future__ import annotations

import math

import numpy as np

from .observer import Block, Observer
from .system import System

BEYOND = 1e-9  # of a limit: less is rounding


class Limits(Observer):
    """Looks at every recorded real output in every row: at its own min and max, and those of the inputs that it drives.

    A start value and a parameter are looked at by the plan.
    """

    def __init__(self, system: System):
        plan = system.plan
        self._grid = plan.experiment.grid
        limits = {(c, v.name): [(v.limits, f"{c}.{v.name}", 1.0, 0.0)] for c, v in plan.recorded if v.kind == "real"}
        for k in plan.connections:
            if (k.source, k.output.name) in limits:
                entry = k.input.limits, f"{k.sink}.{k.input.name}", k.factor, k.offset
                limits[k.source, k.output.name].append(entry)
        self._watched: list[tuple[int, str, str, float, float]] = []  # column, signal, whose limit, factor, offset
        low, high = [], []
        for column, (port, entries) in enumerate(limits.items()):
            seen = set()
            for (least, largest), owner, factor, offset in entries:
                bounds = least, largest, factor, offset
                if bounds not in seen and (math.isfinite(least) or math.isfinite(largest)):
                    seen.add(bounds)
                    self._watched.append((column, ".".join(port), owner, factor, offset))
                    low.append(least - BEYOND * abs(least) if math.isfinite(least) else least)
                    high.append(largest + BEYOND * abs(largest) if math.isfinite(largest) else largest)
        self._low, self._high = np.array(low), np.array(high)
        self._columns = np.array([entry[0] for entry in self._watched], dtype=np.intp)
        self._factors = np.array([entry[3] for entry in self._watched])
        self._offsets = np.array([entry[4] for entry in self._watched])
        self._first: dict[int, tuple[int, float]] = {}  # {place in _watched: tick and value}
        self._farthest: dict[int, float] = {}

    def rows(self, block: Block) -> None:
        if not self._watched:
            return
        values = block.values["real"][:, self._columns] * self._factors + self._offsets
        least, largest = values.min(axis=0), values.max(axis=0)
        for i in np.flatnonzero((least < self._low) | (largest > self._high)):
            column = values[:, i]
            row = int(np.flatnonzero((column < self._low[i]) | (column > self._high[i]))[0])
            self._first.setdefault(int(i), (block.ticks[row], float(column[row])))
            low, high = float(self._low[i]), float(self._high[i])
            ends = (self._farthest.get(int(i), float(column[row])), float(least[i]), float(largest[i]))
            self._farthest[int(i)] = max((max(low - end, end - high), end) for end in ends)[1]

    def warnings(self) -> list[str]:
        """A sentence for each limit that was left."""
        sentences: list[str] = []
        for i, (tick, value) in sorted(self._first.items()):
            _, signal, owner, _, _ = self._watched[i]
            which, limit = ("min", self._low[i]) if value < self._low[i] else ("max", self._high[i])
            at = "" if owner == signal else f" of {owner}"
            time = self._grid.time(tick)
            sentences.append(
                f"{signal} = {value:.6g} at t = {time:.10g} s is beyond {limit:.6g}, the {which}{at} that its FMU "
                f"declares, and {self._farthest[i]:.6g} at its farthest: the model is not valid there"
            )
        return sentences
