"""Files that Python FMUs of this process open besides their own: no digest covers what is read there.

Python reports each file that it opens to audit hooks; one that is set stays, so there is one, which looks only while
somebody watches.  What a library in C opens is not seen, nor what an isolated FMU opens.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

PROGRAMS = (".py", ".pyc", ".pyi", ".so", ".pyd", ".dll", ".dylib", ".pth")
SYSTEM = ("/dev/", "/proc/", "/sys/", "/etc/", "/usr/")
LIBRARIES = ("site-packages", os.sep + ".")  # in a path: what is installed, settings and caches

_watching: list[Opened] = []
_read: dict[str, dict[str, None]] = {}  # {top-level module of an FMU: files that its code has read in this process}


class Opened:
    """Watches from its making until `stop`.  modules: top-level ones that FMUs bring; own: where FMUs are unpacked."""

    def __init__(self, modules: Iterable[str], own: Path):
        self.modules, self.own = frozenset(modules), str(own)
        if self.modules:
            _set_hook()
            _watching.append(self)

    def stop(self) -> None:
        """Watch no longer; called twice, it does nothing more."""
        if self in _watching:
            _watching.remove(self)

    def files(self, module: str) -> list[str]:
        """What the code of a module has read in this process, but for what FMUs bring and what is installed."""
        return list(_read.get(module, ()))


@cache
def _set_hook() -> None:
    sys.addaudithook(_look)


def _look(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "open" or not _watching or not isinstance(arguments[0], str | bytes | os.PathLike):
        return
    path, _, flags = arguments
    if isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR):
        return
    module = _module_of(sys._getframe(1))
    if not module:
        return
    try:
        name = os.path.abspath(os.fsdecode(path))
    except (OSError, ValueError):  # what a hook raises would end the model's call
        return
    beside = (*SYSTEM, sys.prefix, sys.base_prefix, *(watch.own for watch in _watching))
    if name.startswith(beside) or name.endswith(PROGRAMS) or any(part in name for part in LIBRARIES):
        return
    if os.path.isfile(name):
        _read.setdefault(module, {})[name] = None


def _module_of(frame: FrameType | None) -> str:
    """The module of an FMU whose code is running, or ""."""
    while frame is not None:
        module = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        if any(module in watch.modules for watch in _watching):
            return module
        frame = frame.f_back
    return ""
