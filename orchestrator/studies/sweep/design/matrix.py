"""The table of runs of a sweep: draws of the distributions, crossed with every value of every list."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ....errors import Problem, did_you_mean
from ....experiment.experiment import split_key
from . import sampling
from .sampling import DESIGNS, Vector

KEEP = ("full", "decimated", "metrics")
DISTRIBUTIONS = {  # {name: the keys it needs}
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
    "normal": ("mean", "std"),
    "integer": ("low", "high"),
    "choice": ("values",),
    "direction": ("axes", "low", "high"),
}
KEYS = ("draws", "skip", "design", "seed", "keep", "vary", "zip", "tune")


def cells_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """{dotted key: value}, those with axes one a cell: other axes stay what the file says."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        is_vector = isinstance(value, Vector)
        found |= {f"{key}.{axis}": component for axis, component in value.items()} if is_vector else {key: value}
    return found


@dataclass(frozen=True)
class Run:
    """One line of the table.  draw: from 0; values: {dotted key: value}."""

    index: int
    draw: int
    values: Mapping[str, Any]

    @property
    def cells(self) -> dict[str, Any]:
        """What stands in the table."""
        return cells_of(self.values)


@dataclass(frozen=True)
class Design:
    """A [sweep] that was read.

    lists: the groups of keys whose values change together, each with its rows of values; distributions: {key: its
    table}; skip: how many draws are left out before the first, for they were used elsewhere.
    """

    draws: int
    method: str
    seed: int
    keep: str
    lists: tuple[tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]], ...]
    distributions: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    skip: int = 0

    @property
    def combinations(self) -> list[dict[str, Any]]:
        """{key: value} of every combination of the lists."""
        rows = [values for _, values in self.lists]
        keys = [key for names, _ in self.lists for key in names]
        return [dict(zip(keys, itertools.chain(*chosen), strict=True)) for chosen in itertools.product(*rows)]

    def runs(self) -> list[Run]:
        """Draw by draw, every combination of the lists."""
        numbers = sampling.draw(self.distributions, self.method, self.skip + self.draws, self.seed)
        found: list[Run] = []
        combinations = self.combinations
        for draw in range(self.skip, self.skip + self.draws):
            drawn = {key: numbers[key][draw] for key in self.distributions}
            found += [Run(len(found) + i, draw, {**c, **drawn}) for i, c in enumerate(combinations)]
        return found

    @property
    def identity(self) -> dict[str, Any]:
        """What makes two sweeps the same: not the number of draws where more of them only add to the table."""
        lists = sorted([list(keys), [list(row) for row in rows]] for keys, rows in self.lists)
        return {
            "design": self.method,
            "seed": self.seed,
            "lists": lists,
            "distributions": dict(self.distributions),
            "skip": self.skip,
            "draws": self.draws if self.method == "lhs" else None,
        }


def read(table: Mapping[str, Any]) -> tuple[Design, list[Problem]]:
    """The design that a [sweep] asks for, and everything that is wrong with it."""
    reader = _Reader()
    return reader.design(table), reader.problems


def distribution_problems(key: str, table: Mapping[str, Any]) -> list[Problem]:
    """What is wrong with one distribution.  key: its dotted key below [sweep]."""
    reader = _Reader()
    reader.distribution(key, table)
    return reader.problems


def labels(keys: Sequence[str]) -> dict[str, str]:
    """{key: its last parts, as many as tell it from the others}: "velocity.x" of components.current....velocity.x."""
    components = {key: [p for p in split_key(key) if p not in ("components", "parameters")] for key in keys}
    found = {}
    for key, own in components.items():
        least = 2 if len(own) > 1 else 1
        for n in range(least, len(own) + 1):
            if sum(other[-n:] == own[-n:] for other in components.values()) == 1:
                break
        found[key] = ".".join(own[-n:]) if own else key
    return found if len(set(found.values())) == len(found) else {key: key for key in keys}


