"""FMU files and what is connected to what: every misfit is found before anything runs."""

import math
import struct
import zipfile

import pytest

from experiments import merged, single
from fmu_files import PROBE_VARIABLES, description_xml, needs_compiler, paper_fmu, probe_fmu, write_zip


@pytest.fixture
def two(tmp_path):
    """An experiment of two paper FMUs, `a` feeding `b`; their variables can be changed."""

    def table(a=PROBE_VARIABLES, b=PROBE_VARIABLES, **changes):
        paper_fmu(tmp_path / "first.fmu", a)
        paper_fmu(tmp_path / "second.fmu", b)
        experiment = {
            "master": {"stop_time": 0.05, "step": 0.01},
            "components": {"a": {"fmu": "first.fmu", "start": "fmu"}, "b": {"fmu": "second.fmu", "start": "fmu"}},
            "connections": {"b.u": "a.y", "b.count": "a.steps", "b.flag": "a.odd", "b.text": "a.words"},
        }
        return merged(experiment, changes)

    return table


def vector(name, axes, kind="Real", causality="output", unit="m"):
    return [(f"{name}.{axis}", kind, causality, "0" if causality == "input" else None, unit, name) for axis in axes]


# --- FMU files --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fmu", "words"),
    [
        ("pdi", "no FMU 'pdi'; did you mean 'pid'?"),
        ("secnd.fmu", "no file 'secnd.fmu'; did you mean 'second.fmu'?"),
        ("mine.py", "build it first: orch build mine.py"),
        ("nowhere/second.fmu", "no file 'nowhere/second.fmu'"),
    ],
)
def test_an_unknown_fmu_names_the_nearest_one(problems, two, fmu, words):
    (found,) = problems(two(**{"components.a.fmu": fmu}))
    assert found[0] == "components.a.fmu"
    assert words in found[1]


def test_what_is_no_fmu_is_refused(problems, two, tmp_path):
    table = two()
    (tmp_path / "first.fmu").write_text("not a zip file")
    write_zip(tmp_path / "second.fmu", {"model.xml": "<a/>"})
    assert dict(problems(table)) == {
        "components.a.fmu": f"{tmp_path / 'first.fmu'} is not an FMU: not a zip file",
        "components.b.fmu": f"{tmp_path / 'second.fmu'} is not an FMU: it has no modelDescription.xml",
    }


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        ("<fmiModelDescription", "modelDescription.xml cannot be read"),
        ("<nothing/>", "modelDescription.xml cannot be read"),
        (description_xml("first", PROBE_VARIABLES, version="1.0"), "orch runs FMI 2.0"),
        (description_xml("first", PROBE_VARIABLES, version="3.0"), "orch runs FMI 2.0"),
        (description_xml("first", PROBE_VARIABLES, interface="ModelExchange"), "only Model Exchange"),
        (description_xml("other", PROBE_VARIABLES), "no binary"),
    ],
)
def test_an_fmu_that_cannot_run_here_says_why(problems, two, tmp_path, xml, words):
    table = two()
    with zipfile.ZipFile(tmp_path / "first.fmu") as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    write_zip(tmp_path / "first.fmu", {**files, "modelDescription.xml": xml})
    found = dict(problems(table))
    assert words in found["components.a.fmu"] or "modelDescription.xml cannot be read" in found["components.a.fmu"]
    assert str(tmp_path / "first.fmu") in found["components.a.fmu"]


def test_an_fmu_of_another_interface_is_named_as_such(problems, two, tmp_path):
    table = two()
    xml = (
        '<?xml version="1.0"?><fmiModelDescription fmiVersion="3.0" modelName="first" instantiationToken="{a}">'
        '<ScheduledExecution modelIdentifier="first"/><ModelVariables><Float64 name="y" valueReference="1" '
        'causality="output"/></ModelVariables><ModelStructure><Output valueReference="1"/></ModelStructure>'
        "</fmiModelDescription>"
    )
    write_zip(tmp_path / "first.fmu", {"modelDescription.xml": xml})
    words = "has no co-simulation interface, only Scheduled Execution"
    assert words in dict(problems(table))["components.a.fmu"]


