"""The command `orch`.  Each command imports what it needs when it runs, so that `orch --help` is there at once."""

from __future__ import annotations

import io
import json
import os
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from . import __version__
from .errors import ExperimentError, FmuError, OrchError

INTERRUPTED = 130


def main() -> None:
    """Entry point: exit codes 0 done, 2 not started, 3 failed, 130 interrupted."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal may lack the letters of a model's own words
    try:
        code = orch.main(standalone_mode=False)
    except click.exceptions.Abort:  # what click makes of Ctrl-C
        click.echo("interrupted", err=True)
        code = INTERRUPTED
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except KeyboardInterrupt:
        click.echo("interrupted", err=True)
        code = INTERRUPTED
    except OrchError as error:
        click.echo(str(error), err=True)
        code = error.exit_code
    except BrokenPipeError:  # orch ... | head
        code = 0
        sys.stdout = None
    except Exception:
        traceback.print_exc()
        click.echo("\nThis is a bug of orch; please report it with the text above.", err=True)
        code = 1
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    # An FMU that has failed can neither be freed nor be left to the destructors at exit: both may crash.
    os._exit(code if isinstance(code, int) else 0)


class _Group(click.Group):
    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        if self.epilog:
            formatter.write("\n" + self.epilog)


@click.group(
    cls=_Group,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="""Examples:
  orch run experiments/gripping_currents.toml
  orch run experiments/spiral_pid.toml --set components.controller.parameters.K_p.z=90
  orch run experiments/spiral_pid.toml --swap controller=mfsosmc --set master.step=5e-5
  orch plot last
