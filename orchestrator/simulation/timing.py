"""Where the time of a run goes: in some steps, the calls of each component are timed."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
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

    def summary(
        self, names: Sequence[str], ticks: int, loop: str, live: Mapping[str, tuple[float, float]]
    ) -> dict[str, Any]:
        """As the record keeps it: seconds of each component, estimated for all its steps; together at most what
        stepping took.

        ticks: done.  live: {component: seconds in its steps, and of these waited for what is outside}, of every step:
        a timed step that waits would count 127 times.
        """
        components: dict[str, dict[str, float]] = {}
        for i, name in enumerate(names):
            steps = -(-ticks // self._periods[i])
            share = steps / max(1, int(self.samples[i]))
            seconds = {phase: float(self.seconds[i, k]) * share for k, phase in enumerate(PHASES)}
            components[name] = {**seconds, "steps": steps}
        estimated = sum(of[phase] for name, of in components.items() if name not in live for phase in PHASES)
        left = max(0.0, self.stepping - sum(seconds for seconds, _ in live.values()))
        for name, of in components.items():
            if name in live:
                seconds_of, waited = live[name]
                of.update({"set": 0.0, "step": seconds_of - waited, "get": 0.0, "waited": waited})
            elif estimated > left:
                of.update({phase: of[phase] * left / estimated for phase in PHASES})
        return {"loop": loop, "stepping": self.stepping, "components": components}
