"""Commands about models, their FMUs, and what this machine needs for both."""

from __future__ import annotations

import json
from pathlib import Path

import click

from ... import files
from ...errors import FmuError
from .options import json_option, to_stderr


@click.command()
@click.argument("names", metavar="[NAME|FILE.py]...", nargs=-1)
@click.option("--native", "packaging", flag_value="native", help="Native FMUs (compiled C) only.")
@click.option("--python", "packaging", flag_value="python", help="Python FMUs only.")
@click.option(
    "--target",
    "targets",
    metavar="ARCH-OS",
    multiple=True,
    help="Cross-build: x86_64-windows, aarch64-linux, ...; several make one FMU for all.",
)
@click.option("--force", is_flag=True, help="Also build what is up to date.")
def build(names: tuple[str, ...], packaging: str | None, targets: tuple[str, ...], force: bool) -> None:
    """Build FMUs: all that come with orch, the named ones, or a model of your own.

    Native where a C compiler exists, unless --python asks for Python FMUs.

    \b
    orch build
    orch build my_controller.py --python
    orch build bluerov2_thesis --target x86_64-windows --target x86_64-linux
    """
    from ...models import build as builder
    from ...models import catalogue

    if targets and packaging == "python":
        raise click.UsageError(
            "--target is for native FMUs; Python FMUs run on 64-bit x86 Linux and Windows as they are"
        )
    wanted = names or catalogue.shipped()
    if targets:
        built = builder.cross_build(wanted, targets, to_stderr)
    else:
        built = builder.build(wanted, to_stderr, force, packaging or "auto")
    for path in built.values():
        click.echo(files.short(path))


@click.command()
@click.argument("name", required=False)
@json_option
def fmus(name: str | None, as_json: bool) -> None:
    """List FMUs, or show one: variables, units, defaults, capabilities."""
    from ...fmu.fmu import read
    from ...models import build as builder
    from ...models import catalogue
    from ..text import show

    if name is not None:
        built = {} if name.endswith(".fmu") else builder.build([name])
        fmu = read(catalogue.locate(name, Path.cwd(), built))
        click.echo(json.dumps(show.fmu_as_json(fmu)) if as_json else show.fmu(fmu))
        return
    try:
        built = builder.build(catalogue.known())
    except builder.BuildError as error:
        click.echo(str(error), err=True)
        built = error.built
    readable = []
    for path in built.values():
        try:
            readable.append(read(path))
        except FmuError as error:
            click.echo(str(error), err=True)
    click.echo(json.dumps([show.fmu_as_json(f) for f in readable]) if as_json else show.fmus(readable))


@click.command()
@click.argument("kind", type=click.Choice(["controller", "experiment"]))
@click.argument("name")
def new(kind: str, name: str) -> None:
    """Write a commented template that runs: NAME.py with a controller, or NAME.toml with an experiment."""
    from ...models import templates

    path, next_step = templates.write(kind, name)
    click.echo(f"{path}\n{next_step}")


@click.command()
def schema() -> None:
    """Print the JSON Schema of experiment files, with which editors complete and check them.

    \b
    orch schema > experiment.schema.json
    and as the first line of an experiment beside it, as `orch new experiment` writes one:
    #:schema ./experiment.schema.json
    """
    from ...experiment.schema.reference import json_schema

    click.echo(json_schema(), nl=False)


@click.command()
@json_option
def doctor(as_json: bool) -> None:
    """Show what this machine has, and what is missing for what."""
    from ..text import doctor as examiner

    findings = examiner.examine()
    click.echo(json.dumps([f.__dict__ for f in findings]) if as_json else examiner.report(findings))
