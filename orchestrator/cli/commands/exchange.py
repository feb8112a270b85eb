"""Commands that write records and experiments for other tools, and read theirs."""

from __future__ import annotations

from pathlib import Path

import click

from ... import files
from ...views.export import FORMATS
from .options import changes_options, packaging_option, prepared, results_option, to_stderr

EXPERIMENTS = (".toml", ".ssp")  # suffixes by which an experiment is told from a run


@click.command()
@click.argument("run", metavar="RUN|EXPERIMENT.toml")
@click.option(
    "--format",
    "form",
    type=click.Choice([*FORMATS, "ssp"]),
    help=f"Default: by the suffix of FILE ({', '.join(form.suffix for form in FORMATS.values())}, .ssp).",
)
@click.option("--output", "-o", metavar="FILE", help="Default: beside the record; an experiment's is NAME.ssp, here.")
@changes_options
@packaging_option
@results_option
def export(
    run: str,
    form: str | None,
    output: str | None,
    sets: tuple[str, ...],
    swaps: tuple[str, ...],
    packaging: str,
    results: str,
) -> None:
    """Write a run for another tool, with names and units; or an experiment with its FMUs as one SSP archive.

    RUN: an id, a prefix of one, a file, or "last".

    \b
    csv      pandas, spreadsheets: the first line is  time [s],vehicle1.eta.x [m],...
    parquet  pandas, DuckDB, Arrow: units in the metadata of each column
    mat      MATLAB: vehicle1.eta_x, and vectors such as vehicle1.eta, (N, 6); units.vehicle1.eta_x
    netcdf   xarray: variables vehicle1.eta.x over time, with units
    mcap     Foxglove: a channel a component, /vehicle1, and poses and tracks of vehicles
    tlog     QGroundControl, MAVProxy, MAVExplorer: the telemetry of the vehicles as ArduSub
    ssp      of an EXPERIMENT: SSP 1.0, which libcosim, Ecos and orch run
    orch export experiments/spiral_pid.toml -o spiral.ssp

    --set, --swap and --packaging are for experiments.
    MCAP counts simulated time from 0.  Its signals are as recorded, in NED and FRD; its poses are as Foxglove expects
    them: x east, y north, z up, and of a vehicle x forward, y left, z up.

    All but csv need libraries: pip install "orch[export]", for tlog "orch[mavlink]".  Of a run that did not complete,
    the rows that it has are written.
    """
    from ...records.store.folder import open_run
    from ...views import export as exporting

    named = "ssp" if Path(output or "").suffix.lower() == ".ssp" else exporting.named_by(Path(output or ""))
    form = form or named
    if Path(run).suffix.lower() in EXPERIMENTS:
        _export_experiment(run, form, output, sets, swaps, packaging)
        return
    if form == "ssp":
        raise click.UsageError(f"{run} is a run, SSP is for experiments: give an EXPERIMENT.toml")
    if sets or swaps or packaging != "auto":
        raise click.UsageError(f"--set, --swap and --packaging are for experiments, and {run} is a run")
    if form is None:
        raise click.UsageError(f"give a format: --format {', '.join(FORMATS)}")
    with open_run(run, results) as record:
        target = files.target(output or record.path.with_suffix(FORMATS[form].suffix), used=[record.path])
        exporting.export(record, form, target)
        if record.status != "completed":
            rows, time = len(record.time), record.time[-1]
            to_stderr(f"{record.run_id}: {record.status}; these are its {rows} rows until t = {time:.10g} s")
    click.echo(files.short(target))


def _export_experiment(
    path: str, form: str | None, output: str | None, sets: tuple[str, ...], swaps: tuple[str, ...], packaging: str
) -> None:
    from ...ssp import writing

    if form != "ssp":
        what = f"--format {form} is for runs" if form else "give a format"
        raise click.UsageError(f"{what}: an experiment becomes an SSP, --format ssp, and a run is named by its id")
    target = files.target(output or f"{Path(path).stem}.ssp", used=[path])
    plan = prepared(path, sets, swaps, to_stderr, packaging)
    for note in [*plan.notes, *writing.limits(plan)]:
        to_stderr(f"note: {note}")
    click.echo(files.short(writing.export(plan, target)))


@click.command("import")
@click.argument("system", metavar="SYSTEM.ssp")
@click.option("--output", "-o", metavar="FILE.toml", help="Default: named as the archive, in this folder.")
@click.option("--force", is_flag=True, help="Write over an existing file.")
def import_(system: str, output: str | None, force: bool) -> None:
    """Make an experiment file from an SSP 1.0 archive; its FMUs are put into a folder beside it.

    \b
    orch import system.ssp -o system.toml
    orch run system.ssp --set master.step=1e-3      # as it is, or with what it does not state

    Nested systems are flattened.  Of an SSP that orch exported, the experiment is the same: run id, record, metrics.
    """
    from ...errors import StoreError
    from ...ssp import importing

    target = files.target(output or f"{Path(system).stem}.toml", "an experiment", (".toml",), [system])
    if target.exists() and not force:
        raise StoreError(f"{target} exists; give -o another name, or --force to write over it")
    imported = importing.convert(Path(system), target)
    for note in imported.notes:
        to_stderr(f"note: {note}")
    for key in ("stop_time", "step"):
        if key not in imported.table["master"]:
            to_stderr(f"note: the SSP does not state master.{key}: add it to {target}, in s")
    click.echo(files.short(target))
