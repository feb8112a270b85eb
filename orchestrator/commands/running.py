"""Commands that run experiments, or look whether they would."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ..errors import ExperimentError, OrchError
from ..options import (
    INTERRUPTED,
    changes_options,
    json_option,
    packaging_option,
    prepared,
    results_option,
    silent,
    tell,
)


@click.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@changes_options
@packaging_option
@click.option("--output", "-o", metavar="FILE.h5", help="Write exactly this file, not one in the store.")
@results_option
@click.option("--force", is_flag=True, help="Run again although the record is there.")
@click.option("--quiet", "-q", is_flag=True, help="Print nothing but errors.")
@json_option
def run(
    experiment: str,
    sets: tuple[str, ...],
    swaps: tuple[str, ...],
    packaging: str,
    output: str | None,
    results: str,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Run an experiment, or a SYSTEM.ssp, and record it."""
    from .. import show
    from ..progress import Progress
    from ..runner import execute

    told = silent if quiet or as_json else tell
    try:
        plan = prepared(experiment, sets, swaps, told, packaging)
        for note in plan.notes:
            told(f"note: {note}")
        progress = Progress(plan)
        try:
            result = execute(plan, output, results, force, [] if quiet or as_json else [progress])
        finally:
            progress.done()
    except OrchError as error:
        if as_json:
            click.echo(json.dumps(show.not_started(error)))
        raise
    if as_json:
        click.echo(json.dumps(show.result_as_json(result)))
    elif not quiet and result.status == "completed":
        click.echo(show.result(result, plan))
    for warning in result.warnings:
        told(f"warning: {warning}")
    if result.status == "completed":
        return 0
    click.echo(f"{result.file}: {result.error}", err=True)
    return 3 if result.status == "failed" else INTERRUPTED


@click.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@changes_options
@packaging_option
@click.option("--diagram", metavar="FILE", help="Also draw the system: .svg, or Mermaid as .mmd or .md.")
@json_option
def check(
    experiment: str, sets: tuple[str, ...], swaps: tuple[str, ...], packaging: str, diagram: str | None, as_json: bool
) -> None:  # fmt: skip
    """Find all problems of an experiment and its FMUs, and show the system; run nothing.

    \b
    orch check experiments/gripping_currents.toml --diagram system.svg
    orch check system.ssp
    """
    from .. import show

    try:
        plan = prepared(experiment, sets, swaps, silent if as_json else tell, packaging)
    except ExperimentError as error:
        if as_json:
            click.echo(json.dumps(show.problems_as_json(error)))
        raise
    if diagram is not None:
        from ..diagram import write

        write(plan, Path(diagram))
    click.echo(json.dumps(show.plan_as_json(plan)) if as_json else show.plan(plan))
    if diagram is not None and not as_json:
        click.echo(f"\n{show.short(Path(diagram))}")
