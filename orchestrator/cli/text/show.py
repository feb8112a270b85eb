"""What commands print: tables for people, JSON for scripts."""

from __future__ import annotations

import json
import math
from collections.abc import Container, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ... import metrics
from ...errors import ExperimentError, OrchError
from ...files import short
from ...fmu.fmu import Fmu
from ...metrics import finite
from ...plan.feedthrough import Cycle, cycles
from ...plan.plan import Plan
from ...simulation.stepper import PHASES
from ...views.tables import system
from ...views.tables.terminal import table
from ...warning import kinds_of, printed

if TYPE_CHECKING:  # `orch check` and `orch fmus` need no h5py
    from ...records.file.run import Run
    from ...runs.runner import RunResult


SHOWN_INPUTS = 8
ENDS = ("failed_at", "interrupted_at", "stopped_at")


def result(result: RunResult, plan: Plan) -> str:
    """A finished run."""
    head = f"{plan.experiment.path.stem} {result.run_id}: {result.status}"
    if not result.repeated:
        head += ", already in the store (--force runs it again)"
    if result.added:
        head += f"; repeated, the same rows bit for bit, for metrics that were not stored: {', '.join(result.added)}"
    if result.stopped_at is not None:
        head += f"; an FMU ended it at t = {result.stopped_at:.10g} s"
    lines = [
        head,
        f"  file              {short(result.file)}",
        f"  wall time         {result.wall_time:.4g} s",
        f"  real-time factor  {result.real_time_factor:.4g}",
    ]
    if comparison := result.timing.get("comparison"):
        lines.append(f"  compared with     {_comparison(comparison)}")
    lines += [f"  from              {plan.origin}"] if plan.origin else []
    lines += [f"  checkpoint        {short(path)}" for path in result.checkpoints]
    if result.metrics:
        last = round(result.ended_at / plan.experiment.master.step)
        unsampled = {name for name in result.metrics if not plan.has_sample(name, last)}
        shown = _metrics(result.metrics, plan.experiment.metrics, plan.units, unsampled)
        lines += [_heading(result.ended_at, result.ended_at < plan.experiment.master.stop_time)]
        lines += table(shown, 4, title=False)
    return "\n".join(lines)


def record(run: Run) -> str:
    """A record, as `orch show` prints it."""
    facts = run.attributes
    rows = [("file", short(run.path)), ("title", facts["title"]), ("created", facts["created"])]
    rows += [(name.replace("_", " "), facts[name]) for name in ("command", "git_commit", "platform") if facts[name]]
    rows += [(name.replace("_", " "), f"{facts[name]:.10g} s") for name in ENDS if name in facts]
    rows += [
        ("from", _origin(facts)),
        ("error", facts["error"]),
        ("steps", f"{facts['step']:g} s, {facts['algorithm']}; {len(run.time)} rows"),
        ("wall time", f"{facts['wall_time']:.4g} s, {facts['real_time_factor']:.4g}x real time"),
        ("versions", ", ".join(f"{name} {version}" for name, version in facts["versions"].items())),
    ]
    plain = [(k, " ".join(v) if isinstance(v, list) else str(v)) for k, v in rows if v]
    status = ", ".join([run.status, *(mark for mark in run.standing.marks if mark != run.status)])
    lines = [f"{facts['experiment']} {run.run_id}: {status}", *table(plain, 2, title=False), "", "  components"]
    lines += table(
        [
            (c["name"], c["fmu"], c["fmu_sha256"][:10], json.dumps(c["parameters"]) if c["parameters"] else "")
            for c in facts["experiment_resolved"]["components"]
        ],
        4,
        title=False,
        rest="--json",
    )
    if run.metrics:
        shown = _metrics(run.metrics, facts["experiment_resolved"]["metrics"], run.metric_units, run.unsampled)
        lines += ["", _heading(run.ended_at, run.ended_early), *table(shown, 4, title=False)]
    if facts["timing"]:
        lines += ["", *_timing(facts["timing"])]
    lines += [printed(warning) for warning in run.warnings]
    return "\n".join(lines)


def _heading(ended_at: float, early: bool) -> str:
    """Of the metrics, which are of less than the experiment asks for where the run ended early."""
    return f"  metrics, of the time until {ended_at:.10g} s only" if early else "  metrics"


def _origin(facts: Mapping[str, Any]) -> str:
    """The checkpoint that a run was continued from, or ""."""
    if "from_run" not in facts:
        return ""
    fresh = facts["experiment_resolved"]["from"]["fresh"]
    again = f"; reinitialized: {', '.join(fresh)}" if fresh else ""
    return f"run {facts['from_run']} at t = {facts['from_time']:.10g} s, {short(Path(facts['from_file']))}{again}"


