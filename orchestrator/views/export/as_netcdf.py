"""NetCDF 4 for xarray and similar tools: one flat data set over `time`, variables named as in the record.

A slash, which netCDF keeps for groups, becomes an underscore; the attribute `name` holds the name in the record.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from .content import Content, unique


def write(content: Content, target: Path) -> None:
    time = xr.Variable("time", content.time, {"units": "s", "long_name": "simulated time", "axis": "T"})
    taken = {"time"}
    variables: dict[str, xr.Variable] = {}
    for signal in content.signals:
        name = unique(signal.name.replace("/", "_"), taken)
        values = signal.values
        axes = ["time", *(f"{name}_dim{i}" for i in range(1, values.ndim))]
        about = signal.about if name == signal.name else {**signal.about, "name": signal.name}
        variables[name] = xr.Variable(axes, values, about)
    facts = {"Conventions": "CF-1.11", **content.facts}
    encoding: dict[str, dict[str, Any]] = {
        name: {"zlib": True, "shuffle": True, "complevel": 1} for name, v in variables.items() if v.dtype != object
    }
    for name in ("time", *(name for name, v in variables.items() if v.dtype.kind == "f")):
        encoding.setdefault(name, {})["_FillValue"] = None  # no values are missing
    dataset = xr.Dataset(variables, coords={"time": time}, attrs=facts)
    dataset.to_netcdf(target, engine="h5netcdf", encoding=encoding)
