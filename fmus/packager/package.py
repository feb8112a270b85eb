"""One model file as one FMU: which modules go into it, which class it defines, which packaging it gets."""

from __future__ import annotations

import ast
import concurrent.futures
import hashlib
import importlib.util
import pathlib
import sys
from collections.abc import Callable, Collection
from typing import Any

from uuv.modelling.declare import Declared, data_files
from uuv.modelling.equations import Model, trace

from orchestrator.instances.opened import Opened

from . import native, python_fmu

UUV = pathlib.Path(__file__).parent.parent / "uuv"


def package(request: dict[str, Any], pool: concurrent.futures.Executor) -> Callable[[], dict[str, Any]]:
    """Build one FMU.  The function returned waits for the compilers and returns the answer."""
    source = pathlib.Path(request["source"])
    own = {source.name: source, **_imported(source)}
    files = own | {f"uuv/{path.relative_to(UUV)}": path for path in sorted(UUV.rglob("*.py"))}
    modules = {name: path.read_bytes() for name, path in sorted(files.items())}
    own_modules = {pathlib.PurePath(name).parts[0].removesuffix(".py") for name in own}
    opened = Opened(own_modules, UUV)
    try:
        model = _model(source, own.values())
        data = {name: path.read_bytes() for name, path in data_files(model).items()}
        equations = trace(model) if issubclass(model, Model) else None
    finally:
        opened.stop()
    declared = {str(path) for path in data_files(model).values()}
    reads = [path for module in own_modules for path in opened.files(module) if path not in declared]
    target = (equations and request["native"]) or request["python"]
    if target is None:
        raise ValueError("a PythonModel runs in Python only and has no native packaging")
    wait = None
    if target == request["native"]:
        compilers = [native.Compiler(tuple(c["command"]), c["folder"]) for c in request["compilers"]]
        wait = native.build(source.stem, model, equations, compilers, data, pathlib.Path(target), pool).result
    else:
        python_fmu.build(source.stem, model, equations, modules, data, pathlib.Path(target))
    digests = {str(path): hashlib.sha256(modules[name]).hexdigest() for name, path in files.items()}
    digests |= {path: hashlib.sha256(pathlib.Path(path).read_bytes()).hexdigest() for path in reads}
    digests |= {str(path): hashlib.sha256(data[name]).hexdigest() for name, path in data_files(model).items()}

    def answer() -> dict[str, Any]:
        if wait is not None:
            wait()
        return {"target": target, "sources": digests, "plain": equations is None, "reads": reads}

    return answer


def _imported(source: pathlib.Path) -> dict[str, pathlib.Path]:
    """{path in the bundle: file} of the modules beside `source` that it imports, directly or through one another."""
    folder = source.parent
    imported: dict[str, pathlib.Path] = {}
    waiting = [source]
    while waiting:
        for name in _import_names(waiting.pop()):
            single, package = folder / f"{name}.py", folder / name / "__init__.py"
            if name == "uuv" or single == source:
                continue
            files = [single] if single.exists() else sorted(package.parent.rglob("*.py")) if package.exists() else []
            new = {str(file.relative_to(folder)): file for file in files}
            waiting += [file for path, file in new.items() if path not in imported]
            imported |= new
    return imported


def _import_names(file: pathlib.Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(file.read_bytes(), str(file))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names


def _model(source: pathlib.Path, own: Collection[pathlib.Path]) -> type[Declared]:
    """The class that a file defines.  own: the files that go into the FMU."""
    sys.path.insert(0, str(source.parent))
    before = set(sys.modules)
    try:
        spec = importlib.util.spec_from_file_location(source.stem, source)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(source.parent))
        for name in set(sys.modules) - before:  # the next model may import another module of that name
            file = getattr(sys.modules[name], "__file__", None)
            if file and pathlib.Path(file) in own:  # not what is installed in the same folder: CasADi loads only once
                del sys.modules[name]
    models = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Declared)
        and value.__module__ == source.stem
        and not getattr(value, "__abstractmethods__", None)
    ]
    if len(models) != 1:
        names = ", ".join(m.__name__ for m in models) or "none"
        raise ValueError(f"a model file defines one class derived from Model or PythonModel; this one has {names}")
    return models[0]
