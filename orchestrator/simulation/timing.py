"""Where the time of a run goes: in some steps, the calls of each component are timed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

EVERY = 127  # ticks; a prime, so that no slower component is missed or favoured
PHASES = ("set", "step", "get")


class Timing:
    """`seconds`: (components, 3) of the timed steps; `samples`: (components,) how many those were; `overhead`: s, of
    looking at the clock."""

    def __init__(self, periods: Sequence[int]):
        self._periods = periods
        self.seconds = np.zeros((len(periods), len(PHASES)))
        self.samples = np.zeros(len(periods), dtype=np.int64)
        self.overhead = min(-(time.perf_counter() - time.perf_counter()) for _ in range(100))
        self.stepping = 0.0  # s, of all stepping: the components and the loop itself

    def add(self, component: int, marks: Sequence[float]) -> None:
        """A timed step.  marks: the times before set, step, get and after it."""
        for phase in range(len(PHASES)):
            self.seconds[component, phase] += max(0.0, marks[phase + 1] - marks[phase] - self.overhead)
        self.samples[component] += 1

    def summary(self, names: Sequence[str], ticks: int, loop: str) -> dict[str, Any]:
        """As the record keeps it: seconds of each component, estimated for all its steps.  ticks: done."""
        components = {}
        for i, name in enumerate(names):
            steps = -(-ticks // self._periods[i])
            share = steps / max(1, int(self.samples[i]))
            seconds = {phase: float(self.seconds[i, k]) * share for k, phase in enumerate(PHASES)}
            components[name] = {**seconds, "steps": steps}
        return {"loop": loop, "stepping": self.stepping, "components": components}
