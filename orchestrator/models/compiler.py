"""C compilers: for the native packaging of models, here and for other platforms."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from ..errors import OrchError, did_you_mean
from ..fmu.fmu import platform_folder

NAMES = ("cc", "gcc", "clang")
HOW = 'install gcc or clang, or pip install "orch[native]"'
# {target as users name it: (zig's name, folder of FMI 2.0)}
TARGETS = {
    "x86_64-linux": ("x86_64-linux-gnu", "linux64"),
    "aarch64-linux": ("aarch64-linux-gnu", "linux64"),
    "x86_64-windows": ("x86_64-windows-gnu", "win64"),
    "x86-windows": ("x86-windows-gnu", "win32"),
    "x86_64-macos": ("x86_64-macos", "darwin64"),
    "aarch64-macos": ("aarch64-macos", "darwin64"),
}


@dataclass(frozen=True)
class Compiler:
    """command: that compiles C; folder: FMI 2.0's name of the platform it compiles for."""

    command: tuple[str, ...]
    folder: str

    @property
    def identity(self) -> str:
        """Differs for another version or another file."""
        file = Path(self.command[0]).resolve()
        return f"{shlex.join(self.command)} {file} {file.stat().st_mtime_ns}" if file.exists() else ""


@cache
def find() -> Compiler | None:
    """The compiler of this machine: CC if the environment sets it, else cc, gcc, clang or ziglang; None without any."""
    folder = platform_folder()[0]
    if named := shlex.split(os.environ.get("CC", "")):
        return Compiler((path, *named[1:]), folder) if (path := shutil.which(named[0])) else None
    for name in NAMES:
        if path := shutil.which(name):
            return Compiler((path,), folder)
    # By default, zig compiles for exactly the processor that it runs on.
    return Compiler((*_zig(), "-mcpu=baseline"), folder) if find_spec("ziglang") else None


def none() -> str:
    """The message that there is none; it names CC if the environment sets it."""
    named = os.environ.get("CC", "").strip()
    return "no C compiler was found" + (f" (CC is {named!r})" if named else "")


def of_targets(targets: Sequence[str]) -> list[Compiler]:
    """Compilers for other platforms.  Raises OrchError if there is none."""
    for target in targets:
        if target not in TARGETS:
            raise OrchError(f"no target {target!r}{did_you_mean(target, TARGETS)}")
    folders = [TARGETS[target][1] for target in targets]
    if len(set(folders)) < len(folders):
        raise OrchError(f"{' and '.join(targets)} share a folder in FMI 2.0; build an FMU for each")
    if find_spec("ziglang") is None:
        raise OrchError('--target needs the compiler ziglang: pip install "orch[native]"')
    return [Compiler((*_zig(), "-target", TARGETS[target][0]), TARGETS[target][1]) for target in targets]


def _zig() -> tuple[str, ...]:
    return sys.executable, "-m", "ziglang", "cc", "-s"  # without debug information, which names the folder
