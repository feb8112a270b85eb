"""From an experiment and its FMUs to a plan: every name resolved, every value checked, nothing loaded.

Each function returns what it makes of the experiment, and the problems that it meets; `resolve` raises all at once.
"""

from __future__ import annotations

import datetime
import fnmatch
import hashlib
from collections.abc import Callable, Mapping, Sequence, Set
from pathlib import Path
from typing import Any

import numpy as np

from .. import metrics
from ..errors import ExperimentError, FmuError, Problem, did_you_mean
from ..experiment.experiment import ComponentSpec, Experiment
from ..fmu import builtin
from ..fmu.fmu import Fmu, read
from ..fmu.values import flatten
from ..fmu.variables import DTYPES, WHOLE, Variable
from ..models import catalogue
from ..names import matches
from .connections import Fmus, connect, dropped_sinks, undriven
from .motors import with_motors
from .plan import Component, Plan, units_of

Reader = Callable[..., Fmu]
Signal = tuple[str, Variable]  # a component, and a variable of it


def resolve(
    experiment: Experiment,
    built: Mapping[str, Path],
    unbuilt: Mapping[str, str],
    reader: Reader = read,
    *,
    motors: bool = True,
) -> Plan:
    """Fit the experiment to its FMUs.

    built: {model: its FMU}; unbuilt: {model: why it cannot be built}; reader: in place of `fmu.read`.  motors: put the
    component before the thrusters of a steered vehicle, which orch 0.1.0 did not have.  Raises ExperimentError with
    every problem.
    """
    fmus, fmu_problems = _read_fmus(experiment, built, unbuilt, reader)
    reasons, isolation_problems = _isolate(experiment, fmus)
    components, value_problems = _components(experiment, fmus, reasons.keys())
    connections, connection_problems = connect(experiment, fmus)
    driven: dict[str, set[str]] = {component.name: set() for component in components}
    for connection in connections:
        driven[connection.sink].add(connection.input.name)
    accepting = {c.name for c in experiment.components if c.start == "fmu"}
    judged = _judged(experiment, value_problems)
    input_problems = [
        problem
        for component in components
        for problem in undriven(
            component, component.name in accepting, driven[component.name], judged.get(component.name, set())
        )
    ]
    if motors:
        components, connections = with_motors(components, connections)
        fmus = {component.name: component.fmu for component in components}
    recorded, record_problems = _recorded(experiment, fmus)
    problems = [
        *experiment.problems,
        *fmu_problems,
        *isolation_problems,
        *value_problems,
        *connection_problems,
        *input_problems,
        *record_problems,
        *_envelope_problems(experiment, fmus, recorded),
        *_metric_problems(experiment, fmus),
        *_vehicle_problems(experiment, components),
    ]
    if problems:
        raise ExperimentError(experiment.path, problems)
    live = any(component.live for component in components)
    return Plan(
        experiment=experiment,
        components=tuple(components),
        connections=tuple(connections),
        recorded=tuple(recorded),
        notes=(*experiment.notes, *_notes(experiment, fmus, reasons)),
        created=datetime.datetime.now(datetime.UTC).isoformat() if live else "",
    )


def _read_fmus(
    experiment: Experiment, built: Mapping[str, Path], unbuilt: Mapping[str, str], reader: Reader
) -> tuple[dict[str, Fmu], list[Problem]]:
    """The FMU of each component, or a builtin described as one; each file is read once for each structure."""
    fmus: dict[str, Fmu] = {}
    problems: list[Problem] = []
    files: dict[tuple[Path, str], Fmu] = {}

    def read_once(path: Path, structure: Mapping[str, int]) -> Fmu:
        key = path, repr(structure)
        if key not in files:
            files[key] = reader(path, structure) if structure else reader(path)
        return files[key]

    for component in experiment.components:
        if component.builtin:
            try:
                fmus[component.name] = builtin.describe(component.builtin)
            except FmuError as error:
                problems.append(Problem(f"components.{component.name}.builtin", str(error)))
        if not component.fmu:
            continue
        try:
            if component.fmu in unbuilt:
                raise FmuError(unbuilt[component.fmu])
            path = catalogue.locate(component.fmu, experiment.path.resolve().parent, built)
            variables = read_once(path, {}).variables
            structure = {
                name: value
                for name, value in component.parameters.items()
                if name in variables and variables[name].causality == "structuralParameter" and type(value) is int
            }
            fmus[component.name] = read_once(path, structure)
        except FmuError as error:
            problems.append(Problem(f"components.{component.name}.fmu", str(error)))
    return fmus, problems


