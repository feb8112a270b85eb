"""What each draw of a sweep says of each contender and metric: a number that may be compared, or why there is none."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ....experiment.keys import split_key
from ....records.compare.side_by_side import Column
from ..engine.table import SweepTable, standing_of
from ..engine.worker import MISSING

NEVER, NO_VALUE = "never", "no value"  # why a draw has no number, beside the marks of its run

Draw = tuple[str, ...]  # the cells of all that varies beside the contenders


@dataclass(frozen=True)
class DrawOutcome:
    """Of one draw: a number, inf where what it is the time of never happens, nan where there is none; and why."""

    value: float
    why: str = ""


def outcome(row: Mapping[str, Any], column: Column) -> DrawOutcome:
    """What the run of a row says of a metric."""
    if reasons := standing_of(row).reasons_of(column.of):
        return DrawOutcome(math.nan, reasons[0])
    value = abs(row[column.name]) if column.ranked else row[column.name]
    return DrawOutcome(value, "" if math.isfinite(value) else NO_VALUE if math.isnan(value) else NEVER)


def distinct(
    table: SweepTable, group: Sequence[str], names: Mapping[tuple[str, ...], str]
) -> dict[str, dict[Draw, dict[str, Any]]]:
    """{contender: {draw: its row}} of the runs that ended: the same values drawn again are the same run."""
    others = [key for key in table.keys if key not in group]
    result: dict[str, dict[Draw, dict[str, Any]]] = {name: {} for name in names.values()}
    for row in table.rows:
        if row["status"] != MISSING:
            result[names[cells(row, group)]].setdefault(cells(row, others), row)
    return result


def unlike(table: SweepTable, group: Sequence[str], columns: Sequence[Column]) -> dict[str, str]:
    """{metric: the key by which it is another metric for each contender}"""
    result: dict[str, str] = {}
    for key in group:
        parts = split_key(key)
        of_all = parts in (["master", "step"], ["master", "stop_time"], ["metrics"])
        if len({row[key] for row in table.rows}) > 1:
            result |= {c.name: key for c in columns if of_all or parts[:2] == ["metrics", c.name]}
    return result


def cells(row: Mapping[str, Any], keys: Sequence[str]) -> tuple[str, ...]:
    """The texts of a row in the columns of these keys."""
    return tuple(row[key] for key in keys)
