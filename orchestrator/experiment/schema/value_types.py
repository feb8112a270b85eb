"""How keys are declared: what their values may be, and the sections that they stand in."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeGuard

from ...errors import Problem, did_you_mean

Json = dict[str, Any]  # a JSON Schema, draft 7


@dataclass(frozen=True, kw_only=True)
class ValueType:
    """What a value may be.

    words: for the reference.  json: the JSON Schema of it.  problem: what is wrong with a value, as a message has it
    after the key, "" where it fits.  convert: to what the reader returns.
    """

    words: str
    json: Json
    problem: Callable[[Any], str]
    convert: Callable[[Any], Any] = lambda value: value


@dataclass(frozen=True, kw_only=True)
class Key:
    """A key of a section.

    example: a value, as TOML.  default: the value where the key is missing; absent: in words, where it has none.
    missing: what a message adds where a required key is missing.
    """

    name: str
    type: ValueType
    meaning: str
    example: str
    unit: str = ""
    default: Any = None
    absent: str = ""
    required: bool = False
    missing: str = ""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """What a section may hold where the key `by` has a certain value: keys that it needs, and others that it takes.

    unit: of a metric's number; U is the signal's.
    """

    needs: tuple[str, ...]
    takes: tuple[str, ...] = ()
    meaning: str = ""
    unit: str = ""


@dataclass(frozen=True, kw_only=True)
class Section:
    """A table of the experiment file.

    heading: as it stands in a file, names that the user chooses in capitals.  by, variants: the key that decides which
    of the others there may be, and {its value: those}.  rules: JSON Schema keywords on what keys have to do with each
    other.
    """

    heading: str
    keys: tuple[Key, ...]
    by: str = ""
    variants: Mapping[str, Variant] = field(default_factory=dict)
    rules: Json = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        return [key.name for key in self.keys]

    def read(self, table: Mapping[str, Any], path: str) -> tuple[dict[str, Any], list[Problem]]:
        """The values of a table, and what is wrong with it.  path: the dotted key of the table.

        A key that is missing, or whose value does not fit, has its default; where it has none, it is left out.
        """
        problems = [
            Problem(below(path, name), f"unknown key{did_you_mean(name, self.names)}")
            for name in table
            if name not in self.names
        ]
        values: dict[str, Any] = {}
        for key in self.keys:
            sentence = f"is missing{key.missing}" if key.required else ""
            if key.name in table:
                sentence = key.type.problem(table[key.name])
                if not sentence:
                    values[key.name] = key.type.convert(table[key.name])
                    continue
            if sentence:
                problems.append(Problem(below(path, key.name), sentence))
            if key.default is not None:
                values[key.name] = key.default
        return values, problems + self._unfit(table, path, values.get(self.by))

    def _unfit(self, table: Mapping[str, Any], path: str, name: Any) -> list[Problem]:
        """Keys that are missing, or have no place, beside a certain value of `by`."""
        if name not in self.variants:
            return []
        variant = self.variants[name]
        fitting = [key for key in self.names if key not in self._varying or key in (*variant.needs, *variant.takes)]
        taken = [key for key in fitting if key != self.by]
        problems = [
            Problem(below(path, key), f"{name} takes no {key!r}{did_you_mean(key, taken)}")
            for key in table
            if key in self.names and key not in fitting
        ]
        return problems + [Problem(below(path, key), "is missing") for key in variant.needs if key not in table]

    @property
    def _varying(self) -> set[str]:
        return {key for variant in self.variants.values() for key in (*variant.needs, *variant.takes)}

    @property
    def json(self) -> Json:
        schema: Json = {
            "type": "object",
            "properties": {key.name: _described(key) for key in self.keys},
            "additionalProperties": False,
        }
        if required := [key.name for key in self.keys if key.required]:
            schema["required"] = required
        if self.variants:
            schema["allOf"] = [
                {
                    "if": {"properties": {self.by: {"const": name}}, "required": [self.by]},
                    "then": {
                        "required": list(variant.needs),
                        "properties": dict.fromkeys(sorted(self._varying - {*variant.needs, *variant.takes}), False),
                    },
                }
                for name, variant in self.variants.items()
            ]
        return schema | self.rules


def _described(key: Key) -> Json:
    unit = f" [{key.unit}]" if key.unit else ""
    default = {"default": key.default} if key.default is not None else {}
    return {"description": f"{key.meaning}{unit}", **key.type.json, **default}


def below(path: str, key: str) -> str:
    """The dotted key of a key of the table at `path`."""
    return f"{path}.{key}" if path else key


def is_number(value: Any) -> TypeGuard[float]:
    """Whether a value is a finite number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def is_whole(value: Any) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool)


