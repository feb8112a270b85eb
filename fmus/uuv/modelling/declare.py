"""How the variables of a model are declared, and where each of them lies in memory.

A model is a class whose attributes declare its variables.  Their values are one flat vector, the memory

    [ t, h | parameters | calculated | inputs | states | outputs ]

in which every scalar has a fixed place: its FMI value reference.  Packaging needs nothing else, so a Python FMU
and a native one come from the same definition.
"""

from __future__ import annotations

import copy
import math
import pathlib
import sys
from abc import ABC
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

GROUPS = ("parameter", "calculated", "input", "state", "output")
FIRST = 2  # places 0 and 1 hold t and h
PACKED = "_packed_files"  # attribute of an instance in an FMU: the folder of its data files
ANGLES = ("phi", "theta", "psi")  # axes that are angles, where their unit is rad

Limits = tuple[float, float]  # least and largest


@dataclass(frozen=True)
class Signal:
    """A named set of axes.  `axes`: () for a scalar.  `units`: one for all axes, or one an axis.

    `limits`: (least, largest) that a model is valid for, or those of some axes; a run warns where a value leaves them.
    """

    axes: tuple[str, ...]
    units: str | tuple[str, ...]
    meaning: str
    limits: Limits | Mapping[str, Limits] = field(default=(-math.inf, math.inf), hash=False)


@dataclass(frozen=True)
class Scalar:
    """One FMI variable: its name, its place in the memory, and what modelDescription.xml says about it."""

    name: str
    place: int
    causality: str  # FMI's: parameter, calculatedParameter, input, output or local
    unit: str
    start: float
    meaning: str
    type: type = float
    limits: Limits = (-math.inf, math.inf)
    quantity: str = ""  # "angle", whose differences are on the circle


class Declaration:
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
        limits = self.signal.limits
        for i, (suffix, unit, start) in enumerate(zip(self._suffixes(), units, self.start, strict=True)):
            axis = suffix.lstrip(".")
            yield Scalar(
                self.name + suffix,
                place + i,
                self.causality,
                unit,
                start,
                f"{axis}: {self.signal.meaning}" if suffix.startswith(".") else self.signal.meaning,
                self.type,
                limits.get(axis, (-math.inf, math.inf)) if isinstance(limits, Mapping) else limits,
                "angle" if axis in ANGLES and unit == "rad" else "",
            )

    def _suffixes(self) -> list[str]:
        if self.signal.axes:
            # FMI's structured names know L[1] but not L.1
            return [f"[{axis}]" if axis.isdecimal() else f".{axis}" for axis in self.signal.axes]
        if len(self.shape) == 2:  # the memory holds matrices column by column, as CasADi does
            return [f"[{i + 1},{j + 1}]" for j in range(self.shape[1]) for i in range(self.shape[0])]
        return [f"[{i + 1}]" for i in range(self.size)] if self.shape else [""]


class Input(Declaration):
    """What the model reads; its start value is used where nothing is connected."""

    group, causality = "input", "input"


class Output(Declaration):
    """What the model computes for others: a function of states and inputs."""

    group, causality = "output", "output"


class State(Declaration):
    """What the model keeps from step to step; `output=True` makes it an output as well."""

    group = "state"

    def __init__(self, signal: Signal, start: Any = 0.0, output: bool = False):
        super().__init__(signal, start)
        self.causality = "output" if output else "local"


class Parameter(Declaration):
    """A number set before the run.  `default`: a number, True or False, or a sequence; `unit`: one, or one an axis.

    A sequence is a vector over `axes`, or numbered `name[1]`, `name[2]`, ... without them; a number with `axes`
    holds for each.  `type=int` makes an FMI Integer.  `limits`: as of a Signal.
    """

    group, causality = "parameter", "parameter"

    def __init__(
        self,
        default: Any,
        unit: str | tuple[str, ...] = "1",
        meaning: str = "",
        axes: tuple[str, ...] = (),
        type: type = float,
        limits: Limits | Mapping[str, Limits] = (-math.inf, math.inf),
    ):
        shape = (len(axes),) if axes else (len(default),) if isinstance(default, Sequence) else ()
        kind = bool if isinstance(default, bool) else type
        super().__init__(Signal(axes, unit, meaning, limits), default, shape, kind)


class Calculated(Declaration):
    """A number or matrix computed from the parameters by `calculate`: FMI's calculatedParameter."""

    group, causality = "calculated", "calculatedParameter"

    def __init__(self, shape: tuple[int, ...], unit: str = "1", meaning: str = ""):
        super().__init__(Signal((), unit, meaning), 0.0, shape)


class File:
    """A data file of the model: `data = File("points.csv")` makes self.data its path, beside the model's file.

    It is packed into the FMU, whose digest then covers it; in the FMU self.data is the packed file.
    """

    def __init__(self, path: str):
        beside = sys._getframe(1).f_globals.get("__file__", "")
        self.path = pathlib.Path(beside).parent / path

    def __get__(self, model: Any, owner: type) -> pathlib.Path:
        folder = vars(model).get(PACKED) if model is not None else None
        return self.path if folder is None else folder / self.path.name


class Group:
    """The declarations of another class under a common name: `model = Group(Body)` makes `model.m`, `self.model.m`."""

    def __init__(self, declarations: type):
        self.declarations = declarations

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def variables(self) -> Iterator[Declaration]:
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
        self.variables: list[Declaration] = []
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

    def of(self, group: str) -> list[Declaration]:
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


class Declared(ABC):  # noqa: B024 - the two styles, Model and PythonModel, have their own abstract methods
    """Both styles of model: the declarations are class attributes, the values attributes of the instance."""

    @classmethod
    def layout(cls) -> Layout:
        if "_layout" not in cls.__dict__:
            cls._layout = Layout(cls)  # type: ignore[attr-defined]
        return cls._layout  # type: ignore[attr-defined,no-any-return]


def data_files(model: type) -> dict[str, pathlib.Path]:
    """{name in the FMU: file}.  Raises ValueError for a file that does not exist, or a second one of a name."""
    files: dict[str, pathlib.Path] = {}
    for attribute, value in ((a, v) for cls in reversed(model.__mro__) for a, v in vars(cls).items()):
        if isinstance(value, File):
            if not value.path.is_file():
                raise ValueError(f"{attribute}: no data file {str(value.path)!r}")
            if files.setdefault(value.path.name, value.path) != value.path:
                raise ValueError(f"{attribute}: there are two data files named {value.path.name!r}; rename one")
    return files


def made(model_class: type[Any], packed: pathlib.Path | None) -> Any:
    """An instance of a model.  packed: the folder of its data files, None for where they were declared."""
    model = model_class.__new__(model_class)
    if packed is not None:
        setattr(model, PACKED, packed)
    model.__init__()
    return model


def _declarations(model: type) -> list[Declaration]:
    """Declared variables, base classes first, in the order of the source."""
    declared: dict[str, Declaration] = {}
    for cls in reversed(model.__mro__):
        for name, value in vars(cls).items():
            if isinstance(value, Declaration):
                declared[name] = value
            elif isinstance(value, Group):
                declared |= {variable.name: variable for variable in value.variables()}
            else:
                declared.pop(name, None)
    return list(declared.values())


def _flat(value: Any, size: int) -> tuple[float, ...]:
    values = tuple(float(v) for v in value) if isinstance(value, Sequence) else (float(value),) * size
    if len(values) != size:
        raise ValueError(f"{len(values)} start values for {size} axes")
    return values
