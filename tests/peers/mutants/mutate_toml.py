"""Experiment files spoiled at random: their bytes, their words, or their tables."""

import datetime
import json
import math
import random
import re
import shutil
import tomllib
from pathlib import Path

EXPERIMENTS = Path(__file__).parents[3] / "experiments"
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

EVERYTHING = Path(__file__).with_name("everything.toml").read_text(encoding="utf-8")

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


def commands(number, seed, sources):
    """Writes a mutant; yields commands on it, with the exit codes that each may have."""
    chance = random.Random(f"{seed}/{number}")
    Path("mutant.toml").write_bytes(experiment(chance, *sources))
    given = options(chance)
    yield ["check", "mutant.toml", *given, *(["--json"] if chance.random() < 0.3 else [])], (0, 2)
    yield ["run", "mutant.toml", *given, *SHORT, "--force", *(["--json"] if chance.random() < 0.3 else [])], (0, 2, 3)
    shutil.rmtree("results", ignore_errors=True)


def sources():
    texts = [path.read_text(encoding="utf-8") for path in sorted(EXPERIMENTS.rglob("*.toml"))] + [EVERYTHING] * 20
    return texts, sorted({token for one in texts for token in TOKEN.findall(one)})
