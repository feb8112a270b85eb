"""[sweep]: what varies from run to run, and in how many draws.  `studies.sweep` runs it.

A key of [sweep.vary] has a list of values, or a distribution.  Every draw of the distributions meets every combination
of the lists.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..errors import Problem, did_you_mean
from .keys import split_key
from .schema.sections import DISTRIBUTION, SWEEP
from .schema.value_types import is_whole

SUCH_AS = 'such as "components.controller.fmu" = ["pid", "mfsosmc"]'

# Keys whose values change together, and their rows of values.
Group = tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]]


@dataclass(frozen=True, kw_only=True)
class SweepSpec:
    """A [sweep] that was read.

    draws: of the distributions; 0 where a [sweep.tune] stands for it.  skip: how many draws are left out before the
    first.  design: how they are drawn.  keep: which rows a record keeps.  lists: the keys
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
    values, problems = SWEEP.read(table, "sweep")
    lists, distributions, vary_problems = varying(values.get("vary", {}))
    groups, zip_problems = _groups(values["zip"], lists, distributions)
    draws = values.get("draws", 0 if distributions and "draws" not in table else 1)
    if not distributions and draws != 1:
        words = (
            f"is {draws}, but no value in sweep.vary is a distribution: all would be one run; "
            'leave it out, or vary "master.seed" by { distribution = "integer", ... }'
        )
        problems.append(Problem("sweep.draws", words))
    spec = SweepSpec(
        draws=draws,
        skip=values["skip"],
        design=values["design"],
        seed=values["seed"],
        keep=values["keep"],
        lists=groups,
        distributions=distributions,
    )
    problems += vary_problems + zip_problems
    if not table.get("tune"):
        problems += [p for p in incomplete(spec) if p.key != "sweep.vary" or not table.get("vary")]
    return spec, problems


def incomplete(spec: SweepSpec) -> list[Problem]:
    """What a sweep needs and a search for parameters does not."""
    problems = []
    if not spec.lists and not spec.distributions:
        problems.append(Problem("sweep.vary", f"is missing; say what varies, {SUCH_AS}"))
    if not spec.draws:
        problems.append(Problem("sweep.draws", "is missing; say how many draws of the distributions to run"))
    return problems


def distribution_problems(key: str, table: Mapping[str, Any]) -> list[Problem]:
    """What is wrong with a distribution.  key: its dotted key."""
    values, problems = DISTRIBUTION.read(table, key)
    name, low, high = values.get("distribution"), values.get("low"), values.get("high")
    if name == "integer":
        problems += [
            Problem(f"{key}.{end}", f"is {table[end]!r}, not a whole number")
            for end in ("low", "high")
            if end in values and not is_whole(table[end])
        ]
    if low is not None and high is not None and not low < high:
        problems.append(Problem(f"{key}.low", f"is {table['low']}, not below high = {table['high']}"))
    if name == "loguniform" and low is not None and low <= 0:
        problems.append(Problem(f"{key}.low", f"is {table['low']}; a logarithm needs a positive number"))
    if name == "direction" and low is not None and low < 0:
        problems.append(Problem(f"{key}.low", f"is {table['low']}; it is the length of a vector"))
    return problems


def varying(
    table: Mapping[str, Any],
) -> tuple[dict[str, tuple[Any, ...]], dict[str, Mapping[str, Any]], list[Problem]]:
    """The lists and the distributions of a table `vary`, and what is wrong with them."""
    lists: dict[str, tuple[Any, ...]] = {}
    distributions: dict[str, Mapping[str, Any]] = {}
    problems: list[Problem] = []
    by_parts: dict[tuple[str, ...], str] = {}
    for key, value in table.items():
        where, parts = f'sweep.vary."{key}"', tuple(split_key(key))
        if not parts:
            problems.append(Problem(where, "is not a dotted key, such as master.seed"))
            continue
        if (other := by_parts.setdefault(parts, key)) != key:
            problems.append(Problem(where, f"is {other!r} in other words; keep one of them"))
        if isinstance(value, list):
            if not value:
                problems.append(Problem(where, "is an empty list; name the values to run"))
            lists[key] = tuple(value)
        elif isinstance(value, dict) and "distribution" in value:
            problems += distribution_problems(where, value)
            distributions[key] = value
        else:
            hint = 'give a list of values, or a table such as { distribution = "uniform", low = 0.0, high = 1.0 }'
            problems.append(Problem(where, f"is {value!r}; {hint}"))
    for parts, key in by_parts.items():
        outer = [by_parts[parts[:n]] for n in range(1, len(parts)) if parts[:n] in by_parts]
        if outer:  # they would overwrite each other
            problems.append(Problem(f'sweep.vary."{key}"', f"lies in {outer[0]!r}, which varies too; keep one of them"))
    return lists, distributions, problems


def _groups(
    zipped: Sequence[Sequence[str]],
    lists: Mapping[str, tuple[Any, ...]],
    distributions: Mapping[str, Mapping[str, Any]],
) -> tuple[tuple[Group, ...], list[Problem]]:
    """The lists in the order of the file, those that `zip` joins as one."""
    problems: list[Problem] = []
    joined: dict[str, tuple[str, ...]] = {}
    for group in zipped:
        for key in group:
            if key in distributions:
                problems.append(Problem("sweep.zip", f"{key!r} is a distribution; only lists can be zipped"))
            elif key not in lists:
                problems.append(Problem("sweep.zip", f"no list {key!r} in sweep.vary{did_you_mean(key, lists)}"))
            elif key in joined:
                problems.append(Problem("sweep.zip", f"{key!r} is in it twice"))
            else:
                joined[key] = tuple(group)
        lengths = {key: len(lists[key]) for key in group if key in lists}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{key} has {n}" for key, n in lengths.items())
            problems.append(Problem("sweep.zip", f"lists of different lengths: {listed} values"))
    groups: dict[tuple[str, ...], tuple[tuple[Any, ...], ...]] = {}
    for key in lists:
        keys = tuple(k for k in joined.get(key, (key,)) if k in lists)
        rows = tuple(zip(*(lists[k] for k in keys), strict=False))
        if keys not in groups and (row := next((r for i, r in enumerate(rows) if r in rows[:i]), None)) is not None:
            twice = row[0] if len(row) == 1 else row
            problems.append(Problem(f'sweep.vary."{key}"', f"has {twice!r} twice; the two would be the same run"))
        groups.setdefault(keys, rows)
    return tuple(groups.items()), problems
