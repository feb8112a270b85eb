"""Experiment files and FMUs spoiled at random, and what orch says to them: all in this one process.

    python tests/peers/mutants.py experiments --count 500 --seed 1
    python tests/peers/mutants.py archives --count 100 --seed 1
    python tests/peers/mutants.py experiments --only 1234 --seed 1        one again, with all that orch says

Works in the current folder.  A mutant must be refused with an error message (exit code 2) or be valid (0; of a run also
3): no traceback, no crash, no command over 10 s, no file written but in results/ and where temporary files go.  Prints
what breaks this; exit code 1 if anything does.
"""

import argparse
import contextlib
import datetime
import faulthandler
import io
import json
import math
import os
import random
import re
import shutil
import struct
import sys
import tempfile
import tomllib
import warnings
import zipfile
from pathlib import Path

from orchestrator.cli import main as cli
from orchestrator.models import build

EXPERIMENTS = Path(__file__).parent.parent.parent / "experiments"
LONGEST = 10.0  # s that a command may take
MODELS = (
    "pid",
    "lyapunov",
    "feedback_linearization",
    "mfsosmc",
    "nstsmc",
    "ftsosmc",
    "bluerov2_allocation",
    "bluerov2_thesis",
    "spiral_reference",
    "gripping_reference",
    "ocean_current",
)

EVERYTHING = """
title = "All that an experiment may say"
[master]
stop_time = 0.05
step = 0.001
algorithm = "jacobi"
seed = 7
[components.controller]
fmu = "pid"
step = 0.005
parameters = { K_p = { x = 100.0, z = 90.0 }, "K_d.x" = 20, K_i = [1, 1, 1, 1, 0, 1] }
[components.allocation]
fmu = "bluerov2_allocation"
[components.vehicle]
fmu = "bluerov2_thesis"
parameters = { eta_0 = [0, 0, 1, 0, 0, 0.5] }
start = { v_c = [0.1, 0, 0] }
isolation = "none"
[components.reference]
fmu = "spiral_reference"
start = "fmu"
[connections]
"controller.eta" = "vehicle.eta"
"controller.nu" = "vehicle.nu"
"controller.eta_d" = "reference.eta_d"
"controller.eta_d_dot.x" = "reference.eta_d_dot.x"
"controller.eta_d_dot.y" = "reference.eta_d_dot.y"
"controller.eta_d_dot.z" = "reference.eta_d_dot.z"
"controller.eta_d_dot.phi" = "reference.eta_d_dot.phi"
"controller.eta_d_dot.theta" = "reference.eta_d_dot.theta"
"controller.eta_d_dot.psi" = "reference.eta_d_dot.psi"
"controller.eta_d_ddot" = "reference.eta_d_ddot"
"allocation.tau" = "controller.tau"
"vehicle.u" = { from = "allocation.u", gain = 1.0, offset = 0.0, unit_check = true }
[record]
every = 0.005
signals = ["vehicle*", "controller.*", "!*.nu.*"]
inputs = true
[metrics]
a = { of = "rmse", signal = "vehicle.eta.x", reference = "controller.eta_d.x", after = 0.01 }
b = { of = "rms", signal = "vehicle.eta.phi", unit = "deg" }
c = { of = "distance", signal = "vehicle.eta", reference = "vehicle.eta", after = 0.01, before = 0.04, stat = "min" }
d = { of = "convergence_time", signal = "vehicle.eta.x", reference = "controller.eta_d.x", band = 0.1 }
e = { of = "final", signal = "vehicle.eta.z" }
[mavlink]
vehicles = { vehicle = 1 }
origin = { lat = 44.65, lon = -124.05 }
[sweep]
draws = 3
[sweep.vary]
"components.controller.fmu" = ["pid", "nstsmc"]
"components.vehicle.parameters.m" = { distribution = "uniform", low = 10.0, high = 12.0 }
"""

