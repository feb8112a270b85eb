"""What a process of its own costs: spiral_pid with 0 to all of its components isolated, in microseconds a step each.

python benchmarks/isolation.py [REPEATS]
"""

import statistics
import sys
import tempfile
from pathlib import Path

import orchestrator as orch

EXPERIMENT = Path(__file__).parent.parent / "experiments" / "spiral_pid.toml"


def stepping(names, folder):
    """Seconds and steps of a run with those components isolated."""
    changes = {f"components.{name}.isolation": "process" for name in names}
    with orch.run(EXPERIMENT, set=changes, results=folder, force=True) as run:
        return run.attributes["timing"]["stepping"], round(run.time[-1] / run.attributes["step"])


def main(repeats):
    """A table; alternately with and without, so that both meet the same machine."""
    names = ["vehicle", "controller", "allocation", "reference"]
    with tempfile.TemporaryDirectory() as folder:
        for n in range(1, len(names) + 1):
            costs = []
            for _ in range(repeats):
                apart, steps = stepping(names[:n], folder)
                together, _ = stepping([], folder)
                costs.append((apart - together) / steps / n * 1e6)
            print(
                f"{n} isolated: {statistics.median(costs):6.2f} us a step and component "
                f"({min(costs):.2f} - {max(costs):.2f})"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
