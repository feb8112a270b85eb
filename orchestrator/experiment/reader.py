"""Reads and checks the experiment file.  It knows nothing of FMI.

Problems do not stop the reading: they are gathered in `Experiment.problems`, and joined with those of the FMUs by
`plan.resolve`, so that a user sees all of them at once.
"""

from __future__ import annotations

import copy
import functools
import math
import pickle
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..errors import ExperimentError, Problem, did_you_mean, no_such_file
from . import bounds, mavlink, sweep, tune
from .experiment import ComponentSpec, ConnectionSpec, Experiment, MasterSpec, RecordSpec
from .keys import split_key
from .timegrid import EXACT, Grid

ALGORITHMS = ("gauss-seidel", "jacobi")
ISOLATION = ("auto", "process", "none")


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
    reader = _Reader()
    changes = {"set": {key: _plain(value) for key, value in (set or {}).items()}, "swap": dict(swap or {})}
    # The swap first: it drops parameters of the FMU that leaves, not those that are set for the one that comes.
    notes = [reader.swap(table, name, fmu) for name, fmu in changes["swap"].items()]
    for key, value in changes["set"].items():
        reader.overlay(table, key, copy.deepcopy(value))
    return reader.experiment(path, text, table, tuple(note for note in notes if note), changes)


@functools.lru_cache(maxsize=4)
def _read(text: str) -> tuple[bytes, list[Problem]]:
    """The table of a TOML text, pickled, or what is out of bounds; a sweep reads the same text again and again."""
    table = tomllib.loads(text)
    out_of_bounds = list(bounds.problems(table))
    return (b"" if out_of_bounds else pickle.dumps(table)), out_of_bounds


