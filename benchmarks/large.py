"""How cost, loading and memory grow with the number of components: formations of 2 to 1000 vehicles.

Each vehicle brings a reference, a PID controller, an allocation and itself; one current acts on all.  They follow
concentric spirals, and the positions are recorded.  Every run is a process of its own.  Needs Linux or macOS.

examples:
  python benchmarks/large.py
  python benchmarks/large.py --vehicles 2 20 200 --packaging python
  python benchmarks/large.py --vehicles 1000 --write formation.toml     the experiment, to look at or to run
  python benchmarks/large.py --vehicles 1000 --profile                  where loading spends its time
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import machine

STEP = 1e-3  # s
PER_VEHICLE = 4  # components

HEAD = """\
title = "{vehicles} vehicles on concentric spirals, in a current"

[master]
stop_time = {stop_time!r}
step = {step!r}
algorithm = "gauss-seidel"

[components.current]
fmu = "ocean_current"
parameters = {{ velocity = [0.1, 0.05, 0] }}
"""

VEHICLE = """
[components.reference{i}]
fmu = "spiral_reference"
parameters = {{ R = {R}, omega = 0.05 }}

[components.controller{i}]
fmu = "pid"

[components.allocation{i}]
fmu = "bluerov2_allocation"

[components.vehicle{i}]
fmu = "bluerov2_thesis"
parameters = {{ eta_0 = [{R}, 0, 0, 0, 0, 0] }}
"""

CONNECTIONS = """\
"controller{i}.eta" = "vehicle{i}.eta"
"controller{i}.nu" = "vehicle{i}.nu"
"controller{i}.eta_d" = "reference{i}.eta_d"
"controller{i}.eta_d_dot" = "reference{i}.eta_d_dot"
"controller{i}.eta_d_ddot" = "reference{i}.eta_d_ddot"
"allocation{i}.tau" = "controller{i}.tau"
"vehicle{i}.u" = "allocation{i}.u"
"vehicle{i}.v_c" = "current.v_c"
"""

RECORD = """
[record]
every = 0.1
signals = ["vehicle*.eta"]
"""


@dataclass(frozen=True)
class Measured:
    """component_step: its cost with the record [us]; calls: of it within the FMU, estimated [us]; load: from the
    process' start to the first step [s]; memory: its peak [KiB]."""

    vehicles: int
    component_step: float
    calls: float
    load: float
    memory: float

    @property
    def components(self) -> int:
        return 1 + PER_VEHICLE * self.vehicles


def formation(vehicles: int, steps: int) -> str:
    """The experiment file."""
    numbers = range(1, vehicles + 1)
    return "".join(
        [
            HEAD.format(vehicles=vehicles, stop_time=steps / round(1 / STEP), step=STEP),
            *(VEHICLE.format(i=i, R=1 + i / 100) for i in numbers),
            "\n[connections]\n",
            *(CONNECTIONS.format(i=i) for i in numbers),
            RECORD,
        ]
    )


def main() -> None:
    options = _options()
    if options.measure:
        return _measure_here(Path(options.measure[0]), float(options.measure[1]), options.packaging)
    with tempfile.TemporaryDirectory(prefix="orch-bench-") as name:
        if options.write:
            return _write(options.vehicles[-1], options.write)
        if options.profile:
            return _profile(_write(options.vehicles[-1], Path(name) / "formation.toml"), options.packaging)
        print(f"{machine.markdown()}\n", flush=True)
        _measure(options.vehicles[0], 1, Path(name), options.packaging)  # builds what is stale
        rows = [_measure(n, options.repeats, Path(name), options.packaging) for n in options.vehicles]
    print(_table(rows, options.packaging))
    if options.json:
        report = {"machine": machine.describe(), "rows": [asdict(row) for row in rows]}
        options.json.write_text(json.dumps(report, indent=1))
    return None


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, nargs="+", default=[2, 10, 100, 1000], help="default: 2 10 100 1000")
    parser.add_argument("--repeats", type=int, default=3, help="of which the median counts; default: 3")
    parser.add_argument("--packaging", choices=("native", "python"), default="native", help="default: native")
    parser.add_argument("--json", type=Path, metavar="FILE", help="the same numbers, for scripts")
    parser.add_argument("--write", type=Path, metavar="FILE.toml", help="only write the experiment")
    parser.add_argument("--profile", action="store_true", help="only profile the loading")
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)  # what the processes of this script do
    return parser.parse_args()


