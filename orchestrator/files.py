"""Files that commands write for a person: checked before the work begins, replaced once they are complete."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from .errors import StoreError


def target(path: str | Path, what: str = "", suffixes: Sequence[str] = (), used: Iterable[str | Path] = ()) -> Path:
    """The file that a command will write, checked before the work begins.

    what: what the file is, such as "a figure".  suffixes: those allowed; none allows any.  used: other files that the
    command reads or writes.  Raises StoreError where the name has another suffix, or the file could not be written.
    """
    path = Path(path)
    try:
        problem = _problem(path, what, suffixes, used)
    except OSError as error:  # such as a name that is too long
        problem = f"{path} cannot be written: {error.strerror}"
    if problem:
        raise StoreError(problem)
    return path


def _problem(path: Path, what: str, suffixes: Sequence[str], used: Iterable[str | Path]) -> str:
    """Why a file is refused, or ""."""
    if path.is_dir():
        return f"{path} is a folder; give the name of a file in it"
    if suffixes and path.suffix.lower() not in suffixes:
        *others, last = suffixes
        listed = f"{', '.join(others)} or {last}" if others else last
        return f"{path}: {what} is a {listed} file; let its name end in {'one of these' if others else last}"
    if path.resolve() in {Path(file).resolve() for file in used}:
        return f"{path} is already used by this command; write to another file"
    if path.exists() and not path.is_file():
        return ""  # a terminal, a pipe
    folder = path.absolute().parent
    while not os.path.lexists(folder):
        folder = folder.parent
    if not folder.is_dir():
        return f"{path} cannot be written: {short(folder)} is a file, not a folder; give another folder"
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"{path} cannot be written: no permission to write into {short(folder)}; give another folder"
    return ""


def short(path: Path) -> str:
    """The path relative to the current folder, where that is shorter."""
    relative = os.path.relpath(path)
    return relative if len(relative) < len(str(path)) else str(path)


def write_text(target: Path, text: str) -> Path:
    """Write a text as UTF-8; missing folders are made.  Raises StoreError, and leaves an existing file as it was."""
    with replacing(target) as half:
        half.write_text(text, encoding="utf-8")
    return target


@contextlib.contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Yields a file beside the target, which replaces it once it is written.  Raises StoreError."""
    if target.exists() and not target.is_file():  # a terminal, a pipe: nothing to replace
        final = half = target
    else:
        final = target.resolve()  # a symbolic link stays one
        half = final.with_name(f"{final.name}.part")
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        yield half
        if half != final:
            half.replace(final)
    except OSError as error:
        reason = error.strerror or str(error).partition("\n")[0]
        raise StoreError(f"{target} cannot be written: {reason}") from None
    finally:
        if half != final:
            with contextlib.suppress(OSError):  # it has been renamed, or never existed
                half.unlink()
