"""One instance of an FMU 2.0, driven through ctypes; every status is checked, every message kept.

`instance3` is the same for FMI 3.0, `remote` for an instance in another process, `builtin` for what is no FMU.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FmuError
from ..fmu.fmu import Fmu, platform_folder
from ..fmu.variables import ACCESSORS, DTYPES, Variable
from .messages import callbacks_for, listen

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
STATUS = ("OK", "Warning", "Discard", "Error", "Fatal")
CO_SIMULATION = 1  # fmi2Type
LAST_SUCCESSFUL_TIME, TERMINATED = 2, 3  # fmi2StatusKind


class CallFailed(Exception):
    """An FMI call that gave an error.  `.status`: DISCARD, ERROR or FATAL."""

    def __init__(self, version: int, status: int, words: str):
        self.status = status
        name = f"fmi{version}{STATUS[status]}" if 0 <= status < len(STATUS) else f"status {status}"
        super().__init__(f'{name}: "{words}"' if words else f"{name}, without a word")

    @classmethod
    def of(cls, status: int, text: str) -> CallFailed:
        """One in words of its own."""
        error = cls.__new__(cls)
        error.status, error.args = status, (text,)
        return error

    def __reduce__(self) -> Any:  # it travels between processes
        return CallFailed.of, (self.status, str(self))


class Library:
    """The library of an FMU that is unpacked in `folder`, shared by its instances.  Raises FmuError where it does not
    load."""

    def __init__(self, fmu: Fmu, folder: Path):
        self.fmu, self.folder = fmu, folder
        platform, suffix = platform_folder(fmu.version)
        path = folder / "binaries" / platform / f"{fmu.model_identifier}{suffix}"
        try:
            # Not through FMPy's bindings, which refuse a library that lacks a function nobody calls.
            self._library = ctypes.CDLL(str(path))
        except OSError as error:
            raise FmuError(f"{fmu.path} cannot be loaded: {error}") from None
        with contextlib.suppress(AttributeError):  # pythonfmu 0.7.0 frees its state twice at exit unless asked before
            atexit.register(self._library.finalizePythonInterpreter)

    def function(self, name: str) -> Any:
        """A function of FMI.  Raises FmuError where the library has none of that name."""
        try:
            return self._library[name]
        except AttributeError:
            raise FmuError(f"{self.fmu.path} cannot be run: its library has no {name}") from None


class Instance:
    """A live FMU.  Raises FmuError where it cannot be instantiated.

    `component`: what FMI's functions take first; `batched`: whether its step sets and gets too.
    """

    version = 2
    batched = False

    def __init__(self, name: str, library: Library):
        self.name, self.fmu = name, library.fmu
        self.healthy = self._begun = False
        self.function = library.function
        self._environment, self._messages = listen()
        self.component = self._instantiate(library)
        if self.component is None:
            raise FmuError(f"{self.fmu.path} cannot be instantiated as {name!r}{self._words(': ')}")
        self.healthy = True

    def _instantiate(self, library: Library) -> Any:
        """The component, None where the FMU refuses."""
        # Must live as long as the instance.
        self._callbacks = callbacks_for(self._environment, formats=self.fmu.packaging != "python")
        resources = (library.folder / "resources").as_uri().encode()
        instantiate = self.function("fmi2Instantiate")
        instantiate.restype = ctypes.c_void_p
        return instantiate(
            self.name.encode(), CO_SIMULATION, self.fmu.guid.encode(), resources, ctypes.byref(self._callbacks), 0, 1
        )

    def call(self, name: str, *arguments: Any) -> None:
        """Call an FMI function of this instance, without its prefix.  Raises CallFailed."""
        self.check(self._function(name)(ctypes.c_void_p(self.component), *arguments))

    def _function(self, name: str) -> Any:
        return self.function(f"fmi{self.version}{name}")

    def check(self, status: int) -> None:
        """Raise CallFailed unless the status is OK or a warning."""
        if status > WARNING or status < 0:
            # A Python FMU that has raised must never be called or freed again (it segfaults).
            self.healthy = self.healthy and status == DISCARD
            raise CallFailed(self.version, status, self._words())

    def setup(self, start_time: float, stop_time: float | None, values: Mapping[str, Any]) -> None:
        """Enter initialization mode with parameters and start values.  Raises CallFailed."""
        self._set_up_experiment(start_time, stop_time)
        self.assign(values)
        self.call("EnterInitializationMode")

    def _set_up_experiment(self, start_time: float, stop_time: float | None) -> None:
        self.call(
            "SetupExperiment",
            0,
            ctypes.c_double(0.0),
            ctypes.c_double(start_time),
            int(stop_time is not None),
            ctypes.c_double(stop_time or 0.0),
        )

    def begin(self) -> None:
        """Leave initialization mode: steps may follow.  Raises CallFailed."""
        self.call("ExitInitializationMode")
        self._begun = True

    def assign(self, values: Mapping[str, Any]) -> None:
        """Set variables by name; an array whole, where one of its elements is named.  Raises CallFailed."""
        arrays: dict[int, list[Any]] = {}
        for name, value in values.items():
            variable = self.fmu.variables[name]
            if variable.shape:
                elements = arrays.setdefault(variable.reference, self.fmu.elements(variable))
                elements[variable.element] = (variable, value)
            else:
                self._set([variable], [value])
        for elements in arrays.values():
            chosen = [e if isinstance(e, tuple) else (e, e.initial) for e in elements]
            self._set([v for v, _ in chosen], [value for _, value in chosen])

    def _set(self, variables: list[Variable], values: list[Any]) -> None:
        kind = variables[0].kind
        if kind == "string":
            values = [str(value).encode() for value in values]
        elif kind == "binary":
            values = [value if isinstance(value, bytes) else bytes.fromhex(value) for value in values]
        buffer = np.empty(len(values), dtype=DTYPES[kind])
        buffer[:] = values
        self.check(self.exchange("Set", kind, references_of(variables[:1]), buffer)())

    def values(self, variables: Sequence[Variable]) -> dict[str, Any]:
        """{name: value} of numbers of one kind as they are now, of arrays all elements; nothing of an instance that is
        batched.

        Raises CallFailed.
        """
        elements = [element for variable in variables for element in self.fmu.elements(variable)]
        if self.batched or not elements:
            return {}
        buffer = np.zeros(len(elements), dtype=DTYPES[elements[0].kind])
        self.check(self.exchange("Get", elements[0].kind, references_of(variables), buffer)())
        return dict(zip((element.name for element in elements), buffer.tolist(), strict=True))

    def room(self, kind: str, n: int) -> Any:
        """(n,) values of a kind, where a batched instance takes its inputs from and gives its outputs to."""
        return np.zeros(n, dtype=DTYPES[kind])

    def exchange(self, verb: str, kind: str, references: Any, buffer: Any) -> Callable[[], Any]:
        """A getter or setter without arguments; it returns the status.

        verb: "Get" or "Set"; references: (n,) uint32; buffer: the values, which must stay where they are.
        """
        call = partial(
            self.function(self.accessor(verb, kind)),
            ctypes.c_void_p(self.component),
            references.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_size_t(len(references)),
        )
        if kind == "string":
            return partial(exchange_strings, call, verb == "Get", buffer, (ctypes.c_char_p * len(buffer))(), ())
        return partial(call, buffer.ctypes.data_as(ctypes.c_void_p))

    def accessor(self, verb: str, kind: str) -> str:
        """The name of FMI's getter or setter."""
        return f"fmi{self.version}{verb}{ACCESSORS[self.version][kind]}"

    def stepper(self, h: float) -> Callable[[ctypes.c_double], Any]:
        """doStep from a time on, over h [s]; it returns the status."""
        component, step, do_step = ctypes.c_void_p(self.component), ctypes.c_double(h), self._function("DoStep")
        return lambda t: do_step(component, t, step, 1)

    def save(self) -> bytes:
        """Its state, serialized.  Raises CallFailed, or FmuError where the library lacks a function."""
        state, size = ctypes.c_void_p(), ctypes.c_size_t()
        self.call(self._of_state("GetFMUstate"), ctypes.byref(state))
        self.call(self._of_state("SerializedFMUstateSize"), state, ctypes.byref(size))
        content = ctypes.create_string_buffer(size.value)
        self.call(self._of_state("SerializeFMUstate"), state, content, size)
        self.call(self._of_state("FreeFMUstate"), ctypes.byref(state))
        return content.raw

    def restore(self, content: bytes) -> None:
        """Go back, or ahead, to a state that was saved.  Raises like `save`."""
        state, size = ctypes.c_void_p(), ctypes.c_size_t(len(content))
        self.call(self._of_state("DeSerializeFMUstate"), content, size, ctypes.byref(state))
        self.call(self._of_state("SetFMUstate"), state)
        self.call(self._of_state("FreeFMUstate"), ctypes.byref(state))

    def _of_state(self, name: str) -> str:
        """A function of FMI 2.0 under the name that this version gives it."""
        return name if self.version == 2 else name.replace("FMUstate", "FMUState").replace("DeS", "Des")

    def address(self, function: str) -> int:
        return ctypes.cast(self.function(function), ctypes.c_void_p).value or 0

    def program(self) -> tuple[Any, ...]:
        """How the compiled loop steps it: version of FMI, component, address of the function, FMI 3.0's answers."""
        return self.version, self.component, self.address(f"fmi{self.version}DoStep"), None

    def wants_to_end(self) -> bool:
        """After a discarded step: whether the FMU asks to end the simulation.

        pythonfmu's library answers no status query; its only word for it is the discarded step.
        """
        ended = ctypes.c_int(0)
        status = self._function("GetBooleanStatus")(ctypes.c_void_p(self.component), TERMINATED, ctypes.byref(ended))
        if status > WARNING:
            return self.fmu.packaging == "python"
        return bool(ended.value)

    def has_reached(self, end: float) -> bool:
        """After a discarded step: whether it led to its end [s] all the same."""
        reached = ctypes.c_double(math.nan)
        status = self._function("GetRealStatus")(
            ctypes.c_void_p(self.component), LAST_SUCCESSFUL_TIME, ctypes.byref(reached)
        )
        return status <= WARNING and math.isclose(reached.value, end, rel_tol=1e-9)

    def close(self) -> None:
        """Terminate and free the instance; one that has failed is left alone, for freeing it may crash."""
        if not self.healthy:
            return
        self.healthy = False
        component = ctypes.c_void_p(self.component)
        if self._begun and self._function("Terminate")(component) > WARNING:
            return
        self._function("FreeInstance")(component)

    def take_messages(self) -> list[str]:
        """What the FMU has said since the last call, each sentence once."""
        messages = list(dict.fromkeys(self._messages))
        self._messages.clear()
        return messages

    def _words(self, before: str = "") -> str:
        words = "; ".join(self.take_messages())
        return before + words if words else ""


def references_of(variables: Sequence[Variable]) -> Any:
    """(n,) value references: one of each scalar, and one of each whole array."""
    return np.array([v.reference for v in variables if not v.element], dtype=np.uint32)


def exchange_strings(call: Any, reads: bool, buffer: Any, strings: Any, more: tuple[Any, ...]) -> Any:
    if not reads:
        strings[:] = list(buffer)
    status = call(strings, *more)
    if reads:
        buffer[:] = [text or b"" for text in strings]  # valid only until the next call
    return status