def _isolate(experiment: Experiment, fmus: Fmus) -> tuple[dict[str, str], list[Problem]]:
    """Which components run in processes of their own, and why: "" where the experiment says so.

    Python FMUs share one interpreter, where a module name may mean one thing only; and some FMUs can be instantiated
    only once in a process.
    """
    reasons: dict[str, str] = {}
    problems: list[Problem] = []
    owners: dict[str, str] = {}  # {module: its digest}
    loaded: set[Path] = set()
    for component in experiment.components:
        name, fmu = component.name, fmus.get(component.name)
        if fmu is None or component.builtin:
            continue
        if component.isolation == "process" or component.timeout is not None:
            reasons[name] = ""
            continue
        reason = ""
        if fmu.once_per_process and fmu.path in loaded:
            reason = f"{fmu.path.name} can be instantiated only once in a process"
        for module, digest in fmu.python_modules.items():
            if owners.get(module, digest) != digest:
                reason = f"another Python FMU has a different module {module!r}, and one process can hold only one"
        if reason and component.isolation == "none":
            problems.append(Problem(f"components.{name}.isolation", f'is "none", but {reason}; leave it out'))
        elif reason:
            reasons[name] = reason
        else:
            owners = {**fmu.python_modules, **owners}
            loaded.add(fmu.path)
    return reasons, problems


def _components(experiment: Experiment, fmus: Fmus, isolated: Set[str]) -> tuple[list[Component], list[Problem]]:
    """The components whose FMUs could be read, with the values of their parameters and free inputs."""
    components: list[Component] = []
    problems: list[Problem] = []
    for spec in experiment.components:
        if spec.name not in fmus:
            continue
        fmu, key = fmus[spec.name], f"components.{spec.name}"
        parameters, wrong = flatten(fmu, ("parameter", "structuralParameter"), spec.parameters)
        problems += [Problem(f"{key}.parameters.{name}", sentence) for name, sentence in wrong]
        dropped = _dropped_starts(spec, fmu)
        table = {} if isinstance(spec.start, str) else {n: v for n, v in spec.start.items() if n not in dropped}
        start, wrong = flatten(fmu, ("input",), table)
        problems += [Problem(f"{key}.start.{name}", sentence) for name, sentence in wrong]
        period = experiment.grid.ticks(spec.step) if spec.step is not None else 1
        components.append(
            Component(
                name=spec.name,
                fmu_name=spec.fmu or spec.builtin,
                fmu=fmu,
                period=period or 1,
                parameters=parameters | _seed(experiment.master.seed, spec.name, fmu, parameters),
                start=start,
                isolated=spec.name in isolated,
                live=bool(spec.builtin),
                timeout=spec.timeout,
                tolerance=fmu.tolerance if spec.tolerance is None else spec.tolerance,
            )
        )
    return components, problems


def _seed(seed: int | None, component: str, fmu: Fmu, parameters: Mapping[str, Any]) -> dict[str, int]:
    """The parameter `seed` of a component that has one and is given none: drawn from the master's and its name."""
    variable = fmu.variables.get("seed")
    if seed is None or variable is None or "seed" in parameters:
        return {}
    if variable.causality != "parameter" or variable.kind not in WHOLE:
        return {}
    bits = min(32, np.iinfo(DTYPES[variable.kind]).bits)
    number = int.from_bytes(hashlib.sha256(f"{seed}/{component}".encode()).digest()[:4], "big")
    return {"seed": number >> (33 - bits)}


def _dropped_starts(spec: ComponentSpec, fmu: Fmu) -> list[str]:
    """Start values of inputs that the FMU which --swap puts in place lacks."""
    if not spec.swapped or isinstance(spec.start, str):
        return []
    return [name for name in spec.start if not fmu.lookup(name)]


