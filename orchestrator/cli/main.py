"""The command `orch`.  A command is imported when it is called and imports what it needs when it runs: help is fast."""

from __future__ import annotations

import importlib
import io
import os
import sys
import traceback
from collections.abc import Sequence

import click

from ..errors import OrchError
from ..version import __version__
from ..watch import INTERRUPTED, terminable

COMMANDS = {  # name: where it is, module:object of the package `commands`
    "build": "models:build",
    "check": "run:check",
    "compare": "compare:compare",
    "converge": "studies:converge",
    "diff": "compare:diff",
    "doctor": "models:doctor",
    "export": "exchange:export",
    "fmus": "models:fmus",
    "import": "exchange:import_",
    "list": "store:list_",
    "new": "models:new",
    "plot": "report:plot",
    "prune": "store:prune",
    "report": "report:report",
    "reproduce": "studies:reproduce",
    "rerun": "run:rerun",
    "run": "run:run",
    "schema": "models:schema",
    "show": "store:show",
    "sweep": "studies:sweep",
    "tune": "studies:tune",
}


def main() -> None:
    """Entry point; ends the process."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal may lack letters of a model's messages
    with terminable():
        code = execute()
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    # An FMU that has failed can neither be freed nor be left to the destructors at exit: both may crash.
    os._exit(code)


def execute(arguments: Sequence[str] | None = None) -> int:
    """One command; those of the process by default.  Returns 0 done, 2 not started, 3 failed, 130 interrupted."""
    try:
        code = orch.main(None if arguments is None else list(arguments), prog_name="orch", standalone_mode=False)
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
    return code if isinstance(code, int) else 0


class LazyGroup(click.Group):
    """Imports the module of a command when the command, or its line of help, is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        module, attribute = COMMANDS[name].split(":")
        command: click.Command = getattr(importlib.import_module(f".commands.{module}", __package__), attribute)
        return command

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The examples as they are written, without wrapping."""
        if self.epilog:
            formatter.write("\n" + self.epilog)


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="""Examples:
  orch run experiments/gripping_currents.toml
  orch run experiments/spiral_pid.toml --set components.controller.parameters.K_p.z=90
  orch run experiments/spiral_pid.toml --swap controller=mfsosmc --set master.step=5e-5
  orch plot last
""",
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=lambda *args: _version(*args),
    help="Show the version, and which loop runs.",
)
def orch() -> None:
    """Co-simulate underwater vehicles and their controllers, each one an FMU."""


def _version(ctx: click.Context, _: click.Parameter, asked: bool) -> None:
    if asked:
        from ..simulation.loop import compiled, out_of_date

        click.echo(f"orch {__version__}, {'compiled loop' if compiled() else 'loop in Python'}")
        if message := out_of_date():
            click.echo(message, err=True)
        ctx.exit()
