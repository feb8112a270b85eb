"""Commands that compare runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from ... import files
from .options import json_option, results_option, to_stderr


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1)
@click.option(
    "--sweep", "sweep", metavar="SWEEP", help="Instead of runs, compare the contenders of this sweep: its id, or last."
)
@click.option(
    "--by", metavar="KEY", default="", help="Of a sweep: the key whose values compete; default: its first list."
)
@click.option("--pairs/--no-pairs", default=True, help="Of a sweep: with or without comparisons of pairs.")
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
    help="Of a sweep: what --plot draws.",
)
@click.option("--over", metavar="KEY", multiple=True, help="Of a sweep: the two factors of a heat map.")
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
    """Compare the metrics of runs, and show how the runs differ.

    RUN: an id, a prefix of one, a file, "last", or a glob over files or run ids, in quotes.

    \b
    orch compare 4abd4627e7 last --plot both.png
    orch compare 'results/gripping*/*.h5' --metrics 'rmse_*' -o table.tex
    orch compare --sweep last --metrics 'rmse_*' -o table.md
    orch compare --sweep last --plot winds.png --kind heatmap --over velocity.x --over velocity.y

    The best is the number nearest to zero, at the four digits of the tables: of errors (rmse, rms, iae, ise, itae,
    max_abs, overshoot, and final with a reference), times (settling_time, convergence_time) and effort
    (total_variation, energy, mean_power).  Nothing is best of distance, heading_difference, and final without a
    reference, nor where all runs are equal.  A dagger marks numbers that are not compared: of a run that did not
    complete, that an FMU ended early, or that warned that its numbers are wrong.  Runs have no best metric if their
    step, window or definition of it is not the same, or if one of them goes on from another checkpoint.  A run without
    a metric has an empty cell there.

    Where there are more metrics than runs, the runs stand beside each other; CSV always has one line a run, in full
    precision.  LaTeX is for booktabs and siunitx.

    Of a sweep: mean, standard deviation, median and 95 % bootstrap interval of each contender, and in how many draws it
    has a number; each pair of them, draw by draw, by Wilcoxon's signed-rank test, Holm-corrected, with the
    rank-biserial correlation as effect size.  docs/sweeps.md says what is compared and what is not.
    """
    if sweep is not None:
        if runs or signals:
            raise click.UsageError("--sweep compares the runs of a sweep: give neither RUN nor --signals")
        _compare_sweep(sweep, by, pairs, globs, form, output, figure, kind, over, results, as_json)
        return
    if not runs:
        raise click.UsageError("name the runs, or a --sweep")
    from ...records.compare import side_by_side as comparing
    from ...records.store.folder import Store
    from ...views.tables import comparison as compare_tables

    if signals and not figure:
        raise click.UsageError("--signals chooses what --plot draws: add --plot FILE")
    paths = comparing.find(Store(results), runs)
    table, picture = _targets(output, figure, paths)
    comparison = comparing.compare(paths, globs)
    text = compare_tables.FORMATS[_form(form, table)](comparison)
    if picture:
        from ...views.figures import drawing

        drawing.draw_files(paths, picture, signals)
    _answer(text, comparing.as_json(comparison), table, picture, as_json)


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
    from ...studies.sweep.engine import table as sweeps
    from ...studies.sweep.results import analysis, tables

    read = sweeps.find(results, sweep)
    used = [read.storage.local / name for name in (sweeps.TABLE, sweeps.DESCRIPTION)] if read.storage.local else []
    table, picture = _targets(output, figure, used)
    analysed = analysis.analyse(read, globs, by)
    text = tables.FORMATS[_form(form, table)](analysed, pairs)
    if picture:
        from ...studies.sweep.results import figures

        figures.draw(analysed, picture, kind, over)
    _answer(text, analysis.as_json(analysed), table, picture, as_json)


def _targets(output: str | None, figure: str | None, used: Sequence[Path]) -> tuple[Path | None, Path | None]:
    """The files of --output and --plot."""
    from ...views import figures

    table = files.target(output, used=used) if output else None
    return table, figures.target(figure, [*used, *([table] if table else [])]) if figure else None


def _form(form: str | None, table: Path | None) -> str:
    from ...views.tables.comparison import SUFFIXES

    return form or SUFFIXES.get(table.suffix.lower() if table else "", "table")


def _answer(text: str, data: dict[str, Any], table: Path | None, picture: Path | None, as_json: bool) -> None:
    """Write or print the text; with --json, print the data."""
    if table:
        files.write_text(table, f"{text}\n")
    if as_json:
        click.echo(json.dumps(data))
        return
    click.echo("\n".join([*([] if table else [text]), *(files.short(target) for target in (table, picture) if target)]))


@click.command()
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@results_option
@json_option
def diff(a: str, b: str, results: str, as_json: bool) -> int:
    """Show what differs between two records: parameters, FMUs, versions, metrics.

    Exit code 0 where the digests are the same, that is, nothing differs that decides the numbers; else 1.
    """
    from ...records.compare import diff as comparing
    from ...records.store.folder import open_run
    from ...views.tables.terminal import table

    with open_run(a, results) as first, open_run(b, results) as second:
        changes = comparing.changes(first, second)
        names = first.run_id, second.run_id
        same = first.attributes["digest"] == second.attributes["digest"]
    if as_json:
        click.echo(json.dumps([change.__dict__ for change in changes]))
    elif changes:
        click.echo("\n".join(table([("", *names, "by"), *comparing.rows(changes)])))
    elif same:
        to_stderr("nothing differs but what is read from clocks")
    if not same and not any(change.decides for change in changes):
        to_stderr("the digests differ: something that decides the numbers is not the same, and is not listed")
    return 0 if same else 1
