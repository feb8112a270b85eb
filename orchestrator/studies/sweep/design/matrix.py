"""The design matrix of a sweep: draws of the distributions, crossed with every combination of the lists."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ....experiment.keys import split_key
from ....experiment.sweep import SweepSpec
from . import sampling
from .sampling import Vector


@dataclass(frozen=True)
class DesignPoint:
    """One row of the matrix, which is one run.  index, draw: from 0; values: {dotted key: value}."""

    index: int
    draw: int
    values: Mapping[str, Any]

    @property
    def cells(self) -> dict[str, Any]:
        """What stands in the table."""
        return cells_of(self.values)


def points(spec: SweepSpec) -> list[DesignPoint]:
    """Draw by draw, every combination of the lists."""
    numbers = sampling.draw(spec.distributions, spec.design, spec.skip + spec.draws, spec.seed)
    listed = combinations(spec)
    rows: list[DesignPoint] = []
    for draw in range(spec.skip, spec.skip + spec.draws):
        drawn = {key: numbers[key][draw] for key in spec.distributions}
        rows += [DesignPoint(len(rows) + i, draw, {**values, **drawn}) for i, values in enumerate(listed)]
    return rows


def combinations(spec: SweepSpec) -> list[dict[str, Any]]:
    """{key: value} of every combination of the lists."""
    keys = [key for names, _ in spec.lists for key in names]
    rows = [values for _, values in spec.lists]
    return [dict(zip(keys, itertools.chain(*chosen), strict=True)) for chosen in itertools.product(*rows)]


def cells_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """{dotted key: value}, a vector as one cell an axis: the axes that it lacks stay what the file says."""
    cells: dict[str, Any] = {}
    for key, value in values.items():
        cells |= {f"{key}.{axis}": part for axis, part in value.items()} if isinstance(value, Vector) else {key: value}
    return cells


def identity(spec: SweepSpec) -> dict[str, Any]:
    """What makes two sweeps the same: not the number of draws where more of them only add to the table."""
    lists = sorted([list(keys), [list(row) for row in rows]] for keys, rows in spec.lists)
    return {
        "design": spec.design,
        "seed": spec.seed,
        "lists": lists,
        "distributions": dict(spec.distributions),
        "skip": spec.skip,
        "draws": spec.draws if spec.design == "lhs" else None,
    }


def labels(keys: Sequence[str]) -> dict[str, str]:
    """{key: its last parts, as many as tell it from the others}: "velocity.x" of components.current....velocity.x."""
    parts = {key: [p for p in split_key(key) if p not in ("components", "parameters")] for key in keys}
    short = {}
    for key, own in parts.items():
        least = 2 if len(own) > 1 else 1
        for n in range(least, len(own) + 1):
            if sum(other[-n:] == own[-n:] for other in parts.values()) == 1:
                break
        short[key] = ".".join(own[-n:]) if own else key
    return short if len(set(short.values())) == len(short) else {key: key for key in keys}
