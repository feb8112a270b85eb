"""FMUs of the sources in tests/fmus: models by their names, C files compiled, and descriptions without a binary."""

import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from orchestrator.fmu.fmu import platform_folder

SOURCES = Path(__file__).parent / "fmus"
COMPILER = next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None)

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")

# Of fmus/probe.c: name, type, causality, start, unit, description; the place is the value reference.
PROBE_VARIABLES = (
    ("u", "Real", "input", "1.5", "m", "a number in"),
    ("y", "Real", "output", None, "m", "time at the end of the step"),
    ("count", "Integer", "input", "3", None, "added at each step"),
    ("steps", "Integer", "output", None, None, "sum of count"),
    ("flag", "Boolean", "input", "true", None, "whether to alternate"),
    ("odd", "Boolean", "output", None, None, "true after an odd number of steps"),
    ("text", "String", "input", "hallo", None, "a word"),
    ("words", "String", "output", None, None, "the word and the sum"),
    ("level", "Enumeration", "output", None, None, "low or high"),
    ("hidden", "Real", "local", None, "s", "minus the time"),
    ("at", "Real", "parameter", "0.02", "s", "when the trouble comes"),
    ("mode", "Integer", "parameter", "0", None, "which trouble"),
)


def model(name):
    """The source of a model of tests/fmus."""
    return (SOURCES / f"{name}.py").read_text(encoding="utf-8")


def variable_xml(reference, name, kind, causality, start=None, unit=None, description="", low=None, high=None):
    """A ScalarVariable of modelDescription.xml."""
    attributes = {
        "start": start,
        "unit": unit,
        "min": low,
        "max": high,
        "declaredType": "Level" if kind == "Enumeration" else None,
    }
    given = " ".join(f'{key}="{value}"' for key, value in attributes.items() if value is not None)
    variability = "fixed" if causality == "parameter" else "continuous" if kind == "Real" else "discrete"
    return (
        f'<ScalarVariable name="{name}" valueReference="{reference}" causality="{causality}" '
        f'variability="{variability}" description="{description}"><{kind} {given}/></ScalarVariable>'
    )


def description_xml(name, variables, version="2.0", interface="CoSimulation", options=""):
    """A modelDescription.xml of variables as in PROBE_VARIABLES."""
    scalars = [variable_xml(i, *variable) for i, variable in enumerate(variables)]
    outputs = [i for i, variable in enumerate(variables, 1) if variable[2] == "output"]
    unknowns = "".join(f'<Unknown index="{i}" dependencies=""/>' for i in outputs)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{version}" modelName="{name}" guid="{{{name}}}" description="A probe">
  <{interface} modelIdentifier="{name}" {options}/>
  <UnitDefinitions>
    <Unit name="m"><BaseUnit m="1"/></Unit>
    <Unit name="s"><BaseUnit s="1"/></Unit>
    <Unit name="km"><BaseUnit m="1" factor="1000"/></Unit>
    <Unit name="metre"><BaseUnit m="1"/></Unit>
  </UnitDefinitions>
  <TypeDefinitions>
    <SimpleType name="Level">
      <Enumeration><Item name="low" value="1"/><Item name="high" value="7"/></Enumeration>
    </SimpleType>
  </TypeDefinitions>
  <ModelVariables>{"".join(scalars)}</ModelVariables>
  <ModelStructure><Outputs>{unknowns}</Outputs></ModelStructure>
</fmiModelDescription>"""


def write_zip(path, files):
    """{name in the archive: text or bytes}"""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def paper_fmu(path, variables=PROBE_VARIABLES, **changes):
    """An FMU that can be read and wired but not loaded: its binary is none."""
    folder, suffix = platform_folder()
    name = path.stem
    return write_zip(
        path,
        {
            "modelDescription.xml": description_xml(name, variables, **changes),
            f"binaries/{folder}/{name}{suffix}": b"no library",
        },
    )


def compile_fmu(path, source, description, *flags, version=2, **files):
    """An FMU of one C file of tests/fmus.  files: {path in the FMU: content} beside its library."""
    folder, suffix = platform_folder(version)
    library = path.with_suffix(suffix)
    command = [COMPILER, "-w", "-shared", "-fPIC", *flags, "-o", library, SOURCES / source, "-lm"]
    subprocess.run(command, check=True)
    binary = f"binaries/{folder}/{path.stem}{suffix}"
    return write_zip(path, {"modelDescription.xml": description, binary: library.read_bytes(), **files})


def probe_fmu(path, variables=PROBE_VARIABLES, *flags, **changes):
    """fmus/probe.c as an FMU of these variables.  changes: of its description."""
    return compile_fmu(path, "probe.c", description_xml(path.stem, variables, **changes), *flags)