class _Reader:
    def __init__(self) -> None:
        self.problems: list[Problem] = []

    def problem(self, key: str, sentence: str) -> None:
        self.problems.append(Problem(f"sweep.{key}" if key else "sweep", sentence))

    def design(self, table: Mapping[str, Any]) -> Design:
        for key in table:
            if key not in KEYS:
                self.problem(key, f"unknown key{did_you_mean(key, KEYS)}")
        vary = table.get("vary", {})
        if not isinstance(vary, dict) or not vary:
            given = "is missing" if "vary" not in table else f"is {vary!r}"
            self.problem("vary", f'{given}; say what varies, such as "components.controller.fmu" = ["pid", "mfsosmc"]')
            vary = {}
        lists, distributions = {}, {}
        for key, value in vary.items():
            where = f'vary."{key}"'
            if not split_key(key):
                self.problem(where, "is no dotted key, such as master.seed")
            elif isinstance(value, list):
                if not value:
                    self.problem(where, "is an empty list; name the values to run")
                lists[key] = tuple(value)
            elif isinstance(value, dict) and "distribution" in value:
                self.distribution(where, value)
                distributions[key] = value
            else:
                hint = 'give a list of values, or a table such as { distribution = "uniform", low = 0.0, high = 1.0 }'
                self.problem(where, f"is {value!r}; {hint}")
        self.overlaps([*lists, *distributions])
        draws = self.draws(table, bool(distributions))
        return Design(
            draws,
            self.one_of(table, "design", DESIGNS),
            self.whole(table, "seed", 0, None),
            self.one_of(table, "keep", KEEP),
            self.groups(table.get("zip", []), lists, distributions),
            distributions,
            self.whole(table, "skip", 0, 0),
        )

    def draws(self, table: Mapping[str, Any], random: bool) -> int:
        if random and "draws" not in table:
            self.problem("draws", "is missing; say how many draws of the distributions to run")
        draws = self.whole(table, "draws", 1, 1)
        if not random and draws != 1:
            self.problem(
                "draws",
                f"is {draws}, but no value in sweep.vary is a distribution: all would be one run; "
                'leave it out, or vary "master.seed" by { distribution = "integer", ... }',
            )
        return draws

    def groups(
        self, zipped: Any, lists: Mapping[str, tuple[Any, ...]], distributions: Mapping[str, Any]
    ) -> tuple[tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]], ...]:
        """The lists, those that `zip` joins as one, in the order of the file."""
        joined: dict[str, tuple[str, ...]] = {}
        fits = isinstance(zipped, list) and all(
            isinstance(group, list) and all(isinstance(key, str) for key in group) for group in zipped
        )
        if not fits:
            self.problem("zip", f'is {zipped!r}; give lists of keys, such as [["master.step", "record.every"]]')
            zipped = []
        for group in zipped:
            for key in group:
                if key in distributions:
                    self.problem("zip", f"{key!r} is a distribution; only lists can be zipped")
                elif key not in lists:
                    self.problem("zip", f"no list {key!r} in sweep.vary{did_you_mean(key, lists)}")
                elif key in joined:
                    self.problem("zip", f"{key!r} is in it twice")
                else:
                    joined[key] = tuple(group)
            lengths = {key: len(lists[key]) for key in group if key in lists}
            if len(set(lengths.values())) > 1:
                told = ", ".join(f"{key} has {n}" for key, n in lengths.items())
                self.problem("zip", f"lists of different lengths: {told} values")
        found: dict[tuple[str, ...], tuple[tuple[Any, ...], ...]] = {}
        for key in lists:
            group = tuple(k for k in joined.get(key, (key,)) if k in lists)
            rows = tuple(zip(*(lists[k] for k in group), strict=False))
            if group not in found and (same := _repeated(rows)) is not None:
                told = same[0] if len(same) == 1 else same
                self.problem(f'vary."{key}"', f"has {told!r} twice; the two would be the same run")
            found.setdefault(group, rows)
        return tuple(found.items())

    def overlaps(self, keys: Sequence[str]) -> None:
        """Two keys of which one lies in the other would overwrite each other."""
        components = {key: split_key(key) for key in keys}
        for one, other in itertools.permutations(keys, 2):
            n = len(components[one])
            if components[other][:n] == components[one] and (len(components[other]) > n or one < other):
                self.problem(f'vary."{other}"', f"lies in {one!r}, which varies too; keep one of them")

    def distribution(self, where: str, table: Mapping[str, Any]) -> None:
        name = table["distribution"]
        if not isinstance(name, str) or name not in DISTRIBUTIONS:
            self.problem(f"{where}.distribution", f"no {name!r}{did_you_mean(str(name), DISTRIBUTIONS)}")
            return
        needs = DISTRIBUTIONS[name]
        for key in table:
            if key not in ("distribution", *needs):
                self.problem(f"{where}.{key}", f"{name} takes no {key!r}{did_you_mean(key, needs)}")
        for key in needs:
            if key not in table:
                self.problem(f"{where}.{key}", "is missing")
        numbers = [key for key in needs if key in table and key not in ("values", "axes")]
        for key in numbers:
            value = table[key]
            fits = isinstance(value, int) or (isinstance(value, float) and name != "integer" and math.isfinite(value))
            if isinstance(value, bool) or not fits:
                what = "whole number" if name == "integer" else "finite number"
                self.problem(f"{where}.{key}", f"is {value!r}, not a {what}")
                return
        if {"low", "high"} <= set(numbers) and not table["low"] < table["high"]:
            self.problem(f"{where}.low", f"is {table['low']}, not below high = {table['high']}")
        if name == "loguniform" and "low" in table and table["low"] <= 0:
            self.problem(f"{where}.low", f"is {table['low']}; a logarithm needs a positive number")
        if name == "direction" and "low" in table and table["low"] < 0:
            self.problem(f"{where}.low", f"is {table['low']}; it is the length of a vector")
        if name == "normal" and "std" in table and table["std"] <= 0:
            self.problem(f"{where}.std", f"is {table['std']}; give a positive number")
        self.items(where, table, name)

    def items(self, where: str, table: Mapping[str, Any], name: str) -> None:
        """The lists of a distribution: the values of a choice, the axes of a direction."""
        if name == "choice" and "values" in table and not (isinstance(table["values"], list) and table["values"]):
            self.problem(f"{where}.values", f"is {table['values']!r}; give a list of values to draw from")
        axes = table.get("axes", ["x", "y"])
        if name == "direction" and not (
            isinstance(axes, list) and len(axes) in (2, 3) and all(isinstance(axis, str) for axis in axes)
        ):
            self.problem(f"{where}.axes", f'is {axes!r}; give two or three axes, such as ["x", "y"]')

    def whole(self, table: Mapping[str, Any], key: str, default: int, least: int | None) -> int:
        value = table.get(key, default)
        if isinstance(value, int) and not isinstance(value, bool) and (least is None or value >= least):
            return value
        self.problem(key, f"is {value!r}; give a whole number" + (f", at least {least}" if least is not None else ""))
        return default

    def one_of(self, table: Mapping[str, Any], key: str, choices: tuple[str, ...]) -> str:
        value = table.get(key, choices[0])
        if value not in choices:
            self.problem(key, f"no {value!r}{did_you_mean(str(value), choices)}")
            return choices[0]
        return str(value)


def _repeated(values: Sequence[Any]) -> Any:
    return next((value for i, value in enumerate(values) if value in values[:i]), None)
