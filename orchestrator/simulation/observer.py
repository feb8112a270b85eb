"""Who watches a run: what an observer is given, and how a run ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..arrays import Reals, Table


@dataclass(frozen=True)
class Block:
    """Consecutive rows of the record, to read.

    ticks: (N,) of the rows.  values: {kind: (N, recorded values of that kind)}, in the order of `Plan.recorded`.
    bounds: (N, 2, n), the least and the largest value since the row before, of each of `Plan.bounded`.
    """

    ticks: Sequence[int]
    values: Mapping[str, Table]
    bounds: Reals

    def __post_init__(self) -> None:
        for values in (*self.values.values(), self.bounds):
            values.flags.writeable = False


@dataclass(frozen=True)
class SystemView:
    """The values of a running system, to read: as they are when a hook of an observer is called.

    tables: {kind: values}.  places: {(component, variable): place in the table of its kind} of all that is connected,
    recorded or watched.
    """

    tables: Mapping[str, Table]
    places: Mapping[tuple[str, str], int]


class Observer:
    """Watches a run and changes nothing: what it is given cannot be written to.  A hook does nothing unless overridden.

    The order of calls: `opened`; `rows` of the first row; then for each chunk of steps `limit`, `rows` where it has
    some, `progress`; `facts` at the end.
    """

    def opened(self, view: SystemView) -> None:
        """The system is initialized."""

    def rows(self, block: Block) -> None:
        """The next rows of the record, in order, none left out."""

    def limit(self, tick: int, last: int) -> int:
        """Where a chunk from `tick` ends that would go on to `last`: after `tick`, at most there."""
        return last

    def progress(self, tick: int) -> None:
        """All steps until `tick` are done; the view has the values of that time."""

    def facts(self) -> dict[str, Any]:
        """What the record keeps of it, beside where the time went."""
        return {}


@dataclass(kw_only=True)
class Outcome:
    """How a run ended.  Times in s."""

    status: str = "running"  # then completed, failed or interrupted
    ticks: int = 0  # at which it ended
    error: str = ""
    failed_at: float | None = None
    stopped_at: float | None = None
    last_inputs: dict[str, Any] = field(default_factory=dict)  # of the component that failed
    traceback: str = ""  # of its model, in Python
    heard: dict[str, list[tuple[float, Reals]]] = field(default_factory=dict)  # by live components
    warnings: list[str] = field(default_factory=list)
    timing: dict[str, Any] = field(default_factory=dict)  # see stepper.Timing
    calculated: dict[str, dict[str, Any]] = field(default_factory=dict)  # parameters, by component
    metrics: dict[str, float] = field(default_factory=dict)  # of the steps that were done; nan without a sample
