"""What several commands share: their options, and how these become a plan."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...watch import INTERRUPTED

if TYPE_CHECKING:
    from ...plan.plan import Plan
    from ...runs.outside import Outside

EXIT_CODES = {"completed": 0, "failed": 3, "interrupted": INTERRUPTED}  # by status


def results_option(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--results", metavar="DIR", default="results", show_default=True, help="The store.")(command)


def json_option(command: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout, and nothing else.")(command)


def packaging_option(command: Callable[..., Any]) -> Callable[..., Any]:
    choice = click.Choice(["auto", "native", "python"])
    return click.option(
        "--packaging",
        type=choice,
        default="auto",
        help="How models are packaged; auto: native where a C compiler exists.",
    )(command)


def changes_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """--set and --swap."""
    set_ = click.option("--set", "sets", metavar="KEY=VALUE", multiple=True, help="Change a dotted key of the file.")
    swap = click.option("--swap", "swaps", metavar="COMPONENT=FMU", multiple=True, help="Put another FMU in its place.")
    return set_(swap(command))


def live_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """--mavlink, --mavlink-key and --realtime: what connects a run to the world outside."""
    options = [
        click.option(
            "--mavlink",
            "endpoints",
            metavar="ENDPOINT",
            multiple=True,
            help="Show the vehicles to ground stations: udpout:HOST:PORT, udpin:HOST:PORT, tcpin:HOST:PORT or "
            "serial:DEVICE:BAUD; 1=... shows only the vehicle with system id 1.  Repeatable.",
        ),
        click.option(
            "--mavlink-key", "key", metavar="FILE", help="Sign messages with this key, and accept signed ones only."
        ),
        click.option(
            "--realtime",
            metavar="[FACTOR]",
            is_flag=False,
            flag_value="1",
            help="Keep pace with the clock, or run at FACTOR times that pace.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def live_of(
    experiment: str | None, endpoints: tuple[str, ...], key: str | None, realtime: str | None
) -> tuple[str, Outside]:
    """The experiment, and the options above."""
    from ...runs.outside import Outside

    factor = None
    if realtime is not None:
        try:
            factor = float(realtime)
        except ValueError:
            if experiment is not None:
                words = f"--realtime {realtime}: write --realtime, or --realtime 2 for twice the pace"
                raise click.UsageError(words) from None
            experiment, factor = realtime, 1.0  # orch run --realtime EXPERIMENT.toml
        if not 1e-3 <= factor <= 1e3:
            raise click.UsageError(f"--realtime {realtime}: give a factor from 0.001 to 1000")
    if experiment is None:
        raise click.UsageError("Missing argument 'EXPERIMENT.toml'.")
    if key is not None and not endpoints:
        raise click.UsageError("--mavlink-key signs what --mavlink sends, and --mavlink is not given")
    return experiment, Outside(endpoints, key, factor)


def prepared(
    experiment: str | None,
    sets: tuple[str, ...],
    swaps: tuple[str, ...],
    report: Callable[[str], None],
    packaging: str = "auto",
    start_from: str | None = None,
) -> Plan:
    """The plan that the options ask for."""
    from ...runs.prepare import prepare

    changes = pairs("--set", sets), swaps_of(swaps)
    return prepare(experiment, *changes, packaging=packaging, start_from=start_from, report=report)


def pairs(option: str, texts: tuple[str, ...]) -> dict[str, Any]:
    """{key: value} of KEY=VALUE.  option: its name, for messages."""
    from ...experiment.keys import parse_value

    pairs = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise click.UsageError(f"{option} {text}: write {option} KEY=VALUE, such as {option} master.stop_time=10")
        pairs[key.strip()] = parse_value(value.strip())
    return pairs


def swaps_of(texts: tuple[str, ...]) -> Mapping[str, str]:
    """{component: FMU} of COMPONENT=FMU."""
    swaps = {}
    for text in texts:
        component, equals, fmu = text.partition("=")
        if not equals:
            raise click.UsageError(f"--swap {text}: write --swap COMPONENT=FMU, such as --swap controller=pid")
        # On the command line a path is relative to where the user is.
        swaps[component] = str(Path(fmu).resolve()) if fmu.endswith(".fmu") and Path(fmu).exists() else fmu
    return swaps


def to_stderr(text: str) -> None:
    click.echo(text, err=True)


def silent(text: str) -> None:
    """For --quiet and --json."""
