"""The compiled loop, where it is built; see program.py."""

from ..arrays import Reals, Table
from .program import Program

LAYOUT: dict[str, str]

class Loop:
    def __init__(self, program: Program, /) -> None: ...
    def advance(
        self, first: int, last: int, times: Reals, patience: float, rows: tuple[Table, ...], bounds: Reals, /
    ) -> tuple[int, int, int]:
        """Step from tick `first` until `last`.  Returns the ticks done, the component that failed or -1, a status.

        times: (last - first,) of the ticks [s]; patience: s, after which it returns early; rows: an array of each kind;
        bounds: (rows, 2, bounded), the least and the largest values since the row before.
        """
