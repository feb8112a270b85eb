"""What `orch sweep` and `orch tune` print: the design, and the results."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...files import short
from ...metrics import finite
from ...studies.sweep.design.matrix import combinations, labels
from ...studies.sweep.design.prepared import PreparedSweep
from ...studies.sweep.engine.scheduler import SweepResult
from ...studies.sweep.engine.storage import is_local
from ...studies.sweep.engine.table import TABLE
from ...studies.sweep.engine.worker import FAILED
from ...studies.sweep.tuning.optimizer import TuneResult
from ...views.tables.terminal import table

FAILURES = 5  # that are named


def design(prepared: PreparedSweep) -> str:
    """The table of runs."""
    points, keys, spec = prepared.points, prepared.keys, prepared.spec
    names = labels(keys)
    head = ("run", "draw", *(names[key] for key in keys))
    rows = [(str(point.index), str(point.draw), *(_shown(point.cells[key]) for key in keys)) for point in points]
    many = f"{len(points)} runs"
    if spec.distributions:
        crossed = f"x {len(combinations(spec))} combinations"
        many += f": {spec.draws} draws ({spec.design}, seed {spec.seed}) {crossed}"
    return "\n".join([f"sweep {prepared.sweep_id}: {many}", *table([head, *rows], names=2, rest="--json")])


def design_as_json(prepared: PreparedSweep) -> dict[str, Any]:
    spec = prepared.spec
    return {
        "sweep_id": prepared.sweep_id,
        "draws": spec.draws,
        "design": spec.design,
        "seed": spec.seed,
        "keep": spec.keep,
        "notes": list(prepared.notes),
        "runs": [{"run": point.index, "draw": point.draw, "values": dict(point.values)} for point in prepared.points],
    }


def swept(result: SweepResult) -> str:
    """The result of a sweep."""
    facts, prepared = _facts(result), result.prepared
    lines = [f"{prepared.experiment.path.stem} sweep {prepared.sweep_id}: {facts['status']}"]
    of_which = ", ".join(["", *(f"{n} {reason}" for reason, n in facts["marked"].items())]).replace(
        ",", ", of which", 1
    )
    counts = f"{facts['completed']} completed{of_which}, {facts['failed']} failed, {facts['missing']} missing"
    shown = [
        ("runs", f"{facts['runs']}: {counts}"),
        ("reused", str(facts["reused"])),
        ("wall time", f"{result.wall_time:.1f} s"),
        ("table", _place(facts["table"])),
    ]
    lines += [f"  {name:<13} {value}" for name, value in shown]
    failed = [one for _, one in sorted(result.by_index.items()) if one.status == FAILED]
    lines += [f"  run {one.index} failed ({one.run_id or 'no record'}): {one.error}" for one in failed[:FAILURES]]
    if len(failed) > FAILURES:
        lines.append(f"  and {len(failed) - FAILURES} more that failed, see the table")
    if not facts["missing"]:
        lines.append(f"  orch compare --sweep {prepared.sweep_id}")
    return "\n".join(lines)


def swept_as_json(result: SweepResult) -> dict[str, Any]:
    return {**_facts(result), "notes": list(result.prepared.notes)}


def tuned(result: TuneResult) -> str:
    """The result of a search."""
    head = ("controller", "trials", "pruned", "defaults", "tuned", "parameters")
    rows = [
        (
            one.fmu,
            str(one.trials),
            str(one.pruned),
            _number(one.default),
            _number(one.best),
            ", ".join(f"{name} = {_shown(value)}" for name, value in one.parameters.items()),
        )
        for one in result.tuned
    ]
    lines = [f"study {result.tune_id}: {short(result.folder)}", *table([head, *rows])]
    if result.final is not None:
        lines += [
            f"fragments: {short(result.folder / 'tuned.toml')}, and one a controller beside it",
            "",
            "on held-out draws:",
            swept(result.final),
        ]
    return "\n".join(lines)


def tuned_as_json(result: TuneResult) -> dict[str, Any]:
    return {
        "tune_id": result.tune_id,
        "folder": str(result.folder),
        "controllers": [
            {
                "fmu": one.fmu,
                "trials": one.trials,
                "pruned": one.pruned,
                "parameters": dict(one.parameters),
                **finite({"default": one.default, "best": one.best}),
            }
            for one in result.tuned
        ],
        "notes": result.notes,
        "final": swept_as_json(result.final) if result.final is not None else None,
    }


def _facts(result: SweepResult) -> Mapping[str, Any]:
    status = "interrupted" if result.interrupted else "stopped" if result.stopped else "completed"
    return {
        "sweep_id": result.prepared.sweep_id,
        "folder": result.storage.address,
        "table": f"{result.storage.address}/{TABLE}",
        "status": status,
        "runs": len(result.prepared.points),
        "completed": result.count("completed"),
        "failed": result.count(FAILED),
        "missing": result.missing,
        "marked": result.marked,
        "reused": result.reused,
        "wall_time": result.wall_time,
    }


def _place(address: str) -> str:
    return short(Path(address)) if is_local(address) else address


def _number(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else "-"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
