"""What a run costs: microseconds per communication step, and what the process spends besides.

    python benchmarks/speed.py [--repeats 5]

Each repeat is a whole process, `orch run experiments/gripping_currents.toml --force`: nine Python FMUs, all signals
recorded every 10 ms.  Prints a Markdown table: median, and the range over the repeats.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

EXPERIMENT = Path(__file__).parent.parent / "experiments" / "gripping_currents.toml"
STEP = 1e-4  # s, of the experiment


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--simulated", type=float, default=4.0, help="s of simulated time a repeat")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        measured = [one_run(folder, options.simulated) for _ in range(options.repeats + 1)][1:]  # the first warms up
    steps = options.simulated / STEP
    print(f"{platform.machine()}, Python {platform.python_version()}, {options.repeats} repeats of {steps:.0f} steps\n")
    print("| | median | range |\n|---|---|---|")
    row("one communication step of nine Python FMUs, recorded [us]", [loop / steps * 1e6 for loop, _ in measured])
    row("the rest of the process: start, imports, loading [s]", [whole - loop for loop, whole in measured])


def one_run(folder: str, simulated: float) -> tuple[float, float]:
    """Seconds of the stepping loop, and of the whole process."""
    command = [sys.executable, "-m", "orchestrator.cli", "run", str(EXPERIMENT), "--force", "--json"]
    command += ["--results", folder, "--set", f"master.stop_time={simulated}"]
    began = time.perf_counter()
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    whole = time.perf_counter() - began
    return json.loads(process.stdout)["wall_time"], whole


def row(name: str, values: list[float]) -> None:
    print(f"| {name} | {statistics.median(values):.3g} | {min(values):.3g} - {max(values):.3g} |")


if __name__ == "__main__":
    main()
