"""FMUs that run: one interface, and what implements it for FMI 2.0, FMI 3.0, other processes and builtins."""

from __future__ import annotations

from .fmi2 import Fmi2Instance
from .fmi3 import Fmi3Instance
from .library import Library, LibraryInstance


def instantiate(name: str, library: Library) -> LibraryInstance:
    """An instance in this process.  Raises FmuError where the FMU refuses."""
    return (Fmi2Instance if library.fmu.version == 2 else Fmi3Instance)(name, library)
