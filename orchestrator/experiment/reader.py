"""Reads and checks the experiment file.  It knows nothing of FMI.

Problems do not stop the reading: they are gathered in `Experiment.problems`, and joined with those of the FMUs by
`plan.resolve`, so that a user sees all of them at once.
"""

from __future__ import annotations

import copy
import functools
import pickle
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import ExperimentError, Problem, did_you_mean, no_such_file
from . import bounds, mavlink, sweep, tune
from .experiment import ComponentSpec, ConnectionSpec, Experiment, MasterSpec, RecordSpec
from .keys import split_key
from .schema.sections import COMPONENT, COMPONENT_NAME, CONNECTION, EXPERIMENT, MASTER, RECORD, RESERVED
from .schema.value_types import TABLE, is_number
from .timegrid import EXACT, TimeGrid


def load(path: str | Path, set: Mapping[str, Any] | None = None, swap: Mapping[str, str] | None = None) -> Experiment:
    """Read an experiment file.

    set: {dotted key: value} laid over the file.  swap: {component: FMU} in place of the file's.
    Raises ExperimentError where there is no such file or it is no TOML; every other problem is in `.problems`.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ExperimentError(path, [Problem("", no_such_file(path, ".toml", Path("experiments")))]) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ExperimentError(path, [Problem("", f"cannot be read as TOML: {error}")]) from None
    return parse(path, text, set, swap)


def parse(
    path: Path, text: str, set: Mapping[str, Any] | None = None, swap: Mapping[str, str] | None = None
) -> Experiment:
    """`load` for the text of a file that lies, or lay, at `path`."""
    try:
        content, out_of_bounds = _read(text)
    except (ValueError, RecursionError) as error:  # what is no TOML, thousands of digits, thousands of brackets
        raise ExperimentError(path, [Problem("", f"cannot be read as TOML: {error}")]) from None
    if out_of_bounds := [*out_of_bounds, *bounds.problems(set or {})]:
        raise ExperimentError(path, out_of_bounds)
    table = pickle.loads(content)
    changes = {"set": {key: _plain(value) for key, value in (set or {}).items()}, "swap": dict(swap or {})}
    notes: list[str] = []
    problems: list[Problem] = []
    # The swap first: it drops parameters of the FMU that leaves, not those that are set for the one that comes.
    for name, fmu in changes["swap"].items():
        note, wrong = _swap(table, name, fmu)
        notes += [note] if note else []
        problems += wrong
    for key, value in changes["set"].items():
        problems += _overlay(table, key, copy.deepcopy(value))
    return _experiment(path, text, table, changes, notes, problems)


@functools.lru_cache(maxsize=4)
def _read(text: str) -> tuple[bytes, list[Problem]]:
    """The table of a TOML text, pickled, or what is out of bounds; a sweep reads the same text again and again."""
    table = tomllib.loads(text)
    out_of_bounds = list(bounds.problems(table))
    return (b"" if out_of_bounds else pickle.dumps(table)), out_of_bounds


def _overlay(table: dict[str, Any], key: str, value: Any) -> list[Problem]:
    """Lay one --set over the file."""
    parts = split_key(key)
    if not parts:
        return [Problem(f"--set {key}", "is not a dotted key, such as master.stop_time")]
    components = _components_of(table)
    if len(parts) > 2 and parts[0] == "components" and parts[1] not in components:
        return [Problem(f"--set {key}", f"no component {parts[1]!r}{did_you_mean(parts[1], components)}")]
    node: Any = table
    for i, part in enumerate(parts[:-1]):
        inner = node.setdefault(part, {})
        if not isinstance(inner, dict):
            # one axis of a list or scalar: keep the value, let the axis override it
            node[".".join(parts[i:])] = value
            return []
        node = inner
    node[parts[-1]] = value
    return []


def _swap(table: dict[str, Any], name: str, fmu: str) -> tuple[str, list[Problem]]:
    """Put another FMU in a component's place; returns a note."""
    components = _components_of(table)
    component = components.get(name)
    if not isinstance(component, dict):
        return "", [Problem(f"--swap {name}", f"no component {name!r}{did_you_mean(name, components)}")]
    dropped = component.pop("parameters", None)
    was, component["fmu"] = component.get("fmu"), fmu
    names = ", ".join(dropped) if isinstance(dropped, dict) else ""
    return f"{name}: {fmu} in place of {was}" + (f"; dropped its parameters {names}" if names else ""), []


def _components_of(table: Mapping[str, Any]) -> dict[str, Any]:
    components = table.get("components")
    return components if isinstance(components, dict) else {}


def _experiment(
    path: Path,
    text: str,
    table: Mapping[str, Any],
    changes: Mapping[str, Mapping[str, Any]],
    notes: Sequence[str],
    problems: Sequence[Problem],
) -> Experiment:
    """The experiment that a table describes.  changes: laid over it; notes, problems: of these."""
    values, unfit = EXPERIMENT.read(table, "")
    master, master_problems = _master(values.get("master", {}))
    components, component_problems = _components(values.get("components", {}), master, changes["swap"])
    metrics, metric_problems = _tables("metrics", values.get("metrics", {}))
    metric_problems += [
        problem
        for name, spec in metrics.items()
        if is_number(every := spec.get("every")) and every > 0
        for problem in _multiple(every, master.step, f"metrics.{name}.every")
    ]
    connections, connection_problems = _connections(values.get("connections", {}))
    record, record_problems = _record(values.get("record", {}), master)
    swept, names = values.get("sweep", {}), [component.name for component in components]
    sections = [
        *master_problems,
        *component_problems,
        *metric_problems,
        *(sweep.read(swept)[1] if swept else []),
        *(tune.read(swept, metrics)[1] if swept.get("tune") else []),
        *mavlink.read(values.get("mavlink", {}), names)[1],
        *connection_problems,
        *record_problems,
    ]
    return Experiment(
        path=path,
        text=text,
        title=values.get("title", path.stem),
        master=master,
        components=components,
        connections=connections,
        record=record,
        metrics=metrics,
        mavlink=values.get("mavlink", {}),
        sweep=swept,
        problems=(*problems, *unfit, *sections),
        notes=tuple(notes),
        changes=changes,
    )


