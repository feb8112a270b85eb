"""A small language for choosing runs: `components.controller1.fmu == 'pid' and metrics.rmse_x1 < 0.2`.

    expression   and, or, not, parentheses
    comparison   == != < <= > >=, in [..], like 'glob*', and the latter two after not
    value        a dotted name, a number, 'a text', true, false, a list [..]

A run that lacks a name neither matches nor fails to: it is not chosen.  No Python runs.
"""

from __future__ import annotations

import fnmatch
import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...errors import OrchError, did_you_mean

TOKEN = re.compile(
    r"\s*(?:(?P<number>-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![\w.])|(?P<text>'[^']*'|\"[^\"]*\")"
    r"|(?P<name>[A-Za-z_][\w.\[\],]*[\w\]]|[A-Za-z_])|(?P<sign>==|!=|<=|>=|<|>|\(|\)|\[|\]|,))"
)
ORDER: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
WORDS = ("and", "or", "not", "in", "like", "true", "false")


class WhereError(OrchError):
    """An expression that means nothing; the text points at the place."""


@dataclass(frozen=True)
class Token:
    kind: str  # number, text, name, sign, or end
    text: str
    column: int


@dataclass(frozen=True)
class Where:
    """A parsed expression.  `names`: it asks for, with their columns."""

    source: str
    names: Mapping[str, int]
    _evaluate: Callable[[Mapping[str, Any]], Any]

    def choose(self, runs: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
        """The runs for which the expression is true.  Raises WhereError for a name that none of them has."""
        runs = list(runs)
        for name, column in self.names.items():
            if runs and all(lookup(run, name) is None for run in runs):
                known = sorted({known for run in runs for known in _names(run)})
                raise _error(self.source, column, f"no run has {name!r}{did_you_mean(name, known, 'there are')}")
        return [run for run in runs if self.holds(run)]

    def holds(self, run: Mapping[str, Any]) -> bool:
        """Whether the expression is true of one run."""
        return self._evaluate(run) is True


def parse(source: str) -> Where:
    """Raises WhereError."""
    return _Parser(source).whole()


def lookup(run: Mapping[str, Any], name: str) -> Any:
    """The value of a dotted name, None where there is none; keys may themselves have dots, as in parameters.K_p.z."""
    if name in run:
        return run[name]
    for i in range(len(name) - 1, 0, -1):
        below = run.get(name[:i]) if name[i] == "." else None
        if isinstance(below, Mapping) and (found := lookup(below, name[i + 1 :])) is not None:
            return found
    return None


def _names(run: Mapping[str, Any], above: str = "") -> Iterable[str]:
    for key, value in run.items():
        if isinstance(value, Mapping):
            yield from _names(value, f"{above}{key}.")
        else:
            yield above + key


def _error(source: str, column: int, sentence: str) -> WhereError:
    return WhereError(f"--where: {sentence}\n  {source}\n  {' ' * column}^")


class _Parser:
    def __init__(self, source: str):
        self.source = source
        self.names: dict[str, int] = {}
        self.tokens = list(self._tokens())
        self.at = 0

    def whole(self) -> Where:
        evaluate = self.either()
        if self.here.kind != "end":
            raise self.error(f"{self.here.text!r} is not expected here; join conditions by and, or")
        return Where(self.source, self.names, evaluate)

    def _tokens(self) -> Iterable[Token]:
        at, end = 0, len(self.source.rstrip())
        while at < end:
            match = TOKEN.match(self.source, at)
            if match is None:
                column = at + len(self.source[at:]) - len(self.source[at:].lstrip())
                raise _error(self.source, column, f"{self.source[column]!r} belongs to no name, number or text")
            kind = str(match.lastgroup)
            yield Token(kind, match[kind], match.start(kind))
            at = match.end()
        yield Token("end", "the end", end)

    @property
    def here(self) -> Token:
        return self.tokens[self.at]

    def error(self, sentence: str) -> WhereError:
        return _error(self.source, self.here.column, sentence)

    def take(self, *texts: str) -> str:
        """The next token, if it is one of these; "" if not."""
        if self.here.kind in ("sign", "name") and self.here.text in texts:
            self.at += 1
            return self.tokens[self.at - 1].text
        return ""

    def either(self) -> Callable[[Mapping[str, Any]], Any]:
        parts = [self.both()]
        while self.take("or"):
            parts.append(self.both())
        return _joined(parts, decisive=True)

    def both(self) -> Callable[[Mapping[str, Any]], Any]:
        parts = [self.negation()]
        while self.take("and"):
            parts.append(self.negation())
        return _joined(parts, decisive=False)

    def negation(self) -> Callable[[Mapping[str, Any]], Any]:
        if self.take("not"):
            inner = self.negation()
            return lambda run: None if (value := inner(run)) is None else not value
        return self.comparison()

    def comparison(self) -> Callable[[Mapping[str, Any]], Any]:
        if self.take("("):
            inner = self.either()
            if not self.take(")"):
                raise self.error(") is missing")
            return inner
        left, column = self.value(), self.here.column
        negated = bool(self.take("not"))
        sign = self.take("in", "like") if negated else self.take("==", "!=", *ORDER, "in", "like")
        if not sign:
            if negated:
                raise self.error("not is followed by in or like")
            return lambda run: None if (value := left(run)) is None else bool(value)
        right = self.value()

        def evaluate(run: Mapping[str, Any]) -> Any:
            a, b = left(run), right(run)
            if a is None or b is None:
                return None
            return self.compared(a, sign, b, column) != negated

        return evaluate

    def compared(self, a: Any, sign: str, b: Any, column: int) -> bool:
        if sign in ("==", "!="):
            return bool(a == b) == (sign == "==")
        if sign == "in":
            if not isinstance(b, (list, tuple, str)):
                raise _error(self.source, column, "in is followed by a list, such as ['pid', 'lyapunov']")
            return str(a) in b if isinstance(b, str) else a in b
        if sign == "like":
            return fnmatch.fnmatchcase(str(a), str(b))
        if isinstance(a, str) != isinstance(b, str):
            raise _error(self.source, column, f"{a!r} {sign} {b!r} compares a text with a number")
        return ORDER[sign](a, b)

    def value(self) -> Callable[[Mapping[str, Any]], Any]:
        token = self.here
        if self.take("["):
            items = []
            while not self.take("]"):
                items.append(self.value())
                if not self.take(",") and self.here.text != "]":
                    raise self.error("a list goes on with , or ends with ]")
            return lambda run: [item(run) for item in items]
        if token.kind in ("end", "sign") or token.text in ("and", "or", "not", "in", "like"):
            raise self.error(f"a name, a number or a text is missing before {token.text}")
        self.at += 1
        if token.kind == "number":
            number = float(token.text)
            return lambda run: number
        if token.kind == "text":
            return lambda run: token.text[1:-1]
        if token.text in ("true", "false"):
            return lambda run: token.text == "true"
        self.names.setdefault(token.text, token.column)
        return lambda run: lookup(run, token.text)


def _joined(parts: Sequence[Callable[[Mapping[str, Any]], Any]], decisive: bool) -> Callable[[Mapping[str, Any]], Any]:
    """`or` where True decides, `and` where False does; what is not known decides nothing."""

    def evaluate(run: Mapping[str, Any]) -> Any:
        values = [part(run) for part in parts]
        return decisive if decisive in values else None if None in values else not decisive

    return evaluate if len(parts) > 1 else parts[0]
