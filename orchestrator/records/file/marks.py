"""What a run says of its own numbers: the marks that go with them into every table, figure, page and list.

A number that carries a mark is shown with a dagger and is never the best of several; a sweep does not compare it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ... import warning
from ...metrics import METRICS
from ...warning import Kind

DAGGER = "†"
COMPLETED, EARLY = "completed", "ended early"
WORDS = {
    Kind.UNSTABLE: "warned: unstable at this step",
    Kind.ROWS: "metrics of its rows, not of every step",
    Kind.SWITCHING: "warned: switches in every step",
}


@dataclass(frozen=True, kw_only=True)
class Standing:
    """How a run ended, and what it warns of.

    stopped_at: when an FMU ended it before its stop time [s], else None; kinds: of its warnings, each once.
    """

    status: str
    stopped_at: float | None = None
    kinds: tuple[str, ...] = ()

    @property
    def marks(self) -> tuple[str, ...]:
        """Why none of its numbers may be compared, a few words each; () where nothing speaks against them."""
        return self.marks_of("")

    def marks_of(self, of: str) -> tuple[str, ...]:
        """Why a metric of the kind `of`, a key of METRICS, may not be compared: `marks`, and what only it suffers."""
        return tuple(f"{why} at {self.stopped_at:.6g} s" if why == EARLY else why for why in self.reasons_of(of))

    def reasons_of(self, of: str) -> tuple[str, ...]:
        """`marks_of` without times: the same words for all runs that have one fate."""
        ended = [self.status] if self.status != COMPLETED else []
        early = [EARLY] if self.stopped_at is not None else []
        wrong = [WORDS[kind] for kind in WORDS if kind in warning.WRONG and kind in self.kinds]
        counts = of in METRICS and METRICS[of].counts and Kind.SWITCHING in self.kinds
        return (*ended, *early, *wrong, *([WORDS[Kind.SWITCHING]] if counts else []))


def marked(standing: Standing, label: str) -> str:
    """A label of a run behind its marks: "(ended early at 2 s) pid"; where there is no room, a label's end is cut."""
    return f"({'; '.join(standing.marks)}) {label}".rstrip() if standing.marks else label


def standing_of(attributes: Mapping[str, Any], status: str) -> Standing:
    """Of a record.  attributes: those of its root, decoded; status: as it is now, see `Run.status`."""
    stop_time = attributes.get("experiment_resolved", {}).get("master", {}).get("stop_time")
    stopped_at = attributes.get("stopped_at")
    if stopped_at is not None and stop_time is not None and stopped_at >= stop_time:
        stopped_at = None
    return Standing(status=status, stopped_at=stopped_at, kinds=kinds_of(warning.read(dict(attributes))))


def kinds_of(warnings: Iterable[str]) -> tuple[str, ...]:
    """The kinds of warnings, each once; "other" of those that have none."""
    return tuple(dict.fromkeys(kind or "other" for kind in warning.kinds_of(warnings)))
