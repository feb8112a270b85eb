"""The plan of the house: what the package shows, how many modules a level has, and which way its imports go.

import-linter (`make lint`) holds the levels; what is here needs no configuration that could be edited along with the
code, and also sees what import-linter does not: names in strings, and the models' sources.
"""

import ast
import graphlib
import re
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

import pytest

import orchestrator

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "orchestrator"
SOURCES = sorted(PACKAGE.rglob("*.py"))
MOST_MODULES = 10  # of a level
MOST_ARROWS = 80  # of 120 that an order of sixteen packages and modules allows
LOWEST = {"arrays", "errors", "names", "version", "warning", "watch"}


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in SOURCES}


def imported(path):
    """Absolute names of whatever a file imports anywhere in it: lazily, or for types alone, too."""
    package = path.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def imports():
    """{module: modules of the package that it imports}.  What `orchestrator` hands on to users is not counted."""
    arrows = {}
    for name, path in MODULES.items():
        targets = {found if found in MODULES else found.rpartition(".")[0] for found in imported(path)}
        arrows[name] = (targets & MODULES.keys()) - {name}
    del arrows["orchestrator"]
    return arrows


def test_no_module_imports_itself_by_way_of_others():
    arrows = imports()
    assert not [name for name, targets in arrows.items() if "orchestrator" in targets]
    list(graphlib.TopologicalSorter(arrows).static_order())  # raises CycleError, which names them


def test_packages_are_tied_by_few_imports():
    """Not counted: imports of the lowest modules, whose names everybody uses; they import nothing but each other."""
    tops = {(a.split(".")[1], b.split(".")[1]) for a, found in imports().items() for b in found}
    arrows = {(a, b) for a, b in tops if a != b}
    assert {b for a, b in arrows if a in LOWEST} <= LOWEST
    assert len({(a, b) for a, b in arrows if b not in LOWEST}) < MOST_ARROWS


def test_no_level_has_more_modules_than_one_sees_at_a_glance():
    levels = Counter(path.parent for path in SOURCES if path.stem != "__init__")
    levels.update(path.parent.parent for path in SOURCES if path.stem == "__init__" and path.parent != PACKAGE)
    del levels[PACKAGE]  # the plan itself: CONTRIBUTING draws it
    crowded = {str(folder): n for folder, n in levels.items() if n > MOST_MODULES}
    assert not crowded


@pytest.mark.parametrize("folder", ["orchestrator", "fmus"])
def test_a_class_name_means_one_thing(folder):
    trees = [ast.parse(path.read_bytes()) for path in sorted((ROOT / folder).rglob("*.py"))]
    names = Counter(node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    assert len(names) > 20
    assert not {name: count for name, count in names.items() if count > 1}


def test_nothing_imports_the_models():
    """They are built in a process of their own; what runs them runs their FMUs."""
    models = {path.stem for path in (ROOT / "fmus").iterdir()} | {"fmus"}
    assert {"uuv", "packager"} <= models
    wrong = {
        name: found for name, path in MODULES.items() if (found := {i.split(".")[0] for i in imported(path)} & models)
    }
    assert not wrong


def test_models_run_without_this_project():
    """Python FMUs carry uuv and the model, and nothing of orchestrator; what packs them takes its table of units from
    there, and the watch over files that models read."""
    used = {}
    for path in (ROOT / "fmus").rglob("*.py"):
        folder = path.relative_to(ROOT / "fmus").parts[0]
        used.setdefault(folder, set()).update(name for name in imported(path) if name.startswith("orchestrator"))
    assert {folder for folder, names in used.items() if names} == {"packager"}
    taken = {name.rpartition(".")[0] for name in used["packager"]}
    assert taken == {"orchestrator.fmu.units", "orchestrator.instances.opened"}
    assert len(used) > 5


def test_only_the_command_line_names_the_command_line():
    named = re.compile(r"\borchestrator[./]cli\b|\bcli[./]main\b")
    outside = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] != "cli"]
    assert not [str(path) for path in outside if named.search(path.read_text())]
    assert not [name for name, found in imports().items() if "cli" not in name and any(".cli" in i for i in found)]


def test_the_public_face_is_what_the_contract_promises():
    names = {"ExperimentError", "FmuError", "OrchError", "Run", "RunError", "StoreError", "open_run", "run"}
    assert set(orchestrator.__all__) == names | {"__version__"}
    assert all(getattr(orchestrator, name) is not None for name in orchestrator.__all__)
    assert set(dir(orchestrator)) == names | {"__version__"}  # what completion offers
    assert (PACKAGE / "py.typed").is_file()  # type checkers read the signatures
    with pytest.raises(AttributeError, match="no attribute 'runn'"):
        orchestrator.runn  # noqa: B018


def test_importing_the_package_imports_little():
    script = "import sys; before = set(sys.modules); import orchestrator; print(*(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    mine = {name for name in done.stdout.split() if name.startswith("orchestrator")}
    assert mine == {"orchestrator", "orchestrator.errors", "orchestrator.version"}
    assert "numpy" not in done.stdout.split()


def test_the_version_is_written_once():
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "orchestrator.version.__version__"}
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.search(r"^version: (.*)$", citation, re.M)[1] == orchestrator.__version__


def test_the_plan_of_the_house_is_that_of_the_contracts():
    with (ROOT / "pyproject.toml").open("rb") as file:
        (levels,) = (c for c in tomllib.load(file)["tool"]["importlinter"]["contracts"] if c["id"] == "levels")
    rows = re.findall(r"^\| (`.*?`) \|", (ROOT / "CONTRIBUTING.md").read_text(), re.M)
    drawn = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    below = {name: i for i, level in enumerate(levels["layers"]) for name in re.split(r" [|:] ", level)}
    assert set(drawn) == set(below)
    assert [below[name] for name in drawn if name not in LOWEST] == sorted(below[n] for n in drawn if n not in LOWEST)


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "README.md"])
def test_files_that_a_guide_names_exist(name):
    text = (ROOT / name).read_text()
    paths = {path for path in re.findall(r"`([\w./]+)`", text) if "/" in path or path.endswith(".py")}
    given = {path for path in paths if re.search(r"NAME|mine|results|^/", path)}
    missing = {p for p in paths - given if not any((folder / p).exists() for folder in (ROOT, PACKAGE))}
    assert len(paths - given) > 3
    assert not missing
