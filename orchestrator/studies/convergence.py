"""Is the result converged?  The same experiment at several communication steps, metric by metric.

With m(h) = m_0 + c h^p, three steps give the observed order p, and the two finest of them the limit m_0.  A metric that
counts what happens from step to step, such as total variation, follows no such law and is given no order.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import ExperimentError, Problem
from ..fmu.units import conversion
from ..metrics import METRICS, turn_of, unit_of
from ..names import split_axis
from ..plan.plan import Plan
from ..records.file.run import Run
from ..runs.prepare import Report, prepare
from ..views import figures
from ..views.tables import terminal
from ..warning import Warned, are_wrong, printed
from . import processes
from .progress import CommandProgress

TOLERANCE = 0.05  # of a metric: an estimated error beyond it means "not converged"
NEGLIGIBLE = 1e-6  # of the quantity that a metric is of: of the largest magnitude of its vector, in the same unit
FACTORS = (4.0, 2.0, 1.0, 0.5)  # of the experiment's own step, where the user names no steps


@dataclass(frozen=True, kw_only=True)
class MetricConvergence:
    """One metric.  values: by step [s], coarse to fine; order: nan where the values do not approach a limit."""

    name: str
    unit: str
    values: Mapping[float, float]
    order: float
    limit: float  # m_0, or the value at the finest step where there is no order
    error: float  # estimated, at the experiment's own step
    negligible: float = 0.0  # an error that is too small for the quantity to matter, whatever the metric is

    def converged(self, own: float) -> bool:
        """Whether the estimated error is small against the metric or against its quantity.

        A metric that has no value at any step, or is the time of what never happens at any, is the same at all of them.
        """
        if len(set(map(repr, self.values.values()))) == 1:
            return True
        size = max(abs(self.limit), abs(self.values[own]))
        return math.isfinite(self.error) and self.error <= max(TOLERANCE * size, self.negligible)


@dataclass(frozen=True, kw_only=True)
class ConvergenceStudy:
    """All metrics.  warnings: of the run at the experiment's own step, and of runs that ended early."""

    experiment: str
    own: float  # s, the experiment's own step
    steps: tuple[float, ...]  # s, coarse to fine
    metrics: tuple[MetricConvergence, ...]
    warnings: tuple[Warned, ...]

    @property
    def converged(self) -> bool:
        return not are_wrong(self.warnings) and all(metric.converged(self.own) for metric in self.metrics)


def study(
    path: str | Path,
    steps: Sequence[float] = (),
    set: Mapping[str, Any] | None = None,
    swap: Mapping[str, str] | None = None,
    results: str | Path = "results",
    report: Report = lambda _: None,
) -> ConvergenceStudy:
    """Run an experiment at several communication steps; runs whose records are in the store are not repeated.

    steps [s]: beside the experiment's own; none gives 4, 2 and 1/2 times that, where they fit.  report: called with
    each model that is built and each run that has ended.
    Raises ExperimentError where a step does not fit, RunError where a run fails.
    """
    plan = prepare(path, set, swap, report=report)
    own = plan.experiment.master.step
    plans = _plans(plan, path, steps, set or {}, swap)
    chosen = tuple(sorted(plans, reverse=True))
    commands = [processes.command_of(f"step {step:g} s", plans[step], results) for step in chosen]
    ended = processes.run_plans(commands, CommandProgress(len(commands), report))
    by_step = dict(zip(chosen, ended, strict=True))
    with Run(by_step[own]["file"]) as record:
        warnings = (*record.warnings, *_ended_early(plan, {step: by_step[step]["ended_at"] for step in chosen}))
    metrics = []
    for name, spec in plan.experiment.metrics.items():
        values = {step: float(by_step[step]["metrics"][name]) for step in chosen}
        values = _beside(values, own, turn_of(spec, plan.units, plan.angles))
        metrics.append(assess(name, unit_of(spec, plan.units), values, own, METRICS[spec["of"]].counts))
    small = _negligible(plan, [m.name for m in metrics if math.isfinite(m.error) and not m.converged(own)], report)
    metrics = [replace(metric, negligible=small.get(metric.name, 0.0)) for metric in metrics]
    return ConvergenceStudy(
        experiment=plan.experiment.path.stem,
        own=own,
        steps=chosen,
        metrics=tuple(metrics),
        warnings=warnings,
    )


