"""Runs again what a record holds, from the record alone, and compares bit for bit."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import StoreError
from ..experiment.reader import parse
from ..plan.plan import Plan
from ..plan.resolve import resolve
from ..records.compare.bits import Difference, compare
from ..records.file.run import Run
from . import runner
from .checkpoint.file import open_checkpoint
from .checkpoint.fit import attach
from .prepare import build_models


def plan_of(record: Run, report: Callable[[str], None]) -> Plan:
    """What a record says that ran, its models built with the packaging they had.

    report: called with what is being built, and with FMUs that are not the same any more.  Raises ExperimentError,
    BuildError, or StoreError where the record says too little, or the checkpoint that it went on from is missing.
    """
    facts = record.attributes
    missing = [name for name in ("experiment_path", "changes") if name not in facts]
    if missing:
        raise StoreError(f"{record.path} was made by an orch that did not record {' and '.join(missing)}")
    path = Path(facts["experiment_path"])
    loaded = parse(path, facts["experiment_toml"], facts["changes"]["set"], facts["changes"]["swap"])
    packagings = {c.fmu: record.fact(c.name, "packaging") for c in loaded.components if c.fmu}
    resolved = record.resolved
    ran = {component["name"]: component for component in resolved.get("components", ())}
    plan = resolve(
        loaded, *build_models(packagings, report), motors=not ran.keys() <= {c.name for c in loaded.components}
    )
    # orch 0.1.0 gave no FMU its tolerance.
    as_then = (dataclasses.replace(c, tolerance=ran.get(c.name, {}).get("tolerance")) for c in plan.components)
    plan = dataclasses.replace(plan, components=tuple(as_then))
    if plan.live:
        recorded = {*resolved.get("record", {}).get("signals", ())}
        plan = dataclasses.replace(
            plan,
            created=resolved["created"],
            recorded=tuple((c, v) for c, v in plan.recorded if f"{c}.{v.name}" in recorded),
        )
    for component in plan.components:
        was = record.fact(component.name, "fmu_sha256")
        if component.fmu.sha256 != was:
            report(
                f"note: {component.name}: {component.fmu_name} is not the same any more: {was[:10]} then, "
                f"{component.fmu.sha256[:10]} now"
            )
    if "from_file" in facts:
        origin = facts["experiment_resolved"]["from"]
        checkpoint = open_checkpoint(facts["from_file"])
        if checkpoint.about["digest"] != origin["checkpoint_sha256"]:
            raise StoreError(f"{record.path} went on from {checkpoint.path}, which is another checkpoint today")
        plan = attach(plan, checkpoint, origin["fresh"])
    return plan


def replay_of(record: Run, plan: Plan) -> dict[str, dict[str, Any]]:
    """What the components that steer hear in place of the world outside: what they heard then.

    Raises StoreError where the record does not say.
    """
    context: dict[str, dict[str, Any]] = {}
    if plan.live:
        from ..mavlink.steered import context_of

        context = context_of(plan)
    for component in plan.components:
        if component.hears:
            heard = record.heard(component.name)
            if heard is None:
                raise StoreError(f"{record.path} does not say what {component.name!r} heard; it cannot be repeated")
            context.setdefault(component.name, {})["replay"] = heard
    return context


def verify(record: Run, plan: Plan) -> Difference | None:
    """Run the plan of a record into a temporary file; returns what differs, None where nothing does.

    Raises KeyboardInterrupt where it was interrupted.
    """
    with tempfile.TemporaryDirectory(prefix="orch-rerun-") as folder:
        result = runner.execute(plan, Path(folder) / "again.h5", context=replay_of(record, plan))
        if result.status == "interrupted":
            raise KeyboardInterrupt
        with Run(result.file) as again:
            return compare(record, again)
