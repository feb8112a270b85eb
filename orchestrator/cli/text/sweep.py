"""What `orch sweep` prints: the design, and how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...metrics import finite
from ...studies.sweep.design.matrix import labels
from ...studies.sweep.design.study import Study
from ...studies.sweep.engine.scheduler import Ended
from ...studies.sweep.engine.storage import is_local
from ...studies.sweep.engine.table import TABLE
from ...studies.sweep.engine.worker import FAILED
from ...studies.sweep.tuning.optimizer import Outcome
from ...views.tables.terminal import columns_of
from .show import short

FAILURES = 5  # that are named


def design(study: Study) -> str:
    """The table of runs."""
    runs = study.design.runs()
    names = labels(study.keys)
    head = ("run", "draw", *(names[key] for key in study.keys))
    rows = [(str(run.index), str(run.draw), *(_shown(run.cells[key]) for key in study.keys)) for run in runs]
    d = study.design
    many = f"{len(runs)} runs: {d.draws} draws ({d.method}, seed {d.seed}) x {len(d.combinations)} combinations"
    return "\n".join(
        [f"sweep {study.sweep_id}: {many if d.distributions else f'{len(runs)} runs'}", *columns_of([head, *rows])]
    )


def design_as_json(study: Study) -> dict[str, Any]:
    d = study.design
    runs = [{"run": run.index, "draw": run.draw, "values": dict(run.values)} for run in d.runs()]
    return {
        "sweep_id": study.sweep_id,
        "draws": d.draws,
        "design": d.method,
        "seed": d.seed,
        "keep": d.keep,
        "notes": list(study.notes),
        "runs": runs,
    }


def ended(ended: Ended) -> str:
    """How a sweep ended."""
    facts = _facts(ended)
    lines = [f"{ended.study.experiment.path.stem} sweep {ended.study.sweep_id}: {facts['status']}"]
    counts = f"{facts['completed']} completed, {facts['failed']} failed, {facts['missing']} missing"
    found = [
        ("runs", f"{facts['runs']}: {counts}"),
        ("there before", str(facts["reused"])),
        ("wall time", f"{ended.wall_time:.1f} s"),
        ("table", _place(facts["table"])),
    ]
    lines += [f"  {name:<13} {value}" for name, value in found]
    failed = [line for _, line in sorted(ended.lines.items()) if line.status == FAILED]
    lines += [f"  run {line.index} failed ({line.run_id or 'no record'}): {line.error}" for line in failed[:FAILURES]]
    if len(failed) > FAILURES:
        lines.append(f"  and {len(failed) - FAILURES} more that failed, see the table")
    if not facts["missing"]:
        lines.append(f"  orch compare --sweep {ended.study.sweep_id}")
    return "\n".join(lines)


def ended_as_json(ended: Ended) -> dict[str, Any]:
    return {**_facts(ended), "notes": list(ended.study.notes)}


def tuned(outcome: Outcome) -> str:
    """What came of a search."""
    head = ("controller", "trials", "pruned", "defaults", "tuned", "parameters")
    rows = [
        (
            one.fmu,
            str(one.trials),
            str(one.pruned),
            f"{one.default:.6g}",
            f"{one.best:.6g}",
            ", ".join(f"{name} = {_shown(value)}" for name, value in one.parameters.items()),
        )
        for one in outcome.tuned
    ]
    lines = [f"study {outcome.tune_id}: {short(outcome.folder)}", *columns_of([head, *rows])]
    if outcome.final is not None:
        lines += [
            f"fragments: {short(outcome.folder / 'tuned.toml')}, and one a controller beside it",
            "",
            "on held-out draws:",
            ended(outcome.final),
        ]
    return "\n".join(lines)


def tuned_as_json(outcome: Outcome) -> dict[str, Any]:
    return {
        "tune_id": outcome.tune_id,
        "folder": str(outcome.folder),
        "controllers": [
            {
                "fmu": one.fmu,
                "trials": one.trials,
                "pruned": one.pruned,
                "parameters": dict(one.parameters),
                **finite({"default": one.default, "best": one.best}),
            }
            for one in outcome.tuned
        ],
        "final": ended_as_json(outcome.final) if outcome.final is not None else None,
    }


def _facts(ended: Ended) -> Mapping[str, Any]:
    status = "interrupted" if ended.interrupted else "stopped" if ended.stopped else "completed"
    return {
        "sweep_id": ended.study.sweep_id,
        "folder": ended.storage.address,
        "table": f"{ended.storage.address}/{TABLE}",
        "status": status,
        "runs": len(ended.runs),
        "completed": ended.count("completed"),
        "failed": ended.count(FAILED),
        "missing": ended.missing,
        "reused": ended.reused,
        "wall_time": ended.wall_time,
    }


def _place(address: str) -> str:
    return short(Path(address)) if is_local(address) else address


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
