"""The datasets of a record before its first row.  Runs that are alike share them: they are made once, in memory."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from ...fmu.variables import DTYPES, Variable
from ...plan.plan import Plan
from .hdf5 import attach, create, describe, image_of, new_in_memory

CHUNK_ROWS = 1024
REFERENCE = np.dtype([("dataset", h5py.ref_dtype), ("dimension", np.int32)])
STORED = {"boolean": np.int8, "truth": np.int8, "string": h5py.string_dtype()}  # the others as they are


@dataclass(frozen=True)
class Signal:
    """A dataset to be: of a variable, or of an array that is recorded whole.  shape: of one row."""

    component: str
    name: str
    kind: str
    shape: tuple[int, ...]
    units: str
    long_name: str
    causality: str

    @property
    def path(self) -> str:
        return f"{self.component}/{self.name}"

    @property
    def width(self) -> int:
        """Values of a row."""
        return math.prod(self.shape)

    def chunk(self, rows: int) -> tuple[int, ...]:
        """Shape of a chunk of a dataset of at most `rows`."""
        return max(1, min(rows, CHUNK_ROWS // max(1, self.width))), *self.shape


TIME = Signal("", "time", "real", (), "s", "simulated time", "independent")


def signals_of(plan: Plan) -> tuple[Signal, ...]:
    """What a run records, in the order of the columns of its blocks."""
    return tuple(
        Signal(
            component,
            name := variable.array if shape else variable.name,
            variable.kind,
            shape,
            variable.unit or "1",
            variable.description or name,
            variable.causality,
        )
        for component, variable, shape in _variables(plan)
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
def image(components: tuple[str, ...], signals: tuple[Signal, ...], rows: int) -> bytes:
    """An HDF5 file of one group a component, with time and signals of at most `rows`, all without a row."""
    with new_in_memory() as file:
        time = _dataset(file, TIME, rows)
        time.make_scale("time")
        describe(time, {"units": TIME.units, "long_name": TIME.long_name})
        for component in components:
            file.create_group(component, track_order=True)
        references = []
        for signal in signals:
            dataset = _add(file[signal.component], signal, rows, time)
            references.append((dataset.ref, 0))
        if references:  # the other half of attach_scale, for all signals at once
            time.attrs.create("REFERENCE_LIST", np.array(references, dtype=REFERENCE))
        return image_of(file)


def _add(group: Any, signal: Signal, rows: int, time: Any) -> Any:
    name, dataset = signal.name, _dataset(group, signal, rows)
    describe(dataset, {"units": signal.units, "long_name": signal.long_name, "causality": signal.causality})
    scales = [group.create_dataset(f"{name}_dim{i}", data=np.arange(1, n + 1)) for i, n in enumerate(signal.shape, 1)]
    for i, scale in enumerate(scales, 1):
        scale.make_scale(f"{name}_dim{i}")
        scale.attrs.create("REFERENCE_LIST", np.array([(dataset.ref, i)], dtype=REFERENCE))
    attach_scales(dataset, [time, *scales])
    return dataset


def _dataset(group: Any, signal: Signal, rows: int) -> Any:
    """Empty, for at most `rows`.

    Bounded, for h5netcdf looks through all signals to learn the length of an unlimited dimension: minutes for 500.
    It had a row, so that the index of its chunks is there: a kill can come between an index and who points to it.
    """
    dtype = np.dtype(STORED.get(signal.kind, DTYPES[signal.kind]))
    dataset = create(
        group,
        signal.name,
        shape=(1, *signal.shape),
        maxshape=(rows, *signal.shape),
        dtype=dtype,
        chunks=signal.chunk(rows),
        fletcher32=h5py.check_string_dtype(dtype) is None,
        track_order=True,
    )
    dataset[0] = b"" if dtype.kind == "O" else 0
    dataset.id.set_extent((0, *signal.shape))
    return dataset


def attach_scales(dataset: Any, scales: Sequence[Any]) -> None:
    """Write DIMENSION_LIST directly: h5py's attach_scale takes quadratic time in the number of signals."""
    value = np.empty((len(scales),), dtype=object)
    for i, scale in enumerate(scales):
        value[i] = np.array([scale.ref], dtype=h5py.ref_dtype)
    attach(dataset, "DIMENSION_LIST", value, h5py.vlen_dtype(h5py.ref_dtype))