class _Reader:
    def __init__(self) -> None:
        self.problems: list[Problem] = []

    def problem(self, key: str, sentence: str) -> None:
        self.problems.append(Problem(key, sentence))

    def overlay(self, table: dict[str, Any], key: str, value: Any) -> None:
        """Lay one --set over the file."""
        parts = split_key(key)
        if not parts:
            return self.problem(f"--set {key}", "is no dotted key, such as master.stop_time")
        components = table.get("components")
        known = components if isinstance(components, dict) else {}
        if len(parts) > 2 and parts[0] == "components" and parts[1] not in known:
            return self.problem(f"--set {key}", f"no component {parts[1]!r}{did_you_mean(parts[1], known)}")
        node: Any = table
        for i, part in enumerate(parts[:-1]):
            below = node.setdefault(part, {})
            if not isinstance(below, dict):
                # one axis of a list or scalar: keep the value, let the axis override it
                node[".".join(parts[i:])] = value
                return None
            node = below
        node[parts[-1]] = value
        return None

    def swap(self, table: dict[str, Any], name: str, fmu: str) -> str:
        components = table.get("components")
        known = components if isinstance(components, dict) else {}
        component = known.get(name)
        if not isinstance(component, dict):
            self.problem(f"--swap {name}", f"no component {name!r}{did_you_mean(name, known)}")
            return ""
        dropped = component.pop("parameters", None)
        was, component["fmu"] = component.get("fmu"), fmu
        note = f"{name}: {fmu} in place of {was}"
        names = ", ".join(dropped) if isinstance(dropped, dict) else ""
        return note + (f"; dropped its parameters {names}" if names else "")

    def experiment(
        self,
        path: Path,
        text: str,
        table: dict[str, Any],
        notes: tuple[str, ...],
        changes: Mapping[str, Mapping[str, Any]],
    ) -> Experiment:
        sections = ("title", "master", "components", "connections", "record", "metrics", "mavlink", "sweep")
        self.known(table, sections, "")
        master = self.master(self.table(table, "master"))
        components = self.components(self.table(table, "components"), master, tuple(changes["swap"]))
        if not components:
            self.problem("components", "the experiment has none; add [components.NAME] with an fmu")
        metrics, swept = self.tables(table, "metrics"), self.table(table, "sweep")
        if swept:
            self.problems += sweep.read(swept)[1]
        if "tune" in swept:
            self.problems += tune.read(swept, metrics)[1]
        self.problems += mavlink.read(self.table(table, "mavlink"), [component.name for component in components])[1]
        return Experiment(
            path,
            text,
            self.typed(table, "title", "", str, path.stem),
            master,
            components,
            self.connections(self.table(table, "connections")),
            self.record(self.table(table, "record"), master),
            metrics,
            self.table(table, "mavlink"),
            swept,
            tuple(self.problems),
            notes,
            changes,
        )

    def master(self, table: dict[str, Any]) -> MasterSpec:
        self.known(table, ("stop_time", "step", "algorithm", "seed"), "master")
        for key in ("stop_time", "step"):
            if key not in table:
                self.problem(f"master.{key}", "is missing; give it in s")
        step = self.seconds(table, "step", "master", 1.0)
        stop_time = self.seconds(table, "stop_time", "master", step)
        algorithm = self.typed(table, "algorithm", "master", str, ALGORITHMS[0])
        if algorithm not in ALGORITHMS:
            self.problem("master.algorithm", f"no {algorithm!r}{did_you_mean(algorithm, ALGORITHMS)}")
        if "step" in table and "stop_time" in table:
            self.multiple(stop_time, step, "master.stop_time")
        seed = self.typed(table, "seed", "master", int, None)
        if seed is not None and abs(seed) >= 1 << 63:
            self.problem("master.seed", f"{seed} does not fit 64 bits")
        return MasterSpec(stop_time, step, algorithm, seed)

    def components(
        self, table: dict[str, Any], master: MasterSpec, swapped: tuple[str, ...]
    ) -> tuple[ComponentSpec, ...]:
        found = []
        for name in table:
            key = f"components.{name}"
            entry = self.table(table, name, "components")
            if not re.fullmatch(r"[A-Za-z_]\w*", name):
                self.problem(key, "a component's name is letters, digits and _, and begins with no digit")
            if name in ("time", "_heard"):
                self.problem(key, "is where the record keeps something else; give the component another name")
            self.known(entry, ("fmu", "builtin", "parameters", "start", "step", "isolation", "timeout"), key)
            if "builtin" in entry and "fmu" in entry:
                self.problem(f"{key}.builtin", "stands beside fmu; a component is one of them")
            elif isinstance(table[name], dict) and not (entry.get("fmu") or entry.get("builtin")):
                self.problem(f"{key}.fmu", "is missing; give the name of a model or the path of an .fmu")
            start = entry.get("start", {})
            if not isinstance(start, dict) and start != "fmu":
                self.problem(f"{key}.start", f'is {start!r}; give a table of values, or "fmu"')
                start = {}
            step = self.seconds(entry, "step", key, master.step) if "step" in entry else None
            if step is not None:
                self.multiple(step, master.step, f"{key}.step")
            isolation = self.typed(entry, "isolation", key, str, ISOLATION[0])
            if isolation not in ISOLATION:
                self.problem(f"{key}.isolation", f"no {isolation!r}{did_you_mean(isolation, ISOLATION)}")
            timeout = self.seconds(entry, "timeout", key, 1.0) if "timeout" in entry else None
            if timeout is not None and isolation == "none":
                self.problem(f"{key}.timeout", 'can be kept only in a process of its own; take isolation = "process"')
            found.append(
                ComponentSpec(
                    name,
                    self.typed(entry, "fmu", key, str, ""),
                    self.table(entry, "parameters", key),
                    start,
                    step,
                    isolation,
                    timeout,
                    self.typed(entry, "builtin", key, str, ""),
                    name in swapped,
                )
            )
        return tuple(found)

    def connections(self, table: dict[str, Any]) -> dict[str, ConnectionSpec]:
        found = {}
        for sink, source in table.items():
            key = f'connections."{sink}"'
            if isinstance(source, str):
                found[sink] = ConnectionSpec(source)
            elif isinstance(source, dict) and "from" in source:
                self.known(source, ("from", "gain", "offset", "unit_check"), key)
                found[sink] = ConnectionSpec(
                    self.typed(source, "from", key, str, ""),
                    self.number(source, "gain", key),
                    self.number(source, "offset", key),
                    self.typed(source, "unit_check", key, bool, True),
                )
            else:
                hint = '; write the key in quotes: "controller.eta" = "vehicle.eta"' if isinstance(source, dict) else ""
                self.problem(key, f"is {source!r}, not the name of an output{hint}")
        return found

    def number(self, table: dict[str, Any], key: str, path: str) -> float | None:
        value = table.get(key)
        if value is None or (isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)):
            return None if value is None else float(value)
        self.problem(f"{path}.{key}", f"is {value!r}; give a finite number")
        return None

    def record(self, table: dict[str, Any], master: MasterSpec) -> RecordSpec:
        self.known(table, ("every", "signals", "inputs"), "record")
        every = self.seconds(table, "every", "record", master.step)
        self.multiple(every, master.step, "record.every")
        if Grid(every).ticks(master.stop_time) is None and Grid(master.step).ticks(every) is not None:
            self.problem(
                "record.every",
                f"{every} s does not divide master.stop_time = {master.stop_time} s: the last row would be missing",
            )
        signals = table.get("signals", ["*"])
        if not (isinstance(signals, list) and all(isinstance(s, str) for s in signals)):
            self.problem("record.signals", f'is {signals!r}; give a list of globs, such as ["vehicle*", "!*.nu.*"]')
            signals = ["*"]
        return RecordSpec(every, tuple(signals), self.typed(table, "inputs", "record", bool, False))

    def tables(self, table: dict[str, Any], key: str) -> dict[str, dict[str, Any]]:
        return {name: self.table(self.table(table, key), name, key) for name in self.table(table, key)}

    def table(self, parent: dict[str, Any], key: str, path: str = "") -> dict[str, Any]:
        value = parent.get(key, {})
        if isinstance(value, dict):
            return copy.deepcopy(value)
        self.problem(f"{path}.{key}".lstrip("."), f"is {value!r}, not a table")
        return {}

    def typed(self, table: dict[str, Any], key: str, path: str, kind: type, default: Any) -> Any:
        value = table.get(key, default)
        if value is default or (isinstance(value, kind) and (kind is bool or not isinstance(value, bool))):
            return value
        names = {str: "a text", int: "a whole number", bool: "true or false"}
        self.problem(f"{path}.{key}".lstrip("."), f"is {value!r}, not {names[kind]}")
        return default

    def seconds(self, table: dict[str, Any], key: str, path: str, default: float) -> float:
        value = table.get(key, default)
        if isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value) and value > 0:
            return float(value)
        self.problem(f"{path}.{key}", f"is {value!r}; give a positive number of seconds")
        return default

    def multiple(self, value: float, step: float, key: str) -> None:
        grid = Grid(step)
        ticks = grid.ticks(value)
        if ticks and ticks > EXACT:
            self.problem(key, f"{value} s is over {EXACT:.0e} times master.step = {step} s")
        elif not ticks:
            near = " or ".join(f"{v:.12g}" for v in grid.nearest(value))
            self.problem(key, f"{value} s is not a multiple of master.step = {step} s; try {near}")

    def known(self, table: Iterable[str], names: tuple[str, ...], path: str) -> None:
        for key in table:
            if key not in names:
                self.problem(f"{path}.{key}".lstrip("."), f"unknown key{did_you_mean(key, names)}")


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy, tuples and paths as a file would give them."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(below) for key, below in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(below) for below in value]
    return str(value) if isinstance(value, Path) else value
