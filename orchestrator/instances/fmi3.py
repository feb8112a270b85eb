"""One instance of an FMU 3.0."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

import numpy as np

from .fmi2 import DISCARD, ERROR, WARNING, Instance, Library, exchange_strings
from .messages import keep

MOST_UPDATES = 1000  # of discrete states at one event
BOOL = ctypes.c_bool


class Instance3(Instance):
    """A live FMU 3.0.

    It is asked to handle its events by itself; one that refuses is stepped from event to event in event mode.
    `_answers`: what a step said: event handling needed, terminate, early return.
    """

    version = 3

    def _instantiate(self, library: Library) -> Any:
        self._answers = np.zeros(3, dtype=np.bool_)
        self._reached = np.zeros(1)  # s, the time at which the last step ended
        self._event_mode = False
        self._logger = _logger()  # must live as long as the instance
        component = self._try(library)
        if component is None and self.fmu.capabilities["hasEventMode"]:
            self._event_mode = True
            component = self._try(library)
        return component

    def _try(self, library: Library) -> Any:
        resources = f"{library.folder / 'resources'}{os.sep}"
        event_mode = BOOL(self._event_mode)
        instantiate = self.function("fmi3InstantiateCoSimulation")
        instantiate.restype = ctypes.c_void_p
        return instantiate(
            self.name.encode(),
            self.fmu.guid.encode(),
            resources.encode(),
            BOOL(False),
            BOOL(True),
            event_mode,
            event_mode,
            None,
            ctypes.c_size_t(0),
            ctypes.c_void_p(self._environment),
            self._logger,
            None,
        )

    def setup(self, start_time: float, stop_time: float | None, values: Mapping[str, Any]) -> None:
        structure = {n: v for n, v in values.items() if self.fmu.variables[n].causality == "structuralParameter"}
        if structure:
            self.call("EnterConfigurationMode")
            self.assign(structure)
            self.call("ExitConfigurationMode")
        self.assign({name: value for name, value in values.items() if name not in structure})
        self.call(
            "EnterInitializationMode",
            BOOL(False),
            ctypes.c_double(0.0),
            ctypes.c_double(start_time),
            BOOL(stop_time is not None),
            ctypes.c_double(stop_time or 0.0),
        )

    def begin(self) -> None:
        super().begin()
        if self._event_mode:
            self.check(self._leave_event_mode())

    def exchange(self, verb: str, kind: str, references: Any, buffer: Any) -> Callable[[], Any]:
        call = partial(
            self.function(self.accessor(verb, kind)),
            ctypes.c_void_p(self.component),
            references.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_size_t(len(references)),
        )
        n = ctypes.c_size_t(len(buffer))
        if kind == "string":
            return partial(exchange_strings, call, verb == "Get", buffer, (ctypes.c_char_p * len(buffer))(), (n,))
        if kind == "binary":
            return partial(_exchange_binaries, call, verb == "Get", buffer, n)
        return partial(call, buffer.ctypes.data_as(ctypes.c_void_p), n)

    def stepper(self, h: float) -> Callable[[ctypes.c_double], Any]:
        if self._event_mode:
            return lambda t: self._step_through_events(t.value, t.value + h)
        return partial(self._step, h=h)

    def program(self) -> tuple[Any, ...]:
        if not self._event_mode:
            return self.version, self.component, self.address("fmi3DoStep"), (self._answers, self._reached)

        def step(component: Any, t: float, h: float, _: int) -> int:
            return self._step_through_events(t, t + h)

        self._callback = STEP(step)  # must live as long as the loop
        return 2, self.component, ctypes.cast(self._callback, ctypes.c_void_p).value, None

    def wants_to_end(self) -> bool:
        return bool(self._answers[1])

    def has_reached(self, end: float) -> bool:
        return math.isclose(self._reached[0], end, rel_tol=1e-9)

    def _step(self, t: Any, h: float) -> int:
        answers = self._answers.ctypes.data
        status = int(
            self._function("DoStep")(
                ctypes.c_void_p(self.component),
                t,
                ctypes.c_double(h),
                BOOL(True),
                ctypes.c_void_p(answers),
                ctypes.c_void_p(answers + 1),
                ctypes.c_void_p(answers + 2),
                ctypes.c_void_p(self._reached.ctypes.data),
            )
        )
        if status <= WARNING and self._answers[1]:
            return DISCARD
        if status <= WARNING and self._answers[2] and not self._event_mode:
            keep(self._environment, ERROR, b"it ended a step early, which it was not allowed to")
            return ERROR
        return status

    def _step_through_events(self, t: float, end: float) -> int:
        """Steps to `end` [s], by way of event mode where the FMU says so."""
        while True:
            status = self._step(ctypes.c_double(t), end - t)
            if status > WARNING:
                return status
            early, reached = bool(self._answers[2]), float(self._reached[0])
            if early and not t <= reached <= end:
                keep(self._environment, ERROR, f"it ended the step from {t:.10g} s at {reached:.10g} s".encode())
                return ERROR
            if self._answers[0]:
                status = self._function("EnterEventMode")(ctypes.c_void_p(self.component))
                if status <= WARNING:
                    status = self._leave_event_mode()
                if status > WARNING:
                    return int(status)
            if not early or reached >= end:
                return int(status)
            t = reached

    def _leave_event_mode(self) -> int:
        flags, next_event = (BOOL * 5)(), ctypes.c_double()
        component, size = ctypes.c_void_p(self.component), ctypes.sizeof(BOOL)
        for _ in range(MOST_UPDATES):
            status = self._function("UpdateDiscreteStates")(
                component, *(ctypes.byref(flags, i * size) for i in range(5)), ctypes.byref(next_event)
            )
            if status > WARNING:
                return int(status)
            if flags[1]:
                self._answers[1] = True
                return DISCARD
            if not flags[0]:
                return int(self._function("EnterStepMode")(component))
        keep(self._environment, ERROR, f"its discrete states do not settle in {MOST_UPDATES} updates".encode())
        return ERROR


STEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)


@cache
def _logger() -> Any:
    from fmpy.fmi3 import fmi3LogMessageCallback

    def logger(environment: int | None, status: int, category: bytes, message: bytes) -> None:
        keep(environment, status, message)

    return fmi3LogMessageCallback(logger)


def _exchange_binaries(call: Any, reads: bool, buffer: Any, n: Any) -> Any:
    sizes, values = (ctypes.c_size_t * n.value)(), (ctypes.c_void_p * n.value)()
    if reads:
        status = call(sizes, values, n)
        if status <= WARNING:
            buffer[:] = [ctypes.string_at(v, size) if v else b"" for v, size in zip(values, sizes, strict=True)]
        return status
    sizes[:] = [len(value) for value in buffer]
    kept = [ctypes.create_string_buffer(value, max(1, len(value))) for value in buffer]
    values[:] = [ctypes.addressof(value) for value in kept]
    return call(sizes, values, n)