def _steps(vehicles: int) -> int:
    """About eight million steps of components, in whole rows, but no fewer than orch judges sparsely (chatter.py)."""
    return max(16_000, 8_000_000 // (PER_VEHICLE * vehicles) // 100 * 100)


def _write(vehicles: int, path: Path) -> Path:
    path.write_text(formation(vehicles, _steps(vehicles)))
    return path


def _measure(vehicles: int, repeats: int, folder: Path, packaging: str) -> Measured:
    file = _write(vehicles, folder / f"formation{vehicles}.toml")
    runs = []
    for repeat in range(repeats):
        command = [sys.executable, __file__, "--packaging", packaging, "--measure", str(file), repr(time.monotonic())]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode:
            raise SystemExit(done.returncode)  # the process has said why
        runs.append(json.loads(done.stdout))
        print(f"{vehicles} vehicles, {repeat + 1}/{repeats}: {runs[-1]}", file=sys.stderr, flush=True)
    return Measured(vehicles, *(statistics.median(values) for values in zip(*runs, strict=True)))


def _measure_here(file: Path, began: float, packaging: str) -> None:
    """Run an experiment in this process and print the numbers of `Measured`.  began: when it was started [s]."""
    from orchestrator.errors import OrchError
    from orchestrator.records.file.run import Run
    from orchestrator.runs import runner
    from orchestrator.runs.prepare import prepare
    from orchestrator.simulation.observer import Block, Observer

    class FirstRow(Observer):
        """Notes when the initial values exist."""

        at: float | None = None

        def rows(self, block: Block) -> None:
            self.at = self.at or time.monotonic()

    first_row = FirstRow()
    try:
        plan = prepare(file, packaging=packaging)
        result = runner.execute(plan, file.with_suffix(".h5"), observers=[first_row])
    except OrchError as error:
        raise SystemExit(str(error)) from None
    if result.status != "completed" or first_row.at is None:
        raise SystemExit(f"{file}: {result.error}")
    with Run(result.file) as run:
        timing = run.attributes["timing"]
    calls = sum(seconds[phase] for seconds in timing["components"].values() for phase in ("set", "step", "get"))
    us = 1e6 / (plan.steps * len(plan.components))  # of a step of a component, for a second of the run
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # KiB, on macOS bytes
    memory = peak / 1024 if sys.platform == "darwin" else peak
    print(json.dumps([timing["stepping"] * us, calls * us, first_row.at - began, memory]))
    Path(result.file).unlink()


def _table(rows: Sequence[Measured], packaging: str) -> str:
    lines = [
        f"Formations on {packaging} FMUs, steps of {STEP * 1e3:g} ms; in the FMU: estimated, from every 127th "
        "step; further component: what one more costs, from the row above.\n",
        "| vehicles | components | component step [us] | of it in the FMU [us] | load [s] | further component [ms] | "
        "peak memory [MB] | further component [KiB] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row, above in zip(rows, [None, *rows], strict=False):
        load, memory = (
            ("", "")
            if above is None
            else (
                f"{(row.load - above.load) / (row.components - above.components) * 1e3:.3g}",
                f"{(row.memory - above.memory) / (row.components - above.components):.3g}",
            )
        )
        lines.append(
            f"| {row.vehicles} | {row.components} | {row.component_step:.3g} | {row.calls:.3g} | "
            f"{row.load:.3g} | {load} | {row.memory * 1024 / 1e6:.4g} | {memory} |"
        )
    growth = rows[-1].component_step / rows[0].component_step
    lines.append(
        f"\nThe step of a component among {rows[-1].components} costs {growth:.2f} times that among "
        f"{rows[0].components}."
    )
    return "\n".join(lines)


def _profile(file: Path, packaging: str) -> None:
    """Print what loading spends its time on: functions by their own time, then by the time within them."""
    from orchestrator.runs.prepare import prepare
    from orchestrator.simulation.initialization import initialize
    from orchestrator.simulation.system import System

    profile = cProfile.Profile()
    with profile:
        plan = prepare(file, packaging=packaging)
        with System.open(plan) as system:
            initialize(system)
    statistics_of = pstats.Stats(profile).strip_dirs()
    for order in ("tottime", "cumulative"):
        statistics_of.sort_stats(order).print_stats(25)


if __name__ == "__main__":
    main()
