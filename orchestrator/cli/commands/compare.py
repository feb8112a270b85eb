"""Commands that compare runs."""

from __future__ import annotations

import json
from pathlib import Path

import click

from .options import json_option, results_option, tell


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1)
@click.option("--sweep", "sweep", metavar="SWEEP", help="Instead: the values of a list of this sweep; an id, or last.")
@click.option("--by", metavar="KEY", default="", help="The list of the sweep whose values compete; default: its first.")
@click.option("--pairs/--no-pairs", default=True, help="With or without the comparisons of every two, of a sweep.")
@click.option("--metrics", "globs", metavar="GLOB", multiple=True, help="These metrics only, such as 'rmse_*'.")
@click.option(
    "--format",
    "form",
    type=click.Choice(["table", "markdown", "csv", "latex"]),
    help="Default: what FILE's name ends in (.md, .csv, .tex), else table.",
)
@click.option("--output", "-o", metavar="FILE", help="Write the table here.")
@click.option("--plot", "figure", metavar="FILE", help="Also draw the runs over each other: PNG, PDF or SVG.")
@click.option("--signals", metavar="GLOB", multiple=True, help="Plot these signals instead of the overview.")
@click.option(
    "--kind",
    type=click.Choice(["box", "violin", "ecdf", "heatmap", "parallel"]),
    default="box",
    show_default=True,
    help="Of the plot of a sweep.",
)
@click.option("--over", metavar="KEY", multiple=True, help="The two factors of a sweep that a heat map is over.")
@results_option
@json_option
def compare(
    runs: tuple[str, ...],
    sweep: str | None,
    by: str,
    pairs: bool,
    globs: tuple[str, ...],
    form: str | None,
    output: str | None,
    figure: str | None,
    signals: tuple[str, ...],
    kind: str,
    over: tuple[str, ...],
    results: str,
    as_json: bool,
) -> None:
    """Compare metrics of runs, and say what tells the runs apart.

    RUN: an id, a prefix of one, a file, "last", or a glob over files or run ids, in quotes.

    \b
    orch compare 4abd4627e7 last --plot both.png
    orch compare 'results/gripping*/*.h5' --metrics 'rmse_*' -o table.tex
    orch compare --sweep last --metrics 'rmse_*' -o table.md
    orch compare --sweep last --plot winds.png --kind heatmap --over velocity.x --over velocity.y

    The best is the number nearest to zero among completed runs, at the four digits of the tables: of errors (rmse, rms,
    iae, ise, itae, max_abs, overshoot, and final with a reference), times (settling_time, convergence_time) and effort
    (total_variation, energy, mean_power).  Nothing is best of distance, heading_difference, and final without a
    reference, nor where all runs are equal.  A run without a metric has an empty cell there.

    Where there are more metrics than runs, the runs stand beside each other; CSV always has one line a run, in full
    precision.  LaTeX is for booktabs and siunitx.

    Of a sweep: mean, standard deviation, median and 95 % bootstrap interval of each contender; every two of them draw
    by draw, by Wilcoxon's signed-rank test, Holm-corrected, with the rank-biserial correlation as effect size.
    """
    if sweep is not None:
        if runs or signals:
            raise click.UsageError("--sweep compares the runs of a sweep: give neither RUN nor --signals")
        _compare_sweep(sweep, by, pairs, globs, form, output, figure, kind, over, results, as_json)
        return
    if not runs:
        raise click.UsageError("say which runs, or which --sweep")
    from ...errors import StoreError
    from ...records.compare import side_by_side as comparing
    from ...records.store.folder import Store
    from ...views.tables import comparison as compare_tables
    from ..text import show

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
        from ...views.figures import figure as figures

        figures.draw_files(paths, Path(figure), signals)
    if as_json:
        click.echo(json.dumps(comparing.as_json(comparison)))
        return
    lines = [show.short(target) for target in targets] if output else [text, *map(show.short, targets)]
    click.echo("\n".join(lines))


def _compare_sweep(
    sweep: str,
    by: str,
    pairs: bool,
    globs: tuple[str, ...],
    form: str | None,
    output: str | None,
    figure: str | None,
    kind: str,
    over: tuple[str, ...],
    results: str,
    as_json: bool,
) -> None:
    from ...studies.sweep.engine import table
    from ...studies.sweep.results import analysis, tables
    from ...views.tables import comparison as compare_tables
    from ..text import show

    found = analysis.analyse(table.find(results, sweep), globs, by)
    form = form or compare_tables.SUFFIXES.get(Path(output or "").suffix.lower(), "table")
    text = tables.FORMATS[form](found, pairs)
    if output:
        compare_tables.save(Path(output), text)
    if figure:
        from ...studies.sweep.results import figures

        figures.draw(found, Path(figure), kind, over)
    if as_json:
        click.echo(json.dumps(analysis.as_json(found)))
        return
    targets = [Path(name) for name in (output, figure) if name]
    lines = [show.short(target) for target in targets] if output else [text, *map(show.short, targets)]
    click.echo("\n".join(lines))


@click.command()
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@results_option
@json_option
def diff(a: str, b: str, results: str, as_json: bool) -> int:
    """What differs between two records: parameters, FMUs, versions, metrics; nothing that is the same.

    Exit code 0 where nothing differs that decides the numbers, that is, the digests are the same; else 1.
    """
    from ...records.compare import diff as changes
    from ...records.store.folder import open_run
    from ...views.tables.terminal import columns_of

    with open_run(a, results) as first, open_run(b, results) as second:
        found = changes.changes(first, second)
        names = first.run_id, second.run_id
        same = first.attributes["digest"] == second.attributes["digest"]
    if as_json:
        click.echo(json.dumps([change.__dict__ for change in found]))
    elif found:
        click.echo("\n".join(columns_of([("", *names, "by"), *changes.rows(found)])))
    elif same:
        tell("nothing differs but clocks")
    if not same and not any(change.decides for change in found):
        tell("their digests differ, and with them something that decides the numbers")
    return 0 if same else 1
