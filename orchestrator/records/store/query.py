"""A small language for choosing runs: `components.controller1.fmu == 'pid' and metrics.rmse_x1 < 0.2`.

    expression   and, or, not, parentheses
    comparison   == != < <= > >=, in [..], like 'glob*', the latter two also after not; a chain such as 0 < a < 1
    value        a dotted name, a number, 'a text', true, false, a list [..]

A run that lacks a name neither matches nor fails to match: it is not chosen.  Python's parser reads the expression, in
which a stand-in of the same length takes the place of each name and text; nothing is run as Python.
"""

from __future__ import annotations

import ast
import fnmatch
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from ...errors import OrchError, did_you_mean

WORD = re.compile(
    r"""(?P<key>not\s+like|(?:and|or|not|in|like(?!\s+not\b)|true|false)(?![\w.]))
    |(?P<name>(?<![\w.])[^\W\d]\w*(?:\.\w+|\[[\w,]+\])*)|(?P<text>(?<!\w)(?:'[^']*'|"[^"]*"))""",
    re.VERBOSE,
)
PYTHON = {"like": "is", "not like": "is not", "true": "True", "false": "False"}
FOREIGN = re.compile(r"(?<![eE])\+|[^\w .()\[\],<>=!+-]")
JOIN, TOO_DEEP = "join conditions by and, or", "the expression is nested too deeply"
COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda a, b: str(a) in b if isinstance(b, str) else a in b,
    ast.NotIn: lambda a, b: str(a) not in b if isinstance(b, str) else a not in b,
    ast.Is: lambda a, b: fnmatch.fnmatchcase(str(a), str(b)),
    ast.IsNot: lambda a, b: not fnmatch.fnmatchcase(str(a), str(b)),
}

Facts = Mapping[str, Any]


class WhereError(OrchError):
    """An expression that cannot be understood; the message points at the place."""


@dataclass(frozen=True)
class Where:
    """A parsed expression.  tree: Python's, of the expression with stand-ins."""

    source: str
    tree: ast.expr

    def choose(self, runs: Iterable[Facts]) -> list[Facts]:
        """The runs for which the expression is true.  Raises WhereError for a name that none of them has."""
        runs = list(runs)
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Name) and runs and all(self._value(node, run) is None for run in runs):
                name, known = self._word(node), sorted({name for run in runs for name in _names(run)})
                near = did_you_mean(name, known, "there are")
                raise _error(self.source, node.col_offset, f"no run has {name!r}{near}")
        return [run for run in runs if self.holds(run)]

    def holds(self, run: Facts) -> bool:
        """Whether the expression is true of one run."""
        return self._truth(self.tree, run) is True

    def _truth(self, node: ast.expr, run: Facts) -> bool | None:
        """None where the run lacks a name that would decide."""
        match node:
            case ast.BoolOp():
                return _joined([self._truth(part, run) for part in node.values], isinstance(node.op, ast.Or))
            case ast.UnaryOp(op=ast.Not()):
                return None if (truth := self._truth(node.operand, run)) is None else not truth
            case ast.Compare():
                links = zip(pairwise([node.left, *node.comparators]), node.ops, strict=True)
                return _joined([self._compared(a, op, b, run) for (a, b), op in links], False)
            case ast.List() | ast.Tuple():
                raise _error(self.source, node.col_offset, f"a list is no condition; {JOIN}")
        return None if (value := self._value(node, run)) is None else bool(value)

    def _value(self, node: ast.expr, run: Facts) -> Any:
        match node:
            case ast.Name():
                word = self._word(node)
                return word[1:] if word[0] in "'\"" else lookup(run, word)
            case ast.Constant(value=int() | float() as number):  # or a truth
                return number
            case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as number)):
                return -number
            case ast.List() | ast.Tuple():
                return [self._value(item, run) for item in node.elts]
            case ast.BoolOp() | ast.UnaryOp(op=ast.Not()) | ast.Compare():
                return self._truth(node, run)
            case ast.Call(func=head) | ast.Subscript(value=head) | ast.Attribute(value=head) | ast.BinOp(left=head):
                raise _unexpected(self.source, self._after(head))
        raise _unexpected(self.source, node.col_offset)

    def _after(self, node: ast.expr) -> int:
        """The column of what follows a value."""
        return len(self.source) - len(self.source[node.end_col_offset :].lstrip(" )'\""))

    def _word(self, node: ast.Name) -> str:
        """A name, or a text without its last quotation mark."""
        return self.source[node.col_offset : node.end_col_offset]

    def _compared(self, left: ast.expr, op: ast.cmpop, right: ast.expr, run: Facts) -> bool | None:
        a, b = self._value(left, run), self._value(right, run)
        if a is None or b is None:
            return None
        try:
            return bool(COMPARISONS[type(op)](a, b))
        except TypeError:
            sentence = f"this compares {_kind(a)} with {_kind(b)}"
            if isinstance(op, ast.In | ast.NotIn):
                sentence = "in is followed by a list, such as ['pid', 'lyapunov']"
            raise _error(self.source, self._after(left), sentence) from None