def test_an_fmu_without_a_binary_for_this_platform_says_which_it_has(problems, two, tmp_path):
    table = two()
    xml = description_xml("first", PROBE_VARIABLES)
    write_zip(
        tmp_path / "first.fmu",
        {"modelDescription.xml": xml, "binaries/riscv128/first.so": "", "binaries/amiga/first.so": ""},
    )
    (found,) = problems(table)
    assert "has no binary for this platform" in found[1]
    assert "it has amiga, riscv128" in found[1]


@pytest.mark.parametrize(
    "name",
    [
        "../evil.txt",
        "/tmp/evil.txt",
        "binaries/../../evil.txt",
        "resources/..",
        "C:/evil.txt",
        "C:evil.txt",
        "..\\evil.txt",
        "resources\\..\\..\\evil.txt",
        "\\\\server\\share\\evil.txt",
    ],
)
def test_a_zip_that_writes_outside_its_folder_is_not_opened(problems, two, tmp_path, name):
    table = two()
    with zipfile.ZipFile(tmp_path / "first.fmu", "a") as archive:
        archive.writestr(name, "got you")
    ((key, sentence),) = problems(table)
    assert key == "components.a.fmu"
    assert f"{tmp_path / 'first.fmu'} would write outside its folder: {name!r}" in sentence
    assert not list(tmp_path.rglob("evil.txt"))


def test_a_zip_with_a_link_is_not_opened(problems, two, tmp_path):
    table = two()
    link = zipfile.ZipInfo("resources/way_out")
    link.external_attr = 0o120777 << 16
    with zipfile.ZipFile(tmp_path / "first.fmu", "a") as archive:
        archive.writestr(link, "/etc")
    ((_, sentence),) = problems(table)
    assert "contains a link, 'resources/way_out'" in sentence


def test_a_zip_that_unpacks_to_an_absurd_size_is_not_opened(problems, two, tmp_path):
    table = two()
    with zipfile.ZipFile(tmp_path / "first.fmu", "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("resources/bomb", bytes(300 << 20))
    ((_, sentence),) = problems(table)
    assert "absurd size at 'resources/bomb'" in sentence


def test_a_damaged_fmu_is_reported_as_such(orch, write, spiral, tmp_path, shipped):
    """A byte in the middle of the library is wrong: the archive's directory looks right."""
    content = bytearray(shipped["pid"].read_bytes())
    with zipfile.ZipFile(shipped["pid"]) as archive:
        (library,) = [i for i in archive.infolist() if "pid." in i.filename and "binaries/linux64" in i.filename]
    content[library.header_offset + 5000] ^= 0xFF
    (tmp_path / "pid.fmu").write_bytes(content)
    answer = orch("run", write(merged(spiral, {"components.controller.fmu": "pid.fmu"})))
    assert answer.code == 2
    assert "pid.fmu is damaged: Bad CRC-32" in answer.err
    assert not (tmp_path / "results").exists()


def test_a_library_that_cannot_be_loaded_says_so(orch, write, two, tmp_path):
    answer = orch("run", write(two()))
    assert answer.code == 2
    assert f"{tmp_path / 'first.fmu'} cannot be loaded" in answer.err
    assert not (tmp_path / "results").exists()


def test_an_fmu_for_one_instance_a_process_gets_a_process_for_each_further_one(resolve, problems, two, tmp_path):
    table = two(**{"components.b.fmu": "first.fmu"})
    paper_fmu(tmp_path / "first.fmu", options='canBeInstantiatedOnlyOncePerProcess="true"')
    assert [component.isolated for component in resolve(table).components] == [False, True]
    ((key, sentence),) = problems(merged(table, {"components.b.isolation": "none"}))
    assert key == "components.b.isolation"
    assert "only once in a process" in sentence


def test_foreign_fmus_with_different_modules_of_one_name_run_in_different_processes(resolve, problems, two, foreign):
    changes = {"components.a.fmu": str(foreign.north), "components.b.fmu": str(foreign.south), "connections": {}}
    plan = resolve(two(**changes))
    assert [component.isolated for component in plan.components] == [False, True]
    assert any("different module 'helper'" in note for note in plan.notes)
    ((key, sentence),) = problems(two(**changes, **{"components.b.isolation": "none"}))
    assert key == "components.b.isolation"
    assert "different module 'helper'" in sentence


# --- Connections ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"connections.b.u": "a.z"}, 'connections."b.u"', "no output 'a.z'; did you mean 'a.y'? a has: a.y, a.steps"),
        ({"connections.b.uu": "a.y"}, 'connections."b.uu"', "no input 'b.uu'; did you mean 'b.u'?"),
        ({"connections.b.u": "c.y"}, 'connections."b.u"', "no component 'c'"),
        ({"connections.bb.u": "a.y"}, 'connections."bb.u"', "no component 'bb'; did you mean 'b'?"),
        ({"connections.b.u": "a.u"}, 'connections."b.u"', "'a.u' is an input, not an output; did you mean"),
        ({"connections.b.y": "a.y"}, 'connections."b.y"', "'b.y' is an output, not an input; did you mean"),
        ({"connections.b.at": "a.y"}, 'connections."b.at"', "'b.at' is a parameter, not an input"),
        ({"connections.b.u": "a.hidden"}, 'connections."b.u"', "'a.hidden' is a local, not an output"),
        ({"connections.b.u": "a.steps"}, 'connections."b.u"', "u is Real, steps is Integer; say gain = 1.0"),
        ({"connections.b.flag": "a.steps"}, 'connections."b.flag"', "flag is Boolean, steps is Integer"),
        ({"connections.b.text": "a.y"}, 'connections."b.text"', "text is String, y is Real"),
        ({"connections.b": "a.y"}, 'connections."b"', "no input 'b'"),
    ],
)
def test_a_connection_that_does_not_fit_says_why(problems, two, changes, key, words):
    ((found, sentence),) = problems(two(**changes))
    assert found == key
    assert words in sentence


