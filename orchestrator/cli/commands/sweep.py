"""Commands that run an experiment many times: a sweep over a design, and the search for parameters."""

from __future__ import annotations

import json

import click

from .options import (
    INTERRUPTED,
    changes_options,
    json_option,
    packaging_option,
    pairs,
    results_option,
    silent,
    swaps_of,
    tell,
)


@click.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@changes_options
@packaging_option
@click.option("--dry-run", is_flag=True, help="Print the table of runs; run nothing.")
@click.option("--workers", type=click.IntRange(min=1), metavar="N", help="Processes here; default: one a core.")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask scheduler: run on its cluster, not here.")
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
    """Run an experiment many times, as its [sweep] says; runs that are there are not repeated.

    \b
    orch sweep experiments/sweep_currents.toml --dry-run
    orch sweep experiments/sweep_currents.toml --set sweep.draws=20
    orch sweep experiments/sweep_currents.toml --scheduler tcp://10.0.0.1:8786 --results /shared/results
    orch compare --sweep last

    The records, the table and the FMUs lie in DIR/EXPERIMENT-SWEEP; DIR may be a folder that the workers share, or an
    fsspec URL.  Exit code 3: a run failed, and the table says which.
    """
    from ...studies.sweep.design import study
    from ..text import sweep as listing

    told = silent if as_json else tell
    made = study.prepare(experiment, pairs("--set", sets), swaps_of(swaps), packaging, told)
    for note in made.notes:
        told(f"note: {note}")
    if dry_run:
        click.echo(json.dumps(listing.design_as_json(made)) if as_json else listing.design(made))
        return 0
    from ...studies.sweep.engine import scheduler as engine
    from ...studies.sweep.engine.progress import Progress

    progress = Progress(quiet=as_json)
    try:
        ended = engine.sweep(made, results, scheduler, workers, fail_fast, progress)
    finally:
        progress.done()
    click.echo(json.dumps(listing.ended_as_json(ended)) if as_json else listing.ended(ended))
    if ended.interrupted:
        told("interrupted; the same command runs what is missing")
        return INTERRUPTED
    return 3 if ended.count("failed") else 0


@click.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@changes_options
@packaging_option
@click.option("--workers", type=click.IntRange(min=1), metavar="N", help="Processes here; default: one a core.")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask scheduler: run on its cluster, not here.")
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

    Every controller gets the same number of trials on the same draws.  The study lies in DIR/_tune and goes on where it
    was interrupted, or with more trials; beside it the tuned parameters, as TOML for an experiment or a sweep.
    """
    from ...studies.sweep.engine.progress import Progress, Trials
    from ...studies.sweep.tuning import optimizer as tuning
    from ..text import sweep as listing

    told = silent if as_json else tell
    trials, progress = Trials(quiet=as_json), Progress(quiet=as_json)
    try:
        outcome = tuning.tune(
            experiment,
            pairs("--set", sets),
            swaps_of(swaps),
            packaging,
            results,
            scheduler,
            workers,
            told,
            trials,
            progress,
        )
    finally:
        trials.done()
        progress.done()
    click.echo(json.dumps(listing.tuned_as_json(outcome)) if as_json else listing.tuned(outcome))
    if outcome.final is None or outcome.final.interrupted:
        told("interrupted; the same command goes on")
        return INTERRUPTED
    return 3 if outcome.final.count("failed") else 0
