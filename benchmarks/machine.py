"""The machine and the versions that a measurement belongs to."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

from orchestrator.models.compiler import find

PACKAGES = ("orch", "numpy", "casadi", "pythonfmu", "fmpy", "libcosimpy", "ecospy")


def describe() -> dict[str, str]:
    """{what: which}."""
    return {
        "CPU": f"{_cpu()}, {os.cpu_count()} cores",
        "system": f"{platform.system()} {platform.machine()}",
        "C compiler": _compiler(),
        "Python": platform.python_version(),
        "packages": ", ".join(f"{name} {_version(name)}" for name in PACKAGES if _version(name)),
    }


def markdown() -> str:
    return "\n".join(f"* {what}: {which}" for what, which in describe().items())


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def _compiler() -> str:
    compiler = find()
    if compiler is None:
        return "none"
    command = [*compiler.command, "--version"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[0]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""
