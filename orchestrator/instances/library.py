"""The library of an FMU, and what its instances have in common in FMI 2.0 and 3.0."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import References, Table
from ..errors import FmuError
from ..fmu.fmu import Fmu, platform_folder
from ..fmu.variables import ACCESSORS, DTYPES, Variable
from .instance import DISCARD, STATUS, WARNING, Call, CallFailed, Instance, Verb, references_of
from .messages import Message, listen


class Library:
    """The library of an FMU that is unpacked in `folder`, shared by its instances.

    Raises FmuError where it does not load.
    """

    def __init__(self, fmu: Fmu, folder: Path):
        self.fmu, self.folder = fmu, folder
        platform, suffix = platform_folder(fmu.version)
        path = folder / "binaries" / platform / f"{fmu.model_identifier}{suffix}"
        try:
            # Not through FMPy's bindings, which refuse a library that lacks a function that is not called.
            self._library = ctypes.CDLL(str(path))
        except OSError as error:
            raise FmuError(f"{fmu.path} cannot be loaded: {error}") from None
        with contextlib.suppress(AttributeError):  # pythonfmu 0.7.0 frees its state twice at exit unless asked before
            atexit.register(self._library.finalizePythonInterpreter)

    def function(self, name: str) -> Any:
        """A function of FMI.  Raises FmuError where the library does not export it."""
        try:
            return self._library[name]
        except AttributeError:
            raise FmuError(f"{self.fmu.path} cannot be run: its library does not export {name}") from None


class LibraryInstance(Instance):
    """An instance of an FMU in this process, called through ctypes.  Every status is checked, every message kept.

    Raises FmuError where the FMU refuses to be instantiated.
    """

    version: int  # of FMI

    def __init__(self, name: str, library: Library):
        super().__init__(name, library.fmu)
        self._library = library
        self._healthy = self._begun = False
        self._environment, self._messages = listen()
        handle = self._instantiate(library)
        if handle is None:
            raise FmuError(f"{self.fmu.path} cannot be instantiated as {name!r}{self._logged(': ')}")
        self._handle: int = handle
        self._healthy = True

    @abstractmethod
    def _instantiate(self, library: Library) -> int | None:
        """The FMU's pointer to the instance, None where it refuses."""

    def call(self, name: str, *arguments: Any) -> None:
        """Call an FMI function of this instance, without its prefix.  Raises CallFailed."""
        self.check(self._function(name)(ctypes.c_void_p(self._handle), *arguments))

    def _function(self, name: str) -> Any:
        return self._library.function(f"fmi{self.version}{name}")

    def check(self, status: int) -> None:
        if status > WARNING or status < 0:
            # A Python FMU that has raised must never be called or freed again (it segfaults).
            self._healthy = self._healthy and status == DISCARD
            name = f"fmi{self.version}{STATUS[status]}" if 0 <= status < len(STATUS) else f"status {status}"
            messages = self._take_messages()
            logged = "; ".join(messages)
            traceback = "\n".join(message.traceback for message in messages if message.traceback)
            raise CallFailed(
                status, f'{name}: "{logged}"' if logged else f"{name}; the FMU logged no message", traceback
            )

    def begin(self) -> None:
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
        elements = [element for variable in variables for element in self.fmu.elements(variable)]
        if not elements:
            return {}
        buffer = np.zeros(len(elements), dtype=DTYPES[elements[0].kind])
        self.check(self.exchange("Get", elements[0].kind, references_of(variables), buffer)())
        return dict(zip((element.name for element in elements), buffer.tolist(), strict=True))

    def exchange(self, verb: Verb, kind: str, references: References, buffer: Table) -> Call:
        # FMI 3.0 asks for the number of values, too: an array is one reference and many values.
        sizes = (ctypes.c_size_t(len(buffer)),) if self.version == 3 else ()
        call = partial(
            self._library.function(self._accessor(verb, kind)),
            ctypes.c_void_p(self._handle),
            references.ctypes.data_as(ctypes.c_void_p),
            ctypes.c_size_t(len(references)),
        )
        if kind == "string":
            return partial(_exchange_strings, call, verb == "Get", buffer, (ctypes.c_char_p * len(buffer))(), sizes)
        if kind == "binary":
            return partial(_exchange_binaries, call, verb == "Get", buffer, ctypes.c_size_t(len(buffer)))
        return partial(call, buffer.ctypes.data_as(ctypes.c_void_p), *sizes)

    def _accessor(self, verb: Verb, kind: str) -> str:
        return f"fmi{self.version}{verb}{ACCESSORS[self.version][kind]}"

    def address(self, verb: Verb, kind: str) -> int:
        return self._address(self._accessor(verb, kind))

    def _address(self, function: str) -> int:
        return ctypes.cast(self._library.function(function), ctypes.c_void_p).value or 0

    def save(self) -> bytes:
        state, size = ctypes.c_void_p(), ctypes.c_size_t()
        self.call(self._of_state("GetFMUstate"), ctypes.byref(state))
        self.call(self._of_state("SerializedFMUstateSize"), state, ctypes.byref(size))
        content = ctypes.create_string_buffer(size.value)
        self.call(self._of_state("SerializeFMUstate"), state, content, size)
        self.call(self._of_state("FreeFMUstate"), ctypes.byref(state))
        return content.raw

    def restore(self, state: bytes) -> None:
        restored, size = ctypes.c_void_p(), ctypes.c_size_t(len(state))
        self.call(self._of_state("DeSerializeFMUstate"), state, size, ctypes.byref(restored))
        self.call(self._of_state("SetFMUstate"), restored)
        self.call(self._of_state("FreeFMUstate"), ctypes.byref(restored))

    def _of_state(self, name: str) -> str:
        """A function of FMI 2.0 under the name that this version gives it."""
        return name if self.version == 2 else name.replace("FMUstate", "FMUState").replace("DeS", "Des")

    def close(self) -> None:
        """Terminate and free the instance; one that has failed is left alone, for freeing it may crash."""
        if not self._healthy:
            return
        self._healthy = False
        handle = ctypes.c_void_p(self._handle)
        if self._begun and self._function("Terminate")(handle) > WARNING:
            return
        self._function("FreeInstance")(handle)

    def take_messages(self) -> list[str]:
        return list(self._take_messages())

    def _take_messages(self) -> list[Message]:
        messages = list(dict.fromkeys(self._messages))
        self._messages.clear()
        return messages

    def _logged(self, before: str = "") -> str:
        """All messages since the last call, behind `before`; "" where there are none."""
        messages = "; ".join(self.take_messages())
        return before + messages if messages else ""


def _exchange_strings(call: Callable[..., int], reads: bool, buffer: Table, strings: Any, sizes: Any) -> int:
    if not reads:
        strings[:] = list(buffer)
    status = call(strings, *sizes)
    if reads:
        buffer[:] = [text or b"" for text in strings]  # valid only until the next call
    return status


def _exchange_binaries(call: Callable[..., int], reads: bool, buffer: Table, n: ctypes.c_size_t) -> int:
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
