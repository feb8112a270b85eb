"""What tells runs apart, in a few words for a legend."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ...names import split_axis

if TYPE_CHECKING:
    from ..file.run import Run

SHOWN = 3  # words of a label
Key = tuple[str, str]  # component (or "master") and variable; the variable of an FMU's name is ""


def differences(runs: Sequence[Run]) -> list[str]:
    """For each run what differs from the others: "pid", "controller.K_p.z = 60"; "" where nothing does."""
    resolved = [run.attributes.get("experiment_resolved", {}) for run in runs]
    settings = [_settings(r) for r in resolved]
    keys = [key for key in dict.fromkeys(k for s in settings for k in s) if len({s.get(key) for s in settings}) > 1]
    # Where the FMU is another, so are its parameters.
    swapped = {component for component, variable in keys if not variable}
    keys = [(component, variable) for component, variable in keys if not variable or component not in swapped]
    if not keys:
        builds = [_builds(r) for r in resolved]
        keys = [key for key in builds[0] if len({b.get(key) for b in builds}) > 1]
        settings = builds
    return [_label(keys, s) for s in settings]


def _settings(resolved: Mapping[str, Any]) -> dict[Key, str]:
    """{key: value as text} of what decides the numbers, FMUs first."""
    components = resolved.get("components", [])
    settings = {(c["name"], ""): str(c["fmu"]) for c in components}
    for component in components:
        vectors: dict[str, dict[str, Any]] = {}
        for name, value in [*component["parameters"].items(), *component["start"].items()]:
            head, axis = split_axis(name)
            vectors.setdefault(head, {})[axis] = value
        for head, axes in vectors.items():
            values = ", ".join(map(_text, axes.values()))
            if len(axes) > 1:
                settings[component["name"], head] = f"({values})"
            else:
                settings[component["name"], ".".join(filter(None, (head, *axes)))] = values
    for name, value in resolved.get("master", {}).items():
        settings["master", name] = _text(value) + (" s" if name in ("step", "stop_time") else "")
    return settings


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


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