def test_an_enumeration_feeds_an_integer(resolve, two):
    resolve(two(**{"connections.b.count": "a.level"}))


@pytest.mark.parametrize(("unit", "fits"), [("m", True), ("metre", True), (None, True), ("km", True), ("s", False)])
def test_units_must_be_of_the_same_quantity(resolve, problems, two, unit, fits):
    """Units of another name fit where both FMUs say that they are the same; without a unit anything fits."""
    table = two(a=[("y", "Real", "output", None, unit, "a number"), *PROBE_VARIABLES[2:]])
    if fits:
        resolve(table)
    else:
        assert problems(table) == [
            (
                'connections."b.u"',
                "u is in 'm', y in 's': one is s, the other m in SI base units; connect what fits, "
                "or say unit_check = false for this connection",
            )
        ]


@pytest.mark.parametrize(
    ("source", "sink", "factor", "offset"),
    [
        ("deg", "rad", math.pi / 180, 0.0),
        ("rpm", "rad/s", math.pi / 30, 0.0),
        ("kn", "m/s", 1852 / 3600, 0.0),
        ("degC", "K", 1.0, 273.15),
        ("K", "degC", 1.0, -273.15),
        ("rad", "deg", 180 / math.pi, 0.0),
        ("", "rad", 1.0, 0.0),
    ],
)
def test_units_of_one_quantity_are_converted(resolve, two, source, sink, factor, offset):
    table = two(
        a=[("y", "Real", "output", None, source or None, "it"), *PROBE_VARIABLES[2:]],
        b=[("u", "Real", "input", "0", sink, "it"), *PROBE_VARIABLES[1:]],
    )
    connection = next(connection for connection in resolve(table).connections if connection.input.name == "u")
    assert (connection.factor, connection.offset) == (
        pytest.approx(factor, rel=1e-15),
        pytest.approx(offset, rel=1e-15),
    )


