"""What the tests share: the command `orch`, experiments to change, and small FMUs that misbehave on request.

FMUs are built into a folder of the session's own, never beside the models' sources.
"""

import copy
import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

import orchestrator
from orchestrator.fmu.fmu import platform_folder
from orchestrator.models import build
from orchestrator.runs.prepare import prepare

EXPERIMENTS = Path(__file__).parent.parent / "experiments"
ORCH = shutil.which("orch", path=sysconfig.get_path("scripts")) or "orch"
COMPILER = next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None)
DEADLINE = 60  # s, for what takes half a second on an idle machine

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler")


@dataclass(frozen=True)
class Answer:
    """What a command said.  `json`: its standard output, decoded."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


@pytest.fixture(scope="session", autouse=True)
def _build_folder(tmp_path_factory):
    os.environ["ORCH_BUILD"] = str(tmp_path_factory.mktemp("build"))
    os.environ["TMPDIR"] = str(tmp_path_factory.mktemp("tmp"))  # where killed runs leave their FMUs
    os.environ.pop("HDF5_USE_FILE_LOCKING", None)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs begin by ignoring it


@pytest.fixture(scope="session")
def shipped(_build_folder):
    """Builds the models of the experiments, so that no command says that it does."""
    return build.build(
        [
            "pid",
            "mfsosmc",
            "bluerov2_allocation",
            "bluerov2_thesis",
            "spiral_reference",
            "gripping_reference",
            "ocean_current",
        ]
    )


@pytest.fixture
def orch(shipped, tmp_path):
    """orch("run", path, ...) runs the command in the test's folder."""

    def run(*arguments, cwd=tmp_path, **options):
        done = subprocess.run(
            [ORCH, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=DEADLINE, **options
        )
        assert "Traceback" not in done.stderr, done.stderr
        return Answer(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def python(shipped, tmp_path):
    """python(script) runs a script in the test's folder, as a user's would run."""

    def run(script, **options):
        (tmp_path / "script.py").write_text(script, encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE, **options
        )
        return Answer(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def spiral():
    """A short spiral under PID as a dictionary to change; `write` makes a file of it."""
    with (EXPERIMENTS / "spiral_pid.toml").open("rb") as file:
        table = tomllib.load(file)
    table["master"]["stop_time"] = 0.05
    return table


@pytest.fixture
def write(tmp_path):
    """write(dictionary, name) makes an experiment file in the test's folder."""

    def write(table, name="mine.toml"):
        path = tmp_path / name
        path.write_text("\n".join(f"{key} = {toml(value)}" for key, value in table.items()), encoding="utf-8")
        return path

    return write


@pytest.fixture
def without_pymavlink(tmp_path):
    """A folder; a command with this in PYTHONPATH finds no pymavlink."""
    folder = tmp_path / "without"
    (folder / "pymavlink").mkdir(parents=True)
    (folder / "pymavlink" / "__init__.py").write_text("raise ImportError('not here')")
    return folder


@pytest.fixture
def resolve(shipped, write):
    """resolve(dictionary) -> the Plan, as `orch check` finds it, or ExperimentError."""

    def find(table, **options):
        return prepare(write(table), **options)

    return find


@pytest.fixture
def problems(shipped, write, tmp_path):
    """problems(dictionary) -> [(key, sentence)] of an experiment that must not start."""

    def find(table, **options):
        results = tmp_path / "nothing-comes-here"
        with pytest.raises(orchestrator.ExperimentError) as caught:
            orchestrator.run(write(table), results=results, **options)
        assert not results.exists()
        assert all(str(problem) in str(caught.value) for problem in caught.value.problems)
        return [(problem.key, problem.sentence) for problem in caught.value.problems]

    return find


def single(fmu, stop_time=0.05, step=0.01, name="one", **parameters):
    """An experiment of one component that needs no input."""
    component = {"fmu": str(fmu), "parameters": parameters, "start": "fmu"}
    return {"master": {"stop_time": stop_time, "step": step}, "components": {name: component}}


def poll(condition, process=None):
    """Wait until the condition holds; fails after DEADLINE, or when the process has ended before."""
    end = time.monotonic() + DEADLINE
    while not (found := condition()):
        assert time.monotonic() < end, "nothing came of it"
        assert process is None or process.poll() is None or condition(), "the process has ended"
        time.sleep(0.005)
    return found


def toml(value):
    """A value as TOML, tables inline."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(below)}" for key, below in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def merged(table, changes):
    """The table with {dotted key: value} laid over it; None deletes.  Keys of [connections] stand whole."""
    table = copy.deepcopy(table)
    for key, value in changes.items():
        first, _, rest = key.partition(".")
        *above, last = [first, *([rest] if first == "connections" else rest.split("."))] if rest else [first]
        node = table
        for part in above:
            node = node.setdefault(part, {})
        if value is None:
            del node[last]
        else:
            node[last] = value
    return table


# --- FMUs of plain Python -------------------------------------------------------------------------------------------

MODELS = {
    "trouble": '''
from uuv import Input, Output, Parameter, PythonModel, Signal

NUMBER = Signal((), "m", "a number")


class Trouble(PythonModel):
    """y = t + h, until the trouble."""

    u = Input(NUMBER)
    y = Output(NUMBER)
    at = Parameter(0.02, "s", "when the trouble comes")
    kind = Parameter(0, meaning="1 raise, 2 nan, 3 inf, 4 end, 5 wrong shape, 6 raise in initialize", type=int)

    def initialize(self):
        if self.kind == 6:
            raise ValueError("no calm sea: déjà vu")

    def do_step(self, t, h):
        self.y = t + h
        if h == 0.0 or t < self.at - 1e-9:
            return True
        if self.kind == 1:
            raise RuntimeError(f"the thruster is gone at {t:g}, 100 %s sure %n")
        if self.kind in (2, 3):
            self.y = float("nan" if self.kind == 2 else "inf")
        if self.kind == 5:
            self.y = [1.0, 2.0]
        return self.kind != 4
''',
    "relay": '''
from uuv import Input, Output, PythonModel, Signal


class Relay(PythonModel):
    """y is what u was at the start of the step."""

    u = Input(Signal((), "m", "a number"))
    y = Output(Signal((), "m", "a number"))

    def do_step(self, t, h):
        self.y = self.u
''',
    "memory": '''
from uuv import Input, PythonModel, Signal, State


class Memory(PythonModel):
    """n is what u was at the start of the step, and nothing else."""

    u = Input(Signal((), "m", "a number"))
    n = State(Signal((), "m", "a number"), output=True)

    def do_step(self, t, h):
        if h > 0:
            self.n = self.u + 1.0
''',
    "plus": '''
from uuv import Input, Output, PythonModel, Signal


class Plus(PythonModel):
    """y = u + 1."""

    u = Input(Signal((), "m", "a number"))
    y = Output(Signal((), "m", "a number"))

    def do_step(self, t, h):
        self.y = self.u + 1.0
''',
    "moody": '''
import os
import time
from uuv import Output, Parameter, PythonModel, Signal


class Moody(PythonModel):
    """y = t + h; takes its time, and fails where the environment says so: the same FMU, another end."""

    y = Output(Signal((), "m", "time"))
    pause = Parameter(0.0, "s", "how long a step takes")

    def do_step(self, t, h):
        self.y = t + h
        if h and self.pause:
            time.sleep(self.pause)
        if t > 0.02 and os.environ.get("MOOD") == "bad":
            raise RuntimeError("in a bad mood")
''',
    "clock": '''
from uuv import Output, PythonModel, Signal, State


class Clock(PythonModel):
    """Counts its own steps; knows the time at their end."""

    n = State(Signal((), "m", "steps done"), output=True)
    y = Output(Signal((), "m", "time"))

    def do_step(self, t, h):
        self.n = self.n + (h > 0)
        self.y = round(t + h, 9)
''',
    "waves": '''
import numpy as np
from uuv import Output, Parameter, PythonModel, Signal


class Waves(PythonModel):
    """Signals with known metrics."""

    sine = Output(Signal(("a", "b"), ("m", "rad"), "a sine of amplitude 1"))
    ramp = Output(Signal((), "m", "2 t"))
    rate = Output(Signal((), "rad/s", "3 t"))
    decay = Output(Signal((), "m", "exp(-t / 0.02)"))
    eta = Output(Signal(("x", "y", "z", "phi", "theta", "psi"), ("m",) * 3 + ("rad",) * 3, "a place"))
    place = Parameter((0.0, 0.0, 0.0), "m", "where it is")
    heading = Parameter(0.0, "rad", "where it looks")

    def do_step(self, t, h):
        t = t + h
        self.sine = np.full(2, np.sin(2 * np.pi * t / 0.1))
        self.ramp = 2 * t
        self.rate = 3 * t
        self.decay = np.exp(-t / 0.02)
        self.eta = np.r_[self.place, 0, 0, self.heading]
''',
}


@pytest.fixture(scope="session")
def models(_build_folder, tmp_path_factory):
    """Builds MODELS; experiments then name them."""
    folder = tmp_path_factory.mktemp("models")
    for name, source in MODELS.items():
        (folder / f"{name}.py").write_text(source, encoding="utf-8")
    return build.build([str(folder / f"{name}.py") for name in MODELS])


# --- FMUs in C ------------------------------------------------------------------------------------------------------

PROBE = r"""
/* An FMI 2.0 slave that echoes its inputs and has the trouble that its parameters ask for. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

typedef void *Logger(void *, const char *, int, const char *, const char *, ...);
typedef struct { Logger *logger; void *(*allocate)(size_t, size_t); void (*release)(void *); void *done;
                 void *environment; } Callbacks;
enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { MADE, INITIALIZING, STEPPING, ENDED, FAILED };
enum { U, Y, COUNT, STEPS, FLAG, ODD, TEXT, WORDS, LEVEL, HIDDEN, AT, MODE, SIZE };

typedef struct {
    const Callbacks *callbacks;
    char name[64], text[64], words[64];
    double real[SIZE];
    int whole[SIZE], state;
} Probe;

static void expect(Probe *p, const char *call, int legal) {
    if (!legal) fprintf(stderr, "illegal call of %s in state %d\n", call, p->state);
}

static int say(Probe *p, int status, const char *words) {
    if (words) p->callbacks->logger(p->callbacks->environment, p->name, status, "logStatusError", words);
    if (status >= ERROR) p->state = FAILED;
    return status;
}

const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
int fmi2SetDebugLogging(void *p, int on, size_t n, const char *const c[]) { return OK; }

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *where, const Callbacks *callbacks,
                      int visible, int logging) {
    Probe *p;
    if (!strcmp(name, "stillborn")) {
        callbacks->logger(callbacks->environment, name, ERROR, "logStatusError", "no licence for a probe");
        return NULL;
    }
    p = calloc(1, sizeof *p);
    p->callbacks = callbacks;
    snprintf(p->name, sizeof p->name, "%s", name);
    snprintf(p->text, sizeof p->text, "hallo");
    snprintf(p->words, sizeof p->words, "hallo 0");
    p->whole[COUNT] = 3;
    p->whole[FLAG] = 1;
    p->whole[LEVEL] = 1;
    p->real[AT] = 0.02;
    return p;
}

int fmi2SetupExperiment(Probe *p, int a, double b, double c, int d, double e) {
    expect(p, "fmi2SetupExperiment", p->state == MADE);
    return OK;
}

int fmi2EnterInitializationMode(Probe *p) {
    expect(p, "fmi2EnterInitializationMode", p->state == MADE);
    p->state = INITIALIZING;
    if (p->whole[MODE] == 8) p->real[Y] = NAN;
    return p->whole[MODE] == 7 ? say(p, ERROR, "the probe will not wake") : OK;
}

int fmi2ExitInitializationMode(Probe *p) {
    expect(p, "fmi2ExitInitializationMode", p->state == INITIALIZING);
    p->state = STEPPING;
    return OK;
}

int fmi2Terminate(Probe *p) {
    expect(p, "fmi2Terminate", p->state == STEPPING || p->state == ENDED);
    return OK;
}

int fmi2Reset(Probe *p) { return OK; }

void fmi2FreeInstance(Probe *p) {
    expect(p, "fmi2FreeInstance", p->state != FAILED);
    free(p);
}

int fmi2DoStep(Probe *p, double t, double h, int keep) {
    expect(p, "fmi2DoStep", p->state == STEPPING);
    p->real[Y] = t + h;
    p->real[HIDDEN] = -t;
    p->whole[STEPS] = p->whole[STEPS] + p->whole[COUNT];
    p->whole[ODD] = !p->whole[ODD] == p->whole[FLAG];
    p->whole[LEVEL] = p->whole[ODD] ? 7 : 1;
    snprintf(p->words, sizeof p->words, "%s %d", p->text, p->whole[STEPS]);
    if (t < p->real[AT] - 1e-9) return OK;
    switch (p->whole[MODE]) {
        case 1: return say(p, ERROR, "the probe lost its mind: 100 %% sure");
        case 2: p->real[Y] = NAN; return OK;
        case 3: p->real[Y] = -INFINITY; return OK;
        case 4: p->state = ENDED; return say(p, DISCARD, "the probe has seen enough");
        case 5: return say(p, DISCARD, "the step is too large");
        case 6: return say(p, FATAL, NULL);
        case 9: return say(p, WARNING, "the probe feels warm");
        case 10: p->real[HIDDEN] = NAN; return OK;
        case 11: p->state = FAILED; return ERROR;
        case 12: *(volatile int *)NULL = 1; break;
        case 13: abort();
        case 14: exit(3);
        case 15: for (;;) sleep(1);
    }
    return OK;
}

int fmi2GetBooleanStatus(Probe *p, int kind, int *value) {
    *value = kind == 3 && p->state == ENDED;
    return OK;
}

#define UNUSED(name) int name(void) { return ERROR; }
UNUSED(fmi2GetFMUstate) UNUSED(fmi2SetFMUstate) UNUSED(fmi2FreeFMUstate) UNUSED(fmi2SerializedFMUstateSize)
UNUSED(fmi2SerializeFMUstate) UNUSED(fmi2DeSerializeFMUstate) UNUSED(fmi2GetDirectionalDerivative)
UNUSED(fmi2SetRealInputDerivatives) UNUSED(fmi2GetRealOutputDerivatives) UNUSED(fmi2CancelStep)
UNUSED(fmi2GetStatus) UNUSED(fmi2GetRealStatus) UNUSED(fmi2GetIntegerStatus) UNUSED(fmi2GetStringStatus)

int fmi2GetReal(Probe *p, const unsigned r[], size_t n, double v[]) {
    for (size_t i = 0; i < n; i++) v[i] = p->real[r[i]];
    return OK;
}
int fmi2SetReal(Probe *p, const unsigned r[], size_t n, const double v[]) {
    for (size_t i = 0; i < n; i++) p->real[r[i]] = v[i];
    return OK;
}
int fmi2GetInteger(Probe *p, const unsigned r[], size_t n, int v[]) {
    for (size_t i = 0; i < n; i++) v[i] = p->whole[r[i]];
    return OK;
}
int fmi2SetInteger(Probe *p, const unsigned r[], size_t n, const int v[]) {
    for (size_t i = 0; i < n; i++) p->whole[r[i]] = v[i];
    return OK;
}
int fmi2GetBoolean(Probe *p, const unsigned r[], size_t n, int v[]) { return fmi2GetInteger(p, r, n, v); }
int fmi2SetBoolean(Probe *p, const unsigned r[], size_t n, const int v[]) { return fmi2SetInteger(p, r, n, v); }
int fmi2GetString(Probe *p, const unsigned r[], size_t n, const char *v[]) {
    for (size_t i = 0; i < n; i++) v[i] = r[i] == TEXT ? p->text : p->words;
    return OK;
}
int fmi2SetString(Probe *p, const unsigned r[], size_t n, const char *const v[]) {
    for (size_t i = 0; i < n; i++) snprintf(p->text, sizeof p->text, "%s", v[i]);
    return OK;
}
"""

# name, type, causality, start, unit, description; the place is the value reference
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


def compile_fmu(path, source, variables, **changes):
    """An FMU of one C file.  Its name is the path's stem."""
    folder, suffix = platform_folder()
    name, work = path.stem, path.with_suffix(".build")
    work.mkdir()
    (work / "model.c").write_text(source, encoding="utf-8")
    library = work / f"{name}{suffix}"
    subprocess.run([COMPILER, "-w", "-shared", "-fPIC", "-o", library, work / "model.c", "-lm"], check=True)
    return write_zip(
        path,
        {
            "modelDescription.xml": description_xml(name, variables, **changes),
            f"binaries/{folder}/{library.name}": library.read_bytes(),
        },
    )


@pytest.fixture(scope="session")
def probe(tmp_path_factory):
    """The path of the compiled PROBE."""
    if COMPILER is None:
        pytest.skip("no C compiler")
    return compile_fmu(tmp_path_factory.mktemp("probe") / "probe.fmu", PROBE, PROBE_VARIABLES)


PYTHONFMU_PROBE = """
from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String
from {helper} import WORD


class {name}(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y, self.n, self.b, self.s = 0.0, 0, False, WORD
        for kind, name in ((Real, "y"), (Integer, "n"), (Boolean, "b"), (String, "s")):
            self.register_variable(kind(name, causality=Fmi2Causality.output))

    def do_step(self, t, h):
        self.y, self.n, self.b, self.s = t + h, self.n + 1, not self.b, f"{{WORD}} {{self.n}}"
        if WORD == "east" and t > 0.015:
            raise RuntimeError("an east wind")
        return True
"""


@pytest.fixture(scope="session")
def foreign(tmp_path_factory):
    """FMUs that pythonfmu's own builder made: two with another `helper` module each, and one that fails at 0.02 s."""
    found = {}
    for name, helper, word in (("North", "helper", "nord"), ("South", "helper", "süd"), ("East", "east_help", "east")):
        folder = tmp_path_factory.mktemp(name.lower())
        (folder / f"{name.lower()}.py").write_text(PYTHONFMU_PROBE.format(name=name, helper=helper), encoding="utf-8")
        (folder / f"{helper}.py").write_text(f'WORD = "{word}"\n', encoding="utf-8")
        pythonfmu = Path(ORCH).with_name("pythonfmu")
        subprocess.run(
            [pythonfmu, "build", "-f", f"{name.lower()}.py", "--dest", ".", f"{helper}.py"],
            cwd=folder,
            check=True,
            capture_output=True,
        )
        found[name.lower()] = folder / f"{name}.fmu"
    return SimpleNamespace(**found)
