"""The command that runs a record again."""

from __future__ import annotations

import click

from .options import results_option, tell


@click.command()
@click.argument("run", metavar="RUN")
@click.option("--verify", is_flag=True, help="Compare with the record, bit for bit, and keep nothing.")
@click.option("--force", is_flag=True, help="Run although the completed record is in the store.")
@results_option
def rerun(run: str, verify: bool, force: bool, results: str) -> int:
    """Run again what a record holds: from the record alone, its models built anew where they have changed.

    With --verify, exit code 0 where every bit of every signal is the same, 1 where one is not: then it says which
    signal differs first, when, and by how much.  RUN: an id, a prefix of one, a file, or "last".
    """
    from ...records.store.folder import open_run
    from ...runs import rerun as again
    from ...runs import runner
    from ..text import show

    with open_run(run, results) as record:
        plan = again.plan_of(record, tell)
        if not verify:
            result = runner.execute(plan, results=results, force=force, context=again.replay_of(record, plan))
            click.echo(show.result(result, plan))
            return 0 if result.status == "completed" else 3
        difference = again.verify(record, plan)
        if difference is None:
            click.echo(f"{record.run_id}: bit-identical, {len(record.signals)} signals of {len(record.time)} rows")
            return 0
        click.echo(f"{record.run_id}: differs\n{difference}")
        return 1
