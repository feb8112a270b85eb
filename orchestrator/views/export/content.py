"""What is exported of a record: its signals, and the facts of the run."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ...fmu.variables import ANGLE
from ...names import split_axis
from ...records.file.run import Run

if TYPE_CHECKING:
    from ...arrays import Reals, Table

# Attributes that are exported: those that are the same whenever and wherever the run is repeated.
FACTS = (
    "run_id",
    "digest",
    "title",
    "experiment",
    "status",
    "error",
    "failed_at",
    "interrupted_at",
    "stopped_at",
    "algorithm",
    "step",
    "seed",
    "experiment_toml",
    "experiment_resolved",
    "metrics",
    "metrics_never",
    "metrics_of",
    "warnings",
    "warning_kinds",
)


@dataclass(frozen=True)
class Signal:
    """A recorded variable.  kind: real, integer, boolean or string; unit: "1" where it has none."""

    run: Run
    component: str
    variable: str
    kind: str
    unit: str
    long_name: str
    causality: str

    @property
    def name(self) -> str:
        return f"{self.component}.{self.variable}"

    @property
    def head(self) -> str:
        """vehicle1.eta.x [m]; the name alone where there is no unit."""
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    @property
    def values(self) -> Table:
        """(N,), or (N, *shape) of an array: numbers as recorded, bool, or object for texts."""
        values: Table = self.run[self.name]
        return values.astype({"boolean": bool, "string": object}.get(self.kind, values.dtype))

    @property
    def about(self) -> dict[str, str]:
        """Its attributes, named as in the record."""
        about = {"units": self.unit, "long_name": self.long_name, "causality": self.causality}
        return about | ({"quantity": ANGLE} if self.run.is_angle(self.name) else {})

    def columns(self) -> Iterator[tuple[str, Table]]:
        """Its (N,) columns, each with the suffix of its name: none, or [1], [2], ... for the elements of an array."""
        values = self.values
        for index in np.ndindex(values.shape[1:]):
            place = ",".join(str(i + 1) for i in index)
            yield (f"[{place}]" if place else ""), values[(slice(None), *index)]


@dataclass(frozen=True)
class Content:
    """time: (N,) [s]."""

    run: Run
    time: Reals
    signals: list[Signal]

    @cached_property
    def facts(self) -> dict[str, str | float | int]:
        """FACTS that the record has, JSON as text."""
        attributes = self.run.attributes | {"status": self.run.status}
        facts = {name: attributes[name] for name in FACTS if attributes.get(name) not in (None, "")}
        return {k: json.dumps(v, ensure_ascii=False) if isinstance(v, dict | list) else v for k, v in facts.items()}

    def of(self, component: str) -> list[Signal]:
        return [signal for signal in self.signals if signal.component == component]

    @property
    def components(self) -> list[str]:
        return list(dict.fromkeys(signal.component for signal in self.signals))


def read(run: Run) -> Content:
    return Content(run, run.time, [_signal(run, name) for name in run.signals])


def _signal(run: Run, name: str) -> Signal:
    component, _, variable = name.partition(".")
    dtype = run.dtype(name)
    if dtype.kind == "O":
        kind = "string"
    else:
        kind = "boolean" if dtype == np.int8 else "real" if dtype.kind == "f" else "integer"
    unit, long_name, causality = run.units(name), run.about(name, "long_name", variable), run.about(name, "causality")
    return Signal(run, component, variable, kind, unit, long_name, causality)


def vectors(signals: Sequence[Signal]) -> dict[str, list[Signal]]:
    """{"eta": the signals of its axes} of scalar signals of one component that are numbers and share a vector."""
    groups: dict[str, list[Signal]] = {}
    for signal in signals:
        head, axis = split_axis(signal.variable)
        if axis and signal.kind == "real":
            groups.setdefault(head, []).append(signal)
    return {head: axes for head, axes in groups.items() if len(axes) > 1}


def unique(name: str, taken: set[str], longest: int = 1 << 16) -> str:
    """The name, cut and numbered so that it differs from those in `taken`, to which it is added."""
    chosen, k = name[:longest], 1
    while chosen in taken:
        k += 1
        chosen = f"{name[: longest - len(str(k)) - 1]}_{k}"
    taken.add(chosen)
    return chosen
