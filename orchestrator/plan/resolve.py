"""From an experiment and its FMUs to a plan: every name resolved, every value checked, nothing loaded.

`resolve` gathers all problems of the file and its FMUs and raises once.
"""

from __future__ import annotations

import datetime
import fnmatch
import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import metrics
from ..errors import ExperimentError, FmuError, Problem, did_you_mean
from ..experiment.experiment import ComponentSpec, Experiment
from ..fmu import builtin
from ..fmu.fmu import Fmu, read
from ..fmu.values import flatten
from ..fmu.variables import DTYPES, NUMBERS, WHOLE, Variable
from ..models import catalogue
from ..names import matches
from .conversion import between
from .plan import Component, Connection, Plan

Reader = Callable[..., Fmu]


def resolve(
    experiment: Experiment, built: Mapping[str, Path], unbuilt: Mapping[str, str], reader: Reader = read
) -> Plan:
    """Fit the experiment to its FMUs.

    built: {model: its FMU}; unbuilt: {model: why it cannot be built}; reader: in place of `fmu.read`.  Raises
    ExperimentError with every problem.
    """
    return _Resolver(experiment, built, unbuilt, reader).plan()


class _Resolver:
    def __init__(self, experiment: Experiment, built: Mapping[str, Path], unbuilt: Mapping[str, str], reader: Reader):
        self.experiment, self.built, self.unbuilt, self.read = experiment, built, unbuilt, reader
        self.problems = list(experiment.problems)
        self.notes = list(experiment.notes)
        self.fmus: dict[str, Fmu] = {}  # by component
        self.isolated: dict[str, str] = {}  # components that run in processes of their own, and why
        self.broken: set[str] = set()  # inputs whose connection or start value is a problem
        self.components = {c.name: c for c in experiment.components}

    def plan(self) -> Plan:
        self.read_fmus()
        self.isolate()
        components = [self.component(c) for c in self.experiment.components if c.name in self.fmus]
        connections = self.connections()
        driven: dict[str, set[str]] = {component.name: set() for component in components}
        for connection in connections:
            driven[connection.sink].add(connection.input.name)
        for component in components:
            self.unconnected(component, driven[component.name])
        recorded = self.recorded()
        self.check_metrics(recorded)
        self.check_vehicles(components)
        if self.problems:
            raise ExperimentError(self.experiment.path, self.problems)
        now = datetime.datetime.now(datetime.UTC).isoformat() if any(component.live for component in components) else ""
        return Plan(self.experiment, tuple(components), tuple(connections), tuple(recorded), tuple(self.notes), now)

    def problem(self, key: str, sentence: str) -> None:
        self.problems.append(Problem(key, sentence))

    def read_fmus(self) -> None:
        files: dict[tuple[Path, str], Fmu] = {}
        for component in self.experiment.components:
            if component.builtin:
                try:
                    self.fmus[component.name] = builtin.describe(component.builtin)
                except FmuError as error:
                    self.problem(f"components.{component.name}.builtin", str(error))
            if not component.fmu:
                continue
            try:
                if component.fmu in self.unbuilt:
                    raise FmuError(self.unbuilt[component.fmu])
                path = catalogue.locate(component.fmu, self.experiment.path.resolve().parent, self.built)
                fmu = files.get((path, "")) or self.read(path)
                files[path, ""] = fmu
                structure = {
                    n: v
                    for n, v in component.parameters.items()
                    if n in fmu.variables and fmu.variables[n].causality == "structuralParameter" and type(v) is int
                }
                key = path, repr(structure or "")
                files[key] = files.get(key) or (self.read(path, structure) if structure else fmu)
                self.fmus[component.name] = files[key]
            except FmuError as error:
                self.problem(f"components.{component.name}.fmu", str(error))

    def isolate(self) -> None:
        """Decide which components run in processes of their own.

        Python FMUs share one interpreter, where a module name may mean one thing only; and some FMUs can be
        instantiated only once in a process.
        """
        owner: dict[str, str] = {}
        loaded: set[Path] = set()
        for component in self.experiment.components:
            name, fmu = component.name, self.fmus.get(component.name)
            if fmu is None or component.builtin:
                continue
            if component.isolation == "process" or component.timeout is not None:
                self.isolated[name] = "as the experiment says"
                continue
            reason = f"{fmu.path.name} can be instantiated only once in a process" * (
                fmu.once_per_process and fmu.path in loaded
            )
            for module, digest in fmu.python_modules.items():
                if owner.get(module, digest) != digest:
                    reason = f"another Python FMU has a different module {module!r}, and one process can hold only one"
            if reason and component.isolation == "none":
                self.problem(f"components.{name}.isolation", f'is "none", but {reason}; leave it out')
            elif reason:
                self.isolated[name] = reason
                self.notes.append(f"{name} runs in a process of its own: {reason}")
            else:
                owner |= {module: digest for module, digest in fmu.python_modules.items() if module not in owner}
                loaded.add(fmu.path)

    def component(self, component: ComponentSpec) -> Component:
        fmu = self.fmus[component.name]
        parameters = self.values(component, "parameters", component.parameters)
        seed = fmu.variables.get("seed")
        if (
            self.experiment.master.seed is not None
            and seed is not None
            and "seed" not in parameters
            and seed.causality == "parameter"
            and seed.kind in WHOLE
        ):
            text = f"{self.experiment.master.seed}/{component.name}"
            bits = min(32, np.iinfo(DTYPES[seed.kind]).bits)
            number = int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")
            parameters["seed"] = number >> (33 - bits)
        start: dict[str, Any] = {}
        if isinstance(component.start, Mapping):
            table = dict(component.start)
            if component.swapped:
                for name in [n for n in table if not fmu.lookup(n)]:
                    self.notes.append(f"{component.name}: dropped start.{name}, which {fmu.model_name} lacks")
                    del table[name]
            start = self.values(component, "start", table)
        grid = self.experiment.grid
        period = grid.ticks(component.step) if component.step is not None else 1
        return Component(
            component.name,
            component.fmu or component.builtin,
            fmu,
            period or 1,
            parameters,
            start,
            component.name in self.isolated,
            bool(component.builtin),
            component.timeout,
        )

    def values(self, component: ComponentSpec, section: str, table: Mapping[str, Any]) -> dict[str, Any]:
        """{FMI variable: value} of a component's table `parameters` or `start`."""
        causalities = ("parameter", "structuralParameter") if section == "parameters" else ("input",)
        values, problems = flatten(self.fmus[component.name], causalities, table)
        for name, sentence in problems:
            self.problem(f"components.{component.name}.{section}.{name}", sentence)
            if section == "start":
                self.broken.add(f"{component.name}.{name}")
        return values

    def connections(self) -> list[Connection]:
        connections: list[Connection] = []
        driver: dict[tuple[str, str], str] = {}
        for sink, connection in self.experiment.connections.items():
            key, source = f'connections."{sink}"', connection.source
            to, origin = self.end(sink, "input", key), self.end(source, "output", key)
            if to is None or origin is None:
                self.broken.add(sink)
                continue
            (sink_component, inputs), (source_component, outputs) = to, origin
            pairs = self.pairs(inputs, outputs, key, sink, source)
            if not pairs:
                self.broken.add(sink)
            for input, output in pairs:
                other = driver.setdefault((sink_component, input.name), source)
                if other != source:
                    self.problem(key, f"{input.name} has two drivers: {other} and {source}; keep one")
                    break
                try:
                    units = self.fmus[source_component].units, self.fmus[sink_component].units
                    factor, offset = between(connection, output, input, *units)
                except ValueError as error:
                    self.problem(key, str(error))
                    break
                connections.append(Connection(sink_component, input, source_component, output, factor, offset))
        return connections

    def end(self, name: str, causality: str, key: str) -> tuple[str, dict[str, Variable]] | None:
        """The component and variables of one end of a connection."""
        component, _, variable = name.partition(".")
        if component not in self.components:
            self.problem(key, f"no component {component!r}{did_you_mean(component, self.components)}")
            return None
        if component not in self.fmus:
            return None  # its FMU is a problem of its own
        fmu = self.fmus[component]
        found = fmu.lookup(variable)
        choices = [f"{component}.{n}" for n in fmu.names(causality)]
        if found and all(v.causality == causality for v in found.values()):
            return component, found
        if found:
            is_a = next(iter(found.values())).causality
            self.problem(
                key,
                f"{name!r} is {_article(is_a)}, not {_article(causality)}"
                f"{did_you_mean(name, choices, f'{component} has')}",
            )
        elif causality == "input" and self.components[component].swapped:
            self.notes.append(f"{component}: dropped the connection into {variable}, which {fmu.model_name} lacks")
        else:
            near = did_you_mean(name, choices, f"{component} has")
            self.problem(key, f"no {causality} {name!r}{near}")
        return None

    def pairs(
        self, inputs: dict[str, Variable], outputs: dict[str, Variable], key: str, sink: str, source: str
    ) -> list[tuple[Variable, Variable]]:
        """Input and output of each axis: by name, or by number where one side is numbered."""
        if set(inputs) == set(outputs) or len(inputs) == len(outputs) == 1:
            pairs = [(inputs[axis], outputs[axis if axis in outputs else next(iter(outputs))]) for axis in inputs]
        elif len(inputs) != len(outputs):
            self.problem(key, f"{sink} has {_axes(inputs)}, {source} has {_axes(outputs)}")
            return []
        elif all(a.isdigit() for a in inputs) or all(a.isdigit() for a in outputs):
            pairs = list(zip(inputs.values(), outputs.values(), strict=True))
        else:
            self.problem(
                key,
                f"the axes differ: {sink} has {_axes(inputs)}, {source} has {_axes(outputs)}; connect them one by one",
            )
            return []
        return pairs

    def unconnected(self, component: Component, driven: set[str]) -> None:
        key = f"components.{component.name}"
        for name in component.start:
            if name in driven:
                self.problem(f"{key}.start.{name}", "is connected; a start value would be overwritten at once")
        if self.components[component.name].start == "fmu":
            return
        # An input that is a problem already is not reported a second time.
        known = driven | set(component.start) | {sink.removeprefix(component.name + ".") for sink in self.broken}
        for name in component.fmu.names("input"):
            missing = [axis for axis, v in component.fmu.lookup(name).items() if v.name not in known]
            if missing and name not in known:
                whole = len(missing) == len(component.fmu.lookup(name))
                what = repr(name) if whole else f"{name!r} ({', '.join(missing)})"
                self.problem(
                    key,
                    f"nothing drives its input {what}; connect it, give it a value in {key}.start, "
                    'or accept the FMU\'s own with start = "fmu"',
                )

    def recorded(self) -> list[tuple[str, Variable]]:
        record = self.experiment.record
        wanted = ("output", "input", "local") if record.inputs else ("output",)
        choices = [
            (name, variable)
            for name, fmu in self.fmus.items()
            for variable in fmu.variables.values()
            if variable.causality in wanted and variable.kind != "binary"
        ]
        include = [p for p in record.signals if not p.startswith("!")] or ["*"] * bool(record.signals)
        exclude = [p[1:] for p in record.signals if p.startswith("!")]
        full = [f"{component}.{variable.name}" for component, variable in choices]
        for pattern in include:
            if self.judges(pattern) and not any(matches(name, pattern) for name in full):
                vectors = dict.fromkeys(name.rpartition(".")[0] for name in full)
                self.problem("record.signals", f"{pattern!r} matches nothing{did_you_mean(pattern, vectors)}")
        return [
            choice
            for choice, name in zip(choices, full, strict=True)
            if any(matches(name, p) for p in include) and not any(matches(name, p) for p in exclude)
        ]

    def check_metrics(self, recorded: list[tuple[str, Variable]]) -> None:
        units = {f"{c}.{v.name}": v.unit for c, v in recorded if v.kind in NUMBERS}
        for name, spec in self.experiment.metrics.items():
            ends = [end for end in ("signal", "reference") if end in spec and not self.judges(spec[end])]
            found = metrics.problems(f"metrics.{name}", spec, units)
            self.problems += [p for p in found if p.key not in {f"metrics.{name}.{end}" for end in ends}]

    def check_vehicles(self, components: list[Component]) -> None:
        vehicles = [component.name for component in components if component.is_vehicle]
        for name in self.experiment.mavlink_spec.vehicles:
            if name in self.fmus and name not in vehicles:
                near = did_you_mean(name, vehicles, "vehicles")
                self.problem(
                    f"mavlink.vehicles.{name}", f"{name!r} is no vehicle: it does not put out eta and nu{near}"
                )

    def judges(self, signal: Any) -> bool:
        """Whether it is known which signals there are of that name: not where its FMU cannot be read."""
        component = str(signal).partition(".")[0]
        return not any(fnmatch.fnmatchcase(name, component) for name in self.components if name not in self.fmus)


def _article(causality: str) -> str:
    return f"an {causality}" if causality[0] in "aeiou" else f"a {causality}"


def _axes(variables: Mapping[str, Variable]) -> str:
    if set(variables) == {""}:
        return "one value"
    return f"{len(variables)} axes ({' '.join(variables)})"
