"""Loads the modules that an FMU carries under a name of its own, so that no two FMUs of a process mix theirs.

All Python FMUs of a process share one interpreter: two that carry different modules of one name would both compute
with the code of the first.  This package's name holds the digest of what it contains, and an absolute import
inside it finds the bundled module before any other of that name.
"""

import builtins
import contextlib
import importlib
import importlib.machinery
import pathlib
import sys

_FOLDER = pathlib.Path(__file__).parent
_BUNDLED = {path.stem for path in _FOLDER.iterdir() if path.stem != "__init__"}
# Read at import: in a process that unpacks the FMU again for each run, the package outlives its folder.
_SOURCES = {str(path): path.read_bytes() for path in _FOLDER.rglob("*.py")}


def _import(name, globals=None, locals=None, fromlist=(), level=0):
    top = name.partition(".")[0]
    if level or top not in _BUNDLED:
        return builtins.__import__(name, globals, locals, fromlist, level)
    module = load(name)
    if not fromlist:
        return load(top)
    for attribute in fromlist:
        if attribute != "*" and not hasattr(module, attribute):
            with contextlib.suppress(ModuleNotFoundError):  # the import statement itself then says what is missing
                load(f"{name}.{attribute}")
    return module


class _Loader(importlib.machinery.SourceFileLoader):
    def get_data(self, path):
        return _SOURCES[path] if path in _SOURCES else super().get_data(path)

    def exec_module(self, module):
        # Import statements look __import__ up in the builtins of the module they stand in.
        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": _import}
        super().exec_module(module)


class _Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if not name.startswith(__name__ + "."):
            return None
        relative = pathlib.Path(*name.split(".")[1:])
        package = _FOLDER / relative / "__init__.py"
        file = package if str(package) in _SOURCES else (_FOLDER / relative).with_suffix(".py")
        if str(file) not in _SOURCES:
            return None
        return importlib.util.spec_from_file_location(
            name,
            file,
            loader=_Loader(name, str(file)),
            submodule_search_locations=[str(file.parent)] if file is package else None,
        )


sys.meta_path.insert(0, _Finder)


def load(name):
    """The bundled module `name`."""
    return importlib.import_module(f"{__name__}.{name}")