@pytest.mark.parametrize(
    ("connection", "outcome"),
    [
        ({"from": "a.y", "unit_check": False}, (1.0, 0.0)),
        ({"from": "a.y", "unit_check": False, "gain": 2, "offset": -1}, (2.0, -1.0)),
        ({"from": "a.y", "gain": 2.0}, "unit_check = false"),
        ({"gain": 2.0}, "is {'gain': 2.0}, not the name of an output"),
        ({"from": "a.y", "gian": 2.0}, "unknown key; did you mean 'gain'?"),
        ({"from": "a.y", "gain": "2"}, "is '2'; give a finite number"),
    ],
)
def test_a_connection_may_scale_and_may_leave_units_alone(resolve, problems, two, connection, outcome):
    a = [("y", "Real", "output", None, "s", "a time"), *PROBE_VARIABLES[2:]]
    table = two(a=a, **{"connections.b.u": connection})
    if isinstance(outcome, str):
        assert outcome in " ".join(sentence for _, sentence in problems(table))
    else:
        connection = next(connection for connection in resolve(table).connections if connection.input.name == "u")
        assert (connection.factor, connection.offset) == outcome


def test_a_gain_may_carry_the_unit_of_a_number_without_one(resolve, two):
    a = [("y", "Real", "output", None, "1", "a command"), *PROBE_VARIABLES[2:]]
    table = two(a=a, **{"connections.b.u": {"from": "a.y", "gain": 40.0}})
    assert next(connection.factor for connection in resolve(table).connections if connection.input.name == "u") == 40.0


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        (("x", "y"), "b.p has 3 axes (x y z), a.q has 2 axes (x y)"),
        (("x", "y", "w"), "the axes differ"),
    ],
)
def test_vectors_of_different_axes_do_not_fit(problems, two, axes, words):
    table = two(a=vector("q", axes), b=vector("p", "xyz", causality="input"), connections={"b.p": "a.q"})
    ((_, sentence),) = problems(table)
    assert words in sentence


def test_a_scalar_does_not_drive_a_vector(problems, two):
    table = two(a=vector("q", "xyz"), b=vector("p", "xyz", causality="input"), connections={"b.p": "a.q.x"})
    ((_, sentence),) = problems(table)
    assert "b.p has 3 axes (x y z), a.q.x has one value" in sentence


def test_a_numbered_vector_connects_in_order(resolve, two):
    numbered = [(f"q[{i}]", "Real", "output", None, "m", "q") for i in (1, 2, 3)]
    table = two(a=numbered, b=vector("p", "xyz", causality="input"), connections={"b.p": "a.q"})
    assert resolve(table).resolved["connections"] == [["b.p.x", "a.q[1]"], ["b.p.y", "a.q[2]"], ["b.p.z", "a.q[3]"]]


def test_two_drivers_of_one_axis_are_refused(problems, two):
    table = two(
        a=[*vector("q", "xyz"), *PROBE_VARIABLES[1:2]],
        b=vector("p", "xyz", causality="input"),
        connections={"b.p": "a.q", "b.p.y": "a.y"},
    )
    ((key, sentence),) = problems(table)
    assert key == 'connections."b.p.y"'
    assert sentence == "p.y has two drivers: a.q and a.y; keep one"


def test_an_unconnected_input_is_reported_by_axis(problems, two):
    """One axis has its connection, one a start value, one nothing."""
    table = two(
        a=vector("q", "xyz"),
        b=vector("p", "xyz", causality="input"),
        connections={"b.p.x": "a.q.x"},
        **{"components.b.start": {"p.y": 0.5}},
    )
    ((key, sentence),) = problems(table)
    assert key == "components.b"
    assert "nothing drives its input 'p' (z)" in sentence


def test_an_input_whose_connection_is_wrong_is_not_reported_twice(problems, two):
    found = problems(two(**{"connections.b.u": "a.z", "components.b.start": {}}))
    assert [key for key, _ in found] == ['connections."b.u"']


@pytest.mark.parametrize("start", [{"u": 2.0}, "fmu"])
def test_an_unconnected_input_may_have_a_start_value(resolve, two, start):
    resolve(two(**{"connections.b.u": None, "components.b.start": start}))


def test_an_unconnected_input_without_a_value_is_refused(problems, two):
    ((key, sentence),) = problems(two(**{"connections.b.u": None, "components.b.start": {}}))
    assert key == "components.b"
    assert "nothing drives its input 'u'; connect it, give it a value" in sentence


