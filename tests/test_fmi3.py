"""FMUs 3.0: every type, arrays, structural parameters, event mode, and how they fail."""

import json
import shutil
from pathlib import Path

import fmpy
import h5py
import numpy as np
import pytest
import xarray

import orchestrator
from experiments import merged
from fmu_files import compile_fmu, needs_compiler
from test_archive import with_description

pytestmark = needs_compiler

FLOATS = ("Float64", "Float32")
INTEGERS = {"Int8": 8, "UInt8": 8, "Int16": 16, "UInt16": 16, "Int32": 32, "UInt32": 32, "Int64": 64, "UInt64": 64}
TYPES = (*FLOATS, *INTEGERS, "Boolean")


def description(about=""):
    both = [("in", "input", 100), ("out", "output", 200)]
    lines = [
        '<UInt64 name="n" valueReference="1" causality="structuralParameter" variability="fixed" start="2"/>',
        '<Int32 name="mode" valueReference="2" causality="parameter" variability="fixed" start="0"/>',
        '<Float64 name="x" valueReference="3" causality="input" start="1 2"><Dimension valueReference="1"/></Float64>',
        '<Float64 name="A" valueReference="4" causality="parameter" variability="fixed" start="1 0 0 1">'
        '<Dimension valueReference="1"/><Dimension valueReference="1"/></Float64>',
        '<Float64 name="y" valueReference="5" causality="output" unit="m"><Dimension valueReference="1"/></Float64>',
        '<Float64 name="time" valueReference="9" causality="independent"/>',
        '<Float64 name="t" valueReference="6" causality="output"/>',
        '<Int32 name="events" valueReference="7" causality="output"/>',
        '<Float64 name="level" valueReference="8" causality="output"/>',
    ]
    for end, causality, first in both:
        for k, kind in enumerate(TYPES, 10):
            zero = "false" if kind == "Boolean" else "0"
            start = f' start="{zero}"' * (causality == "input")
            lines.append(f'<{kind} name="{kind}_{end}" valueReference="{first + k}" causality="{causality}"{start}/>')
        start = ' start="1"' * (causality == "input")
        lines.append(
            f'<Enumeration name="choice_{end}" valueReference="{first + 30}" declaredType="Choice" '
            f'causality="{causality}"{start}/>'
        )
        start = '<Start value="dry"/>' * (causality == "input")
        tail = f'causality="{causality}">{start}'
        lines.append(f'<String name="text_{end}" valueReference="{first + 31}" {tail}</String>')
        start = '<Start value="00ff"/>' * (causality == "input")
        tail = f'causality="{causality}">{start}'
        lines.append(f'<Binary name="bytes_{end}" valueReference="{first + 32}" {tail}</Binary>')
    outputs = "".join(
        f'<Output valueReference="{r}" dependencies="{d}"/>'
        for r, d in [(5, "3 4"), (6, ""), (7, ""), (8, ""), *((200 + k, 100 + k) for k in (*range(10, 21), 30, 31, 32))]
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="sponge" instantiationToken="{{sponge}}">
<CoSimulation modelIdentifier="sponge" hasEventMode="true" mightReturnEarlyFromDoStep="true"
 canHandleVariableCommunicationStepSize="true" {about}/>
<UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit></UnitDefinitions>
<TypeDefinitions><EnumerationType name="Choice"><Item name="dry" value="1"/><Item name="wet" value="7"/>
</EnumerationType></TypeDefinitions>
<ModelVariables>{"".join(lines)}</ModelVariables>
<ModelStructure>{outputs}</ModelStructure></fmiModelDescription>"""


@pytest.fixture(scope="session")
def sponge(tmp_path_factory):
    headers = Path(fmpy.__file__).parent / "c-code"
    path = tmp_path_factory.mktemp("sponge") / "sponge.fmu"
    files = {"resources/word.txt": "soaked"}
    return compile_fmu(path, "sponge.c", description(), "-O1", f"-I{headers}", version=3, **files)


def alone(fmu, stop_time=0.06, **parameters):
    return {
        "master": {"stop_time": stop_time, "step": 0.01},
        "components": {"one": {"fmu": str(fmu), "start": "fmu", "parameters": parameters}},
    }


@pytest.fixture
def run(orch, write, tmp_path):
    def run(table, code=0):
        answer = orch("run", write(table), "--json")
        assert answer.code == code, answer.err
        return orchestrator.open_run(tmp_path / answer.json["file"])

    return run


EXTREMES = {
    "Float64": -1.0e300,
    "Float32": 0.5,
    "Int8": -128,
    "UInt8": 255,
    "Int16": -32768,
    "UInt16": 65535,
    "Int32": -(2**31),
    "UInt32": 2**32 - 1,
    "Int64": 2**63 - 1,
    "UInt64": 2**64 - 1,
    "Boolean": True,
}


@pytest.mark.parametrize("loop", ["", "python"])
def test_every_type_goes_in_and_comes_out_in_its_own_width(run, sponge, loop, monkeypatch):
    monkeypatch.setenv("ORCH_LOOP", loop)
    given = {f"{kind}_in": value for kind, value in EXTREMES.items()}
    table = alone(sponge)
    words = {"text_in": "wrung", "bytes_in": "c0ffee", "choice_in": "wet"}
    table["components"]["one"]["start"] = {**given, "x": [1, 2], **words}
    table["components"]["two"] = {"fmu": str(sponge), "start": {"x": [0, 0]}}
    kinds = [*TYPES, "text", "bytes", "choice"]
    table["connections"] = {f"two.{kind}_in": f"one.{kind}_out" for kind in kinds}
    record = run(table)
    for kind in TYPES:
        values, expected = record[f"two.{kind}_out"], given[f"{kind}_in"]
        assert values.dtype == np.dtype("int8" if kind == "Boolean" else kind.lower())
        assert values.tolist() == [expected] * 7, kind
    assert record["two.choice_out"].tolist() == [7] * 7
    assert record["two.text_out"].tolist() == ["wrung"] * 7
    assert "two.bytes_out" not in record.signals
    assert record.fact("two", "fmi_version") == "3.0"


def test_an_array_is_one_dataset_with_scales_of_its_own(run, sponge, tmp_path):
    table = alone(sponge, n=3, A=[[1, 2, 3], [0, 1, 0], [0, 0, 2]])
    table["components"]["one"]["start"] = None
    table["components"]["one"]["start"] = {
        "x": [1.0, 10.0, 100.0],
        "text_in": "",
        "bytes_in": "",
        "choice_in": 1,
        **{f"{k}_in": 0 for k in TYPES[:-1]},
        "Boolean_in": False,
    }
    record = run(table)
    assert record["one.y"].tolist() == [[321.0, 10.0, 200.0]] * 7
    assert record["one.y[3]"].tolist() == [200.0] * 7
    assert record.units("one.y") == record.units("one.y[1]") == "m"
    assert list(record.to_dataframe().filter(like="one.y")) == ["one.y[1]", "one.y[2]", "one.y[3]"]
    with h5py.File(record.path, locking=False) as file:
        assert file["one/y"].shape == (7, 3)
        assert file["one/y"].dims[1][0] == file["one/y_dim1"]
    record.close()
    tree = xarray.open_datatree(record.path, engine="h5netcdf")
    assert tree["one"]["y"].dims == ("time", "y_dim1")
    assert tree["one"]["y"].isel(time=0).values.tolist() == [321.0, 10.0, 200.0]


@pytest.mark.parametrize("loop", ["", "python"])
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_arrays_connect_whole_and_one_by_one_with_gain(run, sponge, algorithm, loop, monkeypatch):
    monkeypatch.setenv("ORCH_LOOP", loop)
    table = merged(
        alone(sponge, A=[[2, 0], [0, 3]]),
        {
            "master.algorithm": algorithm,
            "record": {"signals": ["*", "!*.text_out"]},
        },
    )
    table["components"] |= {"whole": {"fmu": str(sponge), "start": "fmu"}, "part": {"fmu": str(sponge), "start": "fmu"}}
    table["connections"] = {
        "whole.x": "one.y",
        "part.x[2]": {"from": "one.y[2]", "gain": -0.5, "offset": 1.0},
        "part.Float32_in": "one.y[1]",
        "part.Float64_in": {"from": "one.UInt32_out", "gain": 1},
    }
    record = run(table)
    assert record["whole.y"].tolist() == [[2.0, 6.0]] * 7
    assert record["part.y"].tolist() == [[1.0, -2.0]] * 7
    assert record["part.Float32_out"].tolist() == [2.0] * 7
    if not loop:
        assert record.attributes["timing"]["loop"] == "compiled"


@pytest.mark.parametrize(("inner", "notes"), [("0.0025", []), ("1e-2", []), ("0.004", ["late"]), ("0.02", ["late"])])
def test_a_step_that_is_no_multiple_of_the_one_inside_is_reported(orch, write, sponge, tmp_path, inner, notes):
    path = tmp_path / "sponge.fmu"
    shutil.copy(sponge, path)
    with_description(path, description(f'fixedInternalStepSize="{inner}"'))
    expected = (
        [
            f"one: steps every 0.01 s, no multiple of the {float(inner):g} s in which its FMU steps inside "
            "(fixedInternalStepSize): what it gives may be late"
        ]
        if notes
        else []
    )
    assert orch("check", write(alone(path)), "--json").json["notes"] == expected
    assert orch("run", write(alone(path)), "--json").json["warnings"] == expected


def test_a_number_too_wide_for_an_input_is_refused(orch, write, sponge):
    table = alone(sponge)
    table["components"]["two"] = {"fmu": str(sponge), "start": "fmu"}
    table["connections"] = {
        "two.Int8_in": "one.UInt8_out",
        "two.Float64_in": "one.Int64_out",
        "two.Float32_in": "one.Int8_out",
        "two.Int16_in": "one.UInt8_out",
    }
    answer = orch("check", write(table))
    assert answer.code == 2
    assert "Int8_in is Int8, UInt8_out is UInt8" in answer.err
    assert "Float64_in is Float64, Int64_out is Int64" in answer.err
    assert "Float32_in is Float32, Int8_out is Int8; say gain = 1.0 to take it as it is" in answer.err
    assert "Int16_in" not in answer.err


@pytest.mark.parametrize("loop", ["compiled", "python"])
def test_an_fmu_that_insists_on_event_mode_is_stepped_from_event_to_event(run, sponge, loop, monkeypatch):
    monkeypatch.setenv("ORCH_LOOP", loop)
    table = alone(sponge, A=[[2, 0], [0, 3]]) | {"record": {"signals": ["*", "!*.text_out"]}}  # texts: Python's loop
    table["components"]["eventful"] = {"fmu": str(sponge), "start": "fmu"}
    table["connections"] = {"eventful.x": "one.y", "eventful.Int8_in": "one.Int8_out"}
    record = run(table)
    assert record.attributes["timing"]["loop"] == loop
    assert record["eventful.y"].tolist() == [[2.0, 6.0]] * 7
    assert record["one.events"].tolist() == [0] * 7
    assert record["eventful.events"].tolist() == [0, 0, 0, 1, 1, 1, 2]
    np.testing.assert_allclose(record["eventful.level"][1:], [0.01, 0.02, 1.03, 1.04, 1.05, 2.06], rtol=1e-12)


@pytest.mark.parametrize("loop", ["", "python"])
@pytest.mark.parametrize(
    ("mode", "words"),
    [
        (2, 'fmi3Error: "the sponge is full: 100 % wet"'),
        (3, "returned early from a step"),
        (4, "output Float32_out is not finite: nan"),
    ],
)
def test_an_fmu_that_fails_is_reported_in_its_own_words(run, sponge, mode, words, loop, monkeypatch):
    monkeypatch.setenv("ORCH_LOOP", loop)
    record = run(alone(sponge, mode=mode), code=3)
    assert record.attributes["error"].startswith("'one' failed at t = 0.02 s: ")
    assert words in record.attributes["error"]
    assert record.time.tolist() == [0.0, 0.01, 0.02]


@pytest.mark.parametrize("isolation", ["none", "process"])
@pytest.mark.parametrize("loop", ["", "python"])
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_an_fmu_may_end_the_simulation_with_a_step_which_is_kept(run, sponge, algorithm, loop, isolation, monkeypatch):
    monkeypatch.setenv("ORCH_LOOP", loop)
    table = merged(alone(sponge, mode=1), {"master.algorithm": algorithm, "components.one.isolation": isolation})
    table["components"]["two"] = {"fmu": str(sponge), "start": "fmu"}
    table["connections"] = {"two.Float64_in": "one.t"}
    record = run(table)
    assert record.status == "completed"
    assert record.attributes["stopped_at"] == record.time[-1] == pytest.approx(0.03)
    assert record["one.t"].tolist() == record["two.t"].tolist() == pytest.approx([0.0, 0.01, 0.02, 0.03])
    late = [0.0, 0.0, 0.01, 0.02] if algorithm == "jacobi" else [0.0, 0.01, 0.02, 0.03]
    assert record["two.Float64_out"].tolist() == pytest.approx(late)


def test_the_fmu_s_variables_are_shown(orch, sponge):
    answer = orch("fmus", sponge)
    assert answer.code == 0, answer.err
    assert "3.0" in answer.out
    shown = {v["name"]: v for v in json.loads(orch("fmus", sponge, "--json").out)["variables"]}
    assert shown["A[2,1]"]["start"] == "0"
    assert shown["A[2,2]"]["start"] == "1"


def test_rerun_names_the_element_of_an_array_that_differs_even_in_the_sign_of_zero(run, orch, sponge):
    record = run(alone(sponge, A=[[1, 0], [0, 0]]))
    assert record["one.y"][2].tolist() == [1.0, 0.0]
    record.close()
    with h5py.File(record.path, "r+") as file:
        file["one/y"][2, 1] = -0.0
    answer = orch("rerun", "last", "--verify")
    assert answer.code == 1
    assert "one.y[2] first, at t = 0.02 s: -0.0 then, 0.0 now" in answer.out


@pytest.mark.parametrize(
    "command",
    [
        ["plot", "last"],
        ["export", "last", "--format", "csv", "-o", "x.csv"],
        ["show", "last"],
        ["compare", "last", "last"],
        ["rerun", "last", "--verify"],
    ],
)
def test_records_of_arrays_go_through_every_command(orch, write, sponge, command):
    table = alone(sponge)
    del table["components"]["one"]["start"]
    table["components"]["one"]["start"] = "fmu"
    assert orch("run", write(table)).code == 0
    answer = orch(*command)
    assert answer.code == 0, answer.err
