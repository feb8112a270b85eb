"""Runs again what a record holds, from the record alone, and compares bit for bit."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import StoreError
from ..experiment import experiment
from ..models import build
from ..plan.plan import Plan
from ..plan.resolve import resolve
from ..records.file.run import Run
from . import runner
from .checkpoint import resume
from .checkpoint.file import open_checkpoint

# Attributes that decide whether two runs ended alike; all others name the clock, the machine or the file.
COMPARED = ("status", "error", "failed_at", "stopped_at", "metrics", "warnings", "digest")


@dataclass(frozen=True)
class Difference:
    """signals: that differ; first: the one that differs first, at `time` [s], with its values then and now; facts:
    attributes that differ, sentences."""

    signals: tuple[str, ...]
    first: str
    time: float
    then: Any
    now: Any
    facts: tuple[str, ...]

    def __str__(self) -> str:
        lines = list(self.facts)
        if self.signals:
            by = "" if isinstance(self.then, str) else f", by {abs(float(self.now) - float(self.then)):.3g}"
            lines.append(
                f"{len(self.signals)} signals differ, {self.first} first, at t = {self.time:.10g} s: "
                f"{self.then!r} then, {self.now!r} now{by}"
            )
        return "\n".join(lines)


def plan_of(record: Run, told: Callable[[str], None]) -> Plan:
    """What a record says that ran, its models built with the packaging they had.

    told: called with what is being built, and with FMUs that are not the same any more.  Raises ExperimentError, or
    StoreError where an FMU cannot be built as it was, or the checkpoint that it went on from is not there.
    """
    facts = record.attributes
    missing = [name for name in ("experiment_path", "changes") if name not in facts]
    if missing:
        raise StoreError(f"{record.path} was made by an orch that did not record {' and '.join(missing)}")
    path = Path(facts["experiment_path"])
    loaded = experiment.parse(path, facts["experiment_toml"], facts["changes"]["set"], facts["changes"]["swap"])
    models = [c for c in loaded.components if c.fmu and not c.fmu.endswith(".fmu")]
    packaging = {c.fmu: record.fact(c.name, "packaging") for c in models}
    built: dict[str, Path] = {}
    for kind in sorted(set(packaging.values())):
        names = sorted(name for name, its in packaging.items() if its == kind)
        try:
            built |= build.build(names, told, packaging=kind)
        except build.BuildError as error:
            raise StoreError(f"{record.path}: {error}") from None
    plan = resolve(loaded, built, {})
    if plan.live:
        plan = dataclasses.replace(plan, created=facts["experiment_resolved"]["created"])
    for part in plan.parts:
        was = record.fact(part.name, "fmu_sha256")
        if part.fmu.sha256 != was:
            told(
                f"note: {part.name}: {part.fmu_name} is not the same any more: {was[:10]} then, "
                f"{part.fmu.sha256[:10]} now"
            )
    if "from_file" in facts:
        origin = facts["experiment_resolved"]["from"]
        checkpoint = open_checkpoint(facts["from_file"])
        if checkpoint.about["digest"] != origin["checkpoint_sha256"]:
            raise StoreError(f"{record.path} went on from {checkpoint.path}, which is another checkpoint today")
        plan = resume.attach(plan, checkpoint, origin["fresh"])
    return plan


def replay_of(record: Run, plan: Plan) -> dict[str, dict[str, Any]]:
    """What the components that steer hear in place of the world outside: what they heard then.

    Raises StoreError where the record does not say.
    """
    found = {}
    for part in plan.parts:
        if part.live:
            heard = record.heard(part.name)
            if heard is None:
                raise StoreError(f"{record.path} does not say what {part.name!r} heard; it cannot be repeated")
            found[part.name] = {"replay": heard}
    return found


def verify(record: Run, plan: Plan) -> Difference | None:
    """Run the plan of a record into a temporary file; returns what differs, None where nothing does."""
    with tempfile.TemporaryDirectory(prefix="orch-rerun-") as folder:
        result = runner.execute(plan, Path(folder) / "again.h5", context=replay_of(record, plan))
        with Run(result.file) as again:
            return compare(record, cast("Run", _Kept(again, record)) if "kept" in record.attributes else again)


class _Kept:
    """A whole record as one of a sweep that has kept fewer rows, or none."""

    def __init__(self, whole: Run, record: Run):
        self.attributes, self._whole, self._rows = whole.attributes, whole, np.isin(whole.time, record.time)
        self.time, self.signals = whole.time[self._rows], record.signals

    def __getitem__(self, name: str) -> Any:
        return self._whole[name][self._rows]


def compare(then: Run, now: Run) -> Difference | None:
    """What differs between two records in their rows, bit for bit, and in how they ended."""
    before, after = then.attributes, now.attributes
    facts = [
        f"{name}: {_short(before.get(name))} then, {_short(after.get(name))} now"
        for name in COMPARED
        if before.get(name) != after.get(name)
    ]
    times = then.time, now.time
    rows = min(map(len, times))
    if len(times[0]) != len(times[1]):
        facts.append(f"rows: {len(times[0])} then, {len(times[1])} now")
    facts += [f"{name} is in one of the two only" for name in sorted(set(then.signals) ^ set(now.signals))]
    found: dict[str, int] = {}
    for name in ["time", *(name for name in then.signals if name in now.signals)]:
        pair = times if name == "time" else (then[name], now[name])
        if not rows:
            continue
        unequal = _bits(pair[0][:rows]) != _bits(pair[1][:rows])
        differing = np.flatnonzero(unequal.reshape(rows, -1).any(axis=1))
        if len(differing):
            found[name] = int(differing[0])
    if not found:
        return Difference((), "", 0.0, None, None, tuple(facts)) if facts else None
    first = min(found, key=lambda name: found[name])
    row = found[first]
    if then.signals and first != "time" and then[first].ndim > 1:
        place = tuple(np.argwhere(then[first][row] != now[first][row])[0])
        index = ",".join(str(i + 1) for i in place)
        return Difference(
            tuple(found),
            f"{first}[{index}]",
            float(times[0][row]),
            then[first][(row, *place)].item(),
            now[first][(row, *place)].item(),
            tuple(facts),
        )
    old, new = (pair.tolist()[row] for pair in (times if first == "time" else (then[first], now[first])))
    return Difference(tuple(found), first, float(times[0][row]), old, new, tuple(facts))


def _bits(values: Any) -> Any:
    """Numbers as integers of their size: equal where every bit is, and only there."""
    return values if values.dtype.kind == "O" else values.view(f"u{values.dtype.itemsize}")


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."
