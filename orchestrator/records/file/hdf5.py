"""HDF5's and h5py's quirks: each function says what it does in their place, and why.

The file format is bounded by 1.8: files of later formats mark themselves open, and do not open again after their writer
was killed (https://github.com/h5py/h5py/issues/1807).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5f, h5p, h5s, h5t

from ...arrays import Table

LIBVER = ("earliest", "v108")
REFERENCE = np.dtype([("dataset", h5py.ref_dtype), ("dimension", np.int32)])

TEXT = h5py.string_dtype()
_STORED, _MEMORY = h5t.py_create(TEXT, logical=True), h5t.py_create(TEXT)
_SCALAR = h5s.create(h5s.SCALAR)

_made: dict[tuple[Any, ...], tuple[Any, Any]] = {}  # types and property lists, by what was asked for


def create_dataset(
    group: h5py.Group, name: str, *, shape: tuple[int, ...], maxshape: tuple[int, ...], dtype: Any, **options: Any
) -> h5py.Dataset:
    """What `group.create_dataset` does, in a third of the time: types and property lists are made once, and a record
    has hundreds of datasets alike."""
    key = (np.dtype(dtype).str, *sorted(options.items()))
    if key in _made and "/" not in name:
        kind, properties = _made[key]
        space = h5s.create_simple(shape, maxshape)
        return h5py.Dataset(h5d.create(group.id, name.encode(), kind, space, properties))
    dataset = group.create_dataset(name, shape=shape, maxshape=maxshape, dtype=dtype, **options)
    if np.dtype(dtype).kind != "O":
        _made[key] = dataset.id.get_type(), dataset.id.get_create_plist()
    return dataset


def create_attributes(item: Any, attributes: Mapping[str, Any]) -> None:
    """What `item.attrs.update` does for new attributes, without its checks, which take most of the time
    (https://github.com/h5py/h5py/issues/705)."""
    for name, value in attributes.items():
        if isinstance(value, str):
            attribute = h5a.create(item.id, name.encode(), _STORED, _SCALAR)
            attribute.write(np.array(value, dtype=TEXT), mtype=_MEMORY)
        else:
            item.attrs.create(name, value)


def overwrite_attributes(item: Any, attributes: Mapping[str, str | float]) -> None:
    """New values for attributes that exist, each in its place: nothing around them changes.

    `item.attrs[name] = value` deletes and creates them instead (https://github.com/h5py/h5py/issues/2204).
    """
    for name, value in attributes.items():
        attribute = h5a.open(item.id, name.encode())
        if isinstance(value, str):
            attribute.write(np.array(value, dtype=TEXT), mtype=_MEMORY)
        else:
            attribute.write(np.array(value, dtype=np.float64))


def attach_scales(dataset: h5py.Dataset, scales: Sequence[h5py.Dataset]) -> None:
    """Attach a dimension scale to each axis of a dataset; `list_references` is the other half.

    `dims[0].attach_scale` appends to a list in the scale each time: that takes quadratic time in the number of
    datasets, and fails at four thousand (https://github.com/h5py/h5py/issues/1887).
    """
    value = np.empty((len(scales),), dtype=object)
    for i, scale in enumerate(scales):
        value[i] = np.array([scale.ref], dtype=h5py.ref_dtype)
    kind = h5py.vlen_dtype(h5py.ref_dtype)
    space = h5s.create_simple(value.shape)
    attribute = h5a.create(dataset.id, b"DIMENSION_LIST", h5t.py_create(kind, logical=True), space)
    attribute.write(value, mtype=h5t.py_create(kind))


def list_references(scale: h5py.Dataset, datasets: Sequence[h5py.Dataset], axis: int) -> None:
    """Say in a scale to which datasets it is attached, all at once."""
    references = [(dataset.ref, axis) for dataset in datasets]
    scale.attrs.create("REFERENCE_LIST", np.array(references, dtype=REFERENCE))


def write_rows(dataset: h5d.DatasetID, first: int, values: Table) -> None:
    """Write rows from `first` on, the new end of the dataset: what `dataset[first:] = values` does, in a third of the
    time.  values: (rows, *shape)."""
    dataset.set_extent((first + values.shape[0], *values.shape[1:]))
    if values.dtype.kind == "O":
        h5py.Dataset(dataset)[first:] = values
        return
    if values.dtype.kind == "b":  # HDF5 does not convert truths to integers
        values = values.view(np.int8)
    space = dataset.get_space()
    space.select_hyperslab((first,) + (0,) * (values.ndim - 1), values.shape)
    dataset.write(h5s.create_simple(values.shape), space, values)


def new_in_memory() -> h5py.File:
    """An empty file."""
    return h5py.File("memory", "w", driver="core", backing_store=False, libver=LIBVER, track_order=True)


def in_memory(image: bytes) -> h5py.File:
    """A copy, to change, of the file that has these bytes."""
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fapl_core(backing_store=False)
    access.set_libver_bounds(h5f.LIBVER_EARLIEST, h5f.LIBVER_V18)
    access.set_file_image(image)
    return h5py.File(h5f.open(b"memory", h5f.ACC_RDWR, access))


def image_of(file: h5py.File) -> bytes:
    """The bytes of a file in memory."""
    h5f.flush(file.id)
    return bytes(file.id.get_file_image())
