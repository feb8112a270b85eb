"""Dotted keys of an experiment file, and values as the command line gives them."""

from __future__ import annotations

import re
import tomllib
from typing import Any


def split_key(key: str) -> list[str]:
    """Parts of a dotted TOML key: connections."a.b" has two; a text that is not a key has none."""
    part = r'"([^"]*)"|\'([^\']*)\'|([^.\s"\']+)'
    if not re.fullmatch(rf"\s*(?:{part})\s*(?:\.\s*(?:{part})\s*)*", key):
        return []
    return [double or single or bare for double, single, bare in re.findall(part, key)]


def parse_value(text: str) -> Any:
    """The value of KEY=VALUE on the command line: TOML where it is, else the text itself."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text
