"""How a model is declared, and how its declaration becomes numbers in a row.

A model is a class whose attributes declare its variables and whose methods give its equations as CasADi
expressions.  `trace` turns it into three functions of one flat vector, the memory

    [ t, h | parameters | calculated | inputs | states | outputs ]

in which every scalar has a fixed place: its FMI value reference.  Packaging needs nothing else, so a Python FMU
and a native one come from the same definition.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

from ..signals import Signal

GROUPS = ("parameter", "calculated", "input", "state", "output")
FIRST = 2  # places 0 and 1 hold t and h


@dataclass(frozen=True)
class Scalar:
    """One FMI variable: its name, its place in the memory, and what modelDescription.xml says of it."""

    name: str
    place: int
    causality: str  # FMI's: parameter, calculatedParameter, input, output or local
    unit: str
    start: float
    meaning: str
    type: type = float


class Variable:
    """A declared variable of one or more axes; `shape` () is a scalar, (n,) a vector, (n, m) a matrix."""

    group: str
    causality: str

    def __init__(self, signal: Signal, start: Any = 0.0, shape: tuple[int, ...] | None = None, type: type = float):
        self.signal, self.type = signal, type
        self.shape = shape if shape is not None else (len(signal.axes),) if signal.axes else ()
        self.size = 1
        for n in self.shape:
            self.size *= n
        self.start = _flat(start, self.size)
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def scalars(self, place: int) -> Iterator[Scalar]:
        """The FMI variables of this one; the first lies at `place`."""
        units = (self.signal.units,) * self.size if isinstance(self.signal.units, str) else self.signal.units
        for i, (suffix, unit, start) in enumerate(zip(self._suffixes(), units, self.start, strict=True)):
            yield Scalar(
                self.name + suffix,
                place + i,
                self.causality,
                unit,
                start,
                f"{suffix.lstrip('.')}: {self.signal.meaning}" if suffix.startswith(".") else self.signal.meaning,
                self.type,
            )

    def _suffixes(self) -> list[str]:
        if self.signal.axes:
            # FMI's structured names know L[1] but not L.1
            return [f"[{axis}]" if axis.isdecimal() else f".{axis}" for axis in self.signal.axes]
        if len(self.shape) == 2:  # the memory holds matrices column by column, as CasADi does
            return [f"[{i + 1},{j + 1}]" for j in range(self.shape[1]) for i in range(self.shape[0])]
        return [f"[{i + 1}]" for i in range(self.size)] if self.shape else [""]


class Input(Variable):
    """What the model reads; its start value holds where nothing is connected."""

    group, causality = "input", "input"


class Output(Variable):
    """What the model gives: a function of states and inputs."""

    group, causality = "output", "output"


class State(Variable):
    """What the model remembers from step to step; `output=True` shows it to the others."""

    group = "state"

    def __init__(self, signal: Signal, start: Any = 0.0, output: bool = False):
        super().__init__(signal, start)
        self.causality = "output" if output else "local"


class Parameter(Variable):
    """A number fixed before the run.  `default`: a number, True or False, or a sequence; `unit`: one, or one an axis.

    A sequence is a vector over `axes`, or numbered `name[1]`, `name[2]`, ... without them; a number with `axes`
    holds for each.  `type=int` makes an FMI Integer.
    """

    group, causality = "parameter", "parameter"

    def __init__(
        self,
        default: Any,
        unit: str | tuple[str, ...] = "1",
        meaning: str = "",
        axes: tuple[str, ...] = (),
        type: type = float,
    ):
        shape = (len(axes),) if axes else (len(default),) if isinstance(default, Sequence) else ()
        kind = bool if isinstance(default, bool) else type
        super().__init__(Signal(axes, unit, meaning), default, shape, kind)


class Calculated(Variable):
    """A number or matrix that follows from the parameters: FMI's calculatedParameter, given by `calculate`."""

    group, causality = "calculated", "calculatedParameter"

    def __init__(self, shape: tuple[int, ...], unit: str = "1", meaning: str = ""):
        super().__init__(Signal((), unit, meaning), 0.0, shape)


class Group:
    """The declarations of another class under a common name: `model = Group(Body)` makes `model.m`, `self.model.m`."""

    def __init__(self, declarations: type):
        self.declarations = declarations

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def variables(self) -> Iterator[Variable]:
        for variable in _declarations(self.declarations):
            member = copy.copy(variable)
            member.name = f"{self.name}.{variable.name}"
            yield member


