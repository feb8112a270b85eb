"""SSP: experiments for libcosim and Ecos, systems of other tools, and archives that mean harm."""

import copy
import importlib.resources
import json
import random
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

import orchestrator
import test_fmi3
from experiments import EXPERIMENTS, merged
from fmu_files import PROBE_VARIABLES, needs_compiler, paper_fmu, write_zip
from orchestrator.errors import OrchError
from orchestrator.fmu.fmu import platform_folder
from orchestrator.runs.prepare import prepare

PEERS = Path(__file__).parent / "peers"
SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"
SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="theirs"
 xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
 xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
 xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
 xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping"
 xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations">
"""
TAIL = """
<ssd:DefaultExperiment startTime="0" stopTime="0.5"><ssd:Annotations><ssc:Annotation type="com.opensimulationplatform">
<osp:Algorithm><osp:FixedStepAlgorithm baseStepSize="1e-2"/></osp:Algorithm></ssc:Annotation></ssd:Annotations>
</ssd:DefaultExperiment></ssd:SystemStructureDescription>"""


def description(path):
    with zipfile.ZipFile(path) as archive:
        return etree.fromstring(archive.read("SystemStructure.ssd"))


def assert_valid(root):
    """By the schemas of the Modelica Association, which come with FMPy."""
    for schema, elements in (("Description", [root]), ("ParameterValues", root.iter(f"{SSV}ParameterSet"))):
        folder = importlib.resources.files("fmpy.ssp") / "schema"
        validator = etree.XMLSchema(file=str(folder / f"SystemStructure{schema}.xsd"))
        for element in elements:
            validator.assertValid(element)


def rewritten(path, target, **changes):
    """A copy of an archive with other content in some files; None leaves one out."""
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    files |= {name.replace("__", "/"): content for name, content in changes.items()}
    return write_zip(target, {name: content for name, content in files.items() if content is not None})


@pytest.fixture
def theirs(tmp_path):
    """theirs(System's content) -> an .ssp of another tool, with the probe's description as its FMUs a and b."""

    def make(content, tail=TAIL, head=HEAD, **files):
        fmus = {f"resources/{name}.fmu": paper_fmu(tmp_path / f"{name}.fmu").read_bytes() for name in ("a", "b")}
        text = f'{head}<ssd:System name="root">{content}</ssd:System>{tail}'
        extra = {f"extra/{name}": content for name, content in files.items()}
        return write_zip(tmp_path / "theirs.ssp", {"SystemStructure.ssd": text, **fmus, **extra})

    return make


def component(name, content="", source="resources/a.fmu", more=""):
    ports = "".join(
        f'<ssd:Connector name="{v}" kind="{causality}"><ssc:{kind}/></ssd:Connector>'
        for v, kind, causality, *_ in PROBE_VARIABLES
        if causality in ("input", "output") and kind != "Enumeration"
    )
    return (
        f'<ssd:Component name="{name}" source="{source}" {more}><ssd:Connectors>{ports}</ssd:Connectors>'
        f"{content}</ssd:Component>"
    )


def connection(start, end, content="", more=""):
    ends = [dict(zip(("Connector", "Element"), reversed(end.split(":")), strict=False)) for end in (start, end)]
    words = [
        f'{side}{key}="{value}"'
        for side, given in zip(("start", "end"), ends, strict=True)
        for key, value in given.items()
    ]
    return f"<ssd:Connection {' '.join(words)} {more}>{content}</ssd:Connection>"


def values(*parameters, attributes="", mapping=""):
    given = "".join(f'<ssv:Parameter name="{n}"><ssv:{kind} {value}/></ssv:Parameter>' for n, kind, value in parameters)
    return (
        f'<ssd:ParameterBinding {attributes}><ssd:ParameterValues><ssv:ParameterSet version="1.0" name="p">'
        f"<ssv:Parameters>{given}</ssv:Parameters></ssv:ParameterSet></ssd:ParameterValues>{mapping}"
        "</ssd:ParameterBinding>"
    )


def bound(*bindings):
    return f"<ssd:ParameterBindings>{''.join(bindings)}</ssd:ParameterBindings>"


# --- export -----------------------------------------------------------------------------------------------------------


def test_the_description_is_valid_ssp_1_0(orch, tmp_path):
    answer = orch("export", EXPERIMENTS / "gripping_currents.toml", "-o", "system.ssp")
    assert (answer.code, answer.out) == (0, "system.ssp\n")
    assert "jacobi" in answer.err  # libcosim and Ecos do not step by Gauss-Seidel
    root = description(tmp_path / "system.ssp")
    assert_valid(root)
    assert root.get("version") == "1.0"
    assert len(list(root.iter(f"{SSD}Component"))) == 9
    assert len(list(root.iter(f"{SSD}Connection"))) == 90
    units = {unit.get("name") for unit in root.find(f"{SSD}Units")}
    assert {"m", "rad", "m/s", "N.m", "1"} <= units
    with zipfile.ZipFile(tmp_path / "system.ssp") as archive:
        assert sorted(archive.namelist()) == sorted(
            [
                "SystemStructure.ssd",
                *(
                    f"resources/{name}.fmu"
                    for name in (
                        "mfsosmc",
                        "bluerov2_allocation",
                        "bluerov2_thesis",
                        "gripping_reference",
                        "ocean_current",
                    )
                ),
            ]
        )


def test_the_same_experiment_gives_the_same_bytes(orch, write, spiral, tmp_path):
    for name in ("one.ssp", "two.ssp"):
        assert orch("export", write(spiral), "--format", "ssp", "-o", name).code == 0
    assert (tmp_path / "one.ssp").read_bytes() == (tmp_path / "two.ssp").read_bytes()
    assert {entry.date_time[0] for entry in zipfile.ZipFile(tmp_path / "one.ssp").infolist()} == {1980}  # not the clock


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["mine.toml", "--format", "csv"], "--format csv is for runs: an experiment becomes an SSP"),
        (["mine.toml"], "give a format"),
        (["last", "--format", "ssp"], "last is a run, SSP is for experiments"),
        (["last", "--format", "csv", "--set", "a=1"], "are for experiments, and last is a run"),
        (["mine.toml", "--format", "ssp", "-o", "mine.toml"], "mine.toml is already used by this command"),
        (["nowhere.toml", "--format", "ssp"], "no such file"),
    ],
)
def test_what_cannot_be_exported_says_so(orch, write, spiral, arguments, words):
    path = write(spiral)
    before = path.read_bytes()
    answer = orch("export", *arguments)
    assert answer.code == 2
    assert words in answer.err
    assert path.read_bytes() == before


# --- the round trip ---------------------------------------------------------------------------------------------------


def same_records(one, two):
    a, b = orchestrator.open_run(one), orchestrator.open_run(two)
    assert a.signals == b.signals
    assert a.attributes["digest"] == b.attributes["digest"]
    for name in a.signals:
        assert a[name].dtype == b[name].dtype
        assert a[name].tolist() == b[name].tolist(), name
    assert a.metrics == b.metrics


def test_export_import_and_run_give_the_same_bits(orch, write, spiral, tmp_path):
    path = write(merged(spiral, {"master.seed": 3}))
    changes = ["--set", "components.controller.parameters.K_p.z=90.1", "--set", "components.controller.step=2e-3"]
    assert orch("export", path, "-o", "system.ssp", *changes).code == 0
    assert orch("import", "system.ssp", "-o", "again.toml").code == 0
    (tmp_path / "elsewhere").mkdir()
    assert orch("run", path, *changes, "-o", "one.h5").code == 0
    assert orch("run", "again.toml", "-o", "two.h5").code == 0
    assert orch("run", "../system.ssp", "-o", "../three.h5", cwd=tmp_path / "elsewhere").code == 0
    same_records(tmp_path / "one.h5", tmp_path / "two.h5")
    same_records(tmp_path / "one.h5", tmp_path / "three.h5")
    assert orch("rerun", "three.h5", "--verify").code == 0
    again = tomllib.loads((tmp_path / "again.toml").read_text())
    assert again["connections"] == spiral["connections"]  # vectors are vectors again
    assert again["components"]["controller"]["step"] == 2e-3
    assert again["metrics"] == spiral["metrics"]


@needs_compiler
def test_all_types_of_values_survive(orch, write, probe, tmp_path):
    start = {"u": 0.1 + 0.2, "count": -7, "flag": False, "text": 'a <b> & "c" \\ é\n'}
    table = {
        "title": 'Ünïcode & "quotes" \\ <tags>',
        "master": {"stop_time": 0.06, "step": 0.01, "algorithm": "jacobi"},
        "components": {
            "b": {"fmu": str(probe), "start": "fmu", "step": 0.02},
            "a": {"fmu": str(probe), "start": start, "parameters": {"at": 1e300}},
        },
        "connections": {"b.u": "a.y", "b.flag": "a.odd"},
        "record": {"every": 0.02, "signals": ["*", "!b.words"], "inputs": True},
        "metrics": {"größe": {"of": "final", "signal": "a.y"}},
    }
    path = write(table)
    assert orch("export", path, "-o", "system.ssp").code == 0
    assert orch("import", "system.ssp", "-o", "again.toml").code == 0
    again = tomllib.loads((tmp_path / "again.toml").read_text())
    assert again["title"] == table["title"]
    assert list(again["components"]) == ["b", "a"]  # the order decides what Gauss-Seidel does
    assert again["components"]["a"]["start"] == start
    for name, file in (("one", path), ("two", "again.toml"), ("three", "system.ssp")):
        answer = orch("run", file, "-o", f"{name}.h5")
        assert answer.code == 0, answer.err
    same_records(tmp_path / "one.h5", tmp_path / "two.h5")
    same_records(tmp_path / "one.h5", tmp_path / "three.h5")


def test_what_lies_between_two_ends_survives(orch, write, tmp_path):
    """Gains, offsets, and units: other tools convert none, so these are written as factors."""
    for name, unit in (("near", "m"), ("far", "km")):
        ports = [
            (f"{v}{i}", "Real", kind, "0" if kind == "input" else None, unit, "")
            for v, kind in (("u", "input"), ("y", "output"))
            for i in range(4)
        ]
        paper_fmu(tmp_path / f"{name}.fmu", [*ports, ("n", "Integer", "output", None, None, "")])
    table = {
        "master": {"stop_time": 0.05, "step": 0.01},
        "components": {name: {"fmu": f"{name}.fmu", "start": "fmu"} for name in ("near", "far")},
        "connections": {
            "near.u0": "far.y0",
            "near.u1": {"from": "far.y1", "gain": 0.1, "offset": -3.0},
            "near.u2": {"from": "far.y2", "unit_check": False},
            "near.u3": {"from": "far.n", "gain": 1.0},
            "far.u0": "near.y0",
        },
    }
    path = write(table)
    found = [re.split(r"\s{2,}", line.strip())[::4] for line in orch("check", path).out.splitlines()]
    for row in (
        ["near.u0", "x 1000 (km to m)"],
        ["near.u1", "x 100 -3 (km to m)"],
        ["far.u0", "x 0.001 (m to km)"],
        ["near.u3", "(Integer to m)"],
    ):
        assert row in found
    orch("export", path, "-o", "system.ssp")
    orch("import", "system.ssp", "-o", "again.toml")
    digest = prepare(path).digest
    assert prepare(tmp_path / "system.ssp").digest == digest
    assert prepare(tmp_path / "again.toml").digest == digest
    scaled = {
        node.get("endConnector"): [(child.get("factor"), child.get("offset")) for child in node]
        for node in description(tmp_path / "system.ssp").iter(f"{SSD}Connection")
    }
    assert scaled["u1"] == [("100.0", "-3.0")]
    assert scaled["u2"] == []


def test_values_of_fmi_3_survive(orch, write, tmp_path):
    """Every type at its limit, arrays, and a structural parameter that sets their size."""
    folder, suffix = platform_folder(3)
    fmu = write_zip(
        tmp_path / "sponge.fmu",
        {"modelDescription.xml": test_fmi3.description(), f"binaries/{folder}/sponge{suffix}": b"no library"},
    )
    start = {f"{kind}_in": value for kind, value in test_fmi3.EXTREMES.items()}
    start |= {"UInt64_in": 7, "x": [1.5, 2.5, 3.5], "text_in": "wrung", "bytes_in": "c0ffee", "choice_in": "wet"}
    one = {"fmu": str(fmu), "start": start, "parameters": {"n": 3, "A": [[1, 2, 3], [0, 1, 0], [0, 0, 2]]}}
    two = {"fmu": str(fmu), "start": "fmu", "parameters": {"n": 3}, "isolation": "process", "timeout": 2.0}
    names = ("Float32", "UInt64", "Boolean", "text", "bytes", "choice")
    links = {f"two.{name}_in": f"one.{name}_out" for name in names}
    path = write(
        {
            "master": {"stop_time": 0.05, "step": 0.01},
            "components": {"one": one, "two": two},
            "connections": links | {"two.x": "one.y"},
        }
    )
    answer = orch("export", path, "-o", "system.ssp")
    assert answer.code == 0, answer.err
    assert "libcosim and Ecos load no SSP with values of enumerations: two.choice_in, one.choice_in" in answer.err
    assert "one, two is FMI 3.0" in answer.err
    assert_valid(description(tmp_path / "system.ssp"))
    orch("import", "system.ssp", "-o", "again.toml")
    for again in ("system.ssp", "again.toml"):
        assert prepare(tmp_path / again).resolved["components"][0] | {"fmu": ""} == prepare(path).resolved[
            "components"
        ][0] | {"fmu": ""}
        assert prepare(tmp_path / again).digest == prepare(path).digest
    again = tomllib.loads((tmp_path / "again.toml").read_text())
    assert (again["components"]["two"]["isolation"], again["components"]["two"]["timeout"]) == ("process", 2.0)
    assert again["connections"]["two.x"] == "one.y"


def test_two_fmus_of_one_name_stay_two(orch, write, tmp_path):
    (tmp_path / "x").mkdir()
    one = paper_fmu(tmp_path / "probe.fmu")
    two = paper_fmu(tmp_path / "x" / "probe.fmu", PROBE_VARIABLES[:4])
    parts = {name: {"fmu": str(fmu), "start": "fmu"} for name, fmu in (("a", one), ("b", two), ("c", one))}
    path = write({"master": {"stop_time": 0.05, "step": 0.01}, "components": parts})
    orch("export", path, "-o", "system.ssp")
    assert prepare(tmp_path / "system.ssp").digest == prepare(path).digest
    assert len([name for name in zipfile.ZipFile(tmp_path / "system.ssp").namelist() if name.endswith(".fmu")]) == 2


def test_an_ssp_can_be_changed_from_the_command_line(orch, write, spiral):
    orch("export", write(spiral), "-o", "system.ssp")
    found = orch("check", "system.ssp", "--set", "master.stop_time=0.02", "--swap", "controller=mfsosmc", "--json").json
    assert found["master"]["stop_time"] == 0.02
    assert found["components"][0]["fmu"] == "mfsosmc"


# --- systems of other tools -------------------------------------------------------------------------------------------


def imported(orch, path, code=0):
    answer = orch("import", path, "-o", "theirs.toml", "--force")
    assert answer.code == code, answer.err
    return tomllib.loads((path.parent / "theirs.toml").read_text()) if code == 0 else answer.err


def test_nested_systems_are_flattened(orch, theirs):
    inner = f"""<ssd:System name="in ner"><ssd:Connectors><ssd:Connector name="push" kind="input"><ssc:Real/>
        </ssd:Connector><ssd:Connector name="pull" kind="output"><ssc:Real/></ssd:Connector></ssd:Connectors>
        <ssd:Elements>{component("core", source="resources/b.fmu")}</ssd:Elements><ssd:Connections>
        {connection("push", "core:u")}{connection("core:y", "pull")}</ssd:Connections></ssd:System>"""
    path = theirs(f"""<ssd:Connectors><ssd:Connector name="border" kind="input"><ssc:Integer/></ssd:Connector>
        </ssd:Connectors><ssd:Elements>{component("a b")}{inner}</ssd:Elements><ssd:Connections>
        {connection("a b:y", "in ner:push")}{connection("a b:u", "in ner:pull")}{connection("border", "a b:count")}
        </ssd:Connections>""")
    found = imported(orch, path)
    assert found["connections"] == {"in_ner_core.u": "a_b.y", "a_b.u": "in_ner_core.y"}  # whichever end is called start
    assert found["master"] == {"stop_time": 0.5, "step": 0.01, "algorithm": "jacobi"}
    assert found["components"]["a_b"] == {"fmu": "theirs_fmus/a.fmu", "start": "fmu"}
    answer = orch("check", "theirs.ssp")
    assert answer.code == 0
    assert "note: in ner.core is called in_ner_core" in answer.out
    assert "means nothing in SSP" in answer.out


def test_transformations_on_the_way_are_put_together(orch, theirs):
    first, second = (f'<ssc:LinearTransformation factor="{f}" offset="{o}"/>' for f, o in ((2, 0.5), (3, 1)))
    inner = f"""<ssd:System name="in"><ssd:Connectors><ssd:Connector name="push" kind="input"><ssc:Real/>
        </ssd:Connector></ssd:Connectors><ssd:Elements>{component("core")}</ssd:Elements><ssd:Connections>
        {connection("push", "core:u", second)}</ssd:Connections></ssd:System>"""
    path = theirs(f"""<ssd:Elements>{component("a")}{inner}</ssd:Elements><ssd:Connections>
        {connection("a:y", "in:push", first)}{connection("a:steps", "a:count", more='suppressUnitConversion="true"')}
        </ssd:Connections>""")
    found = imported(orch, path)["connections"]
    assert found["in_core.u"] == {"from": "a.y", "gain": 6.0, "offset": 2.5}  # 3 (2 y + 0.5) + 1
    assert found["a.count"] == {"from": "a.steps", "unit_check": False}


def test_parameters_come_from_every_level_and_the_outer_one_wins(orch, theirs):
    ssv = f"{HEAD.replace('ssd:SystemStructureDescription', 'ssv:ParameterSet')}"
    ssv += (
        '<ssv:Parameters><ssv:Parameter name="delay"><ssv:Real value="0.25" unit="ms"/></ssv:Parameter>'
        '</ssv:Parameters><ssv:Units><ssc:Unit name="ms"><ssc:BaseUnit s="1" factor="1e-3"/></ssc:Unit></ssv:Units>'
        "</ssv:ParameterSet>"
    )
    ssm = f"{HEAD.replace('ssd:SystemStructureDescription', 'ssm:ParameterMapping')}"
    ssm += (
        '<ssm:MappingEntry source="delay" target="at"><ssc:LinearTransformation factor="2" offset="1"/>'
        "</ssm:MappingEntry></ssm:ParameterMapping>"
    )
    mapped = (
        '<ssd:ParameterBinding source="extra/p.ssv"><ssd:ParameterMapping source="extra/p.ssm"/></ssd:ParameterBinding>'
    )
    own = values(
        ("at", "Real", 'value="7"'),
        ("mode", "Integer", 'value="2"'),
        ("u", "Real", 'value="3"'),
        ("text", "String", 'value="a &amp; b"'),
        ("nowhere", "Real", 'value="1"'),
    )
    prefixed = values(("mode", "Integer", 'value="5"'), attributes='prefix="two."')
    outer = bound(values(("one.mode", "Integer", 'value="4"'), ("way", "Integer", 'value="9"')), prefixed)
    path = theirs(
        f"""<ssd:Connectors><ssd:Connector name="way" kind="input"><ssc:Integer/></ssd:Connector></ssd:Connectors>
        {outer}<ssd:Elements>{component("one", bound(own))}{component("two", bound(own, mapped))}</ssd:Elements>
        <ssd:Connections>{connection("one:y", "two:u")}{connection("way", "two:count")}</ssd:Connections>""",
        **{"p.ssv": ssv, "p.ssm": ssm},
    )
    found = imported(orch, path)["components"]
    assert found["one"]["parameters"] == {"at": 7.0, "mode": 4}
    assert found["one"]["start"] == {"u": 3.0, "count": 3, "flag": True, "text": "a & b"}  # the FMU's own besides
    # The mapping is of the file's number, the unit of the result: (2 x 0.25 + 1) ms.
    assert found["two"]["parameters"] == {"at": pytest.approx(0.0015), "mode": 5}
    assert found["two"]["start"] == {"count": 9, "flag": True, "text": "a & b"}  # u is connected
    assert "no variable is named one.nowhere, two.nowhere: ignored" in orch("check", "theirs.ssp").out


def test_everything_that_orch_does_not_run_is_listed_at_once(orch, theirs):
    entry = '<ssc:MapEntry source="true" target="false"/>'
    mapping = f"<ssc:BooleanMappingTransformation>{entry}</ssc:BooleanMappingTransformation>"
    path = theirs(
        f"""<ssd:Elements>{component("me", more='implementation="ModelExchange"')}
        {component("nested", more='type="application/x-ssp-package"', source="resources/inner.ssp")}
        {component("away", source="http://example.org/a.fmu")}{component("gone", source="resources/gone.fmu")}
        {component("odd", bound(values(("hidden", "Real", 'value="1"'), ("at", "Real", 'value="1" unit="kg"'))))}
        {component("raw", bound(values(("at", "Float32", 'value="0"'))))}
        <ssd:SignalDictionaryReference name="bus" dictionary="d"/></ssd:Elements><ssd:Connections>
        {connection("odd:odd", "me:flag", mapping)}{connection("odd:y", "me:y")}{connection("odd:y", "nobody:u")}
        </ssd:Connections>""",
        tail='<ssd:Units><ssc:Unit name="kg"><ssc:BaseUnit kg="1"/></ssc:Unit></ssd:Units>'
        '<ssd:DefaultExperiment startTime="5"/></ssd:SystemStructureDescription>',
        head=HEAD.replace('version="1.0" name', 'version="3.0" name'),
    )
    text = imported(orch, path, code=2)
    for words in (
        "is of SSP 3.0; orch reads SSP 1.0",
        "starts at 5 s; orch starts at 0",
        "me: asks for Model Exchange",
        "nested: is application/x-ssp-package, not an FMU",
        "'http://example.org/a.fmu' lies outside the archive",
        "gone: the archive has no 'resources/gone.fmu'",
        "odd.hidden: is local of the FMU",
        "odd.at: is in 'kg', the FMU's in 's': one is kg, the other s",
        "raw: its parameters: at is a Float32",
        "bus: is a signal dictionary",
        "maps values one by one",
        "both ends are sources, or both are sinks",
        "there is no element 'nobody'",
    ):
        assert words in text
    assert "13 problems" in text
    assert {p.name for p in path.parent.iterdir()} == {"a.fmu", "b.fmu", "theirs.ssp"}  # nothing is left of it


def test_what_an_ssp_does_not_say_can_be_said(orch, theirs):
    path = theirs(f"<ssd:Elements>{component('a')}</ssd:Elements>", tail="</ssd:SystemStructureDescription>")
    answer = orch("check", path)
    assert "master.step: is missing" in answer.err
    assert "master.stop_time: is missing" in answer.err
    assert orch("check", path, "--set", "master.step=0.1", "--set", "master.stop_time=1").code == 0
    answer = orch("import", path, "-o", "new.toml")
    assert answer.code == 0
    assert "does not state master.step: add it to new.toml" in answer.err
    assert orch("import", path, "-o", "new.toml").code == 2  # it is there


# --- archives that mean harm ------------------------------------------------------------------------------------------


def link_to(target):
    entry = zipfile.ZipInfo("resources/link.fmu")
    entry.external_attr = 0o120777 << 16
    return entry, target


ENTITY = HEAD.replace("<ssd:System", '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/hostname">]>\n<ssd:System', 1)
BOMB = HEAD.replace(
    "<ssd:System",
    "<!DOCTYPE x ["
    + '<!ENTITY a "ha">'
    + "".join(f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(12))
    + "]>\n<ssd:System",
    1,
)


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"../outside.fmu": b"x"}, "would write outside its folder"),
        ({"/tmp/outside.fmu": b"x"}, "would write outside its folder"),
        ({"C:\\outside.fmu": b"x"}, "would write outside its folder"),
        ({"resources/zeros.bin": bytes(1 << 28)}, "unpacks to an absurd size"),
        ({"SystemStructure.ssd": ENTITY + "<ssd:System>&e;</ssd:System>" + TAIL}, "has a document type"),
        ({"SystemStructure.ssd": BOMB + "<ssd:System>&m;</ssd:System>" + TAIL}, "SystemStructure.ssd"),
        ({"SystemStructure.ssd": HEAD}, "cannot be read"),
        ({"SystemStructure.ssd": "<a/>"}, "is not a system structure"),
        ({"SystemStructure.ssd": HEAD + "<ssd:System name='s'>" * 500}, "cannot be read"),
        ({"SystemStructure.ssd": None}, "it has no SystemStructure.ssd"),
        ({"SystemStructure.ssd": b"\xff\xfe\x00"}, "cannot be read"),
    ],
)
def test_an_archive_that_means_harm_is_refused(theirs, tmp_path, files, words):
    path = theirs(f"<ssd:Elements>{component('a')}</ssd:Elements>")
    with zipfile.ZipFile(path) as archive:
        whole = {name: archive.read(name) for name in archive.namelist()} | files
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in whole.items():
            if content is not None:
                archive.writestr(name, content)
    before = {p.name for p in tmp_path.iterdir()}
    with pytest.raises(orchestrator.ExperimentError, match=re.escape(words)):
        orchestrator.run(path, results=tmp_path / "results")
    assert {p.name for p in tmp_path.iterdir()} == before
    assert not Path("/tmp/outside.fmu").exists()


def test_links_and_files_that_are_no_archives_are_refused(orch, theirs, tmp_path):
    path = theirs(f"<ssd:Elements>{component('a')}</ssd:Elements>")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(*link_to("/etc/hostname"))
    assert "contains a link" in orch("check", path).err
    path.write_bytes(path.read_bytes()[:900])
    assert "not a zip file" in orch("check", path).err
    assert f"no such file; did you mean {path.name!r}?" in orch("run", path.with_name(f"x{path.name}")).err


ODD = ["", "-1", "é", "nan", "..", "/", "<", "1e999", "one", "two", "input", "output", "at", "true"]


def mutated(text, dice):
    """The text with a few pieces cut out, doubled or swapped for others: of its tree, or of its letters."""
    if dice.random() < 0.7:
        root = etree.fromstring(text.encode())
        for _ in range(dice.randint(1, 3)):
            node = dice.choice(list(root.iter(etree.Element)))
            if node.attrib and dice.random() < 0.6:
                key = dice.choice(sorted(node.attrib))
                node.set(key, dice.choice(ODD)) if dice.random() < 0.8 else node.attrib.pop(key)
            elif node.getparent() is not None:
                other = dice.choice(list(root.iter(etree.Element)))
                node.getparent().remove(node) if dice.random() < 0.4 else other.append(copy.deepcopy(node))
        return etree.tostring(root).decode()
    pieces = text.replace("<", "\0<").replace(" ", "\0 ").replace('"', '\0"').split("\0")
    for _ in range(dice.randint(1, 2)):
        i, j = dice.randrange(len(pieces)), dice.randrange(len(pieces))
        dice.choice(
            [
                lambda i=i: pieces.pop(i),
                lambda i=i: pieces.insert(i, pieces[i]),
                lambda i=i, j=j: pieces.__setitem__(i, pieces[j]),
                lambda i=i: pieces.__setitem__(
                    i, pieces[i] + dice.choice(["-1", "é", "nan", "..", "/", "&lt;", "1e999"])
                ),
            ]
        )()
    return "".join(pieces)


def test_a_mutated_description_is_read_or_refused_in_words(theirs, tmp_path):
    content = f"""<ssd:Connectors><ssd:Connector name="way" kind="input"><ssc:Integer/></ssd:Connector></ssd:Connectors>
        {bound(values(("one.mode", "Integer", 'value="4"'), ("way", "Integer", 'value="9"')))}
        <ssd:Elements>{component("one", bound(values(("at", "Real", 'value="1" unit="s"'))))}
        <ssd:System name="deep"><ssd:Connectors><ssd:Connector name="in" kind="input"/></ssd:Connectors><ssd:Elements>
        {component("two", source="resources/b.fmu")}</ssd:Elements><ssd:Connections>{connection("in", "two:u")}
        </ssd:Connections></ssd:System></ssd:Elements><ssd:Connections>{
        connection("one:y", "deep:in", '<ssc:LinearTransformation factor="2"/>')
    }{connection("way", "one:count")}</ssd:Connections>"""
    path = theirs(content)
    with zipfile.ZipFile(path) as archive:
        text = archive.read("SystemStructure.ssd").decode()
    dice, refused = random.Random(1), 0
    for _ in range(150):
        broken = rewritten(path, tmp_path / "broken.ssp", **{"SystemStructure.ssd": mutated(text, dice)})
        try:
            prepare(broken)
        except OrchError:
            refused += 1
    assert 50 < refused < 150
    assert {p.name for p in tmp_path.iterdir()} == {"a.fmu", "b.fmu", "theirs.ssp", "broken.ssp"}


# --- other masters ----------------------------------------------------------------------------------------------------


def importable(module):
    done = subprocess.run([sys.executable, "-c", f"import {module}"], capture_output=True, text=True, check=False)
    return done.returncode == 0


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("master", ["libcosim", "ecos"])
@pytest.mark.parametrize(
    ("experiment", "changes"),
    [
        ("spiral_pid", []),
        (
            "spiral_pid",
            [
                "--set",
                "components.current.parameters.velocity.y=0.7",
                "--set",
                'connections."vehicle.v_c"={from = "current.v_c", gain = 0.5, offset = 0.1}',
            ],
        ),
        ("gripping_currents", ["--swap", "controller1=pid", "--swap", "controller2=pid", "--set", "master.step=1e-3"]),
    ],
)
def test_other_masters_compute_the_same_from_the_ssp(orch, tmp_path, master, experiment, changes):
    """Both step by Jacobi, as `orch` then does; times that differ in the last bit leave 1e-11 of forces of 100 N."""
    module = {"libcosim": "libcosimpy", "ecos": "ecospy"}[master]
    if not importable(module):
        pytest.skip(f"{module} cannot be imported: pip install -e '.[bench]', and apt install libtbb12 for ecospy")
    arguments = [EXPERIMENTS / f"{experiment}.toml", "--set", "master.algorithm=jacobi", *changes]
    assert orch("export", *arguments, "-o", "system.ssp").code == 0
    assert orch("run", *arguments, "-o", "run.h5").code == 0
    run = orchestrator.open_run(tmp_path / "run.h5")
    step = run.attributes["step"]
    task = {
        "step": step,
        "stride": round((run.time[1] - run.time[0]) / step),
        "rows": len(run.time) - 1,
        "signals": run.signals,
    }
    (tmp_path / "task.json").write_text(json.dumps(task))
    subprocess.run(
        [sys.executable, PEERS / "ssp_masters.py", master, "system.ssp", "task.json", "rows.npy"],
        cwd=tmp_path,
        check=True,
    )
    theirs = np.load(tmp_path / "rows.npy")
    ours = np.column_stack([run[name] for name in run.signals])[1:]
    assert ours.shape == theirs.shape
    assert np.abs(theirs - ours).max() < 1e-9
    assert np.ptp(ours, axis=0).max() > 1  # they did not stand still