TEXTS = (
    "",
    " ",
    "*",
    "!",
    "a",
    "\0",
    "é",
    "\U0001f419",
    "../../x.fmu",
    "/dev/zero",
    "/dev/zero.fmu",
    "a\nb",
    "{}",
    "%s%n",
    "nan",
    "pid",
    "vehicle.eta",
    "controller",
    "[",
    "]",
    "[1]",
    "eta[1",
    ".",
    "..",
    "x" * 300,
    "x" * 100_000,
    "-1",
    "fmu",
    "\ud7ff",
    "\u202e",
    "con",
    "C:\\x.fmu",
    "~/x.fmu",
    "[a-",
    "**",
    "vehicle.*.*",
    "1e400",
)
NUMBERS = (
    0,
    -0.0,
    -1,
    1,
    2,
    3.5,
    1e-3,
    1e-9,
    1e-300,
    5e-324,
    1e300,
    1.7e308,
    1e15,
    2**31,
    2**53 + 1,
    2**63,
    -(2**63),
    10**40,
    10**400,
    math.nan,
    math.inf,
    -math.inf,
    0.1 + 0.2,
    1 / 3,
)
MOMENTS = (datetime.date(2026, 3, 1), datetime.time(7, 32), datetime.datetime(2026, 3, 1, tzinfo=datetime.UTC))
TOKEN = re.compile(r'"[^"\n]*"|[A-Za-z_][\w-]*|[-+]?\d[\w.+-]*|\s+|.', re.DOTALL)
SNIPPETS = (
    "=",
    "[",
    "]",
    "[[",
    "{",
    "}",
    '"',
    "'''",
    "#",
    "\r",
    "\ufeff",
    "1e400",
    "-nan",
    "0x" + "f" * 300,
    "9" * 5000,
    "[" * 500,
    "a." * 500 + "a = 1\n",
    "\n[master]\n",
    "\n[[components]]\n",
    "\n[components.a.b.c]\n",
    "x = 1\n",
    "1979-05-27",
    "inf",
    '"\\u0000"',
    '"\\U0001F419"',
    "true",
    "[components]\n",
    "metrics = 3\n",
)
KEYS = (
    "master",
    "components",
    "vehicle",
    "controller",
    "parameters",
    "record",
    "K_p",
    "x",
    "step",
    "start",
    "eta_0",
    "fmu",
    '"a.b"',
    "",
    "é",
    "0",
)
XML_VALUES = (
    "",
    "-1",
    "0",
    "1",
    "4294967295",
    "4294967296",
    "1e400",
    "nan",
    "true",
    "x" * 5000,
    "../x",
    "a/b",
    "é",
    "2.0",
    "3.0",
    "1.0",
    "input",
    "output",
    "parameter",
    "independent",
    "Real",
    "String",
    "&#10;",
    "%s",
    "1 2 3",
    "99999999",
    "eta.x",
    "K[1,",
    "a]",
    ".",
    "&lt;",
)


# --- Experiments ------------------------------------------------------------------------------------------------------


def spoil_bytes(content, chance):
    """One change of bytes."""
    content = bytearray(content)
    a, b = sorted(chance.randrange(len(content) + 1) for _ in range(2))
    b = min(b, a + chance.choice((1, 4, 40, 400)))
    match chance.randrange(7):
        case 0:
            del content[a:b]
        case 1:
            content[a:a] = content[a:b]
        case 2:
            content[a:a] = bytes(chance.randrange(256) for _ in range(chance.choice((1, 1, 8))))
        case 3:
            del content[a:]
        case 4:
            for _ in range(chance.choice((1, 3, 30))):
                if content:
                    content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        case 5:
            content[a:b] = bytes(b - a)
        case 6:
            c = chance.randrange(len(content) + 1)
            content[a:b], content[c:c] = b"", content[a:b]
    return bytes(content)


def spoil_tokens(text, chance, corpus):
    """One change of words, numbers and signs."""
    tokens = TOKEN.findall(text)
    if not tokens:
        return text
    i, j = (chance.randrange(len(tokens)) for _ in range(2))
    match chance.randrange(5):
        case 0:
            tokens[i] = chance.choice(SNIPPETS)
        case 1:
            tokens[i] = chance.choice(corpus)
        case 2:
            tokens[i], tokens[j] = tokens[j], tokens[i]
        case 3:
            del tokens[i : i + chance.choice((1, 2, 10))]
        case 4:
            tokens[i:i] = tokens[j : j + chance.choice((1, 5, 20))]
    return "".join(tokens)


