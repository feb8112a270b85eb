"""A few words for each of several runs that tell it from the others, for legends and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...names import split_axis
from .settings import differing, settings

SHOWN = 3  # words of a label
Key = tuple[str, str]  # component (or "master") and variable; the variable of an FMU's name is ""


def labels_of(resolved: Sequence[Mapping[str, Any]]) -> list[str]:
    """For each run what differs from the others: "pid", "controller.K_p.z = 60"; "" where nothing does.

    resolved: the attribute `experiment_resolved` of each run, {} where it has none.
    """
    tables = [_texts(r) for r in resolved]
    keys = differing(tables)
    # Where the FMU is another, so are its parameters.
    swapped = {component for component, variable in keys if not variable}
    keys = [(component, variable) for component, variable in keys if not variable or component not in swapped]
    if not keys:
        tables = [_builds(r) for r in resolved]
        keys = differing(tables)
    return [_label(keys, table) for table in tables]


def _texts(resolved: Mapping[str, Any]) -> dict[Key, str]:
    """{key: value as text} of the FMUs, then of the parameters and start values by vectors, then of the master."""
    fmus: dict[Key, str] = {}
    vectors: dict[tuple[str, str], dict[str, str]] = {}
    master: dict[Key, str] = {}
    for setting, value in settings(resolved).items():
        match setting:
            case ("components", component, "fmu"):
                fmus[component, ""] = str(value)
            case ("components", component, "parameters" | "start", name):
                head, axis = split_axis(name)
                vectors.setdefault((component, head), {})[axis] = text(value)
            case ("components", component, "tolerance"):
                vectors.setdefault((component, "tolerance"), {})[""] = text(value)
            case ("master", name):
                master["master", name] = text(value) + (" s" if name in ("step", "stop_time") else "")
    variables: dict[Key, str] = {}
    for (component, head), axes in vectors.items():
        values = ", ".join(axes.values())
        if len(axes) > 1:
            variables[component, head] = f"({values})"
        else:
            variables[component, ".".join(filter(None, (head, *axes)))] = values
    return fmus | variables | master


def _builds(resolved: Mapping[str, Any]) -> dict[Key, str]:
    """{key: FMU and the beginning of its digest}."""
    return {(c["name"], ""): f"{c['fmu']} {c['fmu_sha256'][:7]}" for c in resolved.get("components", [])}


def _label(keys: Sequence[Key], settings: Mapping[Key, str]) -> str:
    owners: dict[str, list[str]] = {}
    for key in keys:
        component, variable = key
        if variable:
            value = f"= {settings[key]}" if key in settings else "by default"
            owners.setdefault(f"{variable} {value}", []).append(component)
        elif key in settings:
            owners.setdefault(settings[key], [])  # the name of an FMU speaks for itself
    words = [f"{at[0]}.{text}" if len(at) == 1 and at != ["master"] else text for text, at in owners.items()]
    return ", ".join(words[:SHOWN]) + (", …" if len(words) > SHOWN else "")


def text(value: Any) -> str:
    """A value of a setting, as labels show it."""
    return f"{value:g}" if isinstance(value, float) else str(value)
