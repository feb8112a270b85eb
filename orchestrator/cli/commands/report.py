"""Commands that draw runs: figures and HTML pages."""

from __future__ import annotations

from pathlib import Path

import click

from ... import files
from .options import results_option

PAGE = "a report", (".html", ".htm")


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1, required=True)
@click.option("--output", "-o", metavar="FILE", help="PNG, PDF or SVG; default: beside the record, as .png")
@click.option("--signals", metavar="GLOB", multiple=True, help="Plot these signals over time instead of the overview.")
@click.option("--follow", is_flag=True, help="Draw again every second until the runs have ended.")
@results_option
def plot(runs: tuple[str, ...], output: str | None, signals: tuple[str, ...], follow: bool, results: str) -> None:
    """Draw runs: tracks, positions, errors, thrusters.  RUN: an id, a prefix of one, a file, or "last"."""
    from ...records.store.folder import Store
    from ...views import figures
    from ...views.figures import drawing

    store = Store(results)
    paths = [store.find(name) for name in runs]
    target = figures.target(output or paths[0].with_suffix(".png"), paths)
    for drawn in drawing.following(paths, target, signals) if follow else [drawing.draw_files(paths, target, signals)]:
        click.echo(f"{files.short(target)}: t = {drawn.time:.6g} s" if drawn.running else files.short(target))


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1)
@click.option("--sweep", metavar="SWEEP", help="Instead of runs: a sweep, its statistics and figures; its id, or last.")
@click.option("--output", "-o", metavar="FILE", help="The HTML file; default: beside the record, as .html")
@results_option
def report(runs: tuple[str, ...], sweep: str | None, output: str | None, results: str) -> None:
    """Write runs as one HTML page: replay, plots, metrics.  RUN: an id, a prefix of one, a file, or "last"."""
    if sweep is not None:
        if runs:
            raise click.UsageError("give either RUN or --sweep, not both")
        from ...studies.sweep.engine import table
        from ...studies.sweep.results import analysis, page

        read = table.find(results, sweep)
        target = files.target(output or (read.storage.local or Path()) / "report.html", *PAGE)
        click.echo(files.short(page.write(analysis.analyse(read), target)))
        return
    if not runs:
        raise click.UsageError("name the runs, or a --sweep")
    from ...records.store.folder import Store, open_run
    from ...views.report.page import write

    store = Store(results)
    paths = [store.find(name) for name in runs]
    target = files.target(output or paths[0].with_suffix(".html"), *PAGE, used=paths)
    click.echo(files.short(write([open_run(path) for path in paths], target)))
