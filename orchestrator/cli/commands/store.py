"""Commands over the store: list records, show one, delete some."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ... import files
from ...errors import OrchError
from .options import json_option, results_option, to_stderr


def filter_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """--experiment, --status, --since, --before and --where."""
    for option, metavar, text in reversed(
        (
            ("--experiment", "GLOB", "Runs of these experiments."),
            ("--status", "GLOB", "Runs that are completed, failed, interrupted*, running or corrupt."),
            ("--since", "TIME", "Created since a date, or an age: 2h, 3d, 1w."),
            ("--before", "TIME", "Created before a date, or an age."),
            ("--where", "EXPRESSION", "Runs for which this is true."),
        )
    ):
        command = click.option(option, metavar=metavar, default="", help=text)(command)
    return command


@click.command("list")
@filter_options
@click.option("--sort", metavar="NAME", default="", help="Sort by this name; default: newest first.")
@click.option("--reverse", is_flag=True, help="In reverse order.")
@click.option("--limit", type=click.IntRange(min=1), metavar="N", help="N runs at most.")
@click.option("--columns", metavar="NAME,...", default="", help="Also show these: metrics.rmse_x1, wall_time, ...")
@click.option("--csv", "as_csv", is_flag=True, help="Comma-separated values, at full precision.")
@results_option
@json_option
def list_(
    experiment: str,
    status: str,
    since: str,
    before: str,
    where: str,
    sort: str,
    reverse: bool,
    limit: int | None,
    columns: str,
    as_csv: bool,
    results: str,
    as_json: bool,
) -> None:
    """List the runs of the store.

    \b
    orch list --since 3d --columns metrics.rmse_x1 --sort metrics.rmse_x1
    orch list --where "components.controller.fmu == 'pid' and metrics.rmse_x < 0.2"
    orch list --where "components.vehicle.parameters.eta_0.z > 1 and not status == 'failed'"

    A dagger marks runs that ended early or warned that their numbers are wrong; `marks` says which.

    Names: run_id, experiment, title, status, marks, created, wall_time, seed, git_commit, ..., components.NAME.fmu,
    components.NAME.parameters.X, master.step, metrics.NAME, versions.PACKAGE.  The expression knows and, or, not, ==,
    !=, <, <=, >, >=, in [...] and like 'glob*'.
    """
    from ...records.store import filters as listing
    from ...views.tables.terminal import table, tied, wrapped

    filters = listing.Filters(experiment=experiment, status=status, since=since, before=before, where=where)
    runs = listing.choose(Path(results), filters)
    runs = listing.ordered(runs, sort, reverse) if sort else runs if reverse else runs[::-1]
    runs = runs[:limit]
    shown = [*listing.COLUMNS, *(name.strip() for name in columns.split(",") if name.strip())]
    if as_json:
        click.echo(json.dumps([dict(run) for run in runs]))
    elif as_csv:
        click.echo(listing.as_csv(runs, [*shown, listing.MARKS, "file"]), nl=False)
    elif runs:
        rows = listing.table(runs, shown)
        whole = [i for i, name in enumerate(shown) if name not in ("title", "error", "command")]
        cells = [[tied(cell) if i in whole else cell for i, cell in enumerate(row)] for row in rows[1:]]
        click.echo("\n".join([*table([rows[0], *cells]), *filter(None, [wrapped(listing.footnote(runs))])]))
    else:
        to_stderr(
            f"no run in {results}" + (" passes the filters" if any((experiment, status, since, before, where)) else "")
        )


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
@filter_options
@click.option("--yes", is_flag=True, help="Delete; without it, only list what would be deleted.")
@results_option
def prune(experiment: str, status: str, since: str, before: str, where: str, yes: bool, results: str) -> None:
    """List the records that pass the filters, or with --yes delete them.  Those of running runs are kept.

    \b
    orch prune --status failed --before 4w
    orch prune --where "master.step > 0.001" --yes
    """
    from ...records.store import filters as listing
    from ...records.store.prune import NotDeleted, delete

    filters = listing.Filters(experiment=experiment, status=status, since=since, before=before, where=where)
    if not filters:
        raise OrchError("give a filter, such as --status failed: prune deletes what passes its filters")
    passes = listing.passing(filters)
    deleted, kept = [], []
    for run in listing.choose(Path(results), filters):
        if run["status"] == "running":
            continue
        path = Path(run["file"])
        try:
            if yes:
                delete(path, passes)
        except NotDeleted as error:
            kept.append(f"{files.short(path)} is kept: {error}")
        else:
            deleted.append(run)
            click.echo(f"{files.short(path)}  {run['status']}")
    size = sum(run["bytes"] for run in deleted) / 1e6
    what = "1 record" if len(deleted) == 1 else f"{len(deleted)} records"
    to_stderr(
        f"{what}, {size:.1f} MB: deleted" if yes else f"{what}, {size:.1f} MB, would be deleted; --yes deletes them"
    )
    if kept:
        raise OrchError("\n".join(kept))
