"""How long finding records takes in a store of thousands: `orch list`, `orch list --where`, `orch show`.

The store is filled with records of real size: one run of an experiment is recorded, and copied without its signals,
each copy with its own run id, seed, parameter and metrics, as a sweep would leave them.

examples:
  python benchmarks/store.py
  python benchmarks/store.py --records 100000
  python benchmarks/store.py --records 10000 --write DIR      fills a store, to try other commands on
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py

import orchestrator

EXPERIMENT = Path(__file__).parent.parent / "experiments" / "gripping_currents.toml"
OMITTED = "model_descriptions"  # 100 kB that no list reads
TIMES = 5
COMMANDS: dict[str, list[str]] = {
    "list": ["list"],
    "list --limit 20": ["list", "--limit", "20"],
    "list --where a metric": ["list", "--where", "metrics.rmse_x1 < 0.3"],
    "list --where a parameter": ["list", "--where", "components.vehicle1.parameters.eta_0.z < 1.0"],
    "list --json": ["list", "--json"],
    "show a prefix": ["show", "{prefix}"],
}


def fill(store: Path, records: int) -> list[str]:
    """Write that many records; returns their run ids."""
    with (
        tempfile.TemporaryDirectory() as folder,
        orchestrator.run(EXPERIMENT, set={"master.stop_time": 1.0}, output=Path(folder) / "one.h5") as run,
    ):
        attributes = {name: value for name, value in run.file.attrs.items() if name != OMITTED}
    resolved, chance = json.loads(attributes["experiment_resolved"]), random.Random(1)
    place = store / EXPERIMENT.stem
    place.mkdir(parents=True, exist_ok=True)
    run_ids = []
    for i in range(records):
        digest = hashlib.sha256(str(i).encode()).hexdigest()
        for component in resolved["components"]:
            if component["name"] == "vehicle1":
                component["parameters"] = {**component["parameters"], "eta_0.z": chance.uniform(0.0, 2.0)}
        own = {
            "run_id": digest[:10],
            "digest": digest,
            "seed": i,
            "experiment_resolved": json.dumps(resolved),
            OMITTED: "{}",
            "metrics": json.dumps({name: chance.random() for name in json.loads(attributes["metrics"])}),
        }
        with h5py.File(place / f"{digest[:10]}.h5", "w", libver=("earliest", "v108")) as file:
            file.attrs.update({**attributes, **own})
            file["time"] = [0.0]
        run_ids.append(digest[:10])
    return run_ids


def measure(store: Path, run_ids: list[str]) -> None:
    """Print seconds of whole processes: the first list, which fills the cache, and the best of the others."""
    orch = [sys.executable, "-m", "orchestrator.cli"]

    def seconds(command: list[str]) -> float:
        words = [word.format(prefix=run_ids[0]) for word in command]
        began = time.perf_counter()
        subprocess.run([*orch, *words, "--results", str(store)], stdout=subprocess.DEVNULL, check=True)
        return time.perf_counter() - began

    print(f"{len(run_ids)} records, s a command (best of {TIMES})")
    print(f"  {'first list':<26} {seconds(['list']):6.2f}")
    for name, command in COMMANDS.items():
        print(f"  {name:<26} {min(seconds(command) for _ in range(TIMES)):6.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=10_000, metavar="N")
    parser.add_argument("--write", type=Path, metavar="DIR", help="only fill a store")
    asked = parser.parse_args()
    if asked.write:
        fill(asked.write, asked.records)
        return
    with tempfile.TemporaryDirectory(prefix="orch-store-") as folder:
        measure(Path(folder), fill(Path(folder), asked.records))


if __name__ == "__main__":
    main()
