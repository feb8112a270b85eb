"""What no experiment may hold, wherever it stands: numbers of over 64 bits, texts that no file can keep, endless depth.

TOML allows the former to be refused; everything behind this may rely on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..errors import Problem

DEPTH = 32  # tables and lists within each other
LONGEST = 80  # characters of a key that a problem shows


def problems(table: Mapping[str, Any]) -> Iterator[Problem]:
    """All that is out of bounds, by its dotted key."""
    waiting: list[tuple[str, int, Any]] = [("", 0, table)]
    while waiting:
        key, depth, value = waiting.pop()
        if isinstance(value, (Mapping, list)) and depth >= DEPTH:
            yield _problem(key, f"is nested more than {DEPTH} levels deep")
        elif isinstance(value, Mapping):
            for name, below in value.items():
                if isinstance(name, str) and (what := _text(name)):
                    yield _problem(f"{key}.{_plain(name)}".lstrip("."), f"its name {what}")
                waiting.append((f"{key}.{_plain(name)}".lstrip("."), depth + 1, below))
        elif isinstance(value, list):
            waiting += [(key, depth + 1, below) for below in value]
        elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 64:
            yield _problem(key, "is a whole number that does not fit 64 bits")
        elif isinstance(value, str) and (what := _text(value)):
            yield _problem(key, what)


def _text(text: str) -> str:
    """What makes a text impossible to keep."""
    if "\0" in text:
        return "contains the character NUL"
    try:
        text.encode()
    except UnicodeEncodeError:
        return "is not valid UTF-8"
    return ""


def _plain(name: Any) -> str:
    return str(name).encode(errors="replace").decode().replace("\0", "\\0")


def _problem(key: str, sentence: str) -> Problem:
    return Problem(key if len(key) <= LONGEST else f"{key[:LONGEST]}...", sentence)