def nasty(chance, depth=0):
    """A value that is seldom right."""
    match chance.randrange(8 if depth < 3 else 5):
        case 0:
            return chance.choice(NUMBERS)
        case 1:
            return chance.choice(TEXTS)
        case 2:
            return chance.random() < 0.5
        case 3:
            return chance.choice(MOMENTS)
        case 4:
            return chance.choice(([], {}, [0] * 1000, [[]], [1.0, "a", True]))
        case 5:
            return [nasty(chance, depth + 1) for _ in range(chance.choice((0, 1, 3, 6, 7)))]
        case 6:
            return {chance.choice(TEXTS): nasty(chance, depth + 1) for _ in range(chance.choice((0, 1, 3)))}
        case _:
            value = chance.choice(NUMBERS)
            for _ in range(chance.choice((2, 30, 90))):
                value = [value] if chance.random() < 0.5 else {"a": value}
            return value


def spoil_table(table, chance):
    """One change of a value or a key, somewhere."""
    places = [(table, key) for key in table]
    for node, key in places:  # grows
        if isinstance(node[key], dict):
            places += [(node[key], below) for below in node[key]]
        elif isinstance(node[key], list):
            places += [(node[key], below) for below in range(len(node[key]))]
    if not places:
        return
    node, key = chance.choice(places)
    other, its_key = chance.choice(places)
    match chance.randrange(9):
        case 6 | 7 | 8:
            numbers = [(node, key) for node, key in places if type(node[key]) in (int, float)]
            if numbers:
                node, key = chance.choice(numbers)
                node[key] *= chance.choice((0, -1, 2, 0.5, 10, 1e-3, 1e6, 1e200))
        case 0 | 1:
            node[key] = nasty(chance)
        case 2:
            del node[key]
        case 3:
            value = chance.choice(TEXTS)
            if isinstance(node, dict):
                node[value] = node.pop(key)
        case 4:
            node[key] = json.loads(json.dumps(other[its_key], default=str))
        case 5:
            if isinstance(node, dict):
                node[chance.choice((*TEXTS, key))] = nasty(chance)


def as_toml(value):
    """A value as TOML, tables inline."""
    match value:
        case dict():
            return "{ " + ", ".join(f"{text(key)} = {as_toml(below)}" for key, below in value.items()) + " }"
        case list():
            return "[" + ", ".join(map(as_toml, value)) + "]"
        case bool():
            return str(value).lower()
        case str():
            return text(value)
        case float() | int():
            return str(value)
        case None:
            return '""'
        case _:
            return value.isoformat()


def text(value):
    return json.dumps(str(value)).encode("utf-16", "surrogatepass").decode("utf-16", "replace").replace("\x7f", "?")


def experiment(chance, sources, corpus):
    """A mutant, as bytes."""
    source = chance.choice(sources)
    kind = chance.randrange(3)
    if kind == 0:
        content = source.encode()
        for _ in range(chance.choice((1, 1, 1, 2, 4))):
            content = spoil_bytes(content, chance)
        return content
    if kind == 1:
        for _ in range(chance.choice((1, 1, 1, 2, 4))):
            source = spoil_tokens(source, chance, corpus)
        return source.encode(errors="replace")
    table = tomllib.loads(source)
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        spoil_table(table, chance)
    return "\n".join(f"{text(key)} = {as_toml(value)}" for key, value in table.items()).encode(errors="replace")


def options(chance):
    """--set and --swap that nobody should give."""
    given = []
    while chance.random() < 0.2:
        key = ".".join(chance.choice(KEYS) for _ in range(chance.randrange(5)))
        given += ["--set", f"{key}={chance.choice((*SNIPPETS, *TEXTS, *map(str, NUMBERS)))}"]
    if chance.random() < 0.1:
        given += ["--swap", f"{chance.choice(('controller', 'vehicle', '', 'x'))}={chance.choice((*MODELS, *TEXTS))}"]
    return [word.replace("\0", "?") for word in given]


SHORT = ("--set", "master.stop_time=0.004", "--set", "master.step=0.001", "--set", "record.every=0.001")


