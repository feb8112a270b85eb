"""An instance of an FMU 2.0."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from typing import Any

from .instance import WARNING, StepCall, StepFunction
from .library import Library, LibraryInstance
from .messages import callbacks_for

CO_SIMULATION = 1  # fmi2Type
LAST_SUCCESSFUL_TIME, TERMINATED = 2, 3  # fmi2StatusKind


class Fmi2Instance(LibraryInstance):
    """An FMU 2.0 that runs in this process."""

    version = 2

    def _instantiate(self, library: Library) -> int | None:
        # Must live as long as the instance.
        self._callbacks = callbacks_for(self._environment, formats=self.fmu.packaging != "python")
        resources = (library.folder / "resources").as_uri().encode()
        instantiate = library.function("fmi2Instantiate")
        instantiate.restype = ctypes.c_void_p
        handle: int | None = instantiate(
            self.name.encode(), CO_SIMULATION, self.fmu.guid.encode(), resources, ctypes.byref(self._callbacks), 0, 1
        )
        return handle

    def setup(
        self, start_time: float, stop_time: float | None, tolerance: float | None, values: Mapping[str, Any]
    ) -> None:
        self.call(
            "SetupExperiment",
            int(tolerance is not None),
            ctypes.c_double(tolerance or 0.0),
            ctypes.c_double(start_time),
            int(stop_time is not None),
            ctypes.c_double(stop_time or 0.0),
        )
        self.assign(values)
        self.call("EnterInitializationMode")

    def step_call(self, h: float) -> StepCall:
        handle, step, do_step = ctypes.c_void_p(self._handle), ctypes.c_double(h), self._function("DoStep")
        return lambda t: do_step(handle, t, step, 1)

    def step_function(self) -> StepFunction:
        return StepFunction(2, self._handle, self._address("fmi2DoStep"), None)

    def wants_to_end(self) -> bool:
        """pythonfmu's library answers no status query; its only word for it is the discarded step."""
        ended = ctypes.c_int(0)
        status = self._function("GetBooleanStatus")(ctypes.c_void_p(self._handle), TERMINATED, ctypes.byref(ended))
        if status > WARNING:
            return self.fmu.packaging == "python"
        return bool(ended.value)

    def has_reached(self, end: float) -> bool:
        reached = ctypes.c_double(math.nan)
        status = self._function("GetRealStatus")(
            ctypes.c_void_p(self._handle), LAST_SUCCESSFUL_TIME, ctypes.byref(reached)
        )
        return status <= WARNING and math.isclose(reached.value, end, rel_tol=1e-9)
