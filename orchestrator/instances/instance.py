"""What the master and the loops ask of something that runs: the interface of an FMU's instance."""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from ..arrays import Reals, References, Table, Truths
from ..errors import FmuError
from ..fmu.fmu import Fmu
from ..fmu.variables import DTYPES, Variable

OK, WARNING, DISCARD, ERROR, FATAL = range(5)  # fmi2Status, fmi3Status; 5: fmi2Pending
STATUS = ("OK", "Warning", "Discard", "Error", "Fatal", "Pending")

Verb: TypeAlias = Literal["Set", "Get"]
Call: TypeAlias = Callable[[], int]  # returns the status
StepCall: TypeAlias = Callable[[ctypes.c_double], int]  # from a time [s] on; returns the status

# fmi2DoStep: handle, t, h, noSetFMUStatePriorToCurrentPoint.
STEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)


class CallFailed(Exception):
    """A call of FMI that failed.

    `.status`: DISCARD, ERROR, FATAL, or none of FMI's; `.traceback`: of a Python model, or "".
    """

    def __init__(self, status: int, message: str, traceback: str = ""):
        super().__init__(status, message, traceback)  # all: it is pickled on its way from another process
        self.status, self.traceback = status, traceback

    def __str__(self) -> str:
        return str(self.args[1])


class StepFunction(NamedTuple):
    """How the compiled loop calls doStep."""

    version: int  # of FMI, whose signatures the getters and setters have
    handle: int  # the FMU's own pointer to the instance, its first argument
    address: int
    answers: tuple[Truths, Reals] | None
    # Of fmi3DoStep: (3,) event, terminate, early return; (1,) time reached [s].  None: it has fmi2DoStep's signature.


class Instance(ABC):
    """An FMU that runs, or what stands in for one.

    The order of calls, as FMI's state machine has it.  Whoever calls keeps it; no instance checks it:

        instantiated    `room` and `exchange`, for all that is connected or recorded; `step_call`, `step_function`
        `setup`         sets parameters and start values, enters initialization mode
        initializing    the calls that `exchange` returned: setters and getters, in any order, any number of times
        `begin`         leaves initialization mode
        stepping        setters, the step call, getters, in this order; between two steps `values`, `save`, `restore`
        `check`         for each status that a call returned, at once; after DISCARD `wants_to_end`, `has_reached`
        `close`         once, in any state; nothing follows

    `take_messages` may be called until `close`.  Whatever fails raises CallFailed, but for a call that returns its
    status; after ERROR and FATAL only `take_messages` and `close` may follow.

    `batched`: whether the step call does the setters and getters, too, in buffers that `room` gave.
    """

    batched = False

    def __init__(self, name: str, fmu: Fmu):
        self.name, self.fmu = name, fmu

    @abstractmethod
    def setup(
        self, start_time: float, stop_time: float | None, tolerance: float | None, values: Mapping[str, Any]
    ) -> None:
        """Enter initialization mode at start_time [s].

        tolerance: of the solver inside, None for the FMU's own choice.  values: {variable: value}.
        """

    @abstractmethod
    def begin(self) -> None:
        """Leave initialization mode."""

    def room(self, kind: str, n: int) -> Table:
        """(n,) values of a kind, all zero, for `exchange`."""
        return np.zeros(n, dtype=DTYPES[kind])

    @abstractmethod
    def exchange(self, verb: Verb, kind: str, references: References, buffer: Table) -> Call:
        """A setter or getter without arguments.

        references: (n,) uint32, one of each scalar and one of each whole array; buffer: (m,) the values, which must
        stay where they are.
        """

    @abstractmethod
    def address(self, verb: Verb, kind: str) -> int:
        """Of the function that `exchange` calls; 0 where the step call does it."""

    @abstractmethod
    def step_call(self, h: float) -> StepCall:
        """doStep over h [s]."""

    @abstractmethod
    def step_function(self) -> StepFunction:
        """doStep for the compiled loop."""

    @abstractmethod
    def check(self, status: int) -> None:
        """Raises CallFailed unless the status is OK or a warning."""

    def values(self, variables: Sequence[Variable]) -> dict[str, Any]:
        """{name: value} of numbers of one kind as they are now, of arrays all elements; {} where it cannot read them
        outside its step."""
        return {}

    def save(self) -> bytes:
        """Its state, serialized.  Raises FmuError where it has no way to give it."""
        raise FmuError(f"{self.name!r} has no state that can be saved")

    def restore(self, state: bytes) -> None:
        """Take over a state that was saved.  Raises FmuError where it has no way to."""
        raise FmuError(f"{self.name!r} has no state that can be restored")

    def wants_to_end(self) -> bool:
        """Whether it asks to end the simulation."""
        return False

    def has_reached(self, end: float) -> bool:
        """Whether the discarded step led to its end [s] all the same."""
        return False

    def take_messages(self) -> list[str]:
        """What was logged since the last call, each message once."""
        return []

    @abstractmethod
    def close(self) -> None:
        """Free it."""


class BatchedInstance(Instance):
    """One whose step does its setters and getters, too.  Both loops call the same function of Python."""

    batched = True

    @abstractmethod
    def _step(self, handle: int | None, t: float, h: float, _: int) -> int:
        """Setters, the step from t over h [s], getters; returns the status.  Arguments as fmi2DoStep's."""

    def address(self, verb: Verb, kind: str) -> int:
        return 0

    def step_call(self, h: float) -> StepCall:
        return lambda t: self._step(None, t.value, h, 1)

    def step_function(self) -> StepFunction:
        self._callback = STEP(self._step)  # must live as long as the loop
        return StepFunction(2, 0, ctypes.cast(self._callback, ctypes.c_void_p).value or 0, None)


def references_of(variables: Sequence[Variable]) -> References:
    """(n,) uint32: one value reference of each scalar, and one of each whole array."""
    return np.array([v.reference for v in variables if not v.element], dtype=np.uint32)
