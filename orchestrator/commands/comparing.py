"""The command that puts runs side by side."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ..options import json_option, results_option


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1, required=True)
@click.option("--metrics", "globs", metavar="GLOB", multiple=True, help="These metrics only, such as 'rmse_*'.")
@click.option("--format", "form", type=click.Choice(["table", "markdown", "csv", "latex"]),
              help="Default: what FILE's name ends in (.md, .csv, .tex), else table.")  # fmt: skip
@click.option("--output", "-o", metavar="FILE", help="Write the table here.")
@click.option("--plot", "figure", metavar="FILE", help="Also draw the runs over each other: PNG, PDF or SVG.")
@click.option("--signals", metavar="GLOB", multiple=True, help="Plot these signals instead of the overview.")
@results_option
@json_option
def compare(
    runs: tuple[str, ...], globs: tuple[str, ...], form: str | None, output: str | None, figure: str | None,
    signals: tuple[str, ...], results: str, as_json: bool,
) -> None:  # fmt: skip
    """Compare metrics of runs, and say what tells the runs apart.

    RUN: an id, a prefix of one, a file, "last", or a glob over files or run ids, in quotes.

    \b
    orch compare 4abd4627e7 last --plot both.png
    orch compare 'results/gripping*/*.h5' --metrics 'rmse_*' -o table.tex

    The best is the number nearest to zero among completed runs, at the four digits of the tables: of errors (rmse, rms,
    iae, ise, itae, max_abs, overshoot, and final with a reference), times (settling_time, convergence_time) and effort
    (total_variation, energy, mean_power).  Nothing is best of distance, heading_difference, and final without a
    reference, nor where all runs are equal.  A run without a metric has an empty cell there.

    Where there are more metrics than runs, the runs stand beside each other; CSV always has one line a run, in full
    precision.  LaTeX is for booktabs and siunitx.
    """
    from .. import compare as comparing
    from .. import compare_tables, show
    from ..errors import StoreError
    from ..store import Store

    if signals and not figure:
        raise click.UsageError("--signals says what to draw: give --plot FILE, too")
    paths = comparing.find(Store(results), runs)
    targets = [Path(name) for name in (output, figure) if name]
    for target in targets:
        if target.resolve() in [path.resolve() for path in paths]:
            raise StoreError(f"{target} is one of the runs; write to another file")
    comparison = comparing.compare(paths, globs)
    form = form or compare_tables.SUFFIXES.get(Path(output or "").suffix.lower(), "table")
    text = compare_tables.FORMATS[form](comparison)
    if output:
        compare_tables.save(Path(output), text)
    if figure:
        from .. import plots

        plots.draw_files(paths, Path(figure), signals)
    if as_json:
        click.echo(json.dumps(comparing.as_json(comparison)))
        return
    lines = [show.short(target) for target in targets] if output else [text, *map(show.short, targets)]
    click.echo("\n".join(lines))
