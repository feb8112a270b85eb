"""Reads the record of a run, one HDF5 file.  docs/record.md describes the format; `recorder` writes it."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import h5py
import numpy as np

from ... import warning
from ...errors import StoreError, did_you_mean
from ...experiment.timegrid import TimeGrid
from ...fmu.variables import ANGLE
from ...names import ANGLE_AXES, split_axis
from ...warning import Warned
from .access import PATIENCE, UNREADABLE, first_line, is_locked, opened, patiently
from .format import ENVELOPE, HEARD, JSON
from .marks import Standing, standing_of

if TYPE_CHECKING:
    import pandas as pd

    from ...arrays import Reals, Table

T = TypeVar("T")


class Run:
    """A read-only handle on a record.

    run["vehicle1.eta.x"] is a signal (N,), run["vehicle1.eta"] a vector (N, 6), run.time the times (N,) [s].  An array
    of FMI 3.0 is one signal, run["camera.image"] (N, *shape), and run["camera.image[1,2]"] is one of its elements.
    Raises StoreError where the file is no record.
    """

    def __init__(self, path: str | Path, file: h5py.File | None = None):
        """file: of that path, if it is open already."""
        self.path = Path(path)
        self._signals: list[str] = []
        self._lent = file is not None
        self.file = file or self._open()
        self._length = self._get("the time", lambda file: len(file["time"]))

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
        experiment = self._get("the experiment", lambda file: file.attrs["experiment"])
        return f"<Run {experiment} {self.run_id}: {self.status}, {self._length} rows>"

    def _ipython_key_completions_(self) -> list[str]:
        """Names of vectors and signals: what IPython and Jupyter complete run[" with."""
        vectors = dict.fromkeys(head for head, axis in map(split_axis, self.signals) if axis)
        return [*vectors, *self.signals]

    def __getitem__(self, name: str) -> Table:
        if name in self.signals:
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
        component, _, variable = name.partition(".")

        def values(file: h5py.File) -> Table:
            dataset = file[component][variable]
            is_text = h5py.check_string_dtype(dataset.dtype) is not None
            rows: Table = (dataset.asstr() if is_text else dataset)[: self._length]
            return rows

        return self._get(name, values)

    @property
    def time(self) -> Reals:
        """(N,) [s]."""
        time: Reals = self._get("the time", lambda file: file["time"][: self._length])
        return time

    @property
    def signals(self) -> list[str]:
        """Names of all recorded variables, components in order."""
        if not self._signals:
            self._signals = self._get("the list of signals", _signals)
        return self._signals

    def units(self, name: str) -> str:
        """The unit of a signal, "1" where it has none."""
        component, _, variable = name.partition(".")
        if name not in self.signals and name.endswith("]"):
            variable = variable.rpartition("[")[0]
        return self._get(name, lambda file: str(file[component][variable].attrs["units"]))

    def is_angle(self, name: str) -> bool:
        """Whether differences of a signal are differences on the circle.

        Records of format 1 have no quantities: there it is an axis phi, theta or psi in rad or deg.
        """
        component, _, variable = name.partition(".")

        def judged(file: h5py.File) -> bool:
            stored = file[component][variable].attrs
            if file.attrs["format_version"] > 1:
                return bool(stored.get("quantity") == ANGLE)
            return split_axis(variable)[1] in ANGLE_AXES and stored["units"] in ("rad", "deg")

        return name in self.signals and self._get(name, judged)

    def envelope(self, name: str) -> Reals | None:
        """(N, 2): the least and the largest value of a signal since the row before; None where it is not recorded."""

        def values(file: h5py.File) -> Reals | None:
            component, _, variable = name.partition(".")
            dataset = file.get(f"{ENVELOPE}/{component}/{variable}")
            return None if dataset is None else dataset[: self._length]

        return self._get(f"the envelope of {name}", values)

    def fact(self, component: str, name: str) -> Any:
        """An attribute of a component, such as fmu_sha256 or packaging."""
        return self._get(f"{name} of {component}", lambda file: file[component].attrs[name])

    def heard(self, component: str) -> tuple[Reals, Reals] | None:
        """What a live component received: the times [s] at which it changed (M,), and the values (M, n); or None."""

        def values(file: h5py.File) -> tuple[Reals, Reals] | None:
            group = file.get(f"{HEARD}/{component}")
            return None if group is None else (group["time"][:], group["values"][:])

        return self._get(f"what {component} received", values)

    @property
    def attributes(self) -> dict[str, Any]:
        """The root attributes, JSON decoded."""
        stored = self._get("its attributes", lambda file: dict(file.attrs))
        values = {name: value.item() if isinstance(value, np.generic) else value for name, value in stored.items()}
        return {name: json.loads(value) if name in JSON else value for name, value in values.items()}

    @property
    def resolved(self) -> dict[str, Any]:
        """What ran, every name and value resolved; {} where the record does not say."""
        resolved: dict[str, Any] = self.attributes.get("experiment_resolved", {})
        return resolved

    @property
    def status(self) -> str:
        """completed, failed, interrupted, running, or "interrupted (killed)" where no process writes it any more."""
        status = self._get("its status", lambda file: str(file.attrs["status"]))
        return "interrupted (killed)" if status == "running" and not is_locked(self.path) else status

    @property
    def run_id(self) -> str:
        return self._get("its run id", lambda file: str(file.attrs["run_id"]))

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


def _signals(file: h5py.File) -> list[str]:
    groups = {name: group for name, group in file.items() if isinstance(group, h5py.Group) and not name.startswith("_")}
    return [f"{component}.{variable}" for component, group in groups.items() for variable in _datasets(group)]


def _datasets(group: h5py.Group, above: str = "") -> Iterator[str]:
    """Names of all datasets; a variable whose name contains a slash lies in a group of its own."""
    for name, item in group.items():
        if isinstance(item, h5py.Group):
            yield from _datasets(item, f"{above}{name}/")
        elif not item.is_scale:
            yield above + name
