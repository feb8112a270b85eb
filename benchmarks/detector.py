"""How well a run that is unstable at its step is recognized: misses and false alarms on random experiments.

Each draw is a spiral or a gripping task under one of the six controllers, at a step from an eighth of the controller's
limit to eight times it: both algorithms, currents, sensors with noise of mean zero that the controller reads or not,
components with periods of their own, and sensors without noise, which make limit cycles slower under Jacobi.  The truth
is found without the detector, from every step of the records: a run is wrong where the rms of an axis of tau or u
differs by more than 20 % at half the step, periods of components included.  Of a vector, axes below 1 % of its largest
are left out.  A run that is right at half the step and wrong at a quarter or an eighth is "late": listed, not judged.

examples:
  python benchmarks/detector.py
  python benchmarks/detector.py --runs 12 --seed 7
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import machine
import numpy as np

import orchestrator
from orchestrator.errors import OrchError, RunError
from orchestrator.models import build
from orchestrator.names import split_axis
from orchestrator.warning import Kind, Warned

ROOT = Path(__file__).parent.parent
EXPERIMENT = ROOT / "experiments" / "spiral_pid.toml"
SENSOR = ROOT / "tests" / "fmus" / "noisy_sensor.py"
SEED = 16  # of the runs that the thresholds were measured on, once; they were fixed on others
CHANGE, SMALL = 0.2, 0.01
LIMITS = {  # s, about; docs/thesis.md
    "pid": 2e-3,
    "feedback_linearization": 1e-2,
    "lyapunov": 5e-3,
    "mfsosmc": 3e-4,
    "nstsmc": 1e-2,
    "ftsosmc": 1e-2,
}
ALARMS = (Kind.UNSTABLE, Kind.SAMPLING)


@dataclass(frozen=True)
class Draw:
    """An experiment.  steps: of the master; period: of controller and noisy sensor, in steps; sensors: without noise,
    between vehicle and controller; noise: parameters of a sensor that the controller reads, where `read`."""

    controller: str
    algorithm: str
    step: float
    steps: int
    period: int = 1
    sensors: int = 0
    gripping: bool = False
    current: tuple[float, float, float] = (0.0, 0.0, 0.0)
    noise: dict[str, float] = field(default_factory=dict)
    read: bool = True

    def __str__(self) -> str:
        words = [self.controller, self.algorithm, f"{self.step:g} s", f"{self.steps} steps"]
        words += [f"period {self.period}"] if self.period > 1 else []
        words += [f"{self.sensors} sensors"] if self.sensors else []
        words += ["gripping"] if self.gripping else []
        words += [f"current {self.current}"] if any(self.current) else []
        words += [f"noise {json.dumps(self.noise)}{'' if self.read else ', not read'}"] if self.noise else []
        return ", ".join(words)

    def changes(self, factor: int, kept: bool = False) -> dict[str, Any]:
        """What is laid over EXPERIMENT for steps that are shorter by a factor; kept: but for periods."""
        step = rounded(self.step / factor)
        period = {"step": rounded(self.period * (self.step if kept else step))} if self.period > 1 else {}
        task = "gripping_reference" if self.gripping else "spiral_reference"
        components = {
            "controller": {"fmu": self.controller, **period},
            "allocation": {"fmu": "bluerov2_allocation"},
            "vehicle": {"fmu": "bluerov2_thesis"},
            "reference": {"fmu": task},
            "current": {"fmu": "ocean_current", "parameters": {"velocity": list(self.current)}},
        }
        chain = [f"sensor{i + 1}" for i in range(self.sensors)]
        sensors = {name: {"fmu": "noisy_sensor"} for name in chain}
        if self.noise:
            sensors["noisy"] = {"fmu": "noisy_sensor", "parameters": self.noise, **period}
            chain += ["noisy"] if self.read else []
        connections = {}
        for signal in ("eta", "nu"):
            newest = f"vehicle.{signal}"
            for name in chain:
                connections[f"{name}.{signal}"], newest = newest, f"{name}.{signal}_m"
            connections[f"controller.{signal}"] = newest
            if self.noise and not self.read:
                connections[f"noisy.{signal}"] = f"vehicle.{signal}"
        return {
            "master.step": step,
            "master.stop_time": rounded(self.steps * self.step),
            "master.algorithm": self.algorithm,
            "components": {**sensors, **components},
            **{f'connections."{sink}"': source for sink, source in connections.items()},
            "record": {"every": step, "signals": ["controller.tau.*", "allocation.u.*"]},
            "metrics": {},
        }


@dataclass(frozen=True)
class Judged:
    """A draw.  changes: the largest of an rms at half the step, a quarter and an eighth; kept: at half the step of the
    master alone; kinds: of the warnings; cost: of the comparison, steps by steps of the run."""

    draw: Draw
    changes: tuple[float, ...]
    kept: float
    kinds: tuple[str, ...]
    warnings: tuple[str, ...]
    cost: float

    @property
    def truth(self) -> str:
        if self.changes[0] > CHANGE:
            return "wrong"
        return "late" if max(self.changes) > CHANGE else "right"

    @property
    def alarm(self) -> bool:
        return any(kind in ALARMS for kind in self.kinds)


def main() -> None:
    options = _options()
    generator = random.Random(options.seed)
    draws = [drawn(generator) for _ in range(options.runs)]
    build.build([*LIMITS, "bluerov2_allocation", "bluerov2_thesis", "spiral_reference", "gripping_reference"])
    build.build(["ocean_current", str(SENSOR)])
    print(f"{machine.markdown()}\n")
    with ProcessPoolExecutor(options.jobs) as pool:
        results = []
        for result in pool.map(judged, draws):
            results.append(result)
            print(f"{len(results)}/{len(draws)} {result.truth}, {'alarm' if result.alarm else 'none'}", file=sys.stderr)
    print(report(results))
    if options.json:
        table = [{**asdict(result), "draw": str(result.draw)} for result in results]
        options.json.write_text(json.dumps(table, indent=1))
    if any((r.truth == "wrong" and not r.alarm) or (r.truth == "right" and r.alarm) for r in results):
        sys.exit(1)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100, help="default: 100")
    parser.add_argument("--seed", type=int, default=SEED, help=f"of the draws; default: {SEED}")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes; default: one a core")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every run, for scripts")
    return parser.parse_args()


def rounded(seconds: float) -> float:
    """A decimal number of seconds, as a file would give it."""
    return float(f"{seconds:.12g}")


def drawn(generator: random.Random) -> Draw:
    controller = generator.choice(list(LIMITS))
    algorithm = generator.choice(["gauss-seidel", "jacobi"])
    period = generator.choice([2, 4, 10, 20]) if generator.random() < 0.25 else 1
    held = LIMITS[controller] * 2 ** generator.uniform(-3, 3)
    step = float(f"{held / period:.2g}")
    # 4 to 12 s, but no fewer than 300 periods of the controller and no more than 40 000 steps
    duration = max(300 * period * step, min(generator.uniform(4, 12), 40_000 * step))
    steps = round(duration / step / period) * period
    sensors = generator.choice([1, 2, 3, 5, 7]) if algorithm == "jacobi" and generator.random() < 0.3 else 0
    gripping = generator.random() < 0.3
    still = generator.random() < 0.5
    current = (0.0, 0.0, 0.0) if still else tuple(round(generator.uniform(-0.8, 0.8), 2) for _ in range(3))
    noise: dict[str, float] = {}
    if generator.random() < 0.5:
        sigma = 10 ** generator.uniform(-4, -2)
        nu = generator.choice([0.0, 0.3, 1.0, 3.0])
        noise = {"sigma_eta": round(sigma, 6), "sigma_nu": round(nu * sigma, 6), "seed": generator.randrange(1, 10**6)}
        if generator.random() < 0.5:
            noise["interval"] = rounded(generator.choice([1, 5, 20]) * period * step)
    read = generator.random() < 0.8
    return Draw(controller, algorithm, step, steps, period, sensors, gripping, current, noise, read)


def judged(draw: Draw) -> Judged:
    with tempfile.TemporaryDirectory(prefix="orch-detector-") as folder:
        try:
            rms, relevant, warnings, steps = _run(draw.changes(1), folder)
            found = [change(rms, relevant, _run(draw.changes(factor), folder)[0]) for factor in (2, 4, 8)]
            kept = change(rms, relevant, _run(draw.changes(2, kept=True), folder)[0]) if draw.period > 1 else found[0]
        except OrchError as error:
            raise RuntimeError(f"{draw}: {error}") from None
    kinds = tuple(warning.kind.value for warning in warnings)
    return Judged(draw, tuple(found), kept, kinds, tuple(warnings), steps / draw.steps)


def _run(changes: dict[str, Any], folder: str) -> tuple[dict[str, float], list[str], list[Warned], int]:
    """The rms of each command, which of them are not small in their vectors, the warnings, and steps to compare."""
    try:
        record = orchestrator.run(EXPERIMENT, changes, output=Path(folder) / "run.h5", force=True)
    except RunError as error:
        record = error.run
    with record:
        rms = {name: math.sqrt(float(np.mean(record[name][1:] ** 2))) for name in record.signals}
        units = {name: record.units(name) for name in record.signals}
        warnings, timing = record.warnings, record.attributes["timing"]
    vectors: dict[tuple[str, str], float] = {}
    for name, value in rms.items():
        key = split_axis(name)[0], units[name]
        vectors[key] = max(vectors.get(key, 0.0), value)
    Path(folder, "run.h5").unlink()
    relevant = [name for name, value in rms.items() if value > SMALL * vectors[split_axis(name)[0], units[name]]]
    return rms, relevant, warnings, timing.get("comparison", {}).get("steps", 0)


def change(before: dict[str, float], relevant: list[str], after: dict[str, float]) -> float:
    """The largest relative difference of an rms that is relevant."""
    return max(abs(after[name] / before[name] - 1.0) for name in relevant)


def wilson(hits: int, n: int, z: float = 1.959964) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    if n == 0:
        return math.nan, math.nan
    share, square = hits / n, z * z
    middle = (share + square / (2 * n)) / (1 + square / n)
    half = z / (1 + square / n) * math.sqrt(share * (1 - share) / n + square / (4 * n * n))
    return max(0.0, middle - half), min(1.0, middle + half)


def report(results: list[Judged]) -> str:
    counts = Counter((r.truth, r.alarm) for r in results)
    lines = ["| truth | runs | warned | not warned |", "|---|---|---|---|"]
    for truth, meaning in (
        ("wrong", "an rms changes by more than 20 % at half the step"),
        ("late", "only at a quarter or an eighth of it"),
        ("right", "by no more than 20 %"),
    ):
        warned, silent = counts[truth, True], counts[truth, False]
        lines.append(f"| {truth}: {meaning} | {warned + silent} | {warned} | {silent} |")
    for what, truth, alarm in (("misses", "wrong", False), ("false alarms", "right", True)):
        hits, n = counts[truth, alarm], counts[truth, True] + counts[truth, False]
        low, high = wilson(hits, n)
        lines.append(f"\n{what}: {hits} of {n}, {low:.1%} to {high:.1%} (Wilson, 95 %)")
    costs = sorted(r.cost for r in results if r.cost)
    if costs:
        lines.append(
            f"\ncompared: {len(costs)} of {len(results)} runs, over {costs[0]:.0%} to {costs[-1]:.0%} of their steps, "
            f"median {costs[len(costs) // 2]:.0%}"
        )
    sampled = [r for r in results if r.draw.period > 1 and r.truth == "wrong" and r.alarm]
    right = sum((r.kept <= CHANGE) == (Kind.SAMPLING in r.kinds) for r in sampled)
    lines.append(f"\nof {len(sampled)} with periods of their own, the cause is named right in {right}")
    for r in results:
        if (r.truth == "wrong") != r.alarm:
            shown = ", ".join(f"{c:.0%}" for c in r.changes)
            lines.append(f"\n{r.truth}, {'warned' if r.alarm else 'not warned'}; {shown}: {r.draw} {list(r.warnings)}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
