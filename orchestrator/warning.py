"""Warnings of a run: sentences that carry a kind, so that a table can mark a run without reading its prose.

A warning is a text like any other.  The record keeps the texts in its attribute `warnings` and their kinds, in the same
order, in `warning_kinds`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import Any


class Kind(StrEnum):
    """What a warning is about; the values stand in records."""

    UNSTABLE = "unstable"  # a loop is unstable at this step: the numbers of the run are wrong
    SAMPLING = "sampling"  # a loop is unstable because of a component's own period: right for what is sampled so
    SWITCHING = "switching"  # a loop switches in every step, however short it is: what counts changes is wrong
    ROWS = "rows"  # metrics of a record of format 1, of its rows and not of every step
    UNCHECKED = "unchecked"  # a loop oscillates, and nothing could be run to compare it with
    LIMIT = "limit"  # a value left what an FMU declares: the model is not valid there
    JUMP = "jump"  # a reference jumped by more than half a turn: a note
    FILES = "files"  # an FMU in Python reads a file that its model does not declare
    OTHER = ""


WRONG = frozenset({Kind.UNSTABLE, Kind.ROWS})  # kinds that say of every number of the run that it is wrong
BEFORE_KINDS = "beyond its stability limit"  # in the text of the only warning of that sort, in records without kinds


class Warned(str):
    """The text of a warning, with its kind."""

    kind: Kind

    def __new__(cls, text: str, kind: Kind = Kind.OTHER) -> Warned:
        made = super().__new__(cls, text)
        made.kind = kind
        return made


def printed(text: str) -> str:
    """A line for people."""
    note = isinstance(text, Warned) and text.kind is Kind.JUMP
    return f"{'note' if note else 'warning'}: {text}"


def kinds_of(warnings: Iterable[str]) -> list[str]:
    """What the attribute `warning_kinds` says of them."""
    return [warning.kind.value if isinstance(warning, Warned) else Kind.OTHER.value for warning in warnings]


def read(attributes: dict[str, Any]) -> list[Warned]:
    """The warnings of a record, from its decoded root attributes; one that was made before there were kinds, too."""
    texts: Sequence[str] = attributes.get("warnings", ())
    kinds: Sequence[str] = attributes.get("warning_kinds") or [
        Kind.UNSTABLE if BEFORE_KINDS in text else Kind.OTHER for text in texts
    ]
    known = set(Kind)
    result = [
        Warned(text, Kind(kind) if kind in known else Kind.OTHER) for text, kind in zip(texts, kinds, strict=True)
    ]
    if metrics_of(attributes) == "rows" and attributes.get("metrics"):
        every = attributes["experiment_resolved"]["record"]["every"]
        text = (
            f"its metrics are of its rows, every {every:g} s, and not of every step of {attributes['step']:g} s: "
            "they say nothing of what happens between rows; run the experiment again"
        )
        result.append(Warned(text, Kind.ROWS))
    return result


def metrics_of(attributes: Mapping[str, Any]) -> str:
    """What the metrics of a record are of: "steps", or "rows" where it is of format 1 and does not keep every step."""
    stated = attributes.get("metrics_of")
    if stated is not None or "experiment_resolved" not in attributes:
        return str(stated or "steps")
    every = attributes["experiment_resolved"].get("record", {}).get("every", attributes["step"])
    return "steps" if every == attributes["step"] else "rows"


def are_wrong(warnings: Iterable[str]) -> bool:
    """Whether one of them says that the numbers of its run are wrong."""
    return any(isinstance(warning, Warned) and warning.kind in WRONG for warning in warnings)