def _type(words: str, json: Json, fits: Callable[[Any], bool], otherwise: str) -> ValueType:
    """otherwise: what a message says after "is VALUE" of one that does not fit."""
    return ValueType(words=words, json=json, problem=lambda value: "" if fits(value) else f"is {value!r}{otherwise}")


TEXT = _type("text", {"type": "string"}, lambda value: isinstance(value, str), ", not a text")
TRUTH = _type("true or false", {"type": "boolean"}, lambda value: isinstance(value, bool), ", not true or false")
TABLE = _type("table", {"type": "object"}, lambda value: isinstance(value, dict), ", not a table")


def number(
    least: float | None = None, greatest: float | None = None, otherwise: str = "; give a finite number"
) -> ValueType:
    """A real number, from `least` to `greatest`."""
    json: Json = {"type": "number"}
    json |= {"minimum": least} if least is not None else {}
    json |= {"maximum": greatest} if greatest is not None else {}
    low, high = -math.inf if least is None else least, math.inf if greatest is None else greatest
    return ValueType(
        words="number",
        json=json,
        problem=lambda value: "" if is_number(value) and low <= value <= high else f"is {value!r}{otherwise}",
        convert=float,
    )


def positive(otherwise: str) -> ValueType:
    """A real number above zero."""
    return ValueType(
        words="positive number",
        json={"type": "number", "exclusiveMinimum": 0},
        problem=lambda value: "" if is_number(value) and value > 0 else f"is {value!r}{otherwise}",
        convert=float,
    )


SECONDS = positive("; give a positive number of seconds")


def whole(least: int | None = None, greatest: int | None = None, otherwise: str = "") -> ValueType:
    """A whole number, from `least` to `greatest`."""
    json: Json = {"type": "integer"}
    json |= {"minimum": least} if least is not None else {}
    json |= {"maximum": greatest} if greatest is not None else {}
    ask = otherwise or "; give a whole number" + (f", at least {least}" if least is not None else "")

    def fits(value: Any) -> bool:
        return is_whole(value) and (least is None or value >= least) and (greatest is None or value <= greatest)

    return _type("whole number", json, fits, ask)


def one_of(*choices: str) -> ValueType:
    """One of some words."""

    def problem(value: Any) -> str:
        if not isinstance(value, str):
            return TEXT.problem(value)
        return "" if value in choices else f"no {value!r}{did_you_mean(value, choices)}"

    return ValueType(
        words=" or ".join(f'`"{choice}"`' for choice in choices), json={"enum": list(choices)}, problem=problem
    )


def list_of(
    type: ValueType | None = None, least: int = 0, greatest: int | None = None, otherwise: str = ", not a list"
) -> ValueType:
    """A list of values, of one type if it is given, from `least` to `greatest` of them."""
    json: Json = {"type": "array"}
    json |= {"items": type.json} if type else {}
    json |= {"minItems": least} if least else {}
    json |= {"maxItems": greatest} if greatest is not None else {}

    def fits(value: Any) -> bool:
        if not isinstance(value, list) or len(value) < least or (greatest is not None and len(value) > greatest):
            return False
        return type is None or not any(type.problem(item) for item in value)

    return _type(f"list of {_plural(type.words)}" if type else "list", json, fits, otherwise)


def _plural(words: str) -> str:
    """list of texts or table: lists of texts or tables"""
    parts = (part.partition(" of ") for part in words.split(" or "))
    return " or ".join(f"{noun}s{of}{content}" for noun, of, content in parts)


def table(section: Section) -> ValueType:
    """A table with the keys of a section; what is in it, `Section.read` judges."""
    return ValueType(words="table", json=section.json, problem=TABLE.problem)


def named(type: ValueType, pattern: str = "") -> ValueType:
    """A table whose keys the user chooses, each with a value of one type; values are judged one by one."""
    if not pattern:
        json: Json = {"type": "object", "additionalProperties": type.json}
    else:
        json = {"type": "object", "patternProperties": {pattern: type.json}, "additionalProperties": False}
    return ValueType(words=f"table of {_plural(type.words)}", json=json, problem=TABLE.problem)


def either(*types: ValueType, otherwise: str = "") -> ValueType:
    """A value of one of several types."""
    return _type(
        " or ".join(type.words for type in types),
        {"anyOf": [type.json for type in types]},
        lambda value: any(not type.problem(value) for type in types),
        otherwise,
    )
