"""What a communication step costs, and how far that is from the least that it can cost.

One table from one run: each repeat runs every contender once, in turn, each as a process of its own.  All of them run
experiments/gripping_currents.toml: nine components, 90 connections, 105 signals recorded every 10 ms.

examples:
  make bench
  python benchmarks/speed.py --repeats 9 --json speed.json
  python benchmarks/speed.py --full                  every contender takes all the steps: an hour and more
  python benchmarks/speed.py --quick                 does it run?  The numbers are of no use
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import contenders
import machine
from contenders import Bench, Contender, Measured, Unusable

from orchestrator.errors import OrchError

COMMUNICATION_STEPS = (1e-4, 1e-3)  # s; the experiment's, and one beyond its controllers' limit: costs only

# Read off runs of a Jacobi loop with their times in the place of ours, which gives their bits.
WHY = (
    "What is left in jacobi order is the clock: orch steps from k h by h, libcosim by differences of such times, "
    "Ecos from running sums of h."
)

Repeats = dict[Contender, list[Measured]]


def main() -> None:
    options = _options()
    steps = options.steps or (20_000 if options.quick else 400_000)
    moments = COMMUNICATION_STEPS[:1] if options.quick else COMMUNICATION_STEPS
    report: dict[str, Any] = {"machine": machine.describe(), "steps": steps, "tables": {}}
    print(f"{machine.markdown()}\n")
    with tempfile.TemporaryDirectory(prefix="orch-bench-") as folder:
        bench = Bench(Path(folder))
        usable = _usable(bench, moments[0])
        for h in moments:
            repeats = _measure(bench, usable, h, steps, 1 if options.quick else options.repeats, options.full)
            print(f"{_table(repeats, h, steps)}\n\n{_ratios(repeats)}\n", flush=True)
            report["tables"][f"{h:g}"] = _raw(repeats)
        compared = [c for c in usable if c.packaging == "native"] if options.quick else usable
        print(_agreement(bench, compared, moments[0], 500 if options.quick else 40_000, report))
    if options.json:
        options.json.write_text(json.dumps(report, indent=1))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5, help="default: 5")
    parser.add_argument(
        "--steps",
        type=int,
        help="of the fastest contenders; default: 400000.  Slower ones take 1/10, other masters on Python FMUs 1/40",
    )
    parser.add_argument("--full", action="store_true", help="all contenders take all the steps")
    parser.add_argument("--quick", action="store_true", help="one repeat of few steps")
    parser.add_argument("--json", type=Path, metavar="FILE", help="every measurement, for scripts")
    return parser.parse_args()


def _usable(bench: Bench, h: float) -> list[Contender]:
    """The contenders that run here; a first run of each, which also warms up."""
    usable = []
    for contender in contenders.ALL:
        try:
            bench.run(contender, h, 100)
        except Unusable as reason:
            print(f"Left out: {contender.name}, FMUs: {contender.fmus}: {reason}\n", flush=True)
        else:
            usable.append(contender)
    return usable


def _measure(bench: Bench, chosen: Sequence[Contender], h: float, steps: int, repeats: int, full: bool) -> Repeats:
    found: Repeats = {contender: [] for contender in chosen}
    for repeat in range(repeats):
        for contender in chosen:
            measured = bench.run(contender, h, steps if full else round(steps * contender.share))
            found[contender].append(measured)
            print(
                f"{h:g} s, {repeat + 1}/{repeats}: {contender.name}, FMUs: {contender.fmus}: "
                f"{measured.step:.4g} us a step",
                file=sys.stderr,
                flush=True,
            )
    return found


def _table(repeats: Repeats, h: float, steps: int) -> str:
    lines = [
        f"Communication step {h * 1e3:g} ms, medians of {len(next(iter(repeats.values())))} repeats; process: with "
        f"{steps} steps, of which a share was run and the rest is reckoned where there is a ~.\n",
        "| master | FMUs | one step [us] | range | whole process [s] | range |",
        "|---|---|---|---|---|---|",
    ]
    for contender, runs in repeats.items():
        reckoned = "" if runs[0].steps == steps else "~"
        per_step, process = [run.step for run in runs], [run.process(steps) for run in runs]
        lines.append(f"| {contender.name} | {contender.fmus} | {_spread(per_step)} | {reckoned}{_spread(process)} |")
    return "\n".join(lines)


def _spread(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.3g} | {min(values):.3g} - {max(values):.3g}"


def _ratios(repeats: Repeats) -> str:
    """Of costs a step, in the same repeat: what changes on the machine from repeat to repeat falls out.  And of the
    fastest repeats, for masters with threads of their own are slowed more by a busy machine."""
    lines = []

    def compare(slower: Contender | None, faster: Contender, sentence: str) -> None:
        if slower in repeats and faster in repeats:
            pairs = zip(repeats[slower], repeats[faster], strict=True)
            ratios = [a.step / b.step for a, b in pairs]
            fastest = min(run.step for run in repeats[slower]) / min(run.step for run in repeats[faster])
            lines.append(f"| {sentence.format(slower.name)} | {_spread(ratios)} | {fastest:.3g} |")

    native, python = (_best(repeats, peers) for peers in (contenders.PEERS, contenders.PEERS_PYTHON))
    compare(contenders.ORCH, contenders.LIMIT, "{}, native FMUs, to the same C in one function")
    compare(contenders.ORCH, contenders.ORCH_UNMEASURED, "{} with the metrics of the experiment to without any")
    compare(contenders.ORCH_UNMEASURED, contenders.ORCH_BARE, "{}, with the envelope to without it")
    compare(native, contenders.ORCH, "the best other master, {}, to orch, native FMUs")
    compare(native, contenders.ORCH_INTERPRETED, "the same to orch without its compiled loop")
    compare(python, contenders.ORCH_PYTHON, "the best other master, {}, to orch, Python FMUs")
    compare(python, contenders.ORCH_PYTHON_INTERPRETED, "the same to orch without its compiled loop")
    head = "| one step costs, times | median | range | fastest repeats |\n|---|---|---|---|\n"
    return head + "\n".join(lines)


def _best(repeats: Repeats, among: Sequence[Contender]) -> Contender | None:
    found = [contender for contender in among if contender in repeats]
    return min(found, key=lambda c: statistics.median(run.step for run in repeats[c]), default=None)


def _agreement(bench: Bench, usable: Sequence[Contender], h: float, steps: int, report: dict[str, Any]) -> str:
    """The last rows of the contenders beside those of orch in the same order of exchange."""
    ours = next((contender for contender in usable if contender.master == "orch"), None)
    if ours is None:
        return ""
    orders = ("gauss-seidel", "jacobi")
    by_order = {algorithm: bench.run(ours, h, steps, algorithm).final for algorithm in orders}
    lines = [
        f"The recorded signals at t = {steps * h:g} s, against {ours.name} on {ours.packaging} FMUs:\n",
        "| master | FMUs | order | equal, bit by bit | largest relative difference |",
        "|---|---|---|---|---|",
    ]
    report["agreement"] = []
    for contender in usable:
        if contender is ours:
            continue
        algorithm = "jacobi" if contender.master in ("libcosim", "ecos") else "gauss-seidel"
        final = bench.run(contender, h, steps).final
        signal, difference, equal = _compare(final, by_order[algorithm])
        where = f", {signal}" if difference else ""
        lines.append(
            f"| {contender.name} | {contender.fmus} | {algorithm} | {equal} of {len(final)} | {difference:.2g}{where} |"
        )
        report["agreement"].append(
            {
                "master": contender.name,
                "packaging": contender.packaging,
                "order": algorithm,
                "equal": equal,
                "of": len(final),
                "difference": difference,
                "signal": signal,
            }
        )
    signal, difference, _ = _compare(by_order["jacobi"], by_order["gauss-seidel"])
    lines.append(f"\n{WHY}  The order itself, jacobi or gauss-seidel, makes {difference:.2g}, {signal}.")
    return "\n".join(lines)


def _compare(values: Mapping[str, float], reference: Mapping[str, float]) -> tuple[str, float, int]:
    """The signal that differs most, by how much of the larger of the two, and how many are equal."""

    def difference(name: str) -> float:
        a, b = values[name], reference[name]
        return 0.0 if a == b else abs(a - b) / max(abs(a), abs(b)) if math.isfinite(a + b) else math.inf

    worst = max(reference, key=difference)
    return worst, difference(worst), sum(values[name] == reference[name] for name in reference)


def _raw(repeats: Repeats) -> list[dict[str, Any]]:
    return [
        {
            "master": contender.name,
            "packaging": contender.packaging,
            "steps": runs[0].steps,
            "step_us": [run.step for run in runs],
            "process_s": [run.whole for run in runs],
            "stepping_s": [run.stepping for run in runs],
        }
        for contender, runs in repeats.items()
    ]


if __name__ == "__main__":
    try:
        main()
    except (Unusable, OrchError) as reason:
        raise SystemExit(str(reason)) from None