""",
)
@click.version_option(__version__, "--version", prog_name="orch")
def orch() -> None:
    """Co-simulate underwater vehicles and their controllers, each one an FMU."""


def _results(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--results", metavar="DIR", default="results", show_default=True, help="The store.")(command)


def _json(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, and nothing else.")(command)


def _changes(command: Callable[..., Any]) -> Callable[..., Any]:
    """--set and --swap."""
    set_ = click.option("--set", "sets", metavar="KEY=VALUE", multiple=True, help="Change a dotted key of the file.")
    swap = click.option("--swap", "swaps", metavar="COMPONENT=FMU", multiple=True, help="Put another FMU in its place.")
    return set_(swap(command))


@orch.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@_changes
@click.option("--output", "-o", metavar="FILE.h5", help="Write exactly this file, not one in the store.")
@_results
@click.option("--force", is_flag=True, help="Run again although the record is there.")
@click.option("--quiet", "-q", is_flag=True, help="Print nothing but errors.")
@_json
def run(
    experiment: str,
    sets: tuple[str, ...],
    swaps: tuple[str, ...],
    output: str | None,
    results: str,
    force: bool,
    quiet: bool,
    as_json: bool,
) -> int:
    """Run an experiment and record it."""
    from . import show
    from .progress import Progress
    from .runner import execute

    told = _silent if quiet or as_json else _tell
    try:
        plan = _prepare(experiment, sets, swaps, told)
        for note in plan.notes:
            told(f"note: {note}")
        progress = Progress(plan)
        try:
            result = execute(plan, output, results, force, [] if quiet or as_json else [progress])
        finally:
            progress.done()
    except OrchError as error:
        if as_json:
            click.echo(json.dumps(show.not_started(error)))
        raise
    if as_json:
        click.echo(json.dumps(show.result_as_json(result)))
    elif not quiet and result.status == "completed":
        click.echo(show.result(result, plan))
    for warning in result.warnings:
        told(f"warning: {warning}")
    if result.status == "completed":
        return 0
    click.echo(f"{result.file}: {result.error}", err=True)
    return 3 if result.status == "failed" else INTERRUPTED


@orch.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@_changes
@_json
def check(experiment: str, sets: tuple[str, ...], swaps: tuple[str, ...], as_json: bool) -> None:
    """Find all problems of an experiment and its FMUs; run nothing."""
    from . import show

    try:
        plan = _prepare(experiment, sets, swaps, _silent if as_json else _tell)
    except ExperimentError as error:
        if as_json:
            click.echo(json.dumps(show.problems_as_json(error)))
        raise
    click.echo(json.dumps(show.plan_as_json(plan)) if as_json else show.plan(plan))


@orch.command()
@click.argument("names", metavar="[NAME|FILE.py]...", nargs=-1)
@click.option("--force", is_flag=True, help="Build also what is up to date.")
def build(names: tuple[str, ...], force: bool) -> None:
    """Build FMUs: all that come with orch, the named ones, or a model of your own."""
    from . import build as builder
    from . import show

    built = builder.build(names or builder.shipped(), lambda name: _tell(f"building {name}"), force)
    for path in built.values():
        click.echo(show.short(path))


@orch.command()
@click.argument("name", required=False)
@_json
def fmus(name: str | None, as_json: bool) -> None:
    """List FMUs, or show one: variables, units, defaults, capabilities."""
    from . import build as builder
    from . import show
    from .fmu import read

    if name is not None:
        if not name.endswith(".fmu"):
            builder.build([name])
        fmu = read(builder.locate(name, Path.cwd()))
        click.echo(json.dumps(show.fmu_as_json(fmu)) if as_json else show.fmu(fmu))
        return
    try:
        builder.build(builder.known())
    except builder.BuildError as error:
        click.echo(str(error), err=True)
    found = []
    for path in filter(Path.exists, map(builder.target, builder.known())):
        try:
            found.append(read(path))
        except FmuError as error:
            click.echo(str(error), err=True)
    click.echo(json.dumps([show.fmu_as_json(f) for f in found]) if as_json else show.fmus(found))


@orch.command()
@click.argument("run", metavar="RUN")
@_results
@_json
def show(run: str, results: str, as_json: bool) -> None:
    """Show a record: how it ended, what made it, metrics, warnings.  RUN: an id, a prefix, a file, or "last"."""
    from . import show as shown
    from .store import open_run

    with open_run(run, results) as record:
        click.echo(json.dumps(shown.record_as_json(record)) if as_json else shown.record(record))


@orch.command()
@click.argument("runs", metavar="RUN...", nargs=-1, required=True)
@click.option("--output", "-o", metavar="FILE", help="PNG, PDF or SVG; default: beside the record, as .png")
@click.option("--signals", metavar="GLOB", multiple=True, help="Plot these signals over time instead of the overview.")
@_results
def plot(runs: tuple[str, ...], output: str | None, signals: tuple[str, ...], results: str) -> None:
    """Draw runs: tracks, positions, errors, thrusters.  RUN: an id, a prefix of one, a file, or "last"."""
    from . import plots, show
    from .store import Store, open_run

    store = Store(results)
    records = [open_run(store.find(name)) for name in runs]
    target = Path(output) if output else records[0].path.with_suffix(".png")
    click.echo(show.short(plots.draw(records, target, signals)))


@orch.command()
@click.argument("experiment", metavar="EXPERIMENT.toml")
@click.option("--steps", metavar="S,S,...", help="Communication steps [s]; default: 4, 2, 1 and 1/2 times its own.")
@_changes
@click.option("--output", "-o", metavar="FILE", help="The figure; default: RESULTS/_converge/EXPERIMENT.png")
@_results
@_json
def converge(
    experiment: str, steps: str | None, sets: tuple[str, ...], swaps: tuple[str, ...], output: str | None, results: str,
    as_json: bool,
) -> int:  # fmt: skip
    """Run an experiment at several steps: is the result converged?  Exit code 1 where it is not.

    \b
    orch converge experiments/spiral_pid.toml
    orch converge experiments/spiral_pid.toml --swap controller=mfsosmc --steps 1e-3,5e-4,2.5e-4
    """
    from . import converge as study
    from . import metrics, show

    plan = _prepare(experiment, sets, swaps, _silent if as_json else _tell)
    try:
        chosen = [float(step) for step in steps.split(",")] if steps else study.default_steps(plan)
    except ValueError:
        raise click.UsageError(f"--steps {steps}: write numbers of seconds, such as --steps 1e-3,5e-4,2.5e-4") from None
    arguments = [experiment, "--results", results]
    arguments += [word for text in sets for word in ("--set", text)] + [w for text in swaps for w in ("--swap", text)]
    units = {f"{component}.{variable.name}": variable.unit for component, variable in plan.recorded}
    names = {name: metrics.unit_of(spec, units) for name, spec in plan.experiment.metrics.items()}
    found = study.study(plan, chosen, arguments, names, _silent if as_json else _tell)
    figure = study.draw(found, Path(output) if output else Path(results) / "_converge" / f"{found.experiment}.png")
    click.echo(json.dumps(study.as_json(found)) if as_json else f"{study.report(found)}\n{show.short(figure)}")
    return 0 if found.converged else 1


@orch.command(
    epilog="Example: orch reproduce thesis --only 5.2 --only fig5.57.  Exit code 1: a number lies outside its band."
)
@click.argument("what", metavar="thesis", type=click.Choice(["thesis"]))
@click.option("--only", metavar="TABLE|FIGURE", multiple=True,
              help="Do what this needs, such as 5.2 (the table), fig5.2, 5.57, claims, steps.")  # fmt: skip
@click.option("--quick", is_flag=True, help="Coarser steps, and no step study.")
@_results
def reproduce(what: str, only: tuple[str, ...], quick: bool, results: str) -> int:
    """Rebuild every table, claim and figure of the thesis in DIR/_thesis, each number against the published one.

    Runs that the store has are not repeated, figures whose runs have not changed are not redrawn.
    """
    from . import show
    from .thesis import reproduce as thesis

    outcome = thesis.reproduce(only, quick, results, _tell)
    click.echo(thesis.report(outcome, show.short(outcome.folder)))
    return 1 if outcome.outside else 0


@orch.command()
@click.argument("kind", type=click.Choice(["controller", "experiment"]))
@click.argument("name")
def new(kind: str, name: str) -> None:
    """Write a commented template that runs: NAME.py with a controller, or NAME.toml with an experiment."""
    from . import templates

    path, next_step = templates.write(kind, name)
    click.echo(f"{path}\n{next_step}")


@orch.command()
@_json
def doctor(as_json: bool) -> None:
    """Say what this machine has, and what is missing for what."""
    from . import doctor as examiner

    findings = examiner.examine()
    click.echo(json.dumps([f.__dict__ for f in findings]) if as_json else examiner.report(findings))


def _prepare(experiment: str, sets: tuple[str, ...], swaps: tuple[str, ...], told: Callable[[str], None]) -> Any:
    from .experiment import load
    from .wiring import prepare

    loaded = load(experiment, _pairs("--set", sets), _swaps(swaps))
    return prepare(loaded, lambda name: told(f"building {name}"))


def _pairs(option: str, texts: tuple[str, ...]) -> dict[str, Any]:
    from .experiment import parse_value

    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise click.UsageError(f"{option} {text}: write {option} KEY=VALUE, such as {option} master.stop_time=10")
        pairs[key.strip()] = parse_value(value.strip())
    return pairs


def _swaps(texts: tuple[str, ...]) -> Mapping[str, str]:
    swaps = {}
    for text in texts:
        component, equals, fmu = text.partition("=")
        if not equals:
            raise click.UsageError(f"--swap {text}: write --swap COMPONENT=FMU, such as --swap controller=pid")
        # On the command line a path is relative to where the user is.
        swaps[component] = str(Path(fmu).resolve()) if fmu.endswith(".fmu") and Path(fmu).exists() else fmu
    return swaps


def _tell(text: str) -> None:
    click.echo(text, err=True)


def _silent(text: str) -> None:
    """For --quiet and --json."""


if __name__ == "__main__":
    main()
