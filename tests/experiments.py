"""Experiments as dictionaries to change, and as the text of a file."""

import copy
import json
from pathlib import Path

EXPERIMENTS = Path(__file__).parent.parent / "experiments"


def single(fmu, stop_time=0.05, step=0.01, name="one", **parameters):
    """An experiment of one component that needs no input."""
    component = {"fmu": str(fmu), "parameters": parameters, "start": "fmu"}
    return {"master": {"stop_time": stop_time, "step": step}, "components": {name: component}}


def merged(table, changes):
    """The table with {dotted key: value} laid over it; None deletes.  Keys of [connections] stand whole."""
    table = copy.deepcopy(table)
    for key, value in changes.items():
        first, _, rest = key.partition(".")
        *above, last = [first, *([rest] if first == "connections" else rest.split("."))] if rest else [first]
        node = table
        for part in above:
            node = node.setdefault(part, {})
        if value is None:
            del node[last]
        else:
            node[last] = value
    return table


def toml(value):
    """A value as TOML, tables inline."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(below)}" for key, below in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)
