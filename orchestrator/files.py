"""Files that commands write for a person."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from .errors import StoreError


def write_text(target: Path, text: str) -> Path:
    """Write a file, and the folders it lies in.  Raises StoreError."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
    except OSError as error:
        raise StoreError(f"{target} cannot be written: {error.strerror}") from None
    return target


@contextlib.contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """A file beside the target, which takes its place once it is written.  Raises StoreError."""
    half = target.with_name(f"{target.name}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield half
        half.replace(target)
    except OSError as error:
        reason = error.strerror or str(error).partition("\n")[0]
        raise StoreError(f"{target} cannot be written: {reason}") from None
    finally:
        with contextlib.suppress(OSError):  # it has its name by now, or never had one
            half.unlink()
