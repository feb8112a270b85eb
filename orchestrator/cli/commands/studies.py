"""Commands in which many runs answer one question: convergence, the thesis, sweeps and the tuning of controllers."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import click

from ... import files
from ...watch import INTERRUPTED
from .options import (
    changes_options,
    json_option,
    packaging_option,
    pairs,
    results_option,
    silent,
    swaps_of,
    to_stderr,
)


@click.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@click.option(
    "--steps", metavar="S,S,...", help="Communication steps [s]; default: 4, 2, 1, 1/2 times the experiment's."
)
@changes_options
@click.option("--output", "-o", metavar="FILE", help="The figure; default: RESULTS/_converge/EXPERIMENT.png")
@results_option
@json_option
def converge(
    experiment: str,
    steps: str | None,
    sets: tuple[str, ...],
    swaps: tuple[str, ...],
    output: str | None,
    results: str,
    as_json: bool,
) -> int:
    """Run an experiment at several steps: is its result converged?  Exit code 1 where it is not.

    \b
    orch converge experiments/spiral_pid.toml
    orch converge experiments/spiral_pid.toml --swap controller=mfsosmc --steps 1e-3,5e-4,2.5e-4
    """
    from ...studies import convergence
    from ...views import figures

    target = figures.target(output or Path(results) / "_converge" / f"{Path(experiment).stem}.png", [experiment])
    try:
        chosen = [float(step) for step in steps.split(",")] if steps else []
    except ValueError:
        raise click.UsageError(f"--steps {steps}: write numbers of seconds, such as --steps 1e-3,5e-4,2.5e-4") from None
    changes = pairs("--set", sets), swaps_of(swaps)
    study = convergence.study(experiment, chosen, *changes, results, silent if as_json else to_stderr)
    convergence.draw(study, target)
    text = f"{convergence.report(study)}\n{files.short(target)}"
    click.echo(json.dumps(convergence.as_json(study)) if as_json else text)
    return 0 if study.converged else 1


@click.command(
    epilog="Example: orch reproduce thesis --only 5.2 --only fig5.57.  Exit code 1: a number lies outside its band."
)
@click.argument("what", metavar="thesis", type=click.Choice(["thesis"]))
@click.option(
    "--only",
    metavar="TABLE|FIGURE",
    multiple=True,
    help="Only this: 5.2 (a table), fig5.2, 5.57, claims, steps.  Repeatable.",
)
@click.option("--quick", is_flag=True, help="Coarser steps, and no step study.")
@results_option
def reproduce(what: str, only: tuple[str, ...], quick: bool, results: str) -> int:
    """Rebuild every table, claim and figure of the thesis in DIR/_thesis, each number against the published one.

    Runs that the store has are not repeated, figures whose runs have not changed are not redrawn.
    """
    from ...studies.thesis import reproduce as thesis
    from ...studies.thesis.pages import summary

    reproduction = thesis.reproduce(only, quick, results, to_stderr)
    click.echo(summary.text(reproduction, files.short(reproduction.folder)))
    return 1 if reproduction.outside else 0


@click.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@changes_options
@packaging_option
@click.option("--dry-run", is_flag=True, help="Print the table of runs; run nothing.")
@click.option(
    "--workers", type=click.IntRange(min=1), metavar="N", help="Processes on this machine; default: one a core."
)
@click.option("--scheduler", metavar="ADDRESS", help="Run on the cluster of this Dask scheduler instead of here.")
@click.option("--fail-fast", is_flag=True, help="Stop at the first run that fails.")
@results_option
@json_option
def sweep(
    experiment: str,
    sets: tuple[str, ...],
    swaps: tuple[str, ...],
    packaging: str,
    dry_run: bool,
    workers: int | None,
    scheduler: str | None,
    fail_fast: bool,
    results: str,
    as_json: bool,
) -> int:
    """Run an experiment many times, as its [sweep] says; completed runs are not repeated.

    \b
    orch sweep experiments/sweep_currents.toml --dry-run
    orch sweep experiments/sweep_currents.toml --set sweep.draws=20
    orch sweep experiments/sweep_currents.toml --scheduler tcp://10.0.0.1:8786 --results /shared/results
    orch compare --sweep last

    The records, the table and the FMUs lie in DIR/EXPERIMENT-SWEEP; DIR may be a folder that the workers share, or an
    fsspec URL.  Exit code 3: a run failed, and the table says which.
    """
    from ...studies.sweep.design.prepared import prepare
    from ..text import sweep as listing

    report = silent if as_json else to_stderr
    prepared = prepare(experiment, pairs("--set", sets), swaps_of(swaps), packaging, report)
    for note in prepared.notes:
        report(f"note: {note}")
    if dry_run:
        click.echo(json.dumps(listing.design_as_json(prepared)) if as_json else listing.design(prepared))
        return 0
    from ...runs.progress import ProgressLine
    from ...studies.progress import show_runs
    from ...studies.sweep.engine import scheduler as engine

    with ProgressLine(as_json) as line:
        result = engine.sweep(prepared, results, scheduler, workers, fail_fast, partial(show_runs, line))
    click.echo(json.dumps(listing.swept_as_json(result)) if as_json else listing.swept(result))
    if result.interrupted:
        report("interrupted; the same command runs what is missing")
        return INTERRUPTED
    return 3 if result.count("failed") else 0


@click.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@changes_options
@packaging_option
@click.option(
    "--workers", type=click.IntRange(min=1), metavar="N", help="Processes on this machine; default: one a core."
)
@click.option("--scheduler", metavar="ADDRESS", help="Run on the cluster of this Dask scheduler instead of here.")
@results_option
@json_option
def tune(
    experiment: str,
    sets: tuple[str, ...],
    swaps: tuple[str, ...],
    packaging: str,
    workers: int | None,
    scheduler: str | None,
    results: str,
    as_json: bool,
) -> int:
    """Search the parameters of controllers, as [sweep.tune] says, and compare them on draws that they have not seen.

    \b
    orch tune experiments/sweep_currents.toml
    orch tune experiments/sweep_currents.toml --set sweep.tune.trials=100

    Every controller gets the same number of trials on the same draws.  The study lies in DIR/_tune; it continues where
    it was interrupted, or with more trials.  Beside it lie the tuned parameters, as TOML for an experiment or a sweep.
    """
    from ...runs.progress import ProgressLine
    from ...studies.progress import TrialProgress, show_runs
    from ...studies.sweep.tuning import optimizer as tuning
    from ..text import sweep as listing

    report = silent if as_json else to_stderr
    with ProgressLine(as_json) as line:
        result = tuning.tune(
            experiment,
            pairs("--set", sets),
            swaps_of(swaps),
            packaging,
            results,
            scheduler,
            workers,
            report,
            TrialProgress(line),
            partial(show_runs, line),
        )
    click.echo(json.dumps(listing.tuned_as_json(result)) if as_json else listing.tuned(result))
    if result.final is None or result.final.interrupted:
        report("interrupted; the same command continues")
        return INTERRUPTED
    return 3 if result.final.count("failed") else 0
