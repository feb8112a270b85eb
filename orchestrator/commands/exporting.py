"""The command that writes records for other tools."""

from __future__ import annotations

from pathlib import Path

import click

from ..options import results_option, tell


@click.command()
@click.argument("run", metavar="RUN")
@click.option("--format", "form", type=click.Choice(["csv", "parquet", "mat", "netcdf", "mcap", "tlog"]),
              help="Default: what FILE's name ends in (.csv, .parquet, .mat, .nc, .mcap, .tlog).")  # fmt: skip
@click.option("--output", "-o", metavar="FILE", help="Default: beside the record.")
@results_option
def export(run: str, form: str | None, output: str | None, results: str) -> None:
    """Write a run for another tool, with names and units.  RUN: an id, a prefix of one, a file, or "last".

    \b
    csv      pandas, spreadsheets: the first line is  time [s],vehicle1.eta.x [m],...
    parquet  pandas, DuckDB, Arrow: units in the metadata of each column
    mat      MATLAB: vehicle1.eta_x, and vectors such as vehicle1.eta, (N, 6); units.vehicle1.eta_x
    netcdf   xarray: variables vehicle1.eta.x over time, with units
    mcap     Foxglove: a channel a component, /vehicle1, and poses and tracks of vehicles
    tlog     QGroundControl, MAVProxy, MAVExplorer: the telemetry of the vehicles as ArduSub

    MCAP counts simulated time from 0.  Its signals are as recorded, in NED and FRD; its poses are as Foxglove expects
    them: x east, y north, z up, and of a vehicle x forward, y left, z up.

    All but csv need libraries: pip install "orch[export]", for tlog "orch[mavlink]".  Of a run that did not complete,
    its rows are written.
    """
    from .. import export as exporting
    from .. import show
    from ..store import open_run

    form = form or exporting.named_by(Path(output or ""))
    if form is None:
        raise click.UsageError("say which format: --format csv, parquet, mat, netcdf, mcap or tlog")
    with open_run(run, results) as record:
        target = Path(output) if output else record.path.with_suffix(exporting.FORMATS[form].suffix)
        exporting.export(record, form, target)
        if record.status != "completed":
            rows, time = len(record.time), record.time[-1]
            tell(f"{record.run_id}: {record.status}; these are its {rows} rows until t = {time:.10g} s")
    click.echo(show.short(target))