def _master(table: Mapping[str, Any]) -> tuple[MasterSpec, list[Problem]]:
    values, problems = MASTER.read(table, "master")
    step = values.get("step", 1.0)
    spec = MasterSpec(
        stop_time=values.get("stop_time", step), step=step, algorithm=values["algorithm"], seed=values.get("seed")
    )
    if "step" in table and "stop_time" in table:
        problems += _multiple(spec.stop_time, step, "master.stop_time")
    return spec, problems


def _components(
    table: Mapping[str, Any], master: MasterSpec, swapped: Collection[str]
) -> tuple[tuple[ComponentSpec, ...], list[Problem]]:
    entries, problems = _tables("components", table)
    if not table:
        problems.append(Problem("components", "the experiment has none; add [components.NAME] with an fmu"))
    components = []
    for name, entry in entries.items():
        key = f"components.{name}"
        values, unfit = COMPONENT.read(entry, key)
        problems += unfit
        if not re.fullmatch(COMPONENT_NAME, name):
            words = "a component's name is letters, digits and _, and begins with no digit"
            problems.append(Problem(key, words))
        if name in RESERVED:
            words = "is reserved for the record; give the component another name"
            problems.append(Problem(key, words))
        if "builtin" in entry and "fmu" in entry:
            problems.append(Problem(f"{key}.builtin", "is given beside fmu; a component has one of them"))
        elif isinstance(table[name], dict) and not (entry.get("fmu") or entry.get("builtin")):
            words = "is missing; give the name of a model or the path of an .fmu"
            problems.append(Problem(f"{key}.fmu", words))
        if "step" in values:
            problems += _multiple(values["step"], master.step, f"{key}.step")
        if "timeout" in values and values["isolation"] == "none":
            words = 'can be enforced only in a process of its own; set isolation = "process"'
            problems.append(Problem(f"{key}.timeout", words))
        if "builtin" in entry and "tolerance" in values:
            problems.append(Problem(f"{key}.tolerance", "is for the solver inside an FMU; a builtin has none"))
        spec = ComponentSpec(
            name=name,
            fmu=values.get("fmu", ""),
            parameters=values.get("parameters", {}),
            start=values.get("start", {}),
            step=values.get("step"),
            isolation=values["isolation"],
            timeout=values.get("timeout"),
            tolerance=values.get("tolerance"),
            builtin=values.get("builtin", ""),
            swapped=name in swapped,
        )
        components.append(spec)
    return tuple(components), problems


def _connections(table: Mapping[str, Any]) -> tuple[dict[str, ConnectionSpec], list[Problem]]:
    connections: dict[str, ConnectionSpec] = {}
    problems: list[Problem] = []
    for sink, source in table.items():
        key = f'connections."{sink}"'
        if isinstance(source, str):
            connections[sink] = ConnectionSpec(source=source)
        elif isinstance(source, dict) and "from" in source:
            values, unfit = CONNECTION.read(source, key)
            problems += unfit
            connections[sink] = ConnectionSpec(
                source=values.get("from", ""),
                gain=values.get("gain"),
                offset=values.get("offset"),
                unit_check=values["unit_check"],
            )
        else:
            hint = '; write the key in quotes: "controller.eta" = "vehicle.eta"' if isinstance(source, dict) else ""
            problems.append(Problem(key, f"is {source!r}, not the name of an output{hint}"))
    return connections, problems


def _record(table: Mapping[str, Any], master: MasterSpec) -> tuple[RecordSpec, list[Problem]]:
    values, problems = RECORD.read(table, "record")
    every = values.get("every", master.step)
    problems += _multiple(every, master.step, "record.every")
    if TimeGrid(every).ticks(master.stop_time) is None and TimeGrid(master.step).ticks(every) is not None:
        words = f"{every} s does not divide master.stop_time = {master.stop_time} s: the last row would be missing"
        problems.append(Problem("record.every", words))
    envelope = values["envelope"] if isinstance(values["envelope"], bool) else tuple(values["envelope"])
    spec = RecordSpec(every=every, signals=tuple(values["signals"]), inputs=values["inputs"], envelope=envelope)
    return spec, problems


def _tables(section: str, table: Mapping[str, Any]) -> tuple[dict[str, dict[str, Any]], list[Problem]]:
    """The tables of a section whose keys are all names; one that is none is empty, and a problem."""
    problems = [
        Problem(f"{section}.{name}", TABLE.problem(value)) for name, value in table.items() if TABLE.problem(value)
    ]
    return {name: value if isinstance(value, dict) else {} for name, value in table.items()}, problems


def _multiple(value: float, step: float, key: str) -> list[Problem]:
    """value, step: s."""
    grid = TimeGrid(step)
    ticks = grid.ticks(value)
    if ticks and ticks <= EXACT:
        return []
    if ticks:
        return [Problem(key, f"{value} s is over {EXACT:.0e} times master.step = {step} s")]
    near = " or ".join(f"{v:.12g}" for v in grid.nearest(value))
    return [Problem(key, f"{value} s is not a multiple of master.step = {step} s; try {near}")]


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy, tuples and paths as a file would give them."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(below) for key, below in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(below) for below in value]
    return str(value) if isinstance(value, Path) else value
