"""FMUs that run.

`instance` is the interface; `fmi2` and `fmi3` implement it over a `library` in this process, `isolated` in a process of
its own, `live` for a builtin.
"""

from __future__ import annotations

from .fmi2 import Fmi2Instance
from .fmi3 import Fmi3Instance
from .library import Library, LibraryInstance


def instantiate(name: str, library: Library) -> LibraryInstance:
    """An instance in this process.  Raises FmuError where the FMU refuses."""
    return (Fmi2Instance if library.fmu.version == 2 else Fmi3Instance)(name, library)
