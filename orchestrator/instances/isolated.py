"""An instance in a process of its own: a crash there is an error message here, and each step is one exchange.

The process is `isolated_child`.  Rare calls go through a connection as (method, arguments).  A step goes through shared
memory: inputs and outputs lie in it, and two counters say what is asked for and what is answered.  Whoever waits looks
at its counter for a while, where there are cores to spare, then sleeps until it is woken.
"""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import platform
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import References, Table
from ..errors import FmuError
from ..fmu.fmu import Fmu
from ..fmu.variables import DTYPES, OBJECTS
from .instance import FATAL, WARNING, BatchedInstance, Call, CallFailed, Verb

# Places in the head of the memory, in words of 8 bytes; request and answer each have a cache line of their own.
REQUEST, SLEEPING_CHILD, TIME, STEP, LEAVING = 0, 1, 2, 3, 4
ANSWER, SLEEPING_PARENT, STATUS = 8, 9, 10
HEAD = 256  # bytes
ALIGNMENT = 64
LOOKS = 4000  # at a counter before sleeping: about 0.2 ms
FIRST_SLEEP, SLEEP = 1, 50  # ms; a waker may miss a sleeper that has just looked, which then looks again
LONGEST_CALL = 60.0  # s, of a call that is no step, where steps have a limit
PATIENCE = 1.0  # s, after Ctrl-C, and for a process to end
SAFE = platform.machine().lower() in ("x86_64", "amd64")  # others may show writes to memory out of order


class ProcessLost(CallFailed):
    """The process of an instance ended, or does not answer."""


