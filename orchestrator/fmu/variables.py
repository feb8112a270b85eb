"""FMI variables, of FMI 2.0 and 3.0 alike: an array is its elements, one variable each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

# Kinds of values, each with a table of its own in a running system, and their types in memory.
DTYPES: dict[str, Any] = {
    "real": np.float64,
    "integer": np.int32,
    "boolean": np.int32,
    "float32": np.float32,
    "int8": np.int8,
    "uint8": np.uint8,
    "int16": np.int16,
    "uint16": np.uint16,
    "uint32": np.uint32,
    "int64": np.int64,
    "uint64": np.uint64,
    "truth": np.bool_,
    "string": object,
    "binary": object,
}
KINDS = tuple(DTYPES)
OBJECTS = ("string", "binary")
NUMBERS = tuple(kind for kind in KINDS if kind not in OBJECTS)
FLOATS = ("real", "float32")
TRUTHS = ("boolean", "truth")
ANGLE = "angle"  # the quantity of the axes phi, theta and psi of models that are built here, and of builtins
WHOLE = tuple(kind for kind in NUMBERS if kind not in (*FLOATS, *TRUTHS))

# FMI's types, by version: the kind they are, and what the getters and setters call them.
TYPES = {
    2: {"Real": "real", "Integer": "integer", "Enumeration": "integer", "Boolean": "boolean", "String": "string"},
    3: {
        "Float64": "real",
        "Float32": "float32",
        "Int8": "int8",
        "UInt8": "uint8",
        "Int16": "int16",
        "UInt16": "uint16",
        "Int32": "integer",
        "UInt32": "uint32",
        "Int64": "int64",
        "UInt64": "uint64",
        "Boolean": "truth",
        "Enumeration": "int64",
        "String": "string",
        "Binary": "binary",
    },
}
ACCESSORS = {
    version: {kind: name for name, kind in types.items() if name != "Enumeration"} for version, types in TYPES.items()
}


@dataclass(frozen=True, kw_only=True)
class Variable:
    """One scalar of an FMU: a variable, or an element of an array (`x[1,2]`, numbered from 1)."""

    name: str
    reference: int
    type: str  # FMI's: Real, Float64, Integer, Int32, Boolean, String, Enumeration, ...
    kind: str  # one of KINDS
    causality: str
    unit: str = ""
    start: Any = None  # as the FMU writes it
    description: str = ""
    depends: tuple[str, ...] | None = ()  # of an output: the inputs of the same instant it depends on; None: all
    items: tuple[tuple[str, int], ...] = ()  # of an enumeration: name and value
    limits: tuple[float, float] = (-math.inf, math.inf)  # min and max
    quantity: str = ""  # as the FMU writes it
    relative: bool = False  # a difference of two quantities: the offset of a unit is not for it
    shape: tuple[int, ...] = ()  # of the array it is an element of
    element: int = 0  # its place in that array, row by row
    fixed: bool = False  # a constant, or a parameter that cannot be set

    @property
    def feedthrough(self) -> bool:
        """Whether an output depends on an input of the same instant, as far as the FMU says."""
        return self.depends is None or bool(self.depends)

    @property
    def is_angle(self) -> bool:
        """Whether differences of its values are differences on the circle; Modelica's "Angle" may count turns."""
        return self.quantity == ANGLE

    @property
    def array(self) -> str:
        """The name of the array it is an element of, or its own."""
        return self.name.rpartition("[")[0] if self.shape else self.name

    @property
    def initial(self) -> Any:
        """Its start value as a number, a truth value, a text or bytes; 0, False or empty if the FMU gives none."""
        if self.kind == "string":
            return self.start or ""
        if self.kind == "binary":
            return bytes.fromhex(self.start or "")
        if self.kind in TRUTHS:
            return self.start in ("true", "1")
        return float(self.start or 0) if self.kind in FLOATS else int(self.start or 0)


def read(description: Any, root: Any, structure: Mapping[str, int]) -> Iterator[Variable]:
    """The variables of FMPy's model description.

    root: of modelDescription.xml, for what FMPy leaves out: limits of unsigned numbers, relativeQuantity.
    structure: {structural parameter: value}, which give arrays their shapes.  Raises ValueError if a shape is negative
    or has more than a million elements.
    """
    version = int(description.fmiVersion[0])
    stated = _stated(root, version)
    outputs = {id(u.variable): u for u in description.outputs}
    inputs = [v.name for v in description.modelVariables if v.causality == "input"]
    for v in description.modelVariables:
        if v.type not in TYPES[version]:  # a clock
            continue
        declared = v.declaredType
        unknown = outputs.get(id(v))
        depends: tuple[str, ...] | None = ()
        if v.causality == "output":
            dependencies = unknown.dependencies if unknown is not None else None
            # FMI 2.0, 2.2.8 and FMI 3.0, 2.4.8: without a list of dependencies, an unknown depends on all inputs.
            names = inputs if dependencies is None else [d.name for d in dependencies if d.causality == "input"]
            depends = None if dependencies is None and inputs else tuple(names)
        whole = Variable(
            name=v.name,
            reference=v.valueReference,
            type=v.type,
            kind=TYPES[version][v.type],
            causality=v.causality or "local",
            unit=v.unit or (declared.unit if declared is not None else None) or "",
            start=v.start,
            description=v.description or "",
            depends=depends,
            items=tuple((i.name, int(i.value)) for i in declared.items or ()) if declared is not None else (),
            limits=(
                _limit(stated.get(v.name, {}).get("min"), -math.inf),
                _limit(stated.get(v.name, {}).get("max"), math.inf),
            ),
            quantity=stated.get(v.name, {}).get("quantity", ""),
            relative=stated.get(v.name, {}).get("relativeQuantity") in ("true", "1"),
            fixed=v.variability == "constant",
        )
        yield from _elements(whole, v, structure) if v.dimensions else (whole,)


def _elements(whole: Variable, v: Any, structure: Mapping[str, int]) -> Iterator[Variable]:
    shape = tuple(
        d.start if d.start is not None else structure.get(d.variable.name, int(d.variable.start)) for d in v.dimensions
    )
    if math.prod(shape) > 1 << 20 or min(shape) < 0:
        raise ValueError(f"{whole.name} would be an array of {' x '.join(map(str, shape))} values")
    starts = (whole.start or "").split() if whole.kind not in OBJECTS else [whole.start]
    for k, place in enumerate(itertools.product(*(range(1, n + 1) for n in shape))):
        start = starts[k] if k < len(starts) else starts[0] if len(starts) == 1 else None
        name = f"{whole.name}[{','.join(map(str, place))}]"
        yield replace(whole, name=name, start=start, shape=shape, element=k)


def _stated(root: Any, version: int) -> dict[str, Mapping[str, str]]:
    """{variable: attributes of its type}: its own, above those of the type that it declares."""
    elements = {e.get("name"): e for e in root.iterfind("ModelVariables/*")}
    types = {e.get("name"): e for e in root.iterfind("TypeDefinitions/*")}
    if version == 2:
        elements, types = (
            {name: next((t for t in e if t.tag in TYPES[2]), e) for name, e in named.items()}
            for named in (elements, types)
        )
    return {name: {**_attributes(types.get(e.get("declaredType"))), **e.attrib} for name, e in elements.items()}


def _attributes(element: Any) -> Mapping[str, str]:
    return {} if element is None else dict(element.attrib)


def _limit(text: str | None, otherwise: float) -> float:
    """A min or max; `otherwise` where there is none, or one for each element."""
    try:
        return otherwise if text is None else float(text)
    except ValueError:
        return otherwise