def test_a_start_value_of_a_connected_input_is_refused(problems, two):
    ((key, sentence),) = problems(two(**{"components.b.start": {"u": 1.0}}))
    assert (key, sentence[:12]) == ("components.b.start.u", "is connected")


# --- Values -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "key", "words"),
    [
        ({"eta_0": [1, 2]}, "eta_0", "has 2 values for 6 axes (x y z phi theta psi)"),
        ({"eta_0": 3.0}, "eta_0", "is a vector (x y z phi theta psi), not 3.0; give 6 values, or a table of axes"),
        ({"eta_0": {"X": 3.0}}, "eta_0", "no axis 'X'; did you mean"),
        ({"eta_0": {"z": [1]}}, "eta_0", "eta_0.z is Real, not [1]"),
        ({"eta_0": [1, 2, 3, 4, 5, "six"]}, "eta_0", "eta_0.psi is Real, not 'six'"),
        ({"W": [1, 2]}, "W", "W is Real, not [1, 2]"),
        ({"W": {"x": 1}}, "W", "W is Real, not {'x': 1}"),
        ({"W": True}, "W", "W is Real, not True"),
        ({"w": 1.0}, "w", "no parameter 'w'"),
        ({"eta": [0, 0, 0, 0, 0, 0]}, "eta", "is an output, not a parameter"),
        ({"T[1,1]": 1.0}, "T[1,1]", "is a calculatedParameter, not a parameter"),
    ],
)
def test_a_parameter_of_the_wrong_shape_says_which_it_has(problems, spiral, parameters, key, words):
    ((found, sentence),) = problems(merged(spiral, {"components.vehicle.parameters": parameters}))
    assert found == f"components.vehicle.parameters.{key}"
    assert words in sentence


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ({"count": 2.5}, "count is Integer, not 2.5"),
        ({"count": 3_000_000_000}, "does not fit 32 bits"),
        ({"flag": 1}, "flag is Boolean, not 1"),
        ({"text": 1}, "text is String, not 1"),
        ({"y": 1.0}, "is an output, not an input"),
        ({"v": 1.0}, "no input 'v'"),
    ],
)
def test_a_start_value_of_the_wrong_type_is_refused(problems, two, start, words):
    table = two(connections={}, **{"components.b.start": {"u": 1.0, "count": 1, "flag": True, "text": "a", **start}})
    found = problems(table)
    assert len(found) == 1, found
    assert words in found[0][1]


def test_an_enumeration_takes_the_numbers_of_its_items_only(resolve, problems, two):
    level = [*PROBE_VARIABLES, ("choice", "Enumeration", "parameter", "1", None, "a level")]
    for given in (7, "high"):
        plan = resolve(two(a=level, **{"components.a.parameters": {"choice": given}}))
        assert plan.components[0].parameters["choice"] == 7
    ((_, sentence),) = problems(two(a=level, **{"components.a.parameters": {"choice": 3}}))
    assert sentence == "choice: no item 3; it has low = 1, high = 7"


@needs_compiler
def test_a_run_warns_of_values_beyond_what_an_fmu_declares(orch, write, tmp_path):
    limited = [(*v, "0", "0.01") if v[0] == "at" else v for v in PROBE_VARIABLES]
    path = write(single(probe_fmu(tmp_path / "probe.fmu", limited), at=0.5))
    answer = orch("run", path, "--json")
    assert (answer.code, answer.json["status"]) == (0, "completed")
    assert answer.json["warnings"] == ["one: at = 0.5 is above 0.01, the max that its FMU declares"]


def test_check_notes_values_beyond_what_an_fmu_declares(orch, write, two):
    limited = [
        *PROBE_VARIABLES,
        ("m", "Real", "parameter", "1", None, "at least nothing", "0"),
        ("n", "Integer", "parameter", "1", None, "a few", "1", "3"),
    ]
    beyond = {"n": 4, "m": -0.5}
    path = write(two(a=limited, **{"components.a.parameters": beyond}))
    sentences = [
        "a: m = -0.5 is below 0, the min that its FMU declares",
        "a: n = 4 is above 3, the max that its FMU declares",
    ]
    assert sorted(orch("check", path, "--json").json["notes"]) == sentences
    assert f"note: {sentences[0]}" in orch("check", path).out
    write(two(a=limited, **{"components.a.parameters": {"m": 0, "n": 3}}))
    assert orch("check", path, "--json").json["notes"] == []


