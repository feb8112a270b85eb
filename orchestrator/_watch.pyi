"""_watch.c, compiled."""

from collections.abc import Callable

from .arrays import Table

SIZE: int  # bytes of the board

def start(
    board: Table, signals: int, reports: int, slow: float, termination: float, halt: Callable[[], None]
) -> object: ...
def stop(line: object) -> None: ...
