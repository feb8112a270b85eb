"""MATLAB's format 5: a struct for each component, whose fields are its signals: `vehicle1.eta_x`.

A vector is also a field: `vehicle1.eta` is (N, 6).  `units`, `names` and `axes` are structs of the same shape: units,
names in the record, and the axes that the columns of a vector are; `run` holds the facts.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat
from scipy.io.matlab import MatWriteError

from ...errors import StoreError
from ...names import split_axis
from .content import Content, Signal, unique, vectors

LONGEST = 63  # characters of a name in MATLAB
KEYWORDS = {
    "break",
    "case",
    "catch",
    "classdef",
    "continue",
    "else",
    "elseif",
    "end",
    "for",
    "function",
    "global",
    "if",
    "otherwise",
    "parfor",
    "persistent",
    "return",
    "spmd",
    "switch",
    "try",
    "while",
}
TEXT = 116  # bytes of the text that a file begins with; scipy writes the date there
ABOUT = ("units", "names", "axes")

Struct = dict[str, Any]


def write(content: Content, target: Path) -> None:
    """Raises StoreError where a component is larger than the format holds."""
    whole: dict[str, Struct] = {name: {} for name in ABOUT}
    taken = {"time", "run", *ABOUT}
    variables: dict[str, Any] = {}
    for component in content.components:
        name = _valid(component, taken)
        variables[name], units, names, axes = _structs(content.of(component))
        for about, struct in zip(ABOUT, (units, names, axes), strict=True):
            whole[about][name] = struct
    whole["units"]["time"] = "s"
    facts = {name[:LONGEST]: value for name, value in content.facts.items()}
    try:
        with target.open("wb") as file:
            savemat(
                file,
                {"time": content.time, **variables, **whole, "run": facts},
                long_field_names=True,
                do_compression=True,
                oned_as="column",
            )
            file.seek(0)
            file.write(f"MATLAB 5.0 MAT-file, written by orch of run {content.run.run_id}".encode().ljust(TEXT)[:TEXT])
    except MatWriteError as error:
        raise StoreError(f"{content.run.path} is larger than the MAT format holds, {error}; try parquet") from None


def _structs(signals: list[Signal]) -> tuple[Struct, Struct, Struct, Struct]:
    """Values, units, names and axes of a component, each by field."""
    values: Struct = {}
    units: Struct = {}
    names: Struct = {}
    axes: Struct = {}
    taken: set[str] = set()
    fields = {signal.variable: _valid(signal.variable, taken) for signal in signals}
    for signal in signals:
        field = fields[signal.variable]
        values[field], units[field], names[field] = signal.values, signal.unit, signal.name
    for head, members in vectors(signals).items():
        field = _valid(head, taken)
        values[field] = np.column_stack([values[fields[member.variable]] for member in members])
        units[field] = _common([member.unit for member in members])
        names[field] = f"{members[0].component}.{head}"
        axes[field] = np.array([split_axis(member.variable)[1] for member in members], object)
    return values, units, names, axes


def _common(texts: list[str]) -> Any:
    """The text, where all are the same, else a cell array of them."""
    return texts[0] if len(set(texts)) == 1 else np.array(texts, object)


def _valid(name: str, taken: set[str]) -> str:
    """A name that MATLAB accepts: letters, digits and underscores, a letter first, at most LONGEST characters."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).rstrip("_")
    if plain in KEYWORDS or not re.match("[A-Za-z]", plain):
        plain = f"x_{plain}".replace("__", "_")
    return unique(plain, taken, LONGEST)
