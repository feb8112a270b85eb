"""Whether a model in plain Python assigns what it declares: a misspelt attribute is no error of Python's."""

from __future__ import annotations

import ast
import difflib
import sys
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np


class Watch:
    """What a model's states and outputs are before its first step, to see after it what was not assigned."""

    def __init__(self, model: Any, names: list[str]):
        self._shown = {name: vars(model).get(name) for name in names}
        self._values = {name: np.copy(value) for name, value in self._shown.items()}

    def check(self, model: Any, outputs: set[str], declared: set[str]) -> None:
        """Raises AttributeError for an output that was not assigned and that no line of the model's files assigns, or
        for an attribute that nothing reads and that is spelt nearly like one that is declared."""
        written, read = _attributes(type(model))
        own = {name: line for name, line in written.items() if name not in declared}
        for name, value in self._shown.items():
            touched = vars(model).get(name) is not value or not np.array_equal(value, self._values[name])
            if name in outputs and not touched and name not in written and not (np.ndim(value) and name in read):
                near = difflib.get_close_matches(name, own.keys() - read, 1)
                hint = f"; {own[near[0]]} assigns self.{near[0]}: did you mean self.{name}?" if near else ""
                raise AttributeError(f"do_step never assigns its output {name}{hint}")
        for name in own.keys() - read:
            near = [known for known in self._shown if _near(name, known)]
            if near:
                raise AttributeError(
                    f"{own[name]} assigns self.{name}, which nothing declares or reads: did you mean self.{near[0]}?"
                )


@cache
def _attributes(model: type) -> tuple[dict[str, str], set[str]]:
    """{attribute that the model's files assign: file and line}, and those that they read, or name in a text."""
    written: dict[str, str] = {}
    read: set[str] = set()
    for file, tree in _sources(model):
        targets = {id(node.target) for node in ast.walk(tree) if isinstance(node, ast.AugAssign)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                read.add(node.value)
            elif isinstance(node, ast.Attribute):
                if not isinstance(node.ctx, ast.Load):
                    written.setdefault(node.attr, f"line {node.lineno} of {file}")
                if isinstance(node.ctx, ast.Load) or id(node) in targets:
                    read.add(node.attr)
    return written, read


def _sources(model: type) -> Iterator[tuple[str, ast.AST]]:
    """The files of the bundle that the model's file is in, but for those of `uuv`."""
    package = model.__module__.partition(".")[0]
    for name, module in sorted(sys.modules.items()):
        top, _, rest = name.partition(".")
        if top == package and rest and rest.partition(".")[0] != "uuv":
            source = module.__loader__.get_source(name)  # type: ignore[union-attr]
            yield f"{rest.replace('.', '/')}.py", ast.parse(source)


def _near(name: str, known: str) -> bool:
    """Whether one letter is wrong, missing or too many, or two are swapped."""
    if min(len(name), len(known)) < 3:
        return False
    start = next((i for i, (a, b) in enumerate(zip(name, known, strict=False)) if a != b), min(len(name), len(known)))
    a, b = name[start:], known[start:]
    letters = a[:1].isalpha() or b[:1].isalpha()  # not x_1 and x_2
    return letters and (a[1:] == b[1:] or a[1:] == b or a == b[1:] or (a[:2] == b[1::-1] and a[2:] == b[2:]))
