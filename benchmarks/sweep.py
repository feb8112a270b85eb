"""What a sweep costs: 200 draws of the spiral under three controllers, 30 s at 1 ms.

With one worker and with two, from the first run started to the last record closed; what a run takes beyond stepping;
and the memory of a worker after many runs.

examples:
  python benchmarks/sweep.py
  python benchmarks/sweep.py --draws 20 --repeats 1
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
from pathlib import Path

import orchestrator
from orchestrator.studies.sweep.design import prepared
from orchestrator.studies.sweep.design.prepared import PreparedSweep
from orchestrator.studies.sweep.engine import scheduler, worker
from orchestrator.studies.sweep.engine.storage import Storage
from orchestrator.studies.sweep.engine.table import TABLE
from orchestrator.studies.sweep.engine.worker import PointResult

EXPERIMENT = Path(__file__).parent.parent / "experiments" / "sweep_currents.toml"
CONTROLLERS = ["pid", "nstsmc", "ftsosmc"]


def prepare(draws: int, keep: str) -> PreparedSweep:
    return prepared.prepare(
        EXPERIMENT,
        {
            "master.step": 1e-3,
            "sweep.draws": draws,
            "sweep.keep": keep,
            'sweep.vary."components.controller.fmu"': CONTROLLERS,
        },
    )


def swept(sweep: PreparedSweep, workers: int) -> tuple[float, bytes]:
    """Seconds, and the table."""
    with tempfile.TemporaryDirectory() as folder:
        result = scheduler.sweep(sweep, folder, workers=workers)
        return result.wall_time, result.storage.read(TABLE)


def here(sweep: PreparedSweep, folder: str, first: int, last: int) -> list[PointResult]:
    """Runs of a sweep in this process, as a worker runs them."""
    job = sweep.job(folder, {"git_commit": "", "command": "[]"})
    storage = Storage(job.folder)
    scheduler.lay_out(sweep, storage)
    return worker.batch("", job, sweep.points[first:last], True)


def beyond_stepping(keep: str, runs: int) -> float:
    """Seconds of a run, the median, in which it does not step."""
    sweep = prepare(runs // len(CONTROLLERS) + 1, keep)
    with tempfile.TemporaryDirectory() as folder:
        here(sweep, folder, 0, len(CONTROLLERS))  # loads the FMUs
        results = here(sweep, folder, len(CONTROLLERS), runs)
        costs = []
        for result in results:
            with orchestrator.open_run(Path(folder) / sweep.folder / f"{result.run_id}.h5") as run:
                costs.append(result.seconds - run.attributes["timing"]["stepping"])
    return statistics.median(costs)


def resident() -> float:
    """Megabytes of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200, help="default: 200")
    parser.add_argument("--repeats", type=int, default=3, help="of the two sweeps, in turn; default: 3")
    parser.add_argument("--runs", type=int, default=2000, help="that memory is measured over; default: 2000")
    given = parser.parse_args()

    sweep = prepare(given.draws, "metrics")
    pairs = [(swept(sweep, 1), swept(sweep, 2)) for _ in range(given.repeats)]
    one, two = (statistics.median(pair[i][0] for pair in pairs) for i in (0, 1))
    same = len({table for pair in pairs for _, table in pair}) == 1
    print(
        f"{len(sweep.points)} runs: {one:.1f} s with one worker, {two:.1f} s with two: {one / two:.2f}x, "
        f"{'the same table' if same else 'DIFFERENT TABLES'}"
    )
    for keep in ("metrics", "decimated", "full"):
        print(f"a run beyond its stepping, keep = {keep!r}: {1e3 * beyond_stepping(keep, min(60, given.runs)):.1f} ms")
    if Path("/proc/self/statm").exists():
        sweep = prepare(given.runs // len(CONTROLLERS) + 1, "metrics")
        with tempfile.TemporaryDirectory() as folder:
            few = given.runs // 10
            here(sweep, folder, 0, few)
            before = resident()
            here(sweep, folder, few, given.runs)
            print(f"memory of a worker: {before:.1f} MB after {few} runs, {resident():.1f} MB after {given.runs}")


if __name__ == "__main__":
    main()
