"""Reads the record of a run, one HDF5 file.  docs/record.md describes the format; `recorder` writes it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from xml.etree import ElementTree

import h5py
import numpy as np

from ... import warning
from ...errors import StoreError, did_you_mean
from ...experiment.timegrid import TimeGrid
from ...fmu.archive import checked_xml
from ...fmu.variables import ANGLE
from ...names import ANGLE_AXES, split_axis
from ...warning import Warned
from . import foreign
from .access import PATIENCE, UNREADABLE, first_line, is_locked, opened, patiently
from .format import ENVELOPE, HEARD, VARIABLE, link_of
from .marks import Standing, standing_of

if TYPE_CHECKING:
    import pandas as pd

    from ...arrays import Reals, Table

DEEPEST = 16  # groups within each other

T = TypeVar("T")


class Run:
    """A read-only handle on a record.

    run["vehicle1.eta.x"] is a signal (N,), run["vehicle1.eta"] a vector (N, 6), run.time the times (N,) [s].  An array
    of FMI 3.0 is one signal, run["camera.image"] (N, *shape), and run["camera.image[1,2]"] is one of its elements.
    Raises StoreError where the file is no record, or holds what none may hold; see `foreign`.
    """

    def __init__(self, path: str | Path, file: h5py.File | None = None):
        """file: of that path, if it is open already."""
        self.path = Path(path)
        self._places: dict[str, tuple[str, ...]] = {}  # of signals: the links that lead to their data sets
        self._known: dict[str, Any] = {}  # root attributes that do not change any more
        self._lent = file is not None
        self.file = file or self._open()
        self._length = self._get("the time", _rows)

    def _open(self) -> h5py.File:
        if not self.path.is_file():
            raise StoreError(f"{self.path}: no such file")
        try:
            file = patiently(lambda: opened(self.path), while_=lambda: is_locked(self.path))
        except UNREADABLE as error:
            raise StoreError(f"{self.path} is no record of a run that can be read: {first_line(error)}") from None
        return file

    def _get(self, what: str, read: Callable[[h5py.File], T]) -> T:
        """Read from the file.  While it is being written, what HDF5 has cached may be out of date: then it is opened
        again."""
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                return read(self.file)
            except UNREADABLE as error:
                if self._lent or time.monotonic() > deadline or not is_locked(self.path):
                    raise StoreError(f"{self.path}: {what} cannot be read: {first_line(error)}") from None
            self.file.close()
            self.file = self._open()

    def __enter__(self) -> Run:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.file.close()

    def __repr__(self) -> str:
        if not self.file:
            return f"<Run {self.path}: closed>"
        return f"<Run {self.attributes['experiment']} {self.run_id}: {self.status}, {self._length} rows>"

    def _ipython_key_completions_(self) -> list[str]:
        """Names of vectors and signals: what IPython and Jupyter complete run[" with."""
        vectors = dict.fromkeys(head for head, axis in map(split_axis, self.signals) if axis)
        return [*vectors, *self.signals]

    def __getitem__(self, name: str) -> Table:
        if name in self._located:
            return self._read(name)
        array, _, place = name.rstrip("]").rpartition("[")
        if array in self.signals and name.endswith("]"):
            values, index = self._read(array), tuple(int(n) - 1 for n in place.split(",") if n.isdecimal())
            if len(index) == values.ndim - 1 and all(0 <= i < n for i, n in zip(index, values.shape[1:], strict=True)):
                element: Table = np.moveaxis(values, 0, -1)[index]
                return element
        axes = [s for s in self.signals if s.startswith((name + ".", name + "[")) and "." not in s[len(name) + 1 :]]
        if not axes:
            near = did_you_mean(name, sorted({s.rpartition(".")[0] for s in self.signals}), "recorded")
            raise KeyError(f"{self.path} has no signal {name!r}{near}")
        return np.column_stack([self._read(axis) for axis in axes])

    def _read(self, name: str) -> Table:
        def values(file: h5py.File) -> Table:
            dataset = self._dataset(file, name, self._length)
            is_text = h5py.check_string_dtype(dataset.dtype) is not None
            rows: Table = foreign.texts(dataset, self._length) if is_text else dataset[: self._length]
            return rows

        return self._get(name, values)

    def _dataset(self, file: h5py.File, name: str, rows: int = 0) -> h5py.Dataset:
        """Of a signal, or of the array of which it is an element.  rows: how many are read."""
        if name not in self._located and name.endswith("]"):
            name = name.rpartition("[")[0]
        if name not in self._located:
            raise KeyError("there is no such signal")
        *above, link = self._located[name]
        group: h5py.Group = file
        for part in above:
            group = foreign.group(group, part)
        return foreign.dataset(group, link, rows)

    @property
    def time(self) -> Reals:
        """(N,) [s]."""
        time: Reals = self._get("the time", lambda file: foreign.dataset(file, "time")[: self._length])
        return time

    @property
    def signals(self) -> list[str]:
        """Names of all recorded variables, components in order."""
        return list(self._located)

    @property
    def _located(self) -> dict[str, tuple[str, ...]]:
        if not self._places:
            self._places = self._get("the list of signals", _places)
        return self._places

    def units(self, name: str) -> str:
        """The unit of a signal, "1" where it has none."""
        return self.about(name, "units", "1")

    def about(self, name: str, attribute: str, default: str = "") -> str:
        """What the record says of a signal: `units`, `long_name`, `causality`, `quantity`."""
        return self._get(name, lambda file: foreign.text_of(self._dataset(file, name), attribute, default))

    def dtype(self, name: str) -> np.dtype[Any]:
        """How a signal is stored: booleans as int8, texts as objects."""
        return self._get(name, lambda file: np.dtype(self._dataset(file, name).dtype))

    def is_angle(self, name: str) -> bool:
        """Whether differences of a signal are differences on the circle.

        Records of format 1 have no quantities: there it is an axis phi, theta or psi in rad or deg.
        """
        if name not in self._located:
            return False
        if self.attributes["format_version"] > 1:
            return self.about(name, "quantity") == ANGLE
        return split_axis(name.partition(".")[2])[1] in ANGLE_AXES and self.units(name) in ("rad", "deg")

    def envelope(self, name: str) -> Reals | None:
        """(N, 2): the least and the largest value of a signal since the row before; None where it is not recorded."""

        def values(file: h5py.File) -> Reals | None:
            component, _, variable = name.partition(".")
            try:
                group = foreign.group(foreign.group(file, ENVELOPE), component)
                dataset = foreign.dataset(group, link_of(variable), self._length)
            except KeyError:
                return None
            if dataset.shape[1:] != (2,) or dataset.dtype.kind != "f":
                raise foreign.Foreign(f"{dataset.name} is not of pairs of numbers")
            return np.asarray(dataset[: self._length])

        return self._get(f"the envelope of {name}", values)

    def fact(self, component: str, name: str) -> Any:
        """An attribute of a component, such as fmu_sha256 or packaging, JSON decoded."""

        def value(file: h5py.File) -> Any:
            facts = foreign.component_attributes(foreign.group(file, component))
            if name not in facts:
                raise foreign.Foreign(f"the attribute {name} of /{component} is missing")
            return facts[name]

        return self._get(f"{name} of {component}", value)

    def facts_of(self, component: str) -> dict[str, Any]:
        """All attributes of a component, JSON decoded; {} of one that the record does not hold."""

        def values(file: h5py.File) -> dict[str, Any]:
            try:
                group = foreign.group(file, component)
            except KeyError:
                return {}
            return foreign.component_attributes(group)

        return self._get(f"what it says of {component}", values)

    def description(self, component: str) -> ElementTree.Element | None:
        """The modelDescription.xml of its FMU; None of a builtin.  Raises FmuError where it cannot be read."""
        digests = {of["name"]: of["fmu_sha256"] for of in self.resolved["components"]}
        text = self.attributes.get("model_descriptions", {}).get(digests.get(component))
        if not text:
            return None
        what = f"{self.path}: the model description of {component}"
        return ElementTree.fromstring(checked_xml(what, text.encode()))

    def heard(self, component: str) -> tuple[Reals, Reals] | None:
        """What a live component received: the times [s] at which it changed (M,), and the values (M, n); or None."""

        def values(file: h5py.File) -> tuple[Reals, Reals] | None:
            try:
                group = foreign.group(foreign.group(file, HEARD), component)
            except KeyError:
                return None
            time = foreign.dataset(group, "time")
            values = foreign.dataset(group, "values", len(time))
            if time.ndim != 1 or values.ndim != 2 or {time.dtype.kind, values.dtype.kind} != {"f"}:
                raise foreign.Foreign(f"{group.name} is not of times and rows of numbers")
            return time[:], values[: len(time)]

        return self._get(f"what {component} received", values)

    @property
    def attributes(self) -> dict[str, Any]:
        """The root attributes, JSON decoded."""
        if not self._known:
            values = self._get("its attributes", _attributes)
            if values["status"] == "running":
                return values
            self._known = values
        return dict(self._known)

    @property
    def resolved(self) -> dict[str, Any]:
        """What ran, every name and value resolved."""
        resolved: dict[str, Any] = self.attributes["experiment_resolved"]
        return resolved

    @property
    def status(self) -> str:
        """completed, failed, interrupted, running, or "interrupted (killed)" where no process writes it any more."""
        status = str(self.attributes["status"])
        return "interrupted (killed)" if status == "running" and not is_locked(self.path) else status

    @property
    def run_id(self) -> str:
        return str(self.attributes["run_id"])

    @property
    def metrics(self) -> dict[str, float]:
        """{metric: number}: inf where what it is the time of never happens, nan where it has none."""
        return metrics_in(self.attributes)

    @property
    def ended_at(self) -> float:
        """Until when its metrics are [s]: the stop time, unless it failed, was interrupted, or an FMU ended it."""
        facts = self.attributes
        early = [facts[name] for name in ("stopped_at", "failed_at", "interrupted_at") if name in facts]
        return float(early[0] if early else self.resolved["master"]["stop_time"])

    @property
    def ended_early(self) -> bool:
        """Whether its metrics are of less than the experiment asks for."""
        return self.ended_at < float(self.resolved["master"]["stop_time"])

    @property
    def unsampled(self) -> set[str]:
        """The metrics into whose windows no step of the run falls."""
        facts = self.attributes
        grid, specs = TimeGrid(facts["step"]), self.resolved.get("metrics", {})
        first, last = (round(time / facts["step"]) for time in (facts.get("from_time", 0.0), self.ended_at))
        return {name for name in self.metrics if name in specs and not grid.has_sample(specs[name], first, last)}

    @property
    def metrics_of(self) -> str:
        """ "steps", or "rows" where the record is of format 1 and does not keep every step: what the metrics are of."""
        return warning.metrics_of(self.attributes)

    @property
    def metric_units(self) -> dict[str, str]:
        """{signal: unit} of the signals that the metrics name."""
        attributes = self.attributes
        if "metric_units" in attributes:
            return dict(attributes["metric_units"])
        specs = self.resolved.get("metrics", {}).values()
        return {spec["signal"]: self.units(spec["signal"]) for spec in specs if spec["signal"] in self.signals}

    @property
    def warnings(self) -> list[Warned]:
        """What the run warns of, each text with its `kind`."""
        return warning.read(self.attributes)

    @property
    def is_wrong(self) -> bool:
        """Whether the run says itself that its numbers are wrong."""
        return warning.are_wrong(self.warnings)

    @property
    def standing(self) -> Standing:
        """Whether its numbers may be compared with those of others, and why not."""
        return standing_of(self.attributes, self.status)

    def to_dataframe(self) -> pd.DataFrame:
        """All signals as columns, indexed by time [s]."""
        import pandas as pd

        columns = {name: values for signal in self.signals for name, values in self._columns(signal)}
        return pd.DataFrame(columns, index=pd.Index(self.time, name="time"))

    def _columns(self, signal: str) -> Iterator[tuple[str, Table]]:
        values = self._read(signal)
        for index in np.ndindex(values.shape[1:]):
            place = ",".join(str(i + 1) for i in index)
            yield f"{signal}[{place}]" if place else signal, values[(slice(None), *index)]


def metrics_in(attributes: Mapping[str, Any]) -> dict[str, float]:
    """`Run.metrics` of its decoded root attributes."""
    missing = dict.fromkeys(attributes.get("metrics_never", ()), math.inf)
    return {name: missing.get(name, math.nan) if v is None else v for name, v in attributes["metrics"].items()}


def _attributes(file: h5py.File) -> dict[str, Any]:
    values = foreign.root_attributes(file)
    for name in values["metrics"]:
        if name not in values["experiment_resolved"]["metrics"]:
            words = "which the attribute experiment_resolved does not define"
            raise foreign.Foreign(f"the attribute metrics has {name[:40]!r}, {words}")
    return values


def _rows(file: h5py.File) -> int:
    time = foreign.dataset(file, "time")
    if time.ndim != 1 or time.dtype.kind != "f":
        raise foreign.Foreign("/time is no column of numbers")
    return len(time)


def _places(file: h5py.File) -> dict[str, tuple[str, ...]]:
    """{signal: the links that lead to its data set}."""
    groups = {name: item for name, item in foreign.children(file) if name not in (ENVELOPE, HEARD)}
    places: dict[str, tuple[str, ...]] = {}
    for component, group in groups.items():
        if isinstance(group, h5py.Group):
            for variable, links in _datasets(group, (component,)):
                if (name := f"{component}.{variable}") in places:
                    raise foreign.Foreign(f"/{component} has two data sets of the variable {variable!r}")
                places[name] = links
    return places


def _datasets(group: h5py.Group, above: tuple[str, ...]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Variables of all data sets, and the links to them; in format 1 and early in format 2, a variable whose name
    contains a slash lies in a group of its own."""
    if len(above) > DEEPEST:
        raise foreign.Foreign(f"{'/'.join(above)[:80]}... is nested more than {DEEPEST} groups deep")
    for link, item in foreign.children(group):
        if isinstance(item, h5py.Group):
            yield from _datasets(item, (*above, link))
        elif not (isinstance(item, h5py.Dataset) and item.is_scale):
            dataset = foreign.dataset(group, link, rows=0)
            yield "/".join((*above[1:], foreign.text_of(dataset, VARIABLE, link))), (*above, link)
