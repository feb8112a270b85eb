"""An instance of an FMU 3.0."""

from __future__ import annotations

import ctypes
import math
import os
from collections.abc import Mapping
from functools import cache, partial
from typing import Any

import numpy as np

from .instance import DISCARD, ERROR, STEP, WARNING, StepCall, StepFunction
from .library import Library, LibraryInstance
from .messages import keep

MOST_UPDATES = 1000  # of discrete states at one event
BOOL = ctypes.c_bool


class Fmi3Instance(LibraryInstance):
    """An FMU 3.0 that runs in this process.

    It is asked to handle its events by itself; one that refuses is stepped from event to event in event mode.
    `_answers`: of the last step: event handling needed, terminate, early return.
    """

    version = 3

    def _instantiate(self, library: Library) -> int | None:
        self._answers = np.zeros(3, dtype=np.bool_)
        self._reached = np.zeros(1)  # s, the time at which the last step ended
        self._event_mode = False
        self._logger = _logger()  # must live as long as the instance
        handle = self._try(library)
        if handle is None and self.fmu.capabilities["hasEventMode"]:
            self._event_mode = True
            self.take_messages()  # of the refusal
            handle = self._try(library)
        return handle

    def _try(self, library: Library) -> int | None:
        resources = f"{library.folder / 'resources'}{os.sep}"
        event_mode = BOOL(self._event_mode)
        instantiate = library.function("fmi3InstantiateCoSimulation")
        instantiate.restype = ctypes.c_void_p
        handle: int | None = instantiate(
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
        return handle

    def setup(
        self, start_time: float, stop_time: float | None, tolerance: float | None, values: Mapping[str, Any]
    ) -> None:
        structure = {n: v for n, v in values.items() if self.fmu.variables[n].causality == "structuralParameter"}
        if structure:
            self.call("EnterConfigurationMode")
            self.assign(structure)
            self.call("ExitConfigurationMode")
        self.assign({name: value for name, value in values.items() if name not in structure})
        self.call(
            "EnterInitializationMode",
            BOOL(tolerance is not None),
            ctypes.c_double(tolerance or 0.0),
            ctypes.c_double(start_time),
            BOOL(stop_time is not None),
            ctypes.c_double(stop_time or 0.0),
        )

    def begin(self) -> None:
        super().begin()
        if self._event_mode:
            self.check(self._leave_event_mode())

    def step_call(self, h: float) -> StepCall:
        if self._event_mode:
            return lambda t: self._step_through_events(t.value, t.value + h)
        return partial(self._step, h=h)

    def step_function(self) -> StepFunction:
        if not self._event_mode:
            return StepFunction(3, self._handle, self._address("fmi3DoStep"), (self._answers, self._reached))

        def step(handle: int | None, t: float, h: float, _: int) -> int:
            return self._step_through_events(t, t + h)

        self._callback = STEP(step)  # must live as long as the loop
        return StepFunction(3, self._handle, ctypes.cast(self._callback, ctypes.c_void_p).value or 0, None)

    def wants_to_end(self) -> bool:
        return bool(self._answers[1])

    def has_reached(self, end: float) -> bool:
        return math.isclose(self._reached[0], end, rel_tol=1e-9)

    def _step(self, t: ctypes.c_double, h: float) -> int:
        answers = self._answers.ctypes.data
        status = int(
            self._function("DoStep")(
                ctypes.c_void_p(self._handle),
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
            keep(self._environment, ERROR, b"it returned early from a step, which it was not allowed to")
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
                keep(self._environment, ERROR, f"its step from {t:.10g} s returned at {reached:.10g} s".encode())
                return ERROR
            if self._answers[0]:
                status = self._function("EnterEventMode")(ctypes.c_void_p(self._handle))
                if status <= WARNING:
                    status = self._leave_event_mode()
                if status > WARNING:
                    return int(status)
            if not early or reached >= end:
                return int(status)
            t = reached

    def _leave_event_mode(self) -> int:
        flags, next_event = (BOOL * 5)(), ctypes.c_double()
        handle, size = ctypes.c_void_p(self._handle), ctypes.sizeof(BOOL)
        for _ in range(MOST_UPDATES):
            status = self._function("UpdateDiscreteStates")(
                handle, *(ctypes.byref(flags, i * size) for i in range(5)), ctypes.byref(next_event)
            )
            if status > WARNING:
                return int(status)
            if flags[1]:
                self._answers[1] = True
                return DISCARD
            if not flags[0]:
                return int(self._function("EnterStepMode")(handle))
        keep(self._environment, ERROR, f"its discrete states do not settle in {MOST_UPDATES} updates".encode())
        return ERROR


@cache
def _logger() -> Any:
    from fmpy.fmi3 import fmi3LogMessageCallback

    def logger(environment: int | None, status: int, category: bytes, message: bytes) -> None:
        keep(environment, status, message)

    return fmi3LogMessageCallback(logger)