class IsolatedInstance(BatchedInstance):
    """An FMU that runs in a child process.  Raises FmuError where it cannot be instantiated.

    timeout: s of wall time that a step may take, other calls LONGEST_CALL; spin: whether to look at the counters before
    sleeping; interrupted: whether the user has pressed Ctrl-C.
    """

    def __init__(
        self, name: str, fmu: Fmu, folder: Path, timeout: float | None, spin: bool, interrupted: Callable[[], bool]
    ):
        if not hasattr(os, "fork"):
            raise FmuError(f"{name!r} cannot run in a process of its own on this system: that needs POSIX")
        super().__init__(name, fmu)
        self._timeout, self._looks, self._interrupted = timeout, LOOKS if spin and SAFE else 0, interrupted
        self._lost = ""
        self._stepping = self._healthy = False
        self._asked, self._used = 0, HEAD
        self._objects: dict[Verb, list[tuple[int, Table]]] = {"Set": [], "Get": []}
        self._start(HEAD + sum(np.dtype(DTYPES[v.kind]).itemsize + ALIGNMENT for v in fmu.variables.values()))
        try:
            self._request("instantiate", name, fmu, folder)
        except ProcessLost as error:
            self.close()
            raise FmuError(f"{fmu.path} cannot be instantiated as {name!r}: {error}") from None
        except FmuError:
            self.close()
            raise
        self._healthy = True

    def _start(self, size: int) -> None:
        folder = "/dev/shm" if os.path.isdir("/dev/shm") else None
        here, there = socket.socketpair()
        self._wake, wake_child = socket.socketpair()
        with tempfile.TemporaryFile(dir=folder) as file, there, wake_child:  # without a name in any folder
            file.truncate(size)
            self._memory = mmap.mmap(file.fileno(), size)
            descriptors = [there.fileno(), wake_child.fileno(), file.fileno()]
            environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "orchestrator.instances.isolated_child",
                    *map(str, [*descriptors, self._looks, os.getpid()]),
                ],
                stdin=subprocess.DEVNULL,
                stdout=2,
                pass_fds=descriptors,
                env=environment,
                start_new_session=True,  # Ctrl-C is for this process, not for that one
            )
        self._connection = Connection(here.detach())
        self._counters, self._numbers = words_of(self._memory), numbers_of(self._memory)
        self._poll = select.poll()
        self._poll.register(self._wake, select.POLLIN)

    def room(self, kind: str, n: int) -> Table:
        """Both processes see it; texts and bytes are sent instead."""
        if kind in OBJECTS:
            return np.full(n, b"", dtype=object)
        dtype = np.dtype(DTYPES[kind])
        first = -(-self._used // ALIGNMENT) * ALIGNMENT
        self._used = first + n * dtype.itemsize
        return np.frombuffer(self._memory, dtype, n, first)

    def exchange(self, verb: Verb, kind: str, references: References, buffer: Table) -> Call:
        place = None
        if kind not in OBJECTS:
            start = np.frombuffer(self._memory, np.uint8).ctypes.data
            place = buffer.ctypes.data - start
        index = self._request("wire", verb, kind, references, place, len(buffer))
        if kind in OBJECTS:
            self._objects[verb].append((index, buffer))

        def call() -> int:
            values = list(buffer) if verb == "Set" and kind in OBJECTS else None
            status, values = self._request("call", verb, index, values)
            if values is not None:
                buffer[:] = values
            return int(status)

        return call

    def setup(
        self, start_time: float, stop_time: float | None, tolerance: float | None, values: Mapping[str, Any]
    ) -> None:
        self._request("instance", "setup", start_time, stop_time, tolerance, dict(values))

    def begin(self) -> None:
        self._request("instance", "begin")

    def save(self) -> bytes:
        return bytes(self._request("instance", "save"))

    def restore(self, state: bytes) -> None:
        self._request("instance", "restore", state)

    def check(self, status: int) -> None:
        if 0 <= status <= WARNING:
            return
        if self._lost:
            self._healthy = False
            raise ProcessLost(FATAL, self._lost)
        self._stepping = False  # it waits for calls after a failed step
        self._request("instance", "check", status)

    def wants_to_end(self) -> bool:
        return bool(self._request("instance", "wants_to_end"))

    def has_reached(self, end: float) -> bool:
        return bool(self._request("instance", "has_reached", end))

    def take_messages(self) -> list[str]:
        if self._lost or not self._healthy:
            return []
        return list(self._request("instance", "take_messages"))

    def close(self) -> None:
        if self._process.poll() is None and not self._lost:
            with contextlib.suppress(CallFailed, FmuError):
                self._request("close")
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(PATIENCE)
        self._healthy = False
        self._process.kill()
        self._process.wait()
        self._connection.close()
        self._wake.close()

    def _step(self, handle: int | None, t: float, h: float, _: int) -> int:
        if any(self._objects.values()):
            return self._step_with_objects(t, h)
        words, numbers = self._counters, self._numbers
        if not self._stepping:
            self._stepping = True
            self._connection.send(("serve", ()))
        numbers[TIME], numbers[STEP] = t, h
        self._asked += 1
        words[REQUEST] = asked = self._asked
        if words[SLEEPING_CHILD]:
            self._wake_child()
        for _ in range(self._looks):
            if words[ANSWER] == asked:
                return words[STATUS]
        try:
            self._await(lambda wait: words[ANSWER] == asked or self._sleep(wait, asked), self._timeout)
        except ProcessLost as error:
            return error.status
        return words[STATUS]

    def _step_with_objects(self, t: float, h: float) -> int:
        given = {index: list(buffer) for index, buffer in self._objects["Set"]}
        try:
            status, taken = self._request("step", t, h, given)
        except ProcessLost as error:
            return error.status
        for index, buffer in self._objects["Get"]:
            buffer[:] = taken[index]
        return int(status)

    def _sleep(self, wait: float, asked: int) -> bool:
        words = self._counters
        words[SLEEPING_PARENT] = 1
        if words[ANSWER] != asked and self._poll.poll(wait):
            self._wake.recv(64)
        words[SLEEPING_PARENT] = 0
        return words[ANSWER] == asked

    def _wake_child(self) -> None:
        with contextlib.suppress(OSError):  # it has ended, which whoever waits for it finds out
            self._wake.send(b"!")

    def _request(self, method: str, *arguments: Any) -> Any:
        """Call a method of the child's Server.  Raises ProcessLost, and what the call raises there."""
        if self._lost:
            raise ProcessLost(FATAL, self._lost)
        if self._stepping:
            self._stepping = False
            self._counters[LEAVING] = 1
            self._wake_child()
        try:
            self._connection.send((method, arguments))
            limit = None if self._timeout is None else max(self._timeout, LONGEST_CALL)
            self._await(lambda wait: self._connection.poll(wait / 1000), self._timeout if method == "step" else limit)
            answer = self._connection.recv()
        except (EOFError, OSError):
            self._give_up(self._ending())
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _await(self, done: Callable[[float], bool], timeout: float | None) -> None:
        """Wait until it is done.  done: waits for so many ms.  Raises ProcessLost where it will not be."""
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        wait: float = FIRST_SLEEP
        while not done(wait):
            wait = SLEEP
            if self._process.poll() is not None and not done(0):
                self._give_up(self._ending())
            if time.monotonic() > deadline:
                self._give_up(f"it did not answer within {timeout:g} s (timeout); its process was ended")
            if self._interrupted():
                self._interrupted, deadline = bool, min(deadline, time.monotonic() + PATIENCE)
                timeout = PATIENCE

    def _give_up(self, message: str) -> None:
        self._lost = message
        self._healthy = False
        self._process.kill()
        raise ProcessLost(FATAL, message)

    def _ending(self) -> str:
        """A message: how the process ended."""
        try:
            code = self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            return "its process has closed its end of the connection"
        if code >= 0:
            return f"its process ended by itself, with exit code {code}"
        return f"its process was ended by signal {-code} ({signal.strsignal(-code)})"


def words_of(memory: mmap.mmap) -> memoryview[int]:
    """The head of the memory as whole numbers of 8 bytes."""
    return memoryview(memory)[:HEAD].cast("q")


def numbers_of(memory: mmap.mmap) -> memoryview[float]:
    """The head of the memory as floats."""
    return memoryview(memory)[:HEAD].cast("d")
