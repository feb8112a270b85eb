"""`python -m packager`: reads one JSON request a line, {"source": file, "target": file}; answers each with a line.

An answer is {"target": ..., "sources": {path: sha256}} or {"target": ..., "error": sentence}.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.util
import json
import pathlib
import sys
import traceback
from typing import Any

from uuv.model import Declared

from . import python_fmu

UUV = pathlib.Path(__file__).parent.parent / "uuv"


def package(source: pathlib.Path, target: pathlib.Path) -> dict[str, Any]:
    """Build one FMU; returns what it was made of."""
    files = {source.name: source, **_imported(source)}
    files |= {f"uuv/{path.relative_to(UUV)}": path for path in sorted(UUV.rglob("*.py"))}
    modules = {name: path.read_bytes() for name, path in sorted(files.items())}
    python_fmu.build(source.stem, _model(source), modules, target)
    return {"sources": {str(path): hashlib.sha256(modules[name]).hexdigest() for name, path in files.items()}}


def _imported(source: pathlib.Path) -> dict[str, pathlib.Path]:
    """{path in the bundle: file} of the modules beside `source` that it imports, directly or through one another."""
    folder = source.parent
    found: dict[str, pathlib.Path] = {}
    waiting = [source]
    while waiting:
        for name in _import_names(waiting.pop()):
            single, package = folder / f"{name}.py", folder / name / "__init__.py"
            if name == "uuv" or single == source:
                continue
            files = [single] if single.exists() else sorted(package.parent.rglob("*.py")) if package.exists() else []
            new = {str(file.relative_to(folder)): file for file in files}
            waiting += [file for path, file in new.items() if path not in found]
            found |= new
    return found


def _import_names(file: pathlib.Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(file.read_bytes(), str(file))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.partition(".")[0])
    return names


def _model(source: pathlib.Path) -> type[Declared]:
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
            if file and pathlib.Path(file).is_relative_to(source.parent):
                del sys.modules[name]
    models = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Declared) and value.__module__ == source.stem
        and not getattr(value, "__abstractmethods__", None)
    ]  # fmt: skip
    if len(models) != 1:
        names = ", ".join(m.__name__ for m in models) or "none"
        raise ValueError(f"a model file defines one class derived from Model or PythonModel; this one has {names}")
    return models[0]


def _reason(error: BaseException, source: pathlib.Path) -> str:
    """The error in one line, with the line of the user's file where it came from."""
    if isinstance(error, SyntaxError):
        return f"line {error.lineno}: {error.msg}"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(source)]
    where = f"line {lines[-1]}: " if lines else ""
    return f"{where}{type(error).__name__}: {error}"


def main() -> None:
    answers = sys.stdout
    for line in sys.stdin:
        request = json.loads(line)
        source, target = pathlib.Path(request["source"]), pathlib.Path(request["target"])
        answer: dict[str, Any] = {"target": str(target)}
        with contextlib.redirect_stdout(sys.stderr):  # what a model prints must not mix with the answers
            try:
                answer |= package(source, target)
            except Exception as error:  # whatever the user's file raises is the answer
                answer["error"] = _reason(error, source)
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
