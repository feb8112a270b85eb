"""Dotted keys of an experiment file."""

from __future__ import annotations

import re


def split_key(key: str) -> list[str]:
    """Parts of a dotted TOML key: connections."a.b" has two; none of what is no key."""
    part = r'"([^"]*)"|\'([^\']*)\'|([^.\s"\']+)'
    if not re.fullmatch(rf"\s*(?:{part})\s*(?:\.\s*(?:{part})\s*)*", key):
        return []
    return [double or single or bare for double, single, bare in re.findall(part, key)]
