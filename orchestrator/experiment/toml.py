"""A table of an experiment as the text of a TOML file, laid out as the shipped experiments are."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any


def write(table: Mapping[str, Any]) -> str:
    """One [section] a table, one [components.NAME] a component, everything below inline."""
    return "\n".join(_lines(table)).strip() + "\n"


def _lines(table: Mapping[str, Any]) -> Iterator[str]:
    for key, value in table.items():
        if not isinstance(value, Mapping):
            yield f"{_key(key)} = {inline(value)}"
    for key, value in table.items():
        if not isinstance(value, Mapping) or not value:
            continue
        sections = {f"components.{_key(n)}": t for n, t in value.items()} if key == "components" else {_key(key): value}
        for head, section in sections.items():
            yield from ("", f"[{head}]", *(f"{_key(k)} = {inline(v)}" for k, v in section.items()))


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _text(key)


def inline(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {inline(v)}" for k, v in value.items()) + " }" if value else "{}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(inline, value)) + "]"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value)  # of a float: its shortest text, which gives the same float again


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
