"""Commands that run an experiment, repeat a record, or check whether an experiment would run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ... import files
from ...errors import ExperimentError, OrchError
from ...warning import printed
from .options import (
    EXIT_CODES,
    changes_options,
    json_option,
    live_of,
    live_options,
    packaging_option,
    prepared,
    results_option,
    silent,
    to_stderr,
)


@click.command(
    epilog="""\b
Examples:
  orch run experiments/gripping_currents.toml
  orch run experiments/spiral_pid.toml --set master.stop_time=10 --swap controller=mfsosmc
  orch run experiments/gripping_currents.toml --realtime --mavlink udpout:127.0.0.1:14550
  orch run experiments/gripping_currents.toml --realtime 2 --mavlink 1=tcpin:127.0.0.1:5760
  orch run experiments/spiral_pid.toml --checkpoint-at 12
  orch run --from results/spiral_pid/3f9a2c1d5e.at-12.checkpoint --swap controller=mfsosmc
"""
)
@click.argument("experiment", metavar="EXPERIMENT.toml", required=False)
@changes_options
@packaging_option
@click.option("--output", "-o", metavar="FILE.h5", help="Write exactly this file, not one in the store.")
@results_option
@click.option("--force", is_flag=True, help="Run again although the store has the completed record.")
@click.option(
    "--checkpoint-at",
    "times",
    metavar="T",
    type=float,
    multiple=True,
    help="Save a checkpoint at T seconds, beside the record.  Repeatable.",
)
@click.option(
    "--from",
    "start",
    metavar="CHECKPOINT",
    help="Continue from a checkpoint; components that --swap names are reinitialized.",
)
@click.option("--tlog", metavar="FILE", help="Also write the run as a telemetry log.")
@click.option("--quiet", "-q", is_flag=True, help="Print nothing but errors.")
@live_options
@json_option
def run(
    experiment: str | None,
    sets: tuple[str, ...],
    swaps: tuple[str, ...],
    packaging: str,
    output: str | None,
    results: str,
    force: bool,
    times: tuple[float, ...],
    start: str | None,
    tlog: str | None,
    quiet: bool,
    as_json: bool,
    **live: Any,
) -> int:
    """Run an experiment, or a SYSTEM.ssp, and record it."""
    from ...records.file.run import Run
    from ...runs.checkpoint.observer import ticks_of
    from ...runs.progress import ProgressLine, RunProgress
    from ...runs.runner import execute
    from ...views import export as exporting
    from ..text import show

    report = silent if quiet or as_json else to_stderr
    experiment, asked = live_of("" if experiment is None and start else experiment, **live)
    used = [file for file in (experiment, start) if file]
    try:
        if output is not None:
            files.target(output, used=used)
        if tlog is not None:
            exporting.require("tlog")
            files.target(tlog, used=[*used, *([output] if output else [])])
        plan = prepared(experiment or None, sets, swaps, report, packaging, start)
        if tlog is not None:
            from ...views.export import as_tlog

            as_tlog.check(plan)  # its problems are reported before the run
        ticks = ticks_of(plan, times)
        for note in plan.notes:
            report(f"note: {note}")
        with asked.tied(plan) as ties, ProgressLine(quiet or as_json) as line:
            again = force or bool(ties.observers)
            observers = [RunProgress(plan, line), *ties.observers]
            result = execute(ties.plan, output, results, again, observers, ties.context, ticks)
        for note in asked.notes:
            report(f"note: {note}")
    except OrchError as error:
        if as_json:
            click.echo(json.dumps(show.not_started(error)))
        raise
    if as_json:
        click.echo(json.dumps(show.result_as_json(result)))
    elif not quiet and result.status == "completed":
        click.echo(show.result(result, plan))
    for warning in result.warnings:
        report(printed(warning))
    if result.status != "completed":
        click.echo(f"{result.file}: {result.error}", err=True)
    if result.last_inputs:
        report(show.last_inputs(result))
    if tlog is not None:
        with Run(result.file) as record:
            if len(record.time):  # else the run failed at once, which is reported above
                exporting.export(record, "tlog", Path(tlog))
    return EXIT_CODES[result.status]


@click.command()
@click.argument("run", metavar="RUN")
@click.option("--verify", is_flag=True, help="Compare with the record, bit for bit, and keep nothing.")
@click.option("--force", is_flag=True, help="Run again although the store has the completed record.")
@results_option
def rerun(run: str, verify: bool, force: bool, results: str) -> int:
    """Repeat the run of a record, from the record alone; models that have changed are built again.

    With --verify, exit code 0 where every bit of every signal is the same, else 1: then it says which signal differs
    first, when, and by how much, or that the record has no rows to compare.  RUN: an id, a prefix of one, a file, or
    "last".
    """
    from ...records.store.folder import open_run
    from ...runs import rerun as again
    from ...runs import runner
    from ..text import show

    with open_run(run, results) as record:
        plan = again.plan_of(record, to_stderr)
        if not verify:
            result = runner.execute(plan, results=results, force=force, context=again.replay_of(record, plan))
            click.echo(show.result(result, plan))
            if result.status != "completed":
                click.echo(f"{result.file}: {result.error}", err=True)
            return EXIT_CODES[result.status]
        difference = again.verify(record, plan)
        if difference is None and record.status == "failed" and not len(record.time):
            again_so = f"the run failed again in the same way: {record.attributes['error']}"
            click.echo(f"{record.run_id}: has no rows to compare; {again_so}")
            return 1
        if difference is None:
            click.echo(f"{record.run_id}: bit-identical, {len(record.signals)} signals of {len(record.time)} rows")
            return 0
        click.echo(f"{record.run_id}: differs\n{difference}")
        return 1


@click.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@changes_options
@packaging_option
@click.option("--diagram", metavar="FILE", help="Also draw the system: .svg, or Mermaid in .mmd or .md.")
@click.option(
    "--load", is_flag=True, help="Also load and initialize each FMU, in a process of its own: this runs its code."
)
@click.option(
    "--timeout",
    metavar="S",
    type=click.FloatRange(min=0, min_open=True),
    default=60.0,
    show_default=True,
    help="Of --load: seconds for each FMU.",
)
@json_option
def check(
    experiment: str,
    sets: tuple[str, ...],
    swaps: tuple[str, ...],
    packaging: str,
    diagram: str | None,
    load: bool,
    timeout: float,
    as_json: bool,
) -> None:
    """Find all problems of an experiment and its FMUs, and show the system; nothing is run.

    No FMU is loaded, unless --load is given.

    \b
    orch check experiments/gripping_currents.toml --diagram system.svg
    orch check experiments/spiral_pid.toml --swap controller=theirs.fmu --load
    orch check system.ssp
    """
    from ...views.figures.diagram import FORMS, draw
    from ..text import show

    report = silent if as_json else to_stderr
    target = files.target(diagram, "a diagram", tuple(FORMS), [experiment]) if diagram is not None else None
    try:
        plan = prepared(experiment, sets, swaps, report, packaging)
        if load:
            from ...runs import trial

            if problems := trial.problems(plan, timeout):
                raise ExperimentError(plan.experiment.path, problems)
    except ExperimentError as error:
        if as_json:
            click.echo(json.dumps(show.problems_as_json(error)))
        raise
    if target is not None:
        draw(plan, target)
    click.echo(json.dumps(show.plan_as_json(plan)) if as_json else show.plan(plan))
    if load:
        report("every FMU was loaded and initialized")
    if target is not None and not as_json:
        click.echo(f"\n{files.short(target)}")
