"""The command that makes an experiment of another tool's system."""

from __future__ import annotations

from pathlib import Path

import click

from .options import tell


@click.command("import")
@click.argument("system", metavar="SYSTEM.ssp")
@click.option("--output", "-o", metavar="FILE.toml", help="Default: the archive's name, here.")
@click.option("--force", is_flag=True, help="Write over a file that is there.")
def import_(system: str, output: str | None, force: bool) -> None:
    """Make an experiment file of an SSP 1.0 archive; its FMUs go into a folder beside it.

    \b
    orch import system.ssp -o system.toml
    orch run system.ssp --set master.step=1e-3      # without: as it is, or with what it does not say

    Nested systems are flattened.  Of an SSP that orch exported, the experiment is the same: run id, record, metrics.
    """
    from ...errors import StoreError
    from ...ssp import importing
    from ..text import show

    target = Path(output or f"{Path(system).stem}.toml")
    if target.exists() and not force:
        raise StoreError(f"{target} is there; give -o another name, or --force to write over it")
    imported = importing.convert(Path(system), target)
    for note in imported.notes:
        tell(f"note: {note}")
    for key in ("stop_time", "step"):
        if key not in imported.table["master"]:
            tell(f"note: the SSP does not say master.{key}: add it to {target}, in s")
    click.echo(show.short(target))
