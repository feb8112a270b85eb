"""Builtins that run: components inside orch, in place of an FMU, that the world outside drives.

What comes from outside is listened to once a step, kept with the record where it changes, and can be replayed from
there.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..arrays import Places, Reals, References, Table
from ..errors import OrchError
from ..fmu.builtin import Builtin, load
from ..fmu.fmu import Fmu
from .instance import FATAL, OK, BatchedInstance, Call, CallFailed, Verb


class LiveInstance(BatchedInstance):
    """A builtin that runs.  `heard`: (t [s], numbers) of its steps, wherever the numbers change.

    context: what the builtin may need of the run.  replay: what an earlier run heard, (N,) times [s] and (N, m)
    numbers; nothing is listened to then.
    """

    def __init__(self, name: str, fmu: Fmu, context: Mapping[str, Any], replay: tuple[Reals, Reals] | None):
        super().__init__(name, fmu)
        self._context, self._replay = context, replay
        self._builtin: Builtin | None = None
        self.heard: list[tuple[float, Reals]] = []
        self.seconds = self.waited = 0.0  # s of wall time in steps, and of these in `listen`
        self._error = ""
        self._inputs, self._outputs = (
            np.array([v.initial for v in fmu.variables.values() if v.causality == causality], dtype=float)
            for causality in ("input", "output")
        )
        self._places = {
            v.reference: place
            for causality in ("input", "output")
            for place, v in enumerate(v for v in fmu.variables.values() if v.causality == causality)
        }
        self._gathered: list[tuple[Table, Places | slice]] = []  # buffer, places in the inputs
        self._given: list[tuple[Table, Places | slice]] = []  # buffer, places in the outputs

    def exchange(self, verb: Verb, kind: str, references: References, buffer: Table) -> Call:
        places = np.array([self._places[r] for r in references.tolist()], dtype=np.intp)
        first, end = int(places[0]), int(places[0]) + len(places)
        block = slice(first, end) if np.array_equal(places, np.arange(first, end)) else places  # as fast as a copy
        (self._gathered if verb == "Set" else self._given).append((buffer, block))
        return self._take if verb == "Set" else self._restart

    def setup(
        self, start_time: float, stop_time: float | None, tolerance: float | None, values: Mapping[str, Any]
    ) -> None:
        parameters = {n: v for n, v in values.items() if self.fmu.variables[n].causality == "parameter"}
        for name, value in values.items():
            if self.fmu.variables[name].causality == "input":
                self._inputs[self._places[self.fmu.variables[name].reference]] = value
        try:
            self._builtin = load(self.fmu.model_name)(self.name, parameters, self._context)
        except OrchError as error:
            raise CallFailed(FATAL, str(error)) from None

    def begin(self) -> None:
        """Nothing is left to do."""

    def check(self, status: int) -> None:
        if status != OK:
            raise CallFailed(status, self._error)

    def close(self) -> None:
        if self._builtin is not None:
            self._builtin.close()
            self._builtin = None

    def _take(self) -> int:
        for buffer, places in self._gathered:
            self._inputs[places] = buffer
        return OK

    def _give(self) -> int:
        for buffer, places in self._given:
            buffer[:] = self._outputs[places]
        return OK

    def _restart(self) -> int:
        assert self._builtin is not None
        self._outputs[:] = self._builtin.start(self._inputs)
        return self._give()

    def _step(self, handle: int | None, t: float, h: float, _: int) -> int:
        assert self._builtin is not None
        self._take()
        began = time.perf_counter()
        try:
            heard = self._builtin.listen(t, self._inputs) if self._replay is None else self._heard_then(t)
            self.waited += time.perf_counter() - began
            if len(heard) and (not self.heard or not np.array_equal(heard, self.heard[-1][1], equal_nan=True)):
                self.heard.append((t, np.array(heard, dtype=float)))
            self._outputs[:] = self._builtin.step(t, h, self._inputs, heard)
        except OrchError as error:
            self._error = str(error)
            return FATAL
        finally:
            self.seconds += time.perf_counter() - began
        return self._give()

    def _heard_then(self, t: float) -> Reals:
        assert self._replay is not None
        times, numbers = self._replay
        row: Reals = numbers[max(0, int(np.searchsorted(times, t, side="right")) - 1)]
        return row
