"""Commands that look at records."""

from __future__ import annotations

import json
from pathlib import Path

import click

from .options import json_option, results_option


@click.command()
@click.argument("run", metavar="RUN")
@results_option
@json_option
def show(run: str, results: str, as_json: bool) -> None:
    """Show a record: how it ended, what made it, metrics, warnings.  RUN: an id, a prefix, a file, or "last"."""
    from ...records.store.folder import open_run
    from ..text import show as shown

    with open_run(run, results) as record:
        click.echo(json.dumps(shown.record_as_json(record)) if as_json else shown.record(record))


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1, required=True)
@click.option("--output", "-o", metavar="FILE", help="PNG, PDF or SVG; default: beside the record, as .png")
@click.option("--signals", metavar="GLOB", multiple=True, help="Plot these signals over time instead of the overview.")
@click.option("--follow", is_flag=True, help="Draw again every second until the runs have ended.")
@results_option
def plot(runs: tuple[str, ...], output: str | None, signals: tuple[str, ...], follow: bool, results: str) -> None:
    """Draw runs: tracks, positions, errors, thrusters.  RUN: an id, a prefix of one, a file, or "last"."""
    from ...records.store.folder import Store
    from ...views.figures import figure
    from ..text import show

    store = Store(results)
    paths = [store.find(name) for name in runs]
    target = Path(output) if output else paths[0].with_suffix(".png")
    for drawn in figure.following(paths, target, signals) if follow else [figure.draw_files(paths, target, signals)]:
        click.echo(f"{show.short(target)}: t = {drawn.time:.6g} s" if drawn.running else show.short(target))
