"""Types of arrays, so that a signature says what an array holds; its shape and unit stand in the docstring.

A module that does not import numpy by itself imports these under TYPE_CHECKING: this one does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

Reals: TypeAlias = NDArray[np.float64]
Places: TypeAlias = NDArray[np.intp]  # indices into a table, or numbers of rows
Truths: TypeAlias = NDArray[np.bool_]
References: TypeAlias = NDArray[np.uint32]  # value references of FMI
Table: TypeAlias = NDArray[Any]  # values of one kind, of the dtype that fmu.variables.DTYPES has for it
Tables: TypeAlias = dict[str, Table]  # {kind: values}


class Signals(Protocol):
    """Recorded signals over time: those of a record, or rows that are still in memory."""

    @property
    def time(self) -> Reals:
        """(N,) [s]."""

    @property
    def signals(self) -> Sequence[str]:
        """Their names, such as "vehicle1.eta.x"."""

    def __getitem__(self, name: str) -> Table:
        """(N,) of a signal."""

    def units(self, name: str) -> str:
        """The unit of a signal, "1" where it has none."""

    def is_angle(self, name: str) -> bool:
        """Whether differences of a signal are differences on the circle."""


LINE = 64  # bytes of a cache


def aligned(n: int, value: float = 0.0) -> Reals:
    """(n,) of one value, in whole lines of the cache: a vector of them is never in two."""
    per_line = LINE // 8
    memory = np.full((-(-n // per_line) + 1) * per_line, value)
    first = -memory.ctypes.data % LINE // 8
    return memory[first : first + n]