def try_experiment(number, seed):
    chance = random.Random(f"{seed}/{number}")
    Path("mutant.toml").write_bytes(experiment(chance, *SOURCES))
    given = options(chance)
    yield ["check", "mutant.toml", *given, *(["--json"] if chance.random() < 0.3 else [])], (0, 2)
    yield ["run", "mutant.toml", *given, *SHORT, "--force", *(["--json"] if chance.random() < 0.3 else [])], (0, 2, 3)
    shutil.rmtree("results", ignore_errors=True)


def sources():
    texts = [path.read_text(encoding="utf-8") for path in sorted(EXPERIMENTS.rglob("*.toml"))] + [EVERYTHING] * 20
    return texts, sorted({token for one in texts for token in TOKEN.findall(one)})


# --- Archives ---------------------------------------------------------------------------------------------------------


def spoil_archive(content, chance):
    """One change of an FMU's bytes; mostly where they matter: the directory and the headers."""
    content = bytearray(content)
    match chance.randrange(5):
        case 0:
            return bytes(content[: chance.randrange(len(content))])
        case 1:
            return spoil_bytes(content, chance)
        case 2:
            begin = max(content.rfind(b"PK\1\2", 0, chance.randrange(len(content)) + 1), content.find(b"PK\1\2"))
            place = begin + chance.randrange(46)
        case 3:
            place = content.rfind(b"PK\5\6") + chance.randrange(22)
        case _:
            begin = max(content.rfind(b"PK\3\4", 0, chance.randrange(len(content)) + 1), 0)
            place = begin + chance.randrange(30)
    size = chance.choice((1, 1, 2, 4))
    value = chance.choice((0, 1, 0x7F, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, chance.randrange(1 << 32)))
    content[place : place + size] = struct.pack("<L", value)[:size]
    return bytes(content)


def spoil_xml(xml, chance, corpus):
    """One change of a description."""
    attributes = list(re.finditer(r'([\w:]+)="([^"]*)"', xml))
    elements = list(re.finditer(r"<(\w+)[^<>]*?/>|</?\w+[^<>]*>", xml))
    kind = chance.randrange(6)
    if kind < 3 and attributes:
        found = chance.choice(attributes)
        value = chance.choice((*XML_VALUES, chance.choice(attributes)[2]))
        change = ("", f'{found[1]}="{value}"', f'{chance.choice(attributes)[1]}="{found[2]}"')[kind]
        return xml[: found.start()] + change + xml[found.end() :]
    if kind < 5 and elements:
        found, other = chance.choice(elements), chance.choice(elements)
        return xml[: found.start()] + (other[0] if kind == 3 else "") + xml[found.end() :]
    return spoil_tokens(xml, chance, corpus)


def archive(chance, originals, corpus):
    """A mutant, as bytes."""
    content = chance.choice(originals)
    if chance.random() < 0.5:
        for _ in range(chance.choice((1, 1, 1, 2, 4))):
            content = spoil_archive(content, chance)
        return content
    with zipfile.ZipFile(io.BytesIO(content)) as original:
        files = {name: original.read(name) for name in original.namelist()}
    xml = files["modelDescription.xml"].decode()
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        xml = spoil_xml(xml, chance, corpus)
    description = xml.encode(errors="replace") if chance.random() < 0.9 else spoil_bytes(xml.encode(), chance)
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w") as made:
        for name, file in {**files, "modelDescription.xml": description}.items():
            made.writestr(chance.choice(TEXTS)[:300].strip("\0") or "b" if chance.random() < 0.02 else name, file)
    return target.getvalue()


def try_archive(number, seed):
    chance = random.Random(f"{seed}/{number}")
    Path("mutant.fmu").write_bytes(archive(chance, *SOURCES))
    as_json = ["--json"] if chance.random() < 0.3 else []
    yield ["fmus", "mutant.fmu", *as_json], (0, 2)
    yield ["check", "mutant.toml", *as_json], (0, 2)


def originals(folder):
    """FMUs to spoil, and an experiment that uses one.  None is ever loaded: who knows what their libraries became."""
    Path("mutant.toml").write_text(EVERYTHING.replace('"pid"', '"mutant.fmu"', 1), encoding="utf-8")
    native = build.build(["pid"])["pid"].read_bytes()
    python = build.build(["pid"], packaging="python")["pid"].read_bytes()
    given = [path.read_bytes() for path in sorted(Path(folder).glob("*.fmu"))] if folder else []
    return [native, python, *given * 2], list(XML_VALUES)


