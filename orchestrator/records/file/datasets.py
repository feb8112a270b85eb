"""The datasets of a record before its first row.  They are made once, in memory, for all runs that are alike."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import h5py
import numpy as np

from ...fmu.variables import DTYPES, Variable
from ...plan.plan import Plan
from .format import ENVELOPE, VARIABLE, link_of
from .hdf5 import attach_scales, create_attributes, create_dataset, image_of, list_references, new_in_memory

CHUNK_ROWS = 1024
STORED = {"boolean": np.int8, "truth": np.int8, "string": h5py.string_dtype()}  # the other kinds as they are


@dataclass(frozen=True, kw_only=True)
class DatasetSpec:
    """A dataset to create, of a variable or of an array that is recorded whole.  shape: of one row."""

    component: str
    name: str
    kind: str
    shape: tuple[int, ...]
    units: str
    long_name: str
    causality: str
    quantity: str = ""

    @property
    def path(self) -> str:
        return f"{self.component}/{self.link}"

    @property
    def link(self) -> str:
        """What it is called in the file: for `time` itself, the name that no variable may have."""
        return link_of(self.name) if self.component else self.name

    @property
    def width(self) -> int:
        """Values of a row."""
        return math.prod(self.shape)

    def chunk(self, rows: int) -> tuple[int, ...]:
        """Shape of a chunk of a dataset of at most `rows`."""
        return max(1, min(rows, CHUNK_ROWS // max(1, self.width))), *self.shape


TIME = DatasetSpec(
    component="",
    name="time",
    kind="real",
    shape=(),
    units="s",
    long_name="simulated time",
    causality="independent",
)


def datasets_of(plan: Plan) -> tuple[DatasetSpec, ...]:
    """What a run records, in the order of the columns of its blocks."""
    return tuple(
        DatasetSpec(
            component=component,
            name=(name := variable.array if shape else variable.name),
            kind=variable.kind,
            shape=shape,
            units=variable.unit or "1",
            long_name=variable.description or name,
            causality=variable.causality,
            quantity=variable.quantity,
        )
        for component, variable, shape in _variables(plan)
    )


def envelope_of(plan: Plan) -> tuple[DatasetSpec, ...]:
    """The least and the largest values between rows that a run records, in the order of `Block.bounds`."""
    return tuple(
        DatasetSpec(
            component=f"{ENVELOPE}/{component}",
            name=variable.name,
            kind="real",
            shape=(2,),
            units=variable.unit or "1",
            long_name=f"least and largest value since the row before: {variable.description or variable.name}",
            causality=variable.causality,
        )
        for component, variable in plan.bounded
    )


def _variables(plan: Plan) -> Iterator[tuple[str, Variable, tuple[int, ...]]]:
    """Component, first variable and shape of each dataset."""
    recorded = {(component, variable.name) for component, variable in plan.recorded}
    fmus = {component.name: component.fmu for component in plan.components}
    for component, variable in plan.recorded:
        if not all((component, element.name) in recorded for element in fmus[component].elements(variable)):
            yield component, variable, ()
        elif not variable.element:
            yield component, variable, variable.shape


@functools.lru_cache(maxsize=8)
def image(components: tuple[str, ...], specs: tuple[DatasetSpec, ...], rows: int) -> bytes:
    """An HDF5 file with a group for each component, the time and the datasets for at most `rows`, all without a row."""
    with new_in_memory() as file:
        time = _create(file, TIME, rows)
        time.make_scale("time")
        create_attributes(time, {"units": TIME.units, "long_name": TIME.long_name})
        for component in components:
            file.create_group(component, track_order=True)
        for envelope in dict.fromkeys(spec.component for spec in specs if spec.component not in components):
            file.create_group(envelope, track_order=True)
        datasets = [_add(file[spec.component], spec, rows, time) for spec in specs]
        if datasets:
            list_references(time, datasets, axis=0)
        return image_of(file)


def _add(group: h5py.Group, spec: DatasetSpec, rows: int, time: h5py.Dataset) -> h5py.Dataset:
    link, dataset = spec.link, _create(group, spec, rows)
    attributes = {"units": spec.units, "long_name": spec.long_name, "causality": spec.causality}
    attributes |= {"quantity": spec.quantity} if spec.quantity else {}
    create_attributes(dataset, attributes | ({VARIABLE: spec.name} if spec.link != spec.name else {}))
    scales = [group.create_dataset(f"{link}_dim{i}", data=np.arange(1, n + 1)) for i, n in enumerate(spec.shape, 1)]
    for i, scale in enumerate(scales, 1):
        scale.make_scale(f"{link}_dim{i}")
        list_references(scale, [dataset], axis=i)
    attach_scales(dataset, [time, *scales])
    return dataset


def _create(group: h5py.Group, spec: DatasetSpec, rows: int) -> h5py.Dataset:
    """Create an empty dataset for at most `rows`.

    It is bounded, as h5netcdf looks through all signals to find the length of an unlimited dimension, which takes
    minutes for 500 of them; netCDF's C library does the same (https://github.com/Unidata/netcdf-c/pull/1709).  It had a
    row, so that the index of its chunks exists: a kill can come between an index and what points to it.
    """
    dtype = np.dtype(STORED.get(spec.kind, DTYPES[spec.kind]))
    dataset = create_dataset(
        group,
        spec.link,
        shape=(1, *spec.shape),
        maxshape=(rows, *spec.shape),
        dtype=dtype,
        chunks=spec.chunk(rows),
        fletcher32=h5py.check_string_dtype(dtype) is None,
        track_order=True,
    )
    dataset[0] = b"" if dtype.kind == "O" else 0
    dataset.id.set_extent((0, *spec.shape))
    return dataset
