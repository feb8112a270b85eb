"""A model given as equations: three functions of its memory, traced from its methods once."""

from __future__ import annotations

import pathlib
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from .declare import Declaration, Declared, Layout, assign, made


class Model(Declared):
    """A model as CasADi expressions; in its methods the declared names are symbols (SX).

    A subclass gives `step` and, where it needs them, `calculate` and `initial`.
    """

    def calculate(self) -> Mapping[str, Any]:
        """{calculated: expression in the parameters}, evaluated once when the run starts."""
        return {}

    def initial(self) -> Mapping[str, Any]:
        """{state: expression in parameters and inputs} at the start; other states start at their start value."""
        return {}

    @abstractmethod
    def step(self, t: Any, h: Any) -> Mapping[str, Any]:
        """{state or output: expression} after the step from t to t + h [s], with the inputs held constant.

        The outputs at the start of a run are those of a step with h = 0, whose states are discarded.
        """


@dataclass(frozen=True)
class Equations:
    """A traced model.  Each function maps the head of the memory to the part that follows it.

    calculate: parameters -> calculated.  initial: up to the inputs -> states.
    step: up to the states -> states and outputs.
    """

    layout: Layout
    calculate: Any
    initial: Any
    step: Any

    @cached_property
    def dependencies(self) -> dict[str, dict[str, list[str]]]:
        """{"outputs" or "initial": {unknown: [knowns it depends on]}}, exact, by CasADi's sparsity (FMI 2.0, 2.2.8).

        "outputs": on the inputs, at a communication point.  "initial": on inputs and parameters.
        """
        return _dependencies(self)


def trace(model_class: type[Model], packed: pathlib.Path | None = None) -> Equations:
    """Evaluate a model's methods once, with symbols.  Raises ValueError where they do not fit the declarations.

    packed: the folder of its data files, in an FMU.
    """
    import casadi as ca

    layout = model_class.layout()
    memory = ca.SX.sym("m", layout.size)
    model = made(model_class, packed)
    for variable in layout.variables:
        if variable.group != "output":
            assign(model, variable.name, _shaped(memory[layout.places[variable.name]], variable.shape))
    calculated = model.calculate()
    for variable in layout.of("calculated"):
        expression = _result(variable, calculated)
        # Keeping the zeros of a matrix structural keeps them out of the step.
        setattr(model, variable.name, ca.project(getattr(model, variable.name), expression.sparsity()))
    initial = {v.name: ca.DM(v.start) for v in layout.of("state")} | dict(model.initial())
    stepped = model.step(memory[0], memory[1])
    unknown = set(calculated) | set(initial) | set(stepped)
    unknown -= {v.name for v in layout.variables if v.group in ("calculated", "state", "output")}
    if unknown:
        raise ValueError(f"{model_class.__name__} computes {', '.join(sorted(unknown))}, which it does not declare")

    def function(name: str, group: str, results: Mapping[str, Any], following: tuple[str, ...]) -> Any:
        head = memory[: layout.groups[group].stop]
        parts = [ca.vec(_result(v, results)) for kind in following for v in layout.of(kind)]
        return ca.Function(name, [head], [ca.cse(ca.densify(ca.vertcat(ca.SX(0, 1), *parts)))])

    return Equations(
        layout,
        function("calculate", "parameter", calculated, ("calculated",)),
        function("initial", "input", initial, ("state",)),
        function("step", "state", stepped, ("state", "output")),
    )


def _dependencies(equations: Equations) -> dict[str, dict[str, list[str]]]:
    import casadi as ca

    layout = equations.layout
    names = {scalar.place: scalar.name for scalar in layout.scalars}
    groups = layout.groups

    def depends(unknowns: slice, expression: Any, knowns: list[tuple[slice, Any]]) -> dict[str, list[str]]:
        dependencies: dict[str, list[str]] = {names[place]: [] for place in range(unknowns.start, unknowns.stop)}
        for places, symbols in knowns:
            rows, columns = ca.jacobian(expression, symbols).sparsity().get_triplet()
            for row, column in sorted(zip(rows, columns, strict=True), key=lambda rc: rc[1]):
                dependencies[names[unknowns.start + row]].append(names[places.start + column])
        return dependencies

    h, t = ca.SX(0), ca.SX.sym("t")
    p, u, x, c = (
        ca.SX.sym(group[0], groups[group].stop - groups[group].start)
        for group in ("parameter", "input", "state", "calculated")
    )
    results = slice(groups["state"].start, groups["output"].stop)
    outputs = depends(results, equations.step(ca.vertcat(t, h, p, c, u, x)), [(groups["input"], u)])
    calculated = equations.calculate(ca.vertcat(t, h, p))
    start = equations.initial(ca.vertcat(t, h, p, calculated, u))
    first = equations.step(ca.vertcat(t, h, p, calculated, u, start))
    knowns = [(groups["parameter"], p), (groups["input"], u)]
    initial = depends(groups["calculated"], calculated, knowns) | depends(results, first, knowns)
    return {"outputs": outputs, "initial": initial}


def _shaped(column: Any, shape: tuple[int, ...]) -> Any:
    import casadi as ca

    return ca.reshape(column, *shape) if len(shape) == 2 else column


def _result(variable: Declaration, results: Mapping[str, Any]) -> Any:
    import casadi as ca

    if variable.name not in results:
        raise ValueError(f"the equations do not compute {variable.name!r}, which is declared as {variable.group}")
    expression = ca.SX(results[variable.name])
    if expression.numel() == 1 and variable.size > 1:
        expression = ca.repmat(expression, variable.size, 1)
    if expression.numel() != variable.size:
        raise ValueError(f"{variable.name!r} has {variable.size} entries, its equation {expression.numel()}")
    return expression if len(variable.shape) == 2 else ca.vec(expression)