def parse(source: str) -> Where:
    """Raises WhereError."""
    source = re.sub(r"\s", " ", source).strip()
    stand_ins = WORD.sub(_stand_in, source)
    if foreign := FOREIGN.search(stand_ins):
        raise _error(source, foreign.start(), f"{foreign[0]!r} belongs to no name, number or text")
    try:
        where = Where(source, ast.parse(stand_ins, mode="eval").body)
        where.holds({})  # raises at what is Python, and not of this language
    except SyntaxError as error:
        raise _mistake(source, error) from None
    except (RecursionError, MemoryError):
        raise _error(source, 0, TOO_DEEP) from None
    return where


def _stand_in(match: re.Match[str]) -> str:
    """As long as the word; that of a text ends with a blank, as a name may follow at once."""
    word = " ".join(match[0].split())
    text = PYTHON.get(word, word) if match["key"] else "x" * (len(match[0]) - bool(match["text"]))
    return text.ljust(len(match[0]))


def _mistake(source: str, error: SyntaxError) -> WhereError:
    """What Python's parser found, in the words of this language."""
    column, value = (error.offset or 0) - 1, "a name, a number or a text"
    if "too many nested" in error.msg:
        return _error(source, 0, TOO_DEEP)
    if "never closed" in error.msg:
        return _error(source, len(source), f"{') ]'['( ['.index(source[column])]} is missing before the end")
    if "comma" in error.msg:  # in brackets; Python tells where the first of the two begins
        return _error(source, column, f"one condition or item follows another; {JOIN}, items by a comma")
    if column < 0:
        return _error(source, len(source), f"{value} is missing before the end")
    before, token = source[:column].rstrip(), _token(source, column)
    if before.endswith("not") and re.match(r"[\w'\"]", token):
        return _error(source, column, "not is followed by in or like")
    if re.search(r"(?<!\w)(?:and|or|not|in|like)$|[^\w'\")\]]$|^$", before):
        return _error(source, column, f"{value} is missing before {token}")
    return _unexpected(source, column)


def _unexpected(source: str, column: int) -> WhereError:
    return _error(source, column, f"{_token(source, column)!r} is not expected here; {JOIN}")


def _token(source: str, column: int) -> str:
    match = WORD.match(source, column) or re.compile(r"[<>=!]+|.").match(source, column)
    return match[0] if match else ""


def lookup(run: Facts, name: str) -> Any:
    """The value of a dotted name, None where there is none; keys may themselves have dots, as in parameters.K_p.z.

    A run that did not complete has no metrics here: theirs are of a part of the time, and a short run is no good one.
    A metric that is the time of what never happens is inf.
    """
    if name.removeprefix("metrics.") in _never(run) and name.startswith("metrics."):
        return math.inf
    if name in run:
        return run[name]
    for i in range(len(name) - 1, 0, -1):
        below = run.get(name[:i]) if name[i] == "." else None
        if name[:i] == "metrics" and run.get("status", "completed") != "completed":
            continue
        if isinstance(below, Mapping) and (value := lookup(below, name[i + 1 :])) is not None:
            return value
    return None


def _never(run: Facts) -> Sequence[str]:
    return (run.get("metrics_never") or ()) if run.get("status", "completed") == "completed" else ()


def _names(run: Facts, above: str = "") -> Iterable[str]:
    for key, value in run.items():
        if isinstance(value, Mapping):
            yield from _names(value, f"{above}{key}.")
        else:
            yield above + key


def _joined(truths: Sequence[bool | None], decisive: bool) -> bool | None:
    """`or` where True decides, `and` where False does; what is unknown decides nothing."""
    return decisive if decisive in truths else None if None in truths else not decisive


def _error(source: str, column: int, sentence: str) -> WhereError:
    return WhereError(f"--where: {sentence}\n  {source}\n  {' ' * column}^")


def _kind(value: Any) -> str:
    return "a text" if isinstance(value, str) else "a number" if isinstance(value, int | float) else "a list"
