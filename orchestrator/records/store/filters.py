"""Runs of a store: chosen by filters, and shown as a table, CSV or JSON."""

from __future__ import annotations

import csv
import datetime
import fnmatch
import io
import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import OrchError, did_you_mean
from ..file.marks import DAGGER, EARLY
from . import index, query
from .query import Facts

AGES = {"min": 60, "h": 3600, "d": 86400, "w": 604800}  # s
STATUSES = ("completed", "failed", "interrupted", "interrupted (killed)", "running", index.CORRUPT)
COLUMNS = ("run_id", "experiment", "status", "created", "real_time_factor")
MARKS = "marks"


@dataclass(frozen=True, kw_only=True)
class Filters:
    """Which runs to choose.  experiment, status: globs; since, before: a date or an age such as 3d; where: an
    expression, see `query`."""

    experiment: str = ""
    status: str = ""
    since: str = ""
    before: str = ""
    where: str = ""

    def __bool__(self) -> bool:
        return any((self.experiment, self.status, self.since, self.before, self.where))


def choose(folder: Path, filters: Filters) -> list[Facts]:
    """The runs of a store that pass all filters, oldest first.  Raises OrchError for a filter that is not valid."""
    expression, passes = _expression(filters), _simply(filters)
    matches: list[Facts] = [run for run in index.runs(folder) if passes(run)]
    return expression.choose(matches) if expression else matches


def passing(filters: Filters) -> Callable[[Facts], bool]:
    """Whether one run passes all filters.  Raises OrchError for a filter that is not valid."""
    expression, passes = _expression(filters), _simply(filters)
    return lambda run: passes(run) and (expression is None or expression.holds(run))


def _expression(filters: Filters) -> query.Where | None:
    return query.parse(filters.where) if filters.where else None


def _simply(filters: Filters) -> Callable[[Facts], bool]:
    """All filters but the expression."""
    since, before = _moment(filters.since), _moment(filters.before)
    if filters.status and not any(fnmatch.fnmatchcase(status, filters.status) for status in STATUSES):
        raise OrchError(f"--status {filters.status}: no such status{did_you_mean(filters.status, STATUSES)}")

    def passes(run: Facts) -> bool:
        return (
            fnmatch.fnmatchcase(run["experiment"], filters.experiment or "*")
            and fnmatch.fnmatchcase(run["status"], filters.status or "*")
            and (since is None or bool(run["created"] and _parsed(run["created"]) >= since))
            and (before is None or bool(run["created"] and _parsed(run["created"]) < before))
        )

    return passes


def ordered(runs: Sequence[Facts], key: str, reverse: bool) -> list[Facts]:
    """Sorted by a dotted name, runs that lack it last.  Raises OrchError where all do."""
    has = [run for run in runs if query.lookup(run, key) is not None]
    if runs and not has:
        raise OrchError(f"--sort: {_none_has(runs, key)}")
    texts = any(isinstance(query.lookup(run, key), str) for run in has)
    has.sort(key=lambda run: str(query.lookup(run, key)) if texts else query.lookup(run, key), reverse=reverse)
    return has + [run for run in runs if query.lookup(run, key) is None]


def cells(runs: Sequence[Facts], columns: Sequence[str]) -> list[tuple[Any, ...]]:
    """Values of the dotted names, None where a run lacks one, inf of a metric that is never reached.

    Raises OrchError for a name that none has.
    """
    for name in columns:
        if runs and name not in (*COLUMNS, MARKS) and all(query.lookup(run, name) is None for run in runs):
            raise OrchError(f"--columns: {_none_has(runs, name)}")
    return [tuple(query.lookup(run, name) for name in columns) for run in runs]


def _none_has(runs: Sequence[Facts], name: str) -> str:
    """That no run has a dotted name, and which metrics there are instead."""
    metrics = {f"metrics.{metric}" for run in runs for metric in run["metrics"]}
    if name in metrics:
        return f"no completed run among these has {name!r}; metrics of a part of a run are in orch show"
    there = sorted(metric for metric in metrics if any(query.lookup(run, metric) is not None for run in runs))
    return f"no run has {name!r}{did_you_mean(name, there, 'there are')}"


def table(runs: Sequence[Facts], columns: Sequence[str]) -> list[tuple[str, ...]]:
    """Rows of text, the head first; with a dagger at the status and the metrics of runs that have marks."""
    head = tuple(name.removeprefix("metrics.").replace("_", " ") for name in columns)
    rows = [[_shown(name, value) for name, value in zip(columns, row, strict=True)] for row in cells(runs, columns)]
    for run, row in zip(runs, rows, strict=True):
        for k, name in enumerate(columns):
            if run.get(MARKS) and row[k] and (name == "status" or name.startswith("metrics.")):
                row[k] += DAGGER
    return [head, *map(tuple, rows)]


def footnote(runs: Sequence[Facts]) -> str:
    """What the daggers mean; "" where there is none."""
    marks = [mark for run in runs for mark in str(run.get(MARKS) or "").split("; ") if mark]
    reasons = Counter(EARLY if mark.startswith(EARLY) else mark for mark in marks)
    counts = ", ".join(f"{n} {reason}" for reason, n in sorted(reasons.items()))
    return f"{DAGGER} not to be compared: {counts}; --columns {MARKS} says which" if reasons else ""


def as_csv(runs: Sequence[Facts], columns: Sequence[str]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(cells(runs, columns))
    return text.getvalue()


def _shown(name: str, value: Any) -> str:
    if value is None:
        return ""
    if name == "created":
        return str(value)[:16].replace("T", " ")
    if isinstance(value, float):
        return f"{value:.5g}" if math.isfinite(value) else "never"
    return str(value)


def _parsed(created: str) -> datetime.datetime:
    moment = datetime.datetime.fromisoformat(created)
    return moment if moment.tzinfo else moment.astimezone()


def _moment(text: str) -> datetime.datetime | None:
    """A date and time, local if it names no zone, or an age before now.  Raises OrchError."""
    if not text:
        return None
    if match := re.fullmatch(r"(\d+(?:\.\d+)?)\s*(min|h|d|w)", text):
        age = datetime.timedelta(seconds=float(match[1]) * AGES[match[2]])
        return datetime.datetime.now(datetime.UTC) - age
    try:
        return _parsed(text)
    except ValueError:
        raise OrchError(
            f"{text!r} is no time; give a date such as 2026-03-01, or an age such as 2h, 3d or 1w"
        ) from None
