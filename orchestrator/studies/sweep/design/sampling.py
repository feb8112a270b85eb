"""Draws of the distributions of a sweep.

With "random" and "lhs" the numbers of a key are seeded by the sweep's seed and the key, whatever the other keys are;
with "sobol" a draw is one point for all keys, in the order of their names.  With "random" and "sobol" draw k does not
depend on how many draws there are; with "lhs" it does.
"""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np

from ....arrays import Reals

ULP = 2.0**-53  # the largest number below 1 is 1 - ULP


class Vector(dict[str, float]):
    """A drawn value with axes: {axis: number}."""


def draw(distributions: Mapping[str, Mapping[str, Any]], method: str, n: int, seed: int) -> dict[str, list[Any]]:
    """n draws of each distribution, {key: values}.

    distributions: {key: its table}; method: `design` of [sweep]; n: of draws.
    """
    coordinates = {key: _coordinates(distributions[key]) for key in sorted(distributions)}
    names = [f"{key}/{i}" for key, count in coordinates.items() for i in range(count)]
    columns = iter(_SAMPLERS[method](names, n, seed))
    return {
        key: _values(distributions[key], [np.clip(next(columns), ULP, 1 - ULP) for _ in range(count)])
        for key, count in coordinates.items()
    }


def _coordinates(table: Mapping[str, Any]) -> int:
    """How many numbers in (0, 1) one draw of a distribution takes."""
    return len(table["axes"]) if table["distribution"] == "direction" else 1


def _raw(name: str, seed: int) -> Callable[[int], Reals]:
    """The stream of a name: of n it makes (n,) numbers in (0, 1).

    It uses only what numpy promises never to change: seeding and raw bits.
    """
    entropy = int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest(), "big")
    bits = np.random.PCG64(entropy)
    return lambda n: ((bits.random_raw(n) >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52


def _random(names: Sequence[str], n: int, seed: int) -> Iterator[Reals]:
    return (_raw(name, seed)(n) for name in names)


def _lhs(names: Sequence[str], n: int, seed: int) -> Iterator[Reals]:
    """One number in each of n cells of equal width, the cells in a random order for each name."""
    for name in names:
        stream = _raw(name, seed)
        order = np.argsort(np.argsort(stream(n), kind="stable"), kind="stable")
        yield (order + stream(n)) / n


def _sobol(names: Sequence[str], n: int, seed: int) -> Iterator[Reals]:
    """Scrambled Sobol points, one dimension for each name."""
    if not names:
        return iter(())
    from scipy.stats import qmc

    entropy = int.from_bytes(hashlib.sha256(f"{seed}/sobol".encode()).digest(), "big")
    engine = qmc.Sobol(len(names), scramble=True, rng=np.random.Generator(np.random.PCG64(entropy)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # n may be any number; `prepared` notes which ones balance
        points = engine.random(n)
    return iter(points.T)


_SAMPLERS: dict[str, Callable[[Sequence[str], int, int], Iterator[Reals]]] = {
    "random": _random,
    "lhs": _lhs,
    "sobol": _sobol,
}


def _values(table: Mapping[str, Any], columns: Sequence[Reals]) -> list[Any]:
    """Draws of a distribution: the inverse of its distribution function, at numbers in (0, 1).  columns: each (n,)."""
    u = columns[0].tolist()
    match table["distribution"]:
        case "uniform":
            return [table["low"] + p * (table["high"] - table["low"]) for p in u]
        case "loguniform":
            low, high = math.log(table["low"]), math.log(table["high"])
            return [math.exp(low + p * (high - low)) for p in u]
        case "normal":
            normal = NormalDist(table["mean"], table["std"])
            return [normal.inv_cdf(p) for p in u]
        case "integer":
            return [table["low"] + int(p * (table["high"] - table["low"] + 1)) for p in u]
        case "choice":
            return [table["values"][int(p * len(table["values"]))] for p in u]
    return [_direction(table, list(p)) for p in zip(*(column.tolist() for column in columns), strict=True)]


def _direction(table: Mapping[str, Any], p: Sequence[float]) -> Vector:
    """A vector in any direction, its length uniform from low to high."""
    length, angle = table["low"] + p[0] * (table["high"] - table["low"]), 2 * math.pi * p[1]
    height = 2 * p[2] - 1 if len(p) == 3 else 0.0  # Archimedes: uniform on the sphere
    flat = length * math.sqrt(1 - height * height)
    return Vector(zip(table["axes"], (flat * math.cos(angle), flat * math.sin(angle), length * height), strict=False))