def _timing(timing: Mapping[str, Any]) -> list[str]:
    """Where the time went: seconds of each component, estimated from timed steps, and what was waited for."""
    components = {name: [seconds[phase] for phase in PHASES] for name, seconds in timing["components"].items()}
    waits = {f"{name}, waiting": of["waited"] for name, of in timing["components"].items() if of.get("waited")}
    if waited := timing.get("pacing", {}).get("waited"):
        waits["waiting for the clock"] = waited
    spent = sum(map(sum, components.values())) + sum(waits.values())
    whole = max(timing["stepping"], spent)  # estimates of older records may add up to more
    rows = [("", "set", "step", "get", "of all")]
    for name, phases in components.items():
        rows.append((name, *(f"{value:.3g} s" for value in phases), _share(sum(phases), whole)))
    rows += [(name, "", f"{value:.3g} s", "", _share(value, whole)) for name, value in waits.items()]
    rows.append(("loop and recording", "", "", "", _share(whole - spent, whole)))
    lines = [f"  time in the loop ({timing['loop']}): {timing['stepping']:.4g} s", *table(rows, 4)]
    if pacing := timing.get("pacing"):
        mean, worst, end = (pacing[f"late_{which}"] * 1e3 for which in ("mean", "max", "end"))
        lines.append(
            f"  paced at {pacing['factor']:g}x real time: {mean:.3g} ms late on average, "
            f"{worst:.3g} ms at worst, {end:.3g} ms at the end"
        )
    if comparison := timing.get("comparison"):
        lines.append(f"  compared with {_comparison(comparison)}")
    return lines


def _comparison(comparison: Mapping[str, Any]) -> str:
    """What judging the feedback loops took, after the run."""
    return f"{comparison['steps']} shorter steps afterwards, in {comparison['seconds']:.3g} s"


def _share(part: float, whole: float) -> str:
    return f"{part / whole:.1%}" if whole else "-"


def record_as_json(run: Run) -> dict[str, Any]:
    facts = {name: value for name, value in run.attributes.items() if value == value}  # JSON has no nan
    facts.pop("model_descriptions", None)  # 100 kB
    marks = list(run.standing.marks)
    ended = {"status": run.status, "marks": marks, "file": str(run.path)}
    return {**facts, **ended, "rows": len(run.time), "signals": run.signals}


def _metrics(
    values: Mapping[str, float],
    specs: Mapping[str, Mapping[str, Any]],
    units: Mapping[str, str],
    unsampled: Container[str],
) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for name, value in values.items():
        unit = metrics.unit_of(specs[name], units)
        shown = "no sample in its window" if name in unsampled else metrics.text(value)
        rows.append((name, shown, "" if unit == "1" else unit))
    return rows


def last_inputs(result: RunResult) -> str:
    """The first few of the last inputs of the component that failed; the record has all."""
    shown = [
        f"{name} = {value:g}" if isinstance(value, float) else f"{name} = {value}"
        for name, value in list(result.last_inputs.items())[:SHOWN_INPUTS]
    ]
    more = len(result.last_inputs) - len(shown)
    return f"  its last inputs: {', '.join(shown)}" + (f", and {more} more in the record" if more else "")


def result_as_json(result: RunResult) -> dict[str, Any]:
    return {
        "run_id": result.run_id,
        "file": str(result.file),
        "status": result.status,
        "wall_time": result.wall_time,
        "real_time_factor": result.real_time_factor,
        "metrics": finite(result.metrics),
        "metrics_never": [name for name, value in result.metrics.items() if value == math.inf],
        "warnings": list(result.warnings),
        "warning_kinds": kinds_of(result.warnings),
        "error": result.error,
        **({"checkpoints": list(map(str, result.checkpoints))} if result.checkpoints else {}),
    }


def not_started(error: OrchError) -> dict[str, Any]:
    """The JSON of a run that was not started, or whose record could not be kept."""
    empty = dict.fromkeys(("run_id", "file", "wall_time", "real_time_factor"))
    status = "not started" if error.exit_code == 2 else "failed"
    return {
        **empty,
        "status": status,
        "metrics": {},
        "metrics_never": [],
        "warnings": [],
        "warning_kinds": [],
        "error": str(error),
    }


def problems_as_json(error: ExperimentError) -> dict[str, Any]:
    return {"experiment": error.path, "problems": [{"key": p.key, "problem": p.sentence} for p in error.problems]}


