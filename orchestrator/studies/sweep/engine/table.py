"""The table of a sweep: one line for each run, in the order of the design."""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ....errors import StoreError, did_you_mean
from ....records.compare.side_by_side import Column
from ....records.file.marks import Standing
from ..design.matrix import DesignPoint
from ..design.prepared import FORMAT
from .storage import Storage
from .worker import COMPLETED, PointResult

DESCRIPTION, TABLE = "sweep.json", "table.csv"


def text(points: Sequence[DesignPoint], results: Mapping[int, PointResult], metrics: Sequence[str]) -> str:
    """The table as CSV.

    Numbers read back to the same bits.  inf: what the metric is the time of never happens; nan: it has no value; an
    empty cell: it has no sample, or the run failed.  stopped_at: when an FMU ended the run before its stop time [s];
    warnings: their kinds, "other" of those that have none.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    keys = list(points[0].cells)
    writer.writerow(["run", "draw", *keys, "run_id", "status", *metrics, "stopped_at", "warnings", "error"])
    for point in points:
        result = results.get(point.index, PointResult(point.index))
        cells = [_cell(point.cells[key]) for key in keys]
        numbers = [_cell(result.metrics.get(name)) for name in metrics]
        said = [_cell(result.stopped_at), " ".join(result.warnings), result.error]
        writer.writerow([point.index, point.draw, *cells, result.run_id, result.status, *numbers, *said])
    return stream.getvalue()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    return repr(value) if isinstance(value, float) else json.dumps(value)


@dataclass(frozen=True, kw_only=True)
class SweepTable:
    """The table of a sweep, read.

    keys: what varied; labels: {key: short name}; groups: the keys that had lists, in groups of those that change
    together; rows: one a run: its cells as text, numbers of metrics under their names, nan for an empty cell.
    unsampled: (run, metric) of the empty cells of completed runs.
    """

    sweep_id: str
    title: str
    storage: Storage
    description: Mapping[str, Any]
    columns: list[Column]
    rows: list[dict[str, Any]]
    unsampled: frozenset[tuple[str, str]]

    @property
    def keys(self) -> list[str]:
        return list(self.description["keys"])

    @property
    def labels(self) -> dict[str, str]:
        return dict(self.description["labels"])

    @property
    def groups(self) -> list[list[str]]:
        return [keys for keys, _ in self.description["lists"]]

    @property
    def completed(self) -> list[dict[str, Any]]:
        return [row for row in self.rows if row["status"] == COMPLETED]

    @property
    def counts(self) -> str:
        """600 runs, 590 completed, of which 3 ended early, 4 warned: unstable at this step"""
        marks = Counter(reason for row in self.completed for reason in standing_of(row).reasons_of(""))
        text = f"{len(self.rows)} runs, {len(self.completed)} completed"
        return f"{text}, of which {', '.join(f'{n} {mark}' for mark, n in marks.items())}" if marks else text

    @property
    def knows_marks(self) -> bool:
        """Whether it says which runs ended early or warned; tables of earlier versions do not."""
        return all("warnings" in row for row in self.rows)


def standing_of(row: Mapping[str, Any]) -> Standing:
    """How the run of a row stands."""
    stopped_at = float(row["stopped_at"]) if row.get("stopped_at") else None
    return Standing(status=row["status"], stopped_at=stopped_at, kinds=tuple((row.get("warnings") or "").split()))


def find(results: str, sweep: str) -> SweepTable:
    """The table of the sweep that a user names.

    sweep: its id or a unique prefix of one, an experiment that has one sweep, or "last".  Raises StoreError where that
    is no sweep, or several.
    """
    storage = Storage(results)
    known = [name.rpartition("/")[0] for name in storage.names(f"*/{DESCRIPTION}") if not name.startswith("_")]
    if sweep == "last":
        local = storage.local
        if not known or local is None:
            raise StoreError(f"{results} holds no sweep; run one first, or give its id")
        return read(results, max(known, key=lambda name: (local / name / DESCRIPTION).stat().st_mtime_ns))
    ids = {name: name.rpartition("-")[2] for name in known}
    matches = [name for name in known if sweep in (name, ids[name])]
    matches = matches or [name for name in known if ids[name].startswith(sweep) or name.rpartition("-")[0] == sweep]
    if len(matches) == 1:
        return read(results, matches[0])
    if matches:
        raise StoreError(f"{sweep!r} means several sweeps: {', '.join(matches[:6])}; give more of the id")
    raise StoreError(f"no sweep {sweep!r} in {results}{did_you_mean(sweep, [*ids.values()], 'there are')}")


def read(results: str, folder: str) -> SweepTable:
    """Raises StoreError where the sweep cannot be read."""
    storage = Storage(f"{results.rstrip('/')}/{folder}")
    try:
        description = json.loads(storage.read(DESCRIPTION))
        if description["format"] != FORMAT:
            raise ValueError(f"its format is not {FORMAT}")
        columns = [Column(**metric) for metric in description["metrics"]]
        rows: list[dict[str, Any]] = list(csv.DictReader(io.StringIO(storage.read(TABLE).decode())))
        unsampled = frozenset(
            (row["run"], column.name)
            for row in rows
            for column in columns
            if row["status"] == COMPLETED and not row[column.name]
        )
        for row in rows:
            row["draw"] = int(row["draw"])
            row |= {column.name: float(row[column.name] or math.nan) for column in columns}
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(f"{storage.address}: the sweep cannot be read: {error}") from None
    return SweepTable(
        sweep_id=description["sweep_id"],
        title=description["title"],
        storage=storage,
        description=description,
        columns=columns,
        rows=rows,
        unsampled=unsampled,
    )