def _judged(experiment: Experiment, problems: Sequence[Problem]) -> dict[str, set[str]]:
    """By component: the inputs that have a connection in the file, or a start value that is a problem."""
    judged: dict[str, set[str]] = {}
    for sink in experiment.connections:
        component, _, input = sink.partition(".")
        judged.setdefault(component, set()).add(input)
    for problem in problems:
        section, component, table, *name = problem.key.split(".", 3)
        if (section, table) == ("components", "start"):
            judged.setdefault(component, set()).update(name)
    return judged


def _recorded(experiment: Experiment, fmus: Fmus) -> tuple[list[Signal], list[Problem]]:
    """The signals that [record] names, in the order of the components and of their FMUs."""
    record = experiment.record
    wanted = ("output", "input", "local") if record.inputs else ("output",)
    choices = {
        f"{component}.{variable.name}": (component, variable)
        for component, fmu in fmus.items()
        for variable in fmu.variables.values()
        if variable.causality in wanted and variable.kind != "binary"
    }
    include = [p for p in record.signals if not p.startswith("!")] or ["*"] * bool(record.signals)
    exclude = [p[1:] for p in record.signals if p.startswith("!")]
    vectors = dict.fromkeys(name.rpartition(".")[0] for name in choices)
    problems = [
        Problem("record.signals", f"{pattern!r} matches nothing{did_you_mean(pattern, vectors)}")
        for pattern in include
        if _is_known(pattern, experiment, fmus) and not any(matches(name, pattern) for name in choices)
    ]
    recorded = [
        signal
        for name, signal in choices.items()
        if any(matches(name, p) for p in include) and not any(matches(name, p) for p in exclude)
    ]
    return recorded, problems


def _envelope_problems(experiment: Experiment, fmus: Fmus, recorded: Sequence[Signal]) -> list[Problem]:
    """Globs of record.envelope that match no recorded signal."""
    envelope = experiment.record.envelope
    names = [f"{component}.{v.name}" for component, v in recorded]
    return [
        Problem("record.envelope", f"{pattern!r} matches no recorded signal{did_you_mean(pattern, names)}")
        for pattern in (() if isinstance(envelope, bool) else envelope)
        if _is_known(pattern, experiment, fmus) and not any(matches(name, pattern) for name in names)
    ]


def _metric_problems(experiment: Experiment, fmus: Fmus) -> list[Problem]:
    units = units_of(fmus)
    problems = []
    for name, spec in experiment.metrics.items():
        key = f"metrics.{name}"
        ends = [end for end in ("signal", "reference") if end in spec and not _is_known(spec[end], experiment, fmus)]
        unknown = {f"{key}.{end}" for end in ends}
        problems += [problem for problem in metrics.problems(key, spec, units) if problem.key not in unknown]
    return problems


def _vehicle_problems(experiment: Experiment, components: Sequence[Component]) -> list[Problem]:
    vehicles = [component.name for component in components if component.is_vehicle]
    shown = experiment.mavlink_spec.vehicles
    others = [component.name for component in components if component.name in shown and not component.is_vehicle]
    near = {name: did_you_mean(name, vehicles, "vehicles") for name in others}
    return [
        Problem(f"mavlink.vehicles.{name}", f"{name!r} is not a vehicle: it does not put out eta and nu{near[name]}")
        for name in others
    ]


def _is_known(signal: Any, experiment: Experiment, fmus: Fmus) -> bool:
    """Whether it is known which signals there are of that name: not where its FMU could not be read."""
    component = str(signal).partition(".")[0]
    unread = [c.name for c in experiment.components if c.name not in fmus]
    return not any(fnmatch.fnmatchcase(name, component) for name in unread)


def _notes(experiment: Experiment, fmus: Fmus, reasons: Mapping[str, str]) -> list[str]:
    """What runs otherwise than the file says, or than one expects."""
    notes = [f"{name} runs in a process of its own: {reason}" for name, reason in reasons.items() if reason]
    for spec in experiment.components:
        fmu = fmus[spec.name]
        notes += [f"{spec.name}: {note}" for note in fmu.notes]
        notes += [
            f"{spec.name}: dropped start.{name}, which {fmu.model_name} lacks" for name in _dropped_starts(spec, fmu)
        ]
    for sink in dropped_sinks(experiment, fmus):
        component, _, input = sink.partition(".")
        notes.append(f"{component}: dropped the connection into {input}, which {fmus[component].model_name} lacks")
    return notes
