"""Commands that run an experiment, or a thesis of them, many times."""

from __future__ import annotations

import json
from pathlib import Path

import click

from .options import changes_options, json_option, prepared, results_option, silent, tell


@click.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@click.option("--steps", metavar="S,S,...", help="Communication steps [s]; default: 4, 2, 1 and 1/2 times its own.")
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
    """Run an experiment at several steps: is the result converged?  Exit code 1 where it is not.

    \b
    orch converge experiments/spiral_pid.toml
    orch converge experiments/spiral_pid.toml --swap controller=mfsosmc --steps 1e-3,5e-4,2.5e-4
    """
    from ... import metrics
    from ...studies import convergence as study
    from ..text import show

    plan = prepared(experiment, sets, swaps, silent if as_json else tell)
    try:
        chosen = [float(step) for step in steps.split(",")] if steps else study.default_steps(plan)
    except ValueError:
        raise click.UsageError(f"--steps {steps}: write numbers of seconds, such as --steps 1e-3,5e-4,2.5e-4") from None
    arguments = [experiment, "--results", results]
    arguments += [word for text in sets for word in ("--set", text)] + [w for text in swaps for w in ("--swap", text)]
    units = {f"{component}.{variable.name}": variable.unit for component, variable in plan.recorded}
    names = {name: metrics.unit_of(spec, units) for name, spec in plan.experiment.metrics.items()}
    found = study.study(plan, chosen, arguments, names, silent if as_json else tell)
    figure = study.draw(found, Path(output) if output else Path(results) / "_converge" / f"{found.experiment}.png")
    click.echo(json.dumps(study.as_json(found)) if as_json else f"{study.report(found)}\n{show.short(figure)}")
    return 0 if found.converged else 1


@click.command(
    epilog="Example: orch reproduce thesis --only 5.2 --only fig5.57.  Exit code 1: a number lies outside its band."
)
@click.argument("what", metavar="thesis", type=click.Choice(["thesis"]))
@click.option(
    "--only",
    metavar="TABLE|FIGURE",
    multiple=True,
    help="Do what this needs, such as 5.2 (the table), fig5.2, 5.57, claims, steps.",
)
@click.option("--quick", is_flag=True, help="Coarser steps, and no step study.")
@results_option
def reproduce(what: str, only: tuple[str, ...], quick: bool, results: str) -> int:
    """Rebuild every table, claim and figure of the thesis in DIR/_thesis, each number against the published one.

    Runs that the store has are not repeated, figures whose runs have not changed are not redrawn.
    """
    from ...studies.thesis import reproduce as thesis
    from ..text import show

    outcome = thesis.reproduce(only, quick, results, tell)
    click.echo(thesis.report(outcome, show.short(outcome.folder)))
    return 1 if outcome.outside else 0
