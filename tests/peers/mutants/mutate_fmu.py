"""FMUs spoiled at random: the bytes of the archive, or what its description says."""

import io
import random
import re
import struct
import zipfile
from pathlib import Path

from mutate_toml import EVERYTHING, TEXTS, spoil_bytes, spoil_tokens

from orchestrator.models import build

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


def commands(number, seed, sources):
    """Writes a mutant; yields commands on it, with the exit codes that each may have."""
    chance = random.Random(f"{seed}/{number}")
    Path("mutant.fmu").write_bytes(archive(chance, *sources))
    as_json = ["--json"] if chance.random() < 0.3 else []
    yield ["fmus", "mutant.fmu", *as_json], (0, 2)
    yield ["check", "mutant.toml", *as_json], (0, 2)


def sources(folder):
    """FMUs to spoil, and an experiment that uses one.  None is ever loaded: their libraries may have been changed."""
    Path("mutant.toml").write_text(EVERYTHING.replace('"pid"', '"mutant.fmu"', 1), encoding="utf-8")
    native = build.build(["pid"])["pid"].read_bytes()
    python = build.build(["pid"], packaging="python")["pid"].read_bytes()
    given = [path.read_bytes() for path in sorted(Path(folder).glob("*.fmu"))] if folder else []
    return [native, python, *given * 2], list(XML_VALUES)
