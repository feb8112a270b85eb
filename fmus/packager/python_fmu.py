"""A model as a Python FMU: pythonfmu's library, the model, and every module of its own folder that it imports."""

from __future__ import annotations

import importlib.metadata
import pathlib
from collections.abc import Mapping

from uuv.modelling.declare import Declared
from uuv.modelling.equations import Equations

from .archive import DATA, digest_of, write_archive
from .description import model_description

HERE = pathlib.Path(__file__).parent

CAPABILITIES = {
    "needsExecutionTool": True,
    "canHandleVariableCommunicationStepSize": True,
    "canNotUseMemoryManagementFunctions": True,
    "canGetAndSetFMUstate": True,
    "canSerializeFMUstate": True,
}

# pythonfmu's library takes the class that is furthest from an ancestor named Fmi2Slave; one without a method of its
# own segfaults at the second instance (pythonfmu 0.7.0).
ENTRY = '''"""What pythonfmu's library loads."""
from {package} import load

Fmi2Slave = load("uuv.modelling.slave").Fmi2Slave


class {identifier}(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(load("{module}").{model}, **kwargs)
'''


def build(
    name: str,
    model: type[Declared],
    equations: Equations | None,
    modules: Mapping[str, bytes],
    data: Mapping[str, bytes],
    target: pathlib.Path,
) -> None:
    """Write the FMU; same input, same bytes.

    modules: {path inside the bundle: source}, the model's own as `name`.py; data: {name: content} of its data files.
    Raises RuntimeError if pythonfmu is installed without its libraries.
    """
    binaries = _binaries(name)
    bundle = {**modules, "__init__.py": (HERE / "bundle.py").read_bytes()}
    digest = digest_of(bundle | binaries | {f"{DATA}/{path}": content for path, content in data.items()})
    package = f"{name}_{digest[:12]}"
    entry = ENTRY.format(package=package, identifier=name, module=name, model=model.__name__)
    tool = f"orch with pythonfmu {importlib.metadata.version('pythonfmu')}"
    files = {
        "modelDescription.xml": model_description(model, name, digest, tool, equations, CAPABILITIES, data=data),
        "resources/slavemodule.txt": f"{package}_entry".encode(),
        f"resources/{package}_entry.py": entry.encode(),
        **{f"resources/{package}/{path}": source for path, source in bundle.items()},
        **{f"{DATA}/{path}": content for path, content in data.items()},
        **binaries,
    }
    write_archive(target, files)


def _binaries(name: str) -> dict[str, bytes]:
    import pythonfmu  # type: ignore[import-untyped]

    folder = pathlib.Path(pythonfmu.__file__).parent / "resources" / "binaries"
    libraries = [path for path in sorted(folder.rglob("*")) if path.suffix in (".so", ".dll", ".dylib")]
    if not libraries:
        raise RuntimeError(f"no libraries in {folder}; install pythonfmu again")
    return {f"binaries/{path.parent.name}/{name}{path.suffix}": path.read_bytes() for path in libraries}
