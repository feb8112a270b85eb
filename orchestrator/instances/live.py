"""Components that run inside orch, in place of an FMU: what steers from outside.

What comes from outside is heard once a step, kept with the record where it changes, and can be replayed from there.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..arrays import Reals
from ..errors import OrchError
from ..fmu.builtin import Builtin, load
from ..fmu.fmu import Fmu
from .fmi2 import FATAL, OK, CallFailed, Instance
from .isolated import STEPPER


class Live(Instance):
    """A builtin as the loops step it.  `heard`: (tick of its own, numbers) wherever they change.

    replay: what an earlier run heard, (times, numbers); nothing is listened to then.
    """

    batched = True

    def __init__(self, name: str, fmu: Fmu, context: Mapping[str, Any], replay: tuple[Reals, Reals] | None):
        self.name, self.fmu, self._context, self._replay = name, fmu, context, replay
        self.component = 0
        self.healthy = True
        self._builtin: Builtin | None = None
        self.heard: list[tuple[float, Reals]] = []
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
        self._gathered: list[tuple[Any, Any]] = []  # buffer, places in the inputs
        self._given: list[tuple[Any, Any]] = []  # buffer, places in the outputs

    def exchange(self, verb: str, kind: str, references: Any, buffer: Any) -> Callable[[], Any]:
        places = np.array([self._places[r] for r in references.tolist()], dtype=np.intp)
        (self._gathered if verb == "Set" else self._given).append((buffer, places))
        return self._take if verb == "Set" else self._begin_again

    def setup(self, start_time: float, stop_time: float | None, values: Mapping[str, Any]) -> None:
        parameters = {n: v for n, v in values.items() if self.fmu.variables[n].causality == "parameter"}
        for name, value in values.items():
            if self.fmu.variables[name].causality == "input":
                self._inputs[self._places[self.fmu.variables[name].reference]] = value
        try:
            self._builtin = load(self.fmu.model_name)(self.name, parameters, self._context)
        except OrchError as error:
            raise CallFailed.of(FATAL, str(error)) from None

    def begin(self) -> None:
        """Nothing is left to do."""

    def stepper(self, h: float) -> Callable[[ctypes.c_double], Any]:
        return lambda t: self._step(None, t.value, h, 1)

    def program(self) -> tuple[Any, ...]:
        self._callback = STEPPER(self._step)  # must live as long as the loop
        return self.version, 0, ctypes.cast(self._callback, ctypes.c_void_p).value, None

    def check(self, status: int) -> None:
        if status != OK:
            raise CallFailed.of(status, self._error)

    def wants_to_end(self) -> bool:
        return False

    def has_reached(self, end: float) -> bool:
        return False

    def take_messages(self) -> list[str]:
        return []

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

    def _begin_again(self) -> int:
        assert self._builtin is not None
        self._outputs[:] = self._builtin.start(self._inputs)
        return self._give()

    def _step(self, component: Any, t: float, h: float, _: int) -> int:
        assert self._builtin is not None
        self._take()
        try:
            heard = self._builtin.listen(t, self._inputs) if self._replay is None else self._heard_then(t)
            if not self.heard or not np.array_equal(heard, self.heard[-1][1], equal_nan=True):
                self.heard.append((t, np.array(heard, dtype=float)))
            self._outputs[:] = self._builtin.step(t, h, self._inputs, heard)
        except OrchError as error:
            self._error = str(error)
            return FATAL
        return self._give()

    def _heard_then(self, t: float) -> Reals:
        assert self._replay is not None
        times, numbers = self._replay
        found: Reals = numbers[max(0, int(np.searchsorted(times, t, side="right")) - 1)]
        return found