def _beside(values: dict[float, float], own: float, turn: float) -> dict[float, float]:
    """Metrics by step; those that are angles, of which `turn` is a full one, as near as may be to that at `own`."""
    if not turn:
        return values
    return {step: values[own] + math.remainder(value - values[own], turn) for step, value in values.items()}


def _ended_early(plan: Plan, ends: Mapping[float, float]) -> list[Warned]:
    """A warning where FMUs ended runs before the stop time.  ends: {step: when} [s]."""
    early = [f"at step {h:g} s at {end:.10g} s" for h, end in ends.items() if end < plan.experiment.master.stop_time]
    text = f"an FMU ended the run early, {', '.join(early)}: metrics of other lengths of time are compared"
    return [Warned(text)] if early else []


def _plans(
    plan: Plan, path: str | Path, steps: Sequence[float], set: Mapping[str, Any], swap: Mapping[str, str] | None
) -> dict[float, Plan]:
    """{step: plan} of `plan` and the same at other steps, see `study`.  Raises ExperimentError."""
    own = plan.experiment.master.step
    plans, problems = {own: plan}, []
    for step in steps or [float(f"{own * factor:.12g}") for factor in FACTORS]:
        try:
            plans[step] = prepare(path, {**set, "master.step": step}, swap)
        except ExperimentError as error:
            if steps:
                problems += [Problem(f"--steps {step:g}", str(problem)) for problem in error.problems]
    if len(plans) < 3 and not problems:
        problems.append(Problem("--steps", f"{len(plans)} steps show no order of convergence; give at least 3"))
    problems += [
        Problem(f"components.{component.name}", "is steered from outside; runs at other steps would get other inputs")
        for component in plan.components
        if component.hears
    ]
    if not plan.experiment.metrics:
        problems.append(Problem("metrics", "the experiment has none; convergence is judged by its metrics"))
    if problems:
        raise ExperimentError(plan.experiment.path, problems)
    return plans


def _negligible(plan: Plan, names: Sequence[str], report: Report) -> dict[str, float]:
    """{metric: an error that does not matter because its quantity is a million times as large}, in the metric's unit.

    plan: at the experiment's own step, which times cannot be closer than.  It runs once more, for the largest
    magnitudes in all of its steps, whatever is recorded.  A metric that is no measure of its quantity has 0.
    """
    specs = {name: plan.experiment.metrics[name] for name in names if "{}" in METRICS[_of(plan, name)].unit}
    vectors = {name: _vector_of(plan, spec["signal"]) for name, spec in specs.items()}
    sizes = _magnitudes(plan, [axis for vector in vectors.values() for axis in vector], report)
    own = plan.experiment.master.step
    duration = (plan.steps - plan.first) * own
    result = {name: own for name in names if METRICS[_of(plan, name)].unit == "s"}
    for name, spec in specs.items():
        unit = plan.units[spec["signal"]]
        factor = conversion(unit, {}, spec["unit"], {})[0] if "unit" in spec else 1.0
        small = NEGLIGIBLE * factor * max(sizes[axis] for axis in vectors[name])
        by_unit = {"{}": small, "{}.s": small * duration, "({})2.s": small**2 * duration}
        result[name] = {**by_unit, "{}.s2": small * duration**2 / 2}[METRICS[spec["of"]].unit]
    return result


def _of(plan: Plan, metric: str) -> str:
    return str(plan.experiment.metrics[metric]["of"])


def _vector_of(plan: Plan, signal: str) -> list[str]:
    """The axes of the vector of a signal that have its unit."""
    vector, unit = _vector(signal), plan.units[signal]
    return [name for name in plan.readable if _vector(name) == vector and plan.units[name] == unit]


def _magnitudes(plan: Plan, signals: Sequence[str], report: Report) -> dict[str, float]:
    """The largest magnitude of each signal, over all steps of a run that is not kept."""
    if not signals:
        return {}
    metrics = {name: {"of": "max_abs", "signal": name} for name in signals}
    measuring = replace(plan, experiment=replace(plan.experiment, metrics=metrics), recorded=(), watched=())
    with tempfile.TemporaryDirectory(prefix="orch-") as folder:
        command = processes.command_of("magnitudes of signals", measuring, folder)
        (ended,) = processes.run_plans([command], CommandProgress(1, report))
    return dict(ended["metrics"])


