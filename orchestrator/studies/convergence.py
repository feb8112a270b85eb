"""Is the result converged?  The same experiment at several communication steps, metric by metric.

With m(h) = m_0 + c h^p, three steps give the observed order p, and the two finest of them the limit m_0.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ExperimentError, OrchError, Problem, RunError
from ..experiment.timegrid import Grid
from ..plan.plan import Plan
from ..views import figures

TOLERANCE = 0.05  # of a metric: an estimated error beyond it means "not converged"
NOISE = 1e-6  # SI; a metric that is zero but for rounding has no relative error
FACTORS = (4.0, 2.0, 1.0, 0.5)  # of the experiment's own step, where the user names no steps


@dataclass(frozen=True)
class Convergence:
    """One metric.  `values`: by step, coarse to fine; `order`: nan where the values do not shrink monotonically."""

    name: str
    unit: str
    values: Mapping[float, float]
    order: float
    limit: float  # m_0, or the value at the finest step where there is no order
    error: float  # estimated, at the experiment's own step

    def converged(self, own: float) -> bool:
        """Whether the estimated error is small against the metric, or against what it changes by over all steps."""
        size = max(abs(self.limit), abs(self.values[own]))
        return math.isfinite(self.error) and self.error <= TOLERANCE * size + NOISE


@dataclass(frozen=True)
class Study:
    """The whole answer.  `warnings`: of the run at the experiment's own step."""

    experiment: str
    own: float
    steps: tuple[float, ...]
    metrics: tuple[Convergence, ...]
    warnings: tuple[str, ...]

    @property
    def converged(self) -> bool:
        return not self.warnings and all(metric.converged(self.own) for metric in self.metrics)


def default_steps(plan: Plan) -> list[float]:
    """Multiples of the experiment's own step that fit its stop time, rows and periods."""
    own = plan.experiment.master.step
    return [step for factor in FACTORS if not _misfit(plan, step := float(f"{own * factor:.12g}"))]


def study(
    plan: Plan, steps: Sequence[float], arguments: Sequence[str], units: Mapping[str, str], told: Callable[[str], None]
) -> Study:
    """Run `plan` at each step; runs that are in the store are not repeated.

    arguments: the command line of `orch run` but for --json and the step.  told: called with each finished run.
    Raises ExperimentError where a step does not fit, RunError where a run fails.
    """
    own = plan.experiment.master.step
    chosen = tuple(sorted({own, *steps}, reverse=True))
    problems = [Problem(f"--steps {step:g}", words) for step in chosen if (words := _misfit(plan, step))]
    if len(chosen) < 3:
        problems.append(Problem("--steps", f"{len(chosen)} steps show no order of convergence; give at least 3"))
    if not plan.experiment.metrics:
        problems.append(Problem("metrics", "the experiment has none; convergence is judged by its metrics"))
    if problems:
        raise ExperimentError(plan.experiment.path, problems)
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # each run is a process of its own
        results = dict(zip(chosen, pool.map(lambda step: _run(step, arguments, told), chosen), strict=True))
    found = []
    for name in plan.experiment.metrics:
        values = {step: _number(results[step]["metrics"][name]) for step in chosen}
        found.append(assess(name, units[name], values, own))
    return Study(plan.experiment.path.stem, own, chosen, tuple(found), tuple(results[own]["warnings"]))


def assess(name: str, unit: str, values: Mapping[float, float], own: float) -> Convergence:
    """Order, limit and error of one metric from its three finest steps.  values: {step: metric}."""
    steps = sorted(values, reverse=True)
    h1, h2, h3 = steps[-3:]
    m1, m2, m3 = (values[h] for h in (h1, h2, h3))
    order = observed_order((h1, h2, h3), (m1, m2, m3))
    limit = m3 if math.isnan(order) else m3 + (m3 - m2) / ((h2 / h3) ** order - 1)
    error = abs(values[own] - limit)
    if math.isnan(order) and own == h3:  # nothing finer to compare with
        error = abs(m3 - m2)
    return Convergence(name, unit, dict(values), order, limit, error)


def observed_order(steps: tuple[float, float, float], values: tuple[float, float, float]) -> float:
    """p of m(h) = m_0 + c h^p through three points, coarse to fine; nan where no p in 0.1..10 fits."""
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
def draw(study: Study, target: Path) -> Path:
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


def report(study: Study) -> str:
    """The study as a table and a verdict."""
    head = ["metric", *(f"{step:g} s{'*' if step == study.own else ''}" for step in study.steps), "order", "error*", ""]
    rows = [head]
    for metric in study.metrics:
        order = "-" if math.isnan(metric.order) else f"{metric.order:.2g}"
        verdict = "" if metric.converged(study.own) else "not converged"
        values = [f"{metric.values[step]:.5g}" for step in study.steps]
        rows.append([metric.name, *values, order, f"{metric.error:.2g} {metric.unit}".strip(), verdict])
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines += ["", f"* the experiment's own step; errors are estimates, {TOLERANCE:.0%} of the metric is allowed"]
    lines += [f"warning: {warning}" for warning in study.warnings]
    verdict = "converged" if study.converged else "NOT converged"
    return "\n".join([*lines, f"{study.experiment} is {verdict} at {study.own:g} s"])


def as_json(study: Study) -> dict[str, Any]:
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


def _run(step: float, arguments: Sequence[str], told: Callable[[str], None]) -> dict[str, Any]:
    orch = [sys.executable, "-m", "orchestrator.cli.main"]
    command = [*orch, "run", *arguments, "--json", "--set", f"master.step={step!r}"]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    if process.returncode:
        error = process.stderr.strip()
        raise (RunError if process.returncode == 3 else OrchError)(f"at a step of {step:g} s: {error}")
    result: dict[str, Any] = json.loads(process.stdout)
    told(f"{step:g} s: {result['wall_time']:.1f} s of wall time")
    return result


def _misfit(plan: Plan, step: float) -> str:
    """Why the experiment cannot run at this step, or ""."""
    experiment, grid = plan.experiment, Grid(step)
    durations = {"master.stop_time": experiment.master.stop_time, "record.every": experiment.record.every}
    durations |= {f"components.{c.name}.step": c.step for c in experiment.components if c.step is not None}
    for key, duration in durations.items():
        if not grid.ticks(duration):
            return f"does not divide {key} = {duration:g} s"
    return ""


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
