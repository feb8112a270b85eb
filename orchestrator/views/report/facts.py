"""The text of the page: what ran, how it ended, its metrics, and how its record was made."""

from __future__ import annotations

import json
import shlex
from collections.abc import Container, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ... import metrics
from ...files import short
from ...records.file.marks import DAGGER

if TYPE_CHECKING:
    from ...records.file.run import Run


def title_of(run: Run) -> str:
    return str(run.attributes["title"] or run.attributes["experiment"])


def of(run: Run, label: str) -> dict[str, Any]:
    """One run, for the head of the page and its last section.  label: its id and how it differs from the others."""
    facts = run.attributes
    last = f"{run.time[-1]:.6g} s" if len(run.time) else "no row"
    return {
        "id": run.run_id,
        "label": label,
        "status": run.status,
        "good": not run.standing.marks,
        "how": f"{last} in steps of {facts['step']:g} s, {facts['algorithm']}; "
        f"wall time {facts['wall_time']:.3g} s, {facts['real_time_factor']:.3g} × real time",
        "error": facts["error"],
        "failed_at": f" at t = {facts['failed_at']:.10g} s" if "failed_at" in facts else "",
        "stopped_at": f"an FMU ended the run at {facts['stopped_at']:.10g} s." if "stopped_at" in facts else "",
        "warnings": run.warnings,
        "made": [row for row in _made(run) if row[1]],
        "components": _components(run),
        "toml": facts["experiment_toml"],
    }


def _made(run: Run) -> list[tuple[str, str, bool]]:
    """Name, value, and whether it is code."""
    facts = run.attributes
    return [
        ("record", short(run.path), False),
        ("run id", run.run_id, True),
        ("digest", str(facts["digest"]), True),
        ("created", str(facts["created"]), False),
        ("command", shlex.join(facts["command"]), True),
        ("git commit", str(facts["git_commit"] or "unknown"), bool(facts["git_commit"])),
        ("versions", ", ".join(f"{name} {version}" for name, version in facts["versions"].items()), False),
        ("platform", str(facts["platform"]), False),
        ("seed", str(facts.get("seed", "")), False),
        ("rows", f"{len(run.time)} of {len(run.signals)} signals", False),
    ]


def _components(run: Run) -> list[dict[str, str]]:
    rows = []
    for component in run.attributes["experiment_resolved"].get("components", []):
        name, fmu, digest = (str(component.get(key, "")) for key in ("name", "fmu", "fmu_sha256"))
        attributes = run.facts_of(name)
        packed = " ".join(str(attributes.get(key, "")) for key in ("packaging", "fmi_version"))
        parameters = ", ".join(f"{k} = {json.dumps(v)}" for k, v in component.get("parameters", {}).items())
        rows.append({"name": name, "fmu": fmu, "packed": packed, "digest": digest, "parameters": parameters})
    return rows


def numbers(runs: Sequence[Run], labels: Sequence[str]) -> dict[str, Any]:
    """The metrics as a table, runs beside each other.

    words: the columns that are no numbers; footnote: what the daggers mean.
    """
    specs: dict[tuple[str, str], Mapping[str, Any]] = {}  # by name and unit
    values: list[dict[tuple[str, str], str]] = []
    for run in runs:
        own, units = run.attributes["experiment_resolved"].get("metrics", {}), run.metric_units
        keys = {name: (name, metrics.unit_of(spec, units)) for name, spec in own.items()}
        specs |= {keys[name]: spec for name, spec in own.items()}
        values.append({keys[name]: text for name, text in _texts(run.metrics, run.unsampled).items() if name in keys})
    rows, footnotes = [], dict[str, None]()
    for key in (key for key in specs if any(key in v for v in values)):
        name, unit = key
        marks = [
            run.standing.marks_of(specs[key]["of"]) if key in v else () for run, v in zip(runs, values, strict=True)
        ]
        shown = [v.get(key, "") + DAGGER * bool(m) for v, m in zip(values, marks, strict=True)]
        footnotes |= {f"{run.run_id} {', '.join(m)}": None for run, m in zip(runs, marks, strict=True) if m}
        rows.append([name, *shown, "" if unit == "1" else unit, _meaning(specs[key])])
    until = [f" until {run.ended_at:.6g} s" if run.ended_early and run.metrics else "" for run in runs]
    values_of = [f"{label}{end}" for label, end in zip(labels if len(runs) > 1 else ["value"], until, strict=True)]
    heads = ["metric", *values_of, "unit", "of"]
    footnote = f"{DAGGER} not to be compared: {'; '.join(footnotes)}" if footnotes else ""
    return {"heads": heads, "rows": rows, "words": (0, len(heads) - 2, len(heads) - 1), "footnote": footnote}


def _texts(values: Mapping[str, float], unsampled: Container[str]) -> dict[str, str]:
    return {name: "no sample" if name in unsampled else metrics.text(value) for name, value in values.items()}


def _meaning(spec: Mapping[str, Any]) -> str:
    """A metric in words: "rmse of vehicle1.eta.x against reference1.eta_d.x, from 6 s"."""
    words = f"{spec.get('stat', '')} {spec['of'].replace('_', ' ')} of {spec['signal']}".strip()
    if "reference" in spec:
        words += f" against {spec['reference']}"
    if "band" in spec:
        words += f" within {spec['band']:g}"
    if "after" in spec:
        words += f", from {spec['after']:g} s"
    if "before" in spec:
        words += f"{' ' if 'after' in spec else ', '}until {spec['before']:g} s"
    return words
