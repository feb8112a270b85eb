"""The command that makes a page of runs."""

from __future__ import annotations

from pathlib import Path

import click

from ..options import results_option


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1, required=True)
@click.option("--output", "-o", metavar="FILE", help="The HTML file; default: beside the record, as .html")
@results_option
def report(runs: tuple[str, ...], output: str | None, results: str) -> None:
    """Write runs as one HTML page: replay, plots, metrics.  RUN: an id, a prefix of one, a file, or "last"."""
    from .. import show
    from ..report.page import write
    from ..store import Store, open_run

    store = Store(results)
    records = [open_run(store.find(name)) for name in runs]
    target = Path(output) if output else records[0].path.with_suffix(".html")
    click.echo(show.short(write(records, target)))