# --- The loop ---------------------------------------------------------------------------------------------------------

# Which argument names the file that changes, and which the folder that it is relative to.
WRITES = {
    "os.mkdir": (0, 2),
    "os.remove": (0, 1),
    "os.rmdir": (0, 1),
    "os.truncate": (0, None),
    "os.rename": (1, 3),
    "os.link": (1, 3),
    "os.symlink": (1, 2),
}
MODES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
strays: list[str] = []
ended: dict[tuple[str, int], int] = {}  # how often a command ended so
allowed: list[str] = []


def watch(event, arguments):
    """An audit hook: notes every file that is changed where none should be."""
    if not allowed or (event != "open" and event not in WRITES):
        return
    if event == "open" and not (isinstance(arguments[2], int) and arguments[2] & MODES):
        return
    which, folder = WRITES.get(event, (0, None))
    path = arguments[which]
    if isinstance(path, (str, bytes, os.PathLike)):
        above = f"/proc/self/fd/{arguments[folder]}" if folder and arguments[folder] >= 0 else "."
        place = os.path.realpath(os.path.join(above, os.fsdecode(path)))
        if not place.startswith(tuple(allowed)):
            strays.append(f"{event} {place}")


def attempt(command):
    """Exit code and all that the command says."""
    out = io.StringIO()
    faulthandler.dump_traceback_later(LONGEST, exit=True)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            code = cli.execute(command)
    finally:
        faulthandler.cancel_dump_traceback_later()
    return code, out.getvalue()


def judge(number, trying, seed, loud):
    """What is wrong with the answers to one mutant, as messages."""
    found = []
    for command, codes in trying(number, seed):
        strays.clear()
        code, said = attempt(command)
        ended[command[0], code] = ended.get((command[0], code), 0) + 1
        if loud:
            print(f"$ orch {' '.join(command)[:300]}\n{said[:3000]}\n-> {code}")
        if code not in codes or "Traceback" in said or "This is a bug" in said or (code and not said.strip()):
            found.append(f"{number}: {' '.join(command)[:200]} -> {code}\n{said[-3000:]}")
        found += [f"{number}: {' '.join(command)[:200]} writes: {stray}" for stray in strays[:3]]
        if "--json" in command and code != 2:
            try:
                json.loads(said[said.index("{") :] if code == 0 else said.splitlines()[0])
            except ValueError as error:
                found.append(f"{number}: {' '.join(command)[:200]}: no JSON: {error}\n{said[-500:]}")
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["experiments", "archives"])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", default="1")
    parser.add_argument("--only", type=int, metavar="NUMBER")
    parser.add_argument("--given", metavar="DIR", help="more FMUs to spoil")
    asked = parser.parse_args()
    global SOURCES
    build.build(MODELS)
    SOURCES = sources() if asked.what == "experiments" else originals(asked.given)
    trying = try_experiment if asked.what == "experiments" else try_archive
    warnings.simplefilter("ignore")  # zipfile's, of names that occur twice
    temporary = os.path.realpath(tempfile.gettempdir())
    mine = {"mutant.toml", "mutant.fmu", "results", *os.listdir()}
    sys.dont_write_bytecode = True
    sys.addaudithook(watch)
    allowed[:] = [os.path.realpath("results"), os.path.realpath("mutant."), f"{temporary}{os.sep}orch-", os.devnull]
    broken = 0
    for number in range(asked.count) if asked.only is None else [asked.only]:
        found = judge(number, trying, asked.seed, asked.only is not None)
        found += [f"{number}: leaves {name}" for name in set(os.listdir()) - mine]
        if found:
            broken += 1
            print("\n".join(found), flush=True)
    allowed.clear()
    left = [name for name in os.listdir(temporary) if name.startswith("orch-")]
    print(", ".join(f"{command} {code}: {times} times" for (command, code), times in sorted(ended.items())))
    print(f"{broken} of {asked.count} mutants broke a rule; {len(left)} temporary folders left")
    sys.stdout.flush()
    os._exit(1 if broken or left else 0)


if __name__ == "__main__":
    main()
