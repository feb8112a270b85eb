"""The process of an isolated component: serves one instance to `isolated`, where the exchange is described."""

from __future__ import annotations

import contextlib
import ctypes
import mmap
import os
import select
import signal
import socket
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import References, Table
from ..errors import FmuError
from ..fmu.fmu import Fmu
from ..fmu.variables import DTYPES, OBJECTS
from . import instantiate
from .instance import OK, WARNING, Call, CallFailed, Instance, StepCall, Verb
from .isolated import (
    ANSWER,
    FIRST_SLEEP,
    LEAVING,
    REQUEST,
    SLEEP,
    SLEEPING_CHILD,
    SLEEPING_PARENT,
    STATUS,
    STEP,
    TIME,
    numbers_of,
    words_of,
)
from .library import Library

DEATH_SIGNAL = 1  # of prctl


class Server:
    """One instance, and what is asked of it."""

    def __init__(self, connection: Connection, wake: socket.socket, memory: mmap.mmap, looks: int):
        self._connection, self._wake, self._memory, self._looks = connection, wake, memory, looks
        self._words, self._numbers = words_of(memory), numbers_of(memory)
        self._made: Instance | None = None
        self._calls: dict[Verb, list[tuple[Call, Table]]] = {"Set": [], "Get": []}
        self._answered = 0
        self._poll = select.poll()
        for file in (wake, connection):
            self._poll.register(file, select.POLLIN)

    def run(self) -> None:
        """Answer until the parent asks to close, or is gone."""
        with contextlib.suppress(EOFError, OSError):
            while True:
                method, arguments = self._connection.recv()
                if method == "serve":
                    self.serve()
                    continue
                try:
                    answer = getattr(self, method)(*arguments)
                except (CallFailed, FmuError) as error:
                    answer = error
                self._connection.send(answer)
                if method == "close":
                    return

    def instantiate(self, name: str, fmu: Fmu, folder: Path) -> None:
        self._made = instantiate(name, Library(fmu, folder))

    def instance(self, method: str, *arguments: Any) -> Any:
        return getattr(self._instance, method)(*arguments)

    def wire(self, verb: Verb, kind: str, references: References, place: int | None, n: int) -> int:
        """Prepare a getter or setter of values at a place of the memory; returns its number."""
        buffer = np.full(n, b"", object) if place is None else np.frombuffer(self._memory, DTYPES[kind], n, place)
        self._calls[verb].append((self._instance.exchange(verb, kind, references, buffer), buffer))
        return len(self._calls[verb]) - 1

    def call(self, verb: Verb, index: int, values: list[Any] | None) -> tuple[int, list[Any] | None]:
        call, buffer = self._calls[verb][index]
        if values is not None:
            buffer[:] = values
        status = call()
        return status, list(buffer) if verb == "Get" and buffer.dtype == object else None

    def step(self, t: float, h: float, given: dict[int, list[Any]]) -> tuple[int, dict[int, list[Any]]]:
        """A step with texts or bytes."""
        for index, values in given.items():
            self._calls["Set"][index][1][:] = values
        status = self._step(t, self._instance.step_call(h))
        return status, {i: list(b) for i, (_, b) in enumerate(self._calls["Get"]) if b.dtype == DTYPES[OBJECTS[0]]}

    def close(self) -> None:
        if self._made is not None:
            self._made.close()

    @property
    def _instance(self) -> Instance:
        assert self._made is not None  # by the first request
        return self._made

    def serve(self) -> None:
        """Step whenever the parent counts on, until a step fails or something else is asked for."""
        words, numbers = self._words, self._numbers
        step_calls: dict[float, StepCall] = {}
        while self._await_request():
            self._answered += 1
            h = numbers[STEP]
            step = step_calls.get(h) or step_calls.setdefault(h, self._instance.step_call(h))
            words[STATUS] = status = self._step(numbers[TIME], step)
            words[ANSWER] = self._answered
            if words[SLEEPING_PARENT]:
                self._wake.send(b"!")
            if status > WARNING or status < 0:
                return

    def _step(self, t: float, step: StepCall) -> int:
        for set_, _ in self._calls["Set"]:
            if (status := set_()) > WARNING or status < 0:
                return status
        if (status := step(ctypes.c_double(t))) > WARNING or status < 0:
            return status
        for get, _ in self._calls["Get"]:
            if (status := get()) > WARNING or status < 0:
                return status
        return OK

    def _await_request(self) -> bool:
        """Whether there is another step to do."""
        words, answered, wait = self._words, self._answered, FIRST_SLEEP
        for _ in range(self._looks):
            if words[REQUEST] != answered:
                return True
        while True:
            words[SLEEPING_CHILD] = 1
            if words[REQUEST] == answered and not words[LEAVING]:
                for descriptor, _ in self._poll.poll(wait):
                    if descriptor == self._wake.fileno() and not self._wake.recv(64):
                        raise EOFError
                    if descriptor == self._connection.fileno() and words[REQUEST] == answered:
                        words[LEAVING] = 1
            words[SLEEPING_CHILD] = 0
            if words[REQUEST] != answered:
                return True
            if words[LEAVING]:
                words[LEAVING] = 0
                return False
            wait = SLEEP


def end_with_parent(number: int) -> None:
    """Have the system (Linux) send this process a signal when its parent has ended, also where an FMU hangs."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(DEATH_SIGNAL, number)


def main() -> None:
    connection, wake, memory, looks, parent = map(int, sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(signal.SIGKILL)
    if os.getppid() != parent:
        return
    with mmap.mmap(memory, 0) as mapped:
        Server(Connection(connection), socket.socket(fileno=wake), mapped, looks).run()
        os._exit(0)  # without the FMU's own clean-up, which may crash or hang


if __name__ == "__main__":
    main()