def assess(name: str, unit: str, values: Mapping[float, float], own: float, counts: bool = False) -> MetricConvergence:
    """Order, limit and error of one metric from its three finest steps.

    values: {step: metric}.  counts: whether it counts what happens from step to step; it gets no order.
    """
    steps = sorted(values, reverse=True)
    h1, h2, h3 = steps[-3:]
    m1, m2, m3 = (values[h] for h in (h1, h2, h3))
    order = math.nan if counts else observed_order((h1, h2, h3), (m1, m2, m3))
    limit = m3 if math.isnan(order) else m3 + (m3 - m2) / ((h2 / h3) ** order - 1)
    error = abs(values[own] - limit)
    if math.isnan(order) and own == h3:  # nothing finer to compare with
        error = abs(m3 - m2)
    return MetricConvergence(name=name, unit=unit, values=dict(values), order=order, limit=limit, error=error)


def observed_order(steps: tuple[float, float, float], values: tuple[float, float, float]) -> float:
    """p of m(h) = m_0 + c h^p through three points.

    steps [s], values: coarse to fine.  Returns nan where no p from 0.1 to 10 fits.
    """
    h1, h2, h3 = steps
    first, second = values[0] - values[1], values[1] - values[2]
    if second == 0.0 or not first / second > 0.0:
        return math.nan

    def excess(p: float) -> float:
        return float((h1**p - h2**p) / (h2**p - h3**p)) - first / second

    low, high = 0.1, 10.0
    if excess(low) > 0 or excess(high) < 0:
        return math.nan
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
    return (low + high) / 2


@figures.style()
def draw(study: ConvergenceStudy, target: Path) -> Path:
    """Each metric over the step; its limit dashed, the experiment's own step marked.  Returns `target`."""
    from matplotlib.figure import Figure

    columns = min(4, len(study.metrics))
    rows = math.ceil(len(study.metrics) / columns)
    figure = Figure(figsize=(2.7 * columns, 2.1 * rows + 0.5), layout="constrained")
    figure.suptitle(f"{study.experiment}: {'converged' if study.converged else 'NOT converged'} at {study.own:g} s")
    for axes, metric in zip(figure.subplots(rows, columns, squeeze=False).flat, study.metrics, strict=False):
        axes.semilogx(study.steps, [metric.values[h] for h in study.steps], "o-", color="#0072B2", markersize=4)
        axes.axhline(metric.limit, color="#555555", linestyle="--", linewidth=0.8)
        axes.axvline(study.own, color="#D55E00", linewidth=0.8)
        axes.set_title(metric.name, fontsize=9)
        axes.set_ylabel(f"[{metric.unit or '1'}]", fontsize=8)
        axes.set_xlabel("step [s]", fontsize=8)
        axes.tick_params(labelsize=7)
    for axes in figure.axes[len(study.metrics) :]:
        axes.set_visible(False)
    return figures.save(figure, target)


def report(study: ConvergenceStudy) -> str:
    """The study as a table and a verdict."""
    steps = [terminal.tied(f"{step:g} s{'*' if step == study.own else ''}") for step in study.steps]
    rows = [["metric", *steps, "order", "error*", ""]]
    for metric in study.metrics:
        values = ["never" if metric.values[step] == math.inf else f"{metric.values[step]:.5g}" for step in study.steps]
        order = "-" if math.isnan(metric.order) else f"{metric.order:.2g}"
        error = terminal.tied(f"{metric.error:.2g} {metric.unit}".strip())
        rows.append([metric.name, *values, order, error, "" if metric.converged(study.own) else "not converged"])
    notes = [
        "* the experiment's own step; errors are estimates,",
        f"  {TOLERANCE:.0%} of the metric is allowed, or a millionth of the quantity",
    ]
    lines = [*terminal.table(rows), "", *notes, *map(printed, study.warnings)]
    verdict = "converged" if study.converged else "NOT converged"
    return "\n".join([*lines, f"{study.experiment} is {verdict} at {study.own:g} s"])


def as_json(study: ConvergenceStudy) -> dict[str, Any]:
    """The study, as JSON can hold it."""
    return {
        "experiment": study.experiment,
        "step": study.own,
        "converged": study.converged,
        "warnings": list(study.warnings),
        "metrics": {
            m.name: {
                "values": {f"{h:g}": _finite(v) for h, v in m.values.items()},
                "order": _finite(m.order),
                "limit": _finite(m.limit),
                "error": _finite(m.error),
                "converged": m.converged(study.own),
            }
            for m in study.metrics
        },
    }


def _vector(signal: str) -> tuple[str, str]:
    """Component and variable of a signal, without its axis."""
    component, _, variable = signal.partition(".")
    return component, split_axis(variable)[0]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
