"""[connections] of an experiment between the variables of its FMUs: ends, axes, conversions, and what is left over."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Set

from ..errors import Problem, did_you_mean
from ..experiment.experiment import Experiment
from ..fmu.fmu import Fmu
from ..fmu.variables import Variable
from .conversion import between
from .plan import Component, Connection

Fmus = Mapping[str, Fmu]  # by component, of those whose FMU could be read


def connect(experiment: Experiment, fmus: Fmus) -> tuple[list[Connection], list[Problem]]:
    """The scalar connections of an experiment, but for those that --swap drops."""
    connections: list[Connection] = []
    problems: list[Problem] = []
    drivers: dict[tuple[str, str], str] = {}  # {component and input: the source in the file}
    names = {c.name: c for c in experiment.components}
    dropped = {*dropped_sinks(experiment, fmus)}
    for sink, spec in experiment.connections.items():
        key, source = f'connections."{sink}"', spec.source
        inputs, sink_problem = ({}, "") if sink in dropped else _end(sink, "input", names, fmus)
        outputs, source_problem = _end(source, "output", names, fmus)
        problems += [Problem(key, sentence) for sentence in (sink_problem, source_problem) if sentence]
        if not inputs or not outputs:
            continue
        to, origin = sink.partition(".")[0], source.partition(".")[0]
        try:
            for input, output in _pairs(inputs, outputs, sink, source):
                other = drivers.setdefault((to, input.name), source)
                if other != source:
                    raise ValueError(f"{input.name} has two drivers: {other} and {source}; keep one")
                factor, offset = between(spec, output, input, fmus[origin].units, fmus[to].units)
                connections.append(Connection(to, input, origin, output, factor, offset))
        except ValueError as error:
            problems.append(Problem(key, str(error)))
    return connections, problems


def dropped_sinks(experiment: Experiment, fmus: Fmus) -> list[str]:
    """The connections into inputs that the FMU which --swap puts in place lacks."""
    swapped = {c.name for c in experiment.components if c.swapped and c.name in fmus}
    ends = {sink: sink.partition(".") for sink in experiment.connections}
    return [sink for sink, (name, _, input) in ends.items() if name in swapped and not fmus[name].lookup(input)]


def undriven(component: Component, accepts: bool, driven: Set[str], judged: Set[str]) -> list[Problem]:
    """What is wrong with the inputs of a component that no connection drives, and with start values of those driven.

    accepts: inputs may keep the FMU's own start values.  driven: its inputs that connections drive.  judged: names
    of inputs or of whole vectors whose connection or start value is a problem already.
    """
    key = f"components.{component.name}"
    problems = [
        Problem(f"{key}.start.{name}", "is connected; a start value would be overwritten at once")
        for name in component.start
        if name in driven
    ]
    if accepts:
        return problems
    known = {*driven, *component.start, *judged}
    for name in component.fmu.names("input"):
        axes = component.fmu.lookup(name)
        missing = [axis for axis, variable in axes.items() if variable.name not in known]
        if missing and name not in known:
            what = repr(name) if len(missing) == len(axes) else f"{name!r} ({', '.join(missing)})"
            ways = f'connect it, give it a value in {key}.start, or accept the FMU\'s own with start = "fmu"'
            problems.append(Problem(key, f"nothing drives its input {what}; {ways}"))
    return problems


def _end(name: str, causality: str, components: Collection[str], fmus: Fmus) -> tuple[dict[str, Variable], str]:
    """{axis: variable} of one end of a connection, or {} and what is wrong with it; "" where its FMU is unreadable."""
    component, _, variable = name.partition(".")
    if component not in components:
        return {}, f"no component {component!r}{did_you_mean(component, components)}"
    if component not in fmus:
        return {}, ""  # a problem of its own
    fmu = fmus[component]
    variables = fmu.lookup(variable)
    if variables and all(v.causality == causality for v in variables.values()):
        return variables, ""
    near = did_you_mean(name, [f"{component}.{n}" for n in fmu.names(causality)], f"{component} has")
    if not variables:
        return {}, f"no {causality} {name!r}{near}"
    is_a = next(iter(variables.values())).causality
    return {}, f"{name!r} is {_article(is_a)}, not {_article(causality)}{near}"


def _pairs(
    inputs: Mapping[str, Variable], outputs: Mapping[str, Variable], sink: str, source: str
) -> list[tuple[Variable, Variable]]:
    """Input and output of each axis: by name, or by number where one side is numbered.  Raises ValueError."""
    if set(inputs) == set(outputs) or len(inputs) == len(outputs) == 1:
        return [(inputs[axis], outputs[axis if axis in outputs else next(iter(outputs))]) for axis in inputs]
    axes = f"{sink} has {_axes(inputs)}, {source} has {_axes(outputs)}"
    if len(inputs) != len(outputs):
        raise ValueError(axes)
    if all(a.isdigit() for a in inputs) or all(a.isdigit() for a in outputs):
        return list(zip(inputs.values(), outputs.values(), strict=True))
    raise ValueError(f"the axes differ: {axes}; connect them one by one")


def _article(causality: str) -> str:
    return f"an {causality}" if causality[0] in "aeiou" else f"a {causality}"


def _axes(variables: Mapping[str, Variable]) -> str:
    if set(variables) == {""}:
        return "one value"
    return f"{len(variables)} axes ({' '.join(variables)})"
