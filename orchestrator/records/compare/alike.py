"""Whether a metric of several runs is one metric: same definition, window, communication step and beginning."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .labels import text
from .settings import differing

if TYPE_CHECKING:
    from _typeshed import SupportsRichComparison

WINDOW = ("after", "before")


def unlike(name: str, resolved: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """What is not the same in all runs, with the values that it has: {"step": ["0.001 s", "0.002 s"]}; {} where alike.

    name: of a metric that each run has; resolved: the attribute `experiment_resolved` of each.
    """
    conditions = [_conditions(name, of) for of in resolved]
    keys = differing(conditions)
    if any(key in WINDOW for key in keys):
        keys = [key for key in keys if key != "window"]
    return {key: sorted({of.get(key, "none") for of in conditions}, key=_in_order) for key in keys}


def in_words(differences: Mapping[str, Sequence[str]]) -> str:
    """step = 0.001 s or 0.002 s, window = 0 to 5 s or 0 to 10 s"""
    return ", ".join(f"{key} = {' or '.join(values)}" for key, values in differences.items())


def _conditions(name: str, resolved: Mapping[str, Any]) -> dict[str, str]:
    """What a metric depends on beside what happens in the run."""
    spec, master, origin = resolved["metrics"][name], resolved["master"], resolved.get("from")
    begin = max(origin["time"] if origin else 0.0, spec.get("after", 0.0))
    end = min(master["stop_time"], spec.get("before", math.inf))
    begins = "the beginning"
    if origin:
        begins = f"run {origin['run_id']} at {origin['time']:.10g} s (checkpoint {origin['checkpoint_sha256'][:7]})"
    conditions = {key: text(value) for key, value in spec.items()}
    return {**conditions, "window": f"{begin:.10g} to {end:.10g} s", "step": f"{master['step']:g} s", "from": begins}


def _in_order(text: str) -> SupportsRichComparison:
    """Key that sorts numbers by their size, before words."""
    try:
        return 0, float(text.removesuffix(" s")), text
    except ValueError:
        return 1, 0.0, text