class Layout:
    """Where each variable of a model class lies in its memory."""

    def __init__(self, model: type):
        declared = _declarations(model)
        self.places: dict[str, slice] = {}
        self.groups: dict[str, slice] = {}
        self.variables: list[Variable] = []
        self.scalars: list[Scalar] = []
        place = FIRST
        for group in GROUPS:
            first = place
            for variable in (v for v in declared if v.group == group):
                self.variables.append(variable)
                self.places[variable.name] = slice(place, place + variable.size)
                self.scalars += variable.scalars(place)
                place += variable.size
            self.groups[group] = slice(first, place)
        self.size = place

    def start(self) -> list[float]:
        """The memory before initialization: every declared start value."""
        return [0.0] * FIRST + [scalar.start for scalar in self.scalars]

    def of(self, group: str) -> list[Variable]:
        return [v for v in self.variables if v.group == group]


def assign(model: Any, name: str, value: Any) -> None:
    """Set `model.name`, or `model.group.name` for a variable of a group."""
    group, _, member = name.rpartition(".")
    if not group:
        setattr(model, name, value)
    elif group in vars(model):
        setattr(getattr(model, group), member, value)
    else:
        setattr(model, group, SimpleNamespace(**{member: value}))


class Declared(ABC):  # noqa: B024 - the two styles below have their own abstract methods
    """Both styles of model: the declarations are class attributes, the values attributes of the instance."""

    @classmethod
    def layout(cls) -> Layout:
        if "_layout" not in cls.__dict__:
            cls._layout = Layout(cls)  # type: ignore[attr-defined]
        return cls._layout  # type: ignore[attr-defined,no-any-return]


class Model(Declared):
    """A model as CasADi expressions; in its methods the declared names are symbols (SX).

    A subclass gives `step` and, where it needs them, `calculate` and `initial`.
    """

    def calculate(self) -> Mapping[str, Any]:
        """{calculated: expression in the parameters}, evaluated once when the run begins."""
        return {}

    def initial(self) -> Mapping[str, Any]:
        """{state: expression in parameters and inputs} at the start; other states begin at their start value."""
        return {}

    @abstractmethod
    def step(self, t: Any, h: Any) -> Mapping[str, Any]:
        """{state or output: expression} after the step from t to t + h [s] with the inputs held.

        The values at the start of a run are those of a step with h = 0 whose states are thrown away.
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


def trace(model_class: type[Model]) -> Equations:
    """Evaluate a model's methods once, with symbols.  Raises ValueError where they do not fit the declarations."""
    import casadi as ca

    layout = model_class.layout()
    memory = ca.SX.sym("m", layout.size)
    model = model_class()
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
        raise ValueError(f"{model_class.__name__} gives {', '.join(sorted(unknown))}, which it does not declare")

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
        found: dict[str, list[str]] = {names[place]: [] for place in range(unknowns.start, unknowns.stop)}
        for places, symbols in knowns:
            rows, columns = ca.jacobian(expression, symbols).sparsity().get_triplet()
            for row, column in sorted(zip(rows, columns, strict=True), key=lambda rc: rc[1]):
                found[names[unknowns.start + row]].append(names[places.start + column])
        return found

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


def _declarations(model: type) -> list[Variable]:
    """Declared variables, base classes first, in the order of the source."""
    found: dict[str, Variable] = {}
    for cls in reversed(model.__mro__):
        for name, value in vars(cls).items():
            if isinstance(value, Variable):
                found[name] = value
            elif isinstance(value, Group):
                found |= {variable.name: variable for variable in value.variables()}
            else:
                found.pop(name, None)
    return list(found.values())


def _flat(value: Any, size: int) -> tuple[float, ...]:
    values = tuple(float(v) for v in value) if isinstance(value, Sequence) else (float(value),) * size
    if len(values) != size:
        raise ValueError(f"{len(values)} start values for {size} axes")
    return values


def _shaped(column: Any, shape: tuple[int, ...]) -> Any:
    import casadi as ca

    return ca.reshape(column, *shape) if len(shape) == 2 else column


def _result(variable: Variable, results: Mapping[str, Any]) -> Any:
    import casadi as ca

    if variable.name not in results:
        raise ValueError(f"the equations give no {variable.name!r}, which is declared as {variable.group}")
    expression = ca.SX(results[variable.name])
    if expression.numel() == 1 and variable.size > 1:
        expression = ca.repmat(expression, variable.size, 1)
    if expression.numel() != variable.size:
        raise ValueError(f"{variable.name!r} has {variable.size} entries, its equation {expression.numel()}")
    return expression if len(variable.shape) == 2 else ca.vec(expression)
