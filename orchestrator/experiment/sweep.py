"""[sweep]: what varies from run to run, and in how many draws.  `studies.sweep` runs it.

A key of [sweep.vary] has a list of values, or a distribution.  Every draw of the distributions meets every combination
of the lists.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..errors import Problem, did_you_mean
from .keys import split_key

KEYS = ("draws", "skip", "design", "seed", "keep", "vary", "zip", "tune")
DESIGNS = ("random", "lhs", "sobol")
KEEP = ("full", "decimated", "metrics")
DISTRIBUTIONS = {  # {name: the keys it needs}
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
    "normal": ("mean", "std"),
    "integer": ("low", "high"),
    "choice": ("values",),
    "direction": ("axes", "low", "high"),
}
SUCH_AS = 'such as "components.controller.fmu" = ["pid", "mfsosmc"]'

# Keys whose values change together, and their rows of values.
Group = tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]]


@dataclass(frozen=True, kw_only=True)
class SweepSpec:
    """A [sweep] that was read.

    draws: of the distributions; 0 where a [sweep.tune] stands for it.  skip: how many draws are left out before the
    first.  design: how they are drawn, one of DESIGNS.  keep: which rows a record keeps, one of KEEP.  lists: the keys
    that have lists, those that `zip` joins in one group.  distributions: {key: its table}.
    """

    draws: int
    skip: int
    design: str
    seed: int
    keep: str
    lists: tuple[Group, ...]
    distributions: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def read(table: Mapping[str, Any]) -> tuple[SweepSpec, list[Problem]]:
    """The sweep that a table [sweep] describes, and everything that is wrong with the table but for [sweep.tune]."""
    reader = SectionReader("sweep")
    reader.known(table, KEYS)
    lists, distributions = varying(reader, table.get("vary", {}))
    spec = SweepSpec(
        draws=_draws(reader, table, bool(distributions)),
        skip=reader.whole(table, "skip", 0, 0),
        design=reader.one_of(table, "design", DESIGNS),
        seed=reader.whole(table, "seed", 0, None),
        keep=reader.one_of(table, "keep", KEEP),
        lists=_groups(reader, table.get("zip", []), lists, distributions),
        distributions=distributions,
    )
    if "tune" not in table:
        reader.problems += [p for p in incomplete(spec) if p.key != "sweep.vary" or not table.get("vary")]
    return spec, reader.problems


def incomplete(spec: SweepSpec) -> list[Problem]:
    """What a sweep needs and a search for parameters does not."""
    problems = []
    if not spec.lists and not spec.distributions:
        problems.append(Problem("sweep.vary", f"is missing; say what varies, {SUCH_AS}"))
    if not spec.draws:
        problems.append(Problem("sweep.draws", "is missing; say how many draws of the distributions to run"))
    return problems


class SectionReader:
    """Reads one section of an experiment file.  `problems`: what is wrong with it."""

    def __init__(self, section: str):
        self._section = section
        self.problems: list[Problem] = []

    def problem(self, key: str, sentence: str) -> None:
        self.problems.append(Problem(f"{self._section}.{key}" if key else self._section, sentence))

    def known(self, table: Mapping[str, Any], keys: Sequence[str]) -> None:
        """Every key of the table is one of `keys`."""
        for key in table:
            if key not in keys:
                self.problem(key, f"unknown key{did_you_mean(key, keys)}")

    def whole(self, table: Mapping[str, Any], key: str, default: int | None, least: int | None) -> int:
        """A whole number.  default: None where it has to be given."""
        value = table.get(key, default)
        if isinstance(value, int) and not isinstance(value, bool) and (least is None or value >= least):
            return value
        given = f"is {value!r}" if key in table else "is missing"
        self.problem(key, f"{given}; give a whole number" + (f", at least {least}" if least is not None else ""))
        return default or least or 0

    def one_of(self, table: Mapping[str, Any], key: str, choices: tuple[str, ...]) -> str:
        """One of several words, by default the first."""
        value = table.get(key, choices[0])
        if value not in choices:
            self.problem(key, f"no {value!r}{did_you_mean(str(value), choices)}")
            return choices[0]
        return str(value)

    def distribution(self, key: str, table: Mapping[str, Any]) -> None:
        """A distribution has what it needs.  key: its dotted key below the section."""
        name = table["distribution"]
        if not isinstance(name, str) or name not in DISTRIBUTIONS:
            self.problem(f"{key}.distribution", f"no {name!r}{did_you_mean(str(name), DISTRIBUTIONS)}")
            return
        needs = DISTRIBUTIONS[name]
        for given in table:
            if given not in ("distribution", *needs):
                self.problem(f"{key}.{given}", f"{name} takes no {given!r}{did_you_mean(given, needs)}")
        for need in needs:
            if need not in table:
                self.problem(f"{key}.{need}", "is missing")
        numbers = [need for need in needs if need in table and need not in ("values", "axes")]
        for number in numbers:
            value = table[number]
            fits = isinstance(value, int) or (isinstance(value, float) and name != "integer" and math.isfinite(value))
            if isinstance(value, bool) or not fits:
                what = "whole number" if name == "integer" else "finite number"
                self.problem(f"{key}.{number}", f"is {value!r}, not a {what}")
                return
        if {"low", "high"} <= set(numbers) and not table["low"] < table["high"]:
            self.problem(f"{key}.low", f"is {table['low']}, not below high = {table['high']}")
        if name == "loguniform" and "low" in table and table["low"] <= 0:
            self.problem(f"{key}.low", f"is {table['low']}; a logarithm needs a positive number")
        if name == "direction" and "low" in table and table["low"] < 0:
            self.problem(f"{key}.low", f"is {table['low']}; it is the length of a vector")
        if name == "normal" and "std" in table and table["std"] <= 0:
            self.problem(f"{key}.std", f"is {table['std']}; give a positive number")
        if name == "choice" and "values" in table and not (isinstance(table["values"], list) and table["values"]):
            self.problem(f"{key}.values", f"is {table['values']!r}; give a list of values to draw from")
        axes = table.get("axes", ["x", "y"])
        if name == "direction" and not (
            isinstance(axes, list) and len(axes) in (2, 3) and all(isinstance(axis, str) for axis in axes)
        ):
            self.problem(f"{key}.axes", f'is {axes!r}; give two or three axes, such as ["x", "y"]')


def varying(reader: SectionReader, table: Any) -> tuple[dict[str, tuple[Any, ...]], dict[str, Mapping[str, Any]]]:
    """The lists and the distributions of a table `vary`."""
    lists: dict[str, tuple[Any, ...]] = {}
    distributions: dict[str, Mapping[str, Any]] = {}
    if not isinstance(table, dict):
        reader.problem("vary", f"is {table!r}; say what varies, {SUCH_AS}")
        return lists, distributions
    for key, value in table.items():
        where = f'vary."{key}"'
        if not split_key(key):
            reader.problem(where, "is no dotted key, such as master.seed")
        elif isinstance(value, list):
            if not value:
                reader.problem(where, "is an empty list; name the values to run")
            lists[key] = tuple(value)
        elif isinstance(value, dict) and "distribution" in value:
            reader.distribution(where, value)
            distributions[key] = value
        else:
            hint = 'give a list of values, or a table such as { distribution = "uniform", low = 0.0, high = 1.0 }'
            reader.problem(where, f"is {value!r}; {hint}")
    parts = {key: split_key(key) for key in [*lists, *distributions]}
    for one, other in itertools.permutations(parts, 2):  # they would overwrite each other
        n = len(parts[one])
        if parts[other][:n] == parts[one] and (len(parts[other]) > n or one < other):
            reader.problem(f'vary."{other}"', f"lies in {one!r}, which varies too; keep one of them")
    return lists, distributions


def _draws(reader: SectionReader, table: Mapping[str, Any], random: bool) -> int:
    if random and "draws" not in table:
        return 0
    draws = reader.whole(table, "draws", 1, 1)
    if not random and draws != 1:
        reader.problem(
            "draws",
            f"is {draws}, but no value in sweep.vary is a distribution: all would be one run; "
            'leave it out, or vary "master.seed" by { distribution = "integer", ... }',
        )
    return draws


def _groups(
    reader: SectionReader,
    zipped: Any,
    lists: Mapping[str, tuple[Any, ...]],
    distributions: Mapping[str, Mapping[str, Any]],
) -> tuple[Group, ...]:
    """The lists in the order of the file, those that `zip` joins as one."""
    if not (
        isinstance(zipped, list)
        and all(isinstance(group, list) and all(isinstance(key, str) for key in group) for group in zipped)
    ):
        reader.problem("zip", f'is {zipped!r}; give lists of keys, such as [["master.step", "record.every"]]')
        zipped = []
    joined: dict[str, tuple[str, ...]] = {}
    for group in zipped:
        for key in group:
            if key in distributions:
                reader.problem("zip", f"{key!r} is a distribution; only lists can be zipped")
            elif key not in lists:
                reader.problem("zip", f"no list {key!r} in sweep.vary{did_you_mean(key, lists)}")
            elif key in joined:
                reader.problem("zip", f"{key!r} is in it twice")
            else:
                joined[key] = tuple(group)
        lengths = {key: len(lists[key]) for key in group if key in lists}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{key} has {n}" for key, n in lengths.items())
            reader.problem("zip", f"lists of different lengths: {listed} values")
    groups: dict[tuple[str, ...], tuple[tuple[Any, ...], ...]] = {}
    for key in lists:
        keys = tuple(k for k in joined.get(key, (key,)) if k in lists)
        rows = tuple(zip(*(lists[k] for k in keys), strict=False))
        if keys not in groups and (row := next((r for i, r in enumerate(rows) if r in rows[:i]), None)) is not None:
            twice = row[0] if len(row) == 1 else row
            reader.problem(f'vary."{key}"', f"has {twice!r} twice; the two would be the same run")
        groups.setdefault(keys, rows)
    return tuple(groups.items())