def test_a_matrix_parameter_takes_a_list_of_rows(resolve, problems, two):
    names = [f"M[{i},{j}]" for i in (1, 2) for j in (1, 2, 3)]
    matrix = [(name, "Real", "parameter", "0", None, "M") for name in names]
    table = two(a=[*matrix, *PROBE_VARIABLES], **{"components.a.parameters": {"M": [[1, 2, 3], [4, 5, 6]]}})
    assert resolve(table).components[0].parameters == dict(zip(names, [1.0, 2, 3, 4, 5, 6], strict=True))
    ((_, sentence),) = problems(merged(table, {"components.a.parameters": {"M": [[1, 2], [3, 4], [5, 6]]}}))
    assert sentence == "is a matrix up to [2,3]; give a list of rows"


def test_the_seed_of_the_experiment_reaches_what_has_one_and_is_given_none(resolve, two):
    """Derived from the seed and the component's name: two components differ, a set value stays."""
    seeded = [*PROBE_VARIABLES, ("seed", "Integer", "parameter", "1", None, "seed")]
    table = two(
        a=seeded,
        b=seeded,
        **{"master.seed": 5, "components.c": {"fmu": "first.fmu", "start": "fmu", "parameters": {"seed": 3}}},
    )

    def seeds(**changes):
        return {
            component.name: component.parameters.get("seed") for component in resolve(merged(table, changes)).components
        }

    first = seeds()
    assert first["c"] == 3
    assert first["a"] != first["b"]
    assert all(0 <= seed < 1 << 31 for seed in first.values())
    assert seeds() == first
    assert seeds(**{"master.seed": 6})["a"] != first["a"]
    assert seeds(**{"master.seed": None}) == {"a": None, "b": None, "c": 3}


# --- What is recorded, and the identity of a run ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("signals", "expected"),
    [
        (["*"], ["a.y", "a.steps", "b.y", "b.steps"]),
        (["a.*"], ["a.y", "a.steps"]),
        (["a.y", "b.y"], ["a.y", "b.y"]),
        (["*", "!b.*"], ["a.y", "a.steps"]),
        (["!*.steps"], ["a.y", "b.y"]),
        (["*.y", "!a.*"], ["b.y"]),
        (["?.y"], ["a.y", "b.y"]),
        ([], []),
    ],
)
def test_globs_choose_the_outputs_that_are_recorded(resolve, two, signals, expected):
    short = [v for v in PROBE_VARIABLES if v[0] in ("u", "y", "steps", "hidden")]
    table = two(a=short, b=short, connections={}, **{"record.signals": signals})
    assert resolve(table).resolved["record"]["signals"] == expected


def test_globs_match_inputs_and_locals_where_asked(resolve, two):
    short = [v for v in PROBE_VARIABLES if v[0] in ("u", "y", "at", "hidden")]
    table = two(a=short, b=short, connections={}, **{"record.signals": ["a.*"], "record.inputs": True})
    assert resolve(table).resolved["record"]["signals"] == ["a.u", "a.y", "a.hidden"]


@pytest.mark.parametrize(
    "changes",
    [
        {"master.stop_time": 0.06},
        {"master.step": 5e-4},
        {"master.algorithm": "jacobi"},
        {"master.seed": 1},
        {"components.controller.parameters": {"K_p": {"z": 90.0}}},
        {"components.controller.step": 2e-3},
        {"components.controller.fmu": "mfsosmc"},
        {"connections.controller.nu": None, "components.controller.start": "fmu"},
        {"record.every": 1e-3},
        {"record.signals": ["*", "!current.*"]},
        {"record.inputs": True},
    ],
)
def test_the_run_id_changes_with_what_decides_the_numbers(resolve, spiral, changes):
    spiral["metrics"] = {}
    assert resolve(spiral).digest != resolve(merged(spiral, changes)).digest


