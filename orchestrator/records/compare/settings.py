"""What made a run, as flat settings, and which of several tables of values differ: one place for both.

Who compares what, all with `differing`:

    bits           two records of one plan: their rows bit for bit, and how they ended (`orch rerun --verify`)
    diff           two records: all that differs but clocks, named in full (`orch diff`)
    labels         many records: a few words that tell one from the others, for legends and tables
    alike          many records: whether a metric has one definition, window, step and beginning in all
    side_by_side   many records: their metrics, which is the best (`orch compare`)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

Setting = tuple[str, ...]  # such as ("components", "controller", "parameters", "K_p.z")

Name = TypeVar("Name")


def settings(resolved: Mapping[str, Any]) -> dict[Setting, Any]:
    """{setting: value} of all that decides the numbers of a run, from its attribute `experiment_resolved`.

    A connection is its output, "vehicle.eta.x", or where it is scaled "0.5 * vehicle.eta.x +1".
    """
    components = {c["name"]: {k: v for k, v in c.items() if k != "name"} for c in resolved.get("components", ())}
    connections = {sink: _scaled(*source) for sink, *source in resolved.get("connections", ())}
    made = {"master": resolved.get("master", {}), "components": components, "connections": connections}
    return dict(flat({**made, "record": resolved.get("record", {}), "from": resolved.get("from", {})}))


def flat(table: Mapping[str, Any], above: Setting = ()) -> Iterator[tuple[Setting, Any]]:
    """The values of nested tables, each with the keys that lead to it."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from flat(value, (*above, name))
        else:
            yield (*above, name), value


def differing(tables: Sequence[Mapping[Name, Any]]) -> list[Name]:
    """The names whose values are not the same in all tables, in order; a table that lacks one has None."""
    names = dict.fromkeys(name for table in tables for name in table)
    return [name for name in names if any(table.get(name) != tables[0].get(name) for table in tables[1:])]


def _scaled(source: str, factor: float = 1.0, offset: float = 0.0) -> str:
    scaled = source if factor == 1.0 else f"{factor:.12g} * {source}"
    return f"{scaled} {offset:+.12g}" if offset else scaled