def plan(plan: Plan) -> str:
    """The resolved system, as `orch check` prints it."""
    master, record = plan.experiment.master, plan.experiment.record
    scalars = f"{len(plan.connections)} scalar connections"
    lines = [
        f"{plan.experiment.path}: no problems",
        f"  {master.stop_time:g} s in {plan.steps} steps of {master.step:g} s, {master.algorithm}; {scalars}",
        f"  records {len(plan.recorded)} signals every {record.every:g} s; run id {plan.digest[:10]}",
        *(f"  note: {note}" for note in [*plan.notes, *plan.cautions]),
        *(line for cycle in cycles(plan) for line in _cycle(plan, cycle)),
        "",
        *table(system.components(plan), 2),
    ]
    if plan.connections:
        lines += ["", *table(system.connections(plan), 2)]
    return "\n".join(lines)


def _cycle(plan: Plan, cycle: Cycle) -> list[str]:
    late = ", ".join(
        f"{connection.sink}.{connection.input.name} takes {connection.source}.{connection.output.name}"
        for connection in cycle.delayed
    )
    algorithm = plan.experiment.master.algorithm
    order = "the order of the components" if algorithm == "gauss-seidel" else "jacobi"
    return [
        f"  cycle: {cycle}",
        "         depends on itself at once: while stepping,",
        f"         by {order}, {late} of the step before",
    ]


def plan_as_json(plan: Plan) -> dict[str, Any]:
    shown = [
        {
            "path": [".".join(port) for port in cycle.path],
            "delayed": [[f"{k.sink}.{k.input.name}", f"{k.source}.{k.output.name}"] for k in cycle.delayed],
        }
        for cycle in cycles(plan)
    ]
    return {
        "experiment": str(plan.experiment.path),
        "problems": [],
        "digest": plan.digest,
        "cycles": shown,
        "notes": [*plan.notes, *plan.cautions],
        **plan.resolved,
    }


def fmus(listed: Sequence[Fmu]) -> str:
    """The list of FMUs."""
    rows = [("fmu", "packaging", "what it is")]
    rows += [(f.model_name, f.packaging, f.description) for f in listed]
    return "\n".join(table(rows))


def fmu(fmu: Fmu) -> str:
    """One FMU: its variables, vectors on one line."""
    able = [name for name, has in fmu.capabilities.items() if has]
    facts = [
        ("file", short(fmu.path)),
        ("sha256", fmu.sha256),
        ("FMI", f"{fmu.fmi_version}, co-simulation, {fmu.packaging} packaging ({fmu.tool})"),
        ("capabilities", ", ".join(able) or "none"),
        *(
            [("experiment", ", ".join(f"{k} {v}" for k, v in fmu.default_experiment.items()))]
            * bool(fmu.default_experiment)
        ),
        *(("data file", f"{name} {digest[:10]}") for name, digest in fmu.data_files.items()),
    ]
    lines = [f"{fmu.model_name}: {fmu.description}", *table(facts, 2, title=False)]
    for causality in ("input", "output", "structuralParameter", "parameter", "calculatedParameter", "local"):
        rows = [_variable(fmu, name) for name in fmu.names(causality)]
        if rows:
            kind = causality.removesuffix("Parameter")
            title = f"{causality}s" if kind == causality else f"{kind} parameters"
            lines += ["", title, *table(rows, 2, title=False)]
    return "\n".join(lines)


def _variable(fmu: Fmu, name: str) -> tuple[str, ...]:
    scalars = fmu.lookup(name)
    axes = list(scalars)
    variables = list(scalars.values())
    units = list(dict.fromkeys(v.unit for v in variables if v.unit))
    shown = name if axes == [""] else f"{name}[{axes[-1]}]" if axes[0][0].isdigit() else f"{name} ({' '.join(axes)})"
    starts = [_number(v.start) for v in variables if v.start is not None]
    start = starts[0] if len(set(starts)) == 1 else " ".join(starts)
    meaning = variables[0].description
    if axes != [""]:
        meaning = meaning.partition(": ")[2] or meaning
    return shown, start, ", ".join(units) if units != ["1"] else "", meaning


def _number(start: Any) -> str:
    try:
        return f"{float(start):g}"
    except ValueError:  # a text, true or false
        return str(start)


def fmu_as_json(fmu: Fmu) -> dict[str, Any]:
    return {
        "name": fmu.model_name,
        "description": fmu.description,
        "file": str(fmu.path),
        "sha256": fmu.sha256,
        "fmi_version": fmu.fmi_version,
        "packaging": fmu.packaging,
        "tool": fmu.tool,
        "capabilities": dict(fmu.capabilities),
        "default_experiment": dict(fmu.default_experiment),
        "data_files": dict(fmu.data_files),
        "variables": [
            {
                "name": v.name,
                "type": v.type,
                "causality": v.causality,
                "unit": v.unit,
                "start": v.start,
                "description": v.description,
            }
            for v in fmu.variables.values()
        ],
    }