def test_the_run_id_changes_with_the_order_of_the_components(resolve, spiral):
    before = resolve(spiral).digest
    spiral["components"] = dict(reversed(spiral["components"].items()))
    assert resolve(spiral).digest != before


def test_the_run_id_does_not_change_with_titles_metrics_and_names_of_files(resolve, spiral, tmp_path, shipped):
    before = resolve(spiral).digest
    spiral["components"]["controller"]["fmu"] = "copy.fmu"
    (tmp_path / "copy.fmu").write_bytes(shipped["pid"].read_bytes())
    changes = {
        "title": "Another",
        "metrics": {},
        "components.vehicle.parameters": {"eta_0": {"x": 2.0, "y": -1.0, "z": 1, "phi": 0, "theta": 0, "psi": 0}},
    }
    assert resolve(merged(spiral, changes)).digest == before


def test_the_run_id_changes_with_the_bytes_of_an_fmu(resolve, spiral, tmp_path, shipped):
    (tmp_path / "copy.fmu").write_bytes(shipped["pid"].read_bytes())
    table = merged(spiral, {"components.controller.fmu": "copy.fmu"})
    before = resolve(table).digest
    with zipfile.ZipFile(tmp_path / "copy.fmu", "a") as archive:
        archive.writestr("documentation/note.txt", struct.pack("d", 1.0))
    assert resolve(table).digest != before


# --- Swapping ---------------------------------------------------------------------------------------------------------


def test_a_swap_drops_connections_and_start_values_of_inputs_that_the_new_fmu_lacks(orch, write, two, tmp_path):
    table = two(**{"components.b.start": {"v": 1.0}}, b=[*PROBE_VARIABLES, ("v", "Real", "input", "0", "m", "v")])
    paper_fmu(tmp_path / "third.fmu", [v for v in PROBE_VARIABLES if v[0] != "text"])
    answer = orch("check", write(table), "--swap", "b=third.fmu")
    assert answer.code == 0, answer.err
    assert "b: dropped the connection into text, which third lacks" in answer.out
    assert "b: dropped start.v, which third lacks" in answer.out


def test_a_swap_to_an_fmu_without_the_output_that_others_read_is_an_error(orch, write, two, tmp_path):
    paper_fmu(tmp_path / "third.fmu", [v for v in PROBE_VARIABLES if v[0] != "words"])
    answer = orch("check", write(two()), "--swap", "a=third.fmu")
    assert answer.code == 2
    assert "connections.\"b.text\": no output 'a.words'" in answer.err


def test_without_a_swap_a_connection_into_a_lacking_input_is_an_error(problems, two):
    ((_, sentence),) = problems(two(b=[v for v in PROBE_VARIABLES if v[0] != "text"]))
    assert "no input 'b.text'" in sentence


def test_numbered_axes_are_taken_by_their_numbers_and_not_as_they_are_declared(resolve, two):
    """Eleven of them, so that "10" comes after "2"."""
    numbers = [3, 1, 2, *range(11, 3, -1)]
    outputs = [(f"n[{i}]", "Real", "output", None, "m", "") for i in numbers]
    inputs = [(f"p[{i}]", "Real", "input", "0", "m", "") for i in range(1, 12)]
    gains = [(f"k[{i}]", "Real", "parameter", "0", "m", "") for i in numbers]
    named = vector("q", "abcdefghijk", causality="input")
    table = two([*outputs, *gains], [*inputs, *named], connections={"b.p": "a.n", "b.q": "a.n"})
    table["components"]["a"]["parameters"] = {"k": list(range(1, 12))}
    plan = resolve(table)
    found = {connection.input.name: connection.output.name for connection in plan.connections}
    assert found == {f"p[{i}]": f"n[{i}]" for i in range(1, 12)} | {
        f"q.{axis}": f"n[{i}]" for i, axis in enumerate("abcdefghijk", 1)
    }
    assert plan.components[0].parameters == {f"k[{i}]": i for i in range(1, 12)}
