"""One FMU instance, driven through FMPy's bindings; every status is checked, every message kept."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import itertools
import re
from collections import deque
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from .errors import FmuError
from .fmu import Fmu, Variable

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
STATUS = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal")
TERMINATED = 3  # fmi2StatusKind

CTYPES: dict[str, Any] = {
    "real": ctypes.c_double, "integer": ctypes.c_int, "boolean": ctypes.c_int, "string": ctypes.c_char_p,
}  # fmt: skip

_ENVIRONMENTS = itertools.count(1)
_MESSAGES: dict[int, deque[str]] = {}  # by environment


class CallFailed(Exception):
    """An FMI call that gave an error.  `.status`: fmi2Discard, fmi2Error or fmi2Fatal."""

    def __init__(self, status: int, words: str):
        self.status = status
        name = STATUS[status] if 0 <= status < len(STATUS) else f"status {status}"
        super().__init__(f'{name}: "{words}"' if words else f"{name}, without a word")


class Library:
    """The library of an FMU that is unpacked in `folder`, shared by its instances.  Raises FmuError where it does not
    load."""

    def __init__(self, fmu: Fmu, folder: Path):
        from fmpy.fmi2 import FMU2Slave

        self.fmu, self._resources = fmu, (folder / "resources").as_uri()
        try:
            # FMPy's bindings take milliseconds to make, and serve any instance.
            self._slave = FMU2Slave(guid=fmu.guid, unzipDirectory=str(folder), modelIdentifier=fmu.model_identifier)
        except Exception as error:  # FMPy raises what dlopen says
            raise FmuError(f"{fmu.path} cannot be loaded: {error}") from None
        with contextlib.suppress(AttributeError):  # pythonfmu 0.7.0 frees its state twice at exit unless asked before
            atexit.register(self._slave.dll.finalizePythonInterpreter)

    def instantiate(self, name: str, callbacks: Any) -> Any:
        """The component, None where the FMU refuses.  callbacks: must live as long as the component."""
        from fmpy.fmi2 import fmi2CoSimulation

        guid, resources = self.fmu.guid.encode(), self._resources.encode()
        return self._slave.fmi2Instantiate(
            name.encode(), fmi2CoSimulation, guid, resources, ctypes.byref(callbacks), False, True
        )

    def function(self, name: str) -> Any:
        """The FMI function itself: without the argument types that FMPy declares and ctypes would check each time."""
        return self._slave.dll[name]


class Instance:
    """A live FMU.  Raises FmuError where it cannot be instantiated."""

    def __init__(self, name: str, library: Library):
        self.name, self.fmu = name, library.fmu
        self.healthy = self._begun = False
        self.function = library.function
        environment = next(_ENVIRONMENTS)
        self._messages = _MESSAGES[environment] = deque[str](maxlen=20)
        # Must live as long as the instance.
        self._callbacks = _callbacks_for(environment, formats=self.fmu.packaging != "python")
        self.component = library.instantiate(name, self._callbacks)
        if self.component is None:
            raise FmuError(f"{self.fmu.path} cannot be instantiated as {name!r}{self._words(': ')}")
        self.healthy = True

    def call(self, name: str, *arguments: Any) -> None:
        """Call an FMI function of this instance.  Raises CallFailed."""
        self.check(self.function(name)(ctypes.c_void_p(self.component), *arguments))

    def check(self, status: int) -> None:
        """Raise CallFailed unless the status is fmi2OK or fmi2Warning."""
        if status > WARNING or status < 0:
            # A Python FMU that has raised must never be called or freed again (it segfaults).
            self.healthy = self.healthy and status == DISCARD
            raise CallFailed(status, self._words())

    def setup(self, stop_time: float | None, values: Mapping[str, Any]) -> None:
        """Enter initialization mode with parameters and start values.  Raises CallFailed."""
        defined = stop_time is not None
        self.call("fmi2SetupExperiment", 0, ctypes.c_double(0.0), ctypes.c_double(0.0), int(defined),
                  ctypes.c_double(stop_time or 0.0))  # fmt: skip
        for name, value in values.items():
            self.set(self.fmu.variables[name], value)
        self.call("fmi2EnterInitializationMode")

    def begin(self) -> None:
        """Leave initialization mode: steps may follow.  Raises CallFailed."""
        self.call("fmi2ExitInitializationMode")
        self._begun = True

    def set(self, variable: Variable, value: Any) -> None:
        """Set one variable.  Raises CallFailed."""
        kind = variable.kind
        if kind == "string":
            value = str(value).encode()
        self.call(f"fmi2Set{kind.capitalize()}", ctypes.byref(ctypes.c_uint(variable.reference)), ctypes.c_size_t(1),
                  ctypes.byref(CTYPES[kind](value)))  # fmt: skip

    def get(self, variable: Variable) -> Any:
        """The value of a variable that is no text.  Raises CallFailed."""
        value = CTYPES[variable.kind]()
        self.call(f"fmi2Get{variable.kind.capitalize()}", ctypes.byref(ctypes.c_uint(variable.reference)),
                  ctypes.c_size_t(1), ctypes.byref(value))  # fmt: skip
        return value.value

    def wants_to_end(self) -> bool:
        """After fmi2Discard: whether the FMU asks to end the simulation.

        pythonfmu's library answers no status query; its only word for it is the discarded step.
        """
        ended = ctypes.c_int(0)
        status = self.function("fmi2GetBooleanStatus")(
            ctypes.c_void_p(self.component), TERMINATED, ctypes.byref(ended)
        )
        if status > WARNING:
            return self.fmu.packaging == "python"
        return bool(ended.value)

    def close(self) -> None:
        """Terminate and free the instance; one that has failed is left alone, for freeing it may crash."""
        if not self.healthy:
            return
        self.healthy = False
        component = ctypes.c_void_p(self.component)
        if self._begun and self.function("fmi2Terminate")(component) > WARNING:
            return
        self.function("fmi2FreeInstance")(component)

    def take_messages(self) -> list[str]:
        """What the FMU has said since the last call, each sentence once."""
        messages = list(dict.fromkeys(self._messages))
        self._messages.clear()
        return messages

    def _words(self, before: str = "") -> str:
        words = "; ".join(self.take_messages())
        return before + words if words else ""


@cache
def _callbacks(formats: bool) -> Any:
    """The callbacks of every instance.  There is one logger, for FMPy's proxy, which formats printf-style messages,
    remembers but one; it tells instances apart by their environment.

    formats: False for pythonfmu's library, which hands the text of an exception over as a format: a "%s" in it would
    read whatever lies in memory.
    """
    from fmpy.fmi2 import defaultCallbacks, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
    from fmpy.logging import addLoggerProxy

    def logger(environment: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        messages = _MESSAGES.get(environment or 0)
        if messages is not None and status > OK:
            messages.append(_plain((message or b"").decode(errors="replace")))

    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(logger)
    callbacks.allocateMemory = defaultCallbacks.allocateMemory
    callbacks.freeMemory = defaultCallbacks.freeMemory
    if formats:
        addLoggerProxy(ctypes.byref(callbacks))
    return callbacks, logger


def _callbacks_for(environment: int, formats: bool) -> Any:
    from fmpy.fmi2 import fmi2CallbackFunctions

    copy = fmi2CallbackFunctions.from_buffer_copy(_callbacks(formats)[0])
    copy.componentEnvironment = environment
    return copy


def _plain(message: str) -> str:
    """The model's own words, without what pythonfmu's library puts around them."""
    text = " ".join(message.split())
    match = re.search(r"Fatal py exception encountered: \[\w+\] \w+ (.*)", text)
    if not match:
        return text
    error = re.fullmatch(r"(\w+)\((['\"])(.*?)\2?,?\)", match[1])
    return f"{error[1]}: {error[3]}" if error else match[1]
