"""orch export: every format, read back by the reader that its users have."""

import json
import os
import subprocess

import h5py
import numpy as np
import pandas as pd
import pytest

import orchestrator
from commands import ORCH
from experiments import EXPERIMENTS, single, toml
from orchestrator.records.compare.vehicles import AXES
from orchestrator.views.export import foxglove

FORMATS = {"csv": ".csv", "parquet": ".parquet", "mat": ".mat", "netcdf": ".nc", "mcap": ".mcap"}
LIBRARIES = {"parquet": "pyarrow", "mat": "scipy", "netcdf": "h5netcdf", "mcap": "mcap"}


@pytest.fixture(scope="module")
def gripping(shipped, tmp_path_factory):
    """Two vehicles under PID for a tenth of a second, in a current."""
    pid = {"controller1": "pid", "controller2": "pid"}
    changes = {"master.stop_time": 0.1, "master.step": 1e-3}
    target = tmp_path_factory.mktemp("export") / "gripping.h5"
    with orchestrator.run(EXPERIMENTS / "gripping_currents.toml", changes, pid, output=target) as run:
        yield run


def record(fmu, folder):
    """A run of 0.05 s of one FMU, in a process of its own: FMUs of others may not fit beside each other in one."""
    (folder / "one.toml").write_text("\n".join(f"{k} = {toml(v)}" for k, v in single(fmu).items()), encoding="utf-8")
    subprocess.run([ORCH, "run", "one.toml", "--output", "one.h5", "--quiet"], cwd=folder, capture_output=True)
    return folder / "one.h5"


@pytest.fixture(scope="module")
def mixed(foreign, tmp_path_factory):
    """A real number, an integer, a truth and a text with letters beyond ASCII; six rows."""
    with orchestrator.open_run(record(foreign.south, tmp_path_factory.mktemp("mixed"))) as run:
        yield run


@pytest.fixture(scope="module")
def failed(foreign, tmp_path_factory):
    """The same, failed at 0.02 s."""
    with orchestrator.open_run(record(foreign.east, tmp_path_factory.mktemp("failed"))) as run:
        yield run


@pytest.fixture(scope="module")
def twice(foreign, tmp_path_factory):
    """Two records of one run."""
    runs = [orchestrator.open_run(record(foreign.south, tmp_path_factory.mktemp(name))) for name in ("first", "again")]
    yield runs
    for run in runs:
        run.close()


@pytest.fixture
def export(orch, tmp_path):
    """export(run, format): the path of what was written, its reader's library there."""

    def write(run, form, *arguments):
        pytest.importorskip(LIBRARIES.get(form, "pandas"))
        target = tmp_path / f"exported{FORMATS[form]}"
        answer = orch("export", run.path, "--format", form, "-o", target, *arguments)
        assert answer.code == 0, answer.err
        assert answer.out.strip() == target.name
        assert answer.err == ""
        return target

    return write


def same(values, expected):
    """Bit for bit, and of the same type."""
    assert np.asarray(values).dtype == np.asarray(expected).dtype
    np.testing.assert_array_equal(values, expected)


def test_pandas_reads_csv_with_units_in_the_first_line(export, gripping):
    frame = pd.read_csv(export(gripping, "csv"))
    assert next(iter(frame)) == "time [s]"
    assert len(frame.columns) == 1 + len(gripping.signals)
    same(frame["time [s]"], gripping.time)
    same(frame["vehicle1.eta.x [m]"], gripping["vehicle1.eta.x"])
    same(frame["vehicle2.eta.psi [rad]"], gripping["vehicle2.eta.psi"])
    same(frame["allocation1.u.T1"], gripping["allocation1.u.T1"])  # without a unit


def test_csv_keeps_integers_truths_and_texts(export, mixed):
    target = export(mixed, "csv")
    frame = pd.read_csv(target)
    assert list(frame) == ["time [s]", "one.y", "one.n", "one.b", "one.s"]
    same(frame["one.y"], mixed["one.y"])
    assert frame["one.n"].tolist() == [0, 1, 2, 3, 4, 5]
    assert frame["one.b"].dtype == bool
    assert frame["one.b"].tolist() == [False, True] * 3
    assert frame["one.s"].tolist()[-1] == "süd 4"
    assert target.read_bytes().startswith("\ufefftime".encode())  # for Excel, which knows UTF-8 by it


def test_pyarrow_reads_parquet_with_units_in_the_fields(export, gripping):
    path = export(gripping, "parquet")
    table = pytest.importorskip("pyarrow.parquet").read_table(path)
    assert table.column_names == ["time", *gripping.signals]
    for name in ("vehicle1.eta.x", "vehicle2.nu.r", "controller1.tau.X"):
        same(table[name].to_numpy(), gripping[name])
        assert table.field(name).metadata[b"units"].decode() == gripping.units(name)
    assert table.field("time").metadata[b"units"] == b"s"
    assert table.field("vehicle1.eta.x").metadata[b"causality"] == b"output"
    assert table.schema.metadata[b"run_id"].decode() == gripping.run_id
    assert list(pd.read_parquet(path).columns) == table.column_names


def test_parquet_keeps_types(export, mixed):
    path = export(mixed, "parquet")
    table = pytest.importorskip("pyarrow.parquet").read_table(path)
    assert [str(field.type) for field in table.schema] == ["double", "double", "int32", "bool", "string"]
    assert table["one.b"].to_pylist() == [False, True] * 3
    assert table["one.s"].to_pylist()[-1] == "süd 4"


def test_matlab_reads_a_struct_a_component_with_vectors(export, gripping):
    path = export(gripping, "mat")
    found = pytest.importorskip("scipy.io").loadmat(path, simplify_cells=True)
    same(found["time"], gripping.time)
    same(found["vehicle1"]["eta"], gripping["vehicle1.eta"])
    assert found["vehicle1"]["eta"].shape == (len(gripping.time), 6)
    same(found["vehicle1"]["eta_psi"], gripping["vehicle1.eta.psi"])
    assert found["units"]["vehicle1"]["eta_psi"] == "rad"
    assert list(found["units"]["vehicle1"]["eta"]) == ["m"] * 3 + ["rad"] * 3
    assert found["units"]["allocation1"]["u"] == "1"
    assert found["names"]["vehicle1"]["eta_psi"] == "vehicle1.eta.psi"
    assert list(found["axes"]["vehicle1"]["eta"]) == ["x", "y", "z", "phi", "theta", "psi"]
    assert found["run"]["run_id"] == gripping.run_id
    assert found["run"]["status"] == "completed"


def test_matlab_gets_columns_logicals_and_cells(export, mixed):
    path = export(mixed, "mat")
    found = pytest.importorskip("scipy.io").loadmat(path, squeeze_me=False, struct_as_record=True)
    one = found["one"][0, 0]
    assert one["y"].shape == (6, 1)
    assert one["n"].dtype == np.int32
    assert one["s"][-1, 0].item() == "süd 4"
    kinds = pytest.importorskip("scipy.io").whosmat(path)
    assert ("one", (1, 1), "struct") in kinds
    assert one["b"].ravel().tolist() == [0, 1] * 3
    assert one["b"].dtype == np.uint8  # what scipy makes of a logical; the record has int8
    assert path.read_bytes()[:116].decode().rstrip() == f"MATLAB 5.0 MAT-file, written by orch of run {mixed.run_id}"


def test_names_that_matlab_cannot_have_become_names_that_it_can():
    pytest.importorskip("scipy")
    from orchestrator.views.export import as_mat

    taken = {"time"}
    names = ["eta.x", "eta_x", "T[1,2]", "1st", "end", "time", "größe", "a" * 70, "a" * 70]
    valid = [as_mat._valid(name, taken) for name in names]
    assert valid == ["eta_x", "eta_x_2", "T_1_2", "x_1st", "x_end", "time_2", "gr_e", "a" * 63, "a" * 61 + "_2"]


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_xarray_opens_netcdf_without_arguments(export, gripping, engine):
    path = export(gripping, "netcdf")
    with pytest.importorskip("xarray").open_dataset(path, engine=engine) as data:
        assert sorted(data.data_vars) == sorted(gripping.signals)
        same(data["vehicle1.eta.x"].values, gripping["vehicle1.eta.x"])
        assert data["vehicle1.eta.x"].attrs["units"] == "m"
        assert data["vehicle1.eta.x"].attrs["long_name"]
        same(data["time"].values, gripping.time)
        assert data["time"].attrs["units"] == "s"
        assert data["vehicle1.eta.x"].sel(time=0.05).item() == gripping["vehicle1.eta.x"][gripping.time == 0.05]
        assert data.attrs["run_id"] == gripping.run_id
        assert "[components.vehicle1]" in data.attrs["experiment_toml"]


def test_netcdf_keeps_types(export, mixed):
    path = export(mixed, "netcdf")
    with pytest.importorskip("xarray").open_dataset(path) as data:
        assert data["one.n"].dtype == np.int32
        assert data["one.b"].dtype == bool
        assert data["one.s"].values.tolist()[-1] == "süd 4"


def messages(path):
    """{topic: [(log time in ns, message)]} and {topic: (name of the schema, schema)}."""
    found, schemas = {}, {}
    with path.open("rb") as file:
        for schema, channel, message in pytest.importorskip("mcap.reader").make_reader(file).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            found.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
            schemas[channel.topic] = schema.name, json.loads(schema.data)
    return found, schemas


def test_foxglove_finds_signals_at_their_names(export, gripping):
    found, schemas = messages(export(gripping, "mcap"))
    assert {s.partition(".")[0] for s in gripping.signals} == {t[1:] for t in found if t != "/tf" and t.count("/") == 1}
    times, vehicle = zip(*found["/vehicle1"], strict=True)
    assert list(times) == [k * 10_000_000 for k in range(len(gripping.time))]  # ns, of a row every 0.01 s
    same([m["eta"]["x"] for m in vehicle], gripping["vehicle1.eta.x"])
    same([m["u"]["T6"] for _, m in found["/allocation2"]], gripping["allocation2.u.T6"])
    name, schema = schemas["/vehicle1"]
    assert name == "orch.vehicle1"
    x = schema["properties"]["eta"]["properties"]["x"]
    assert x["type"] == "number"
    assert x["description"].endswith("[m]")


def test_foxglove_gets_poses_in_its_own_frames(export, gripping):
    found, schemas = messages(export(gripping, "mcap"))
    expected = {
        "/vehicle1/pose": "foxglove.PoseInFrame",
        "/vehicle1/desired_pose": "foxglove.PoseInFrame",
        "/vehicle1/track": "foxglove.PosesInFrame",
        "/tf": "foxglove.FrameTransform",
    }
    assert {topic: schemas[topic][0] for topic in expected} == expected
    eta = gripping["vehicle1.eta"][-1]
    time, last = found["/vehicle1/pose"][-1]
    assert last["timestamp"] == {"sec": 0, "nsec": time}
    assert last["pose"]["position"] == {"x": eta[1], "y": eta[0], "z": -eta[2]}
    frame = next(m for t, m in found["/tf"] if t == time and m["child_frame_id"] == "vehicle1")
    assert (frame["parent_frame_id"], frame["translation"]) == ("world", last["pose"]["position"])
    assert frame["rotation"] == last["pose"]["orientation"]
    assert {m["child_frame_id"] for _, m in found["/tf"]} == {"vehicle1", "vehicle2"}
    assert len(found["/vehicle1/track"]) == 1
    assert len(found["/vehicle1/track"][0][1]["poses"]) == len(gripping.time)
    for topic in expected:
        jsonschema_like(found[topic][0][1], schemas[topic][1])


def jsonschema_like(value, schema):
    """The message has what its schema requires, of the type that it says."""
    kinds = {"object": dict, "array": list, "number": (int, float), "integer": int, "string": str}
    assert isinstance(value, kinds[schema["type"]])
    for name in schema.get("required", ()):
        jsonschema_like(value[name], schema["properties"][name])
    for item in value if isinstance(value, list) else ():
        jsonschema_like(item, schema["items"])


def turned(q, vector):
    """A vector turned by a quaternion (x, y, z, w)."""
    axis, w = np.array(q[:3]), q[3]
    return vector + 2 * np.cross(axis, np.cross(axis, vector) + w * np.asarray(vector))


@pytest.mark.parametrize("angles", [(0, 0, 0), (0, 0, 1.2), (0.3, -0.4, 2.5), (-3.0, 1.2, -7.0), (0, 0, np.pi / 2)])
def test_forward_left_and_up_of_a_vehicle_point_where_they_did(angles):
    (c1, c2, c3), (s1, s2, s3) = np.cos(angles), np.sin(angles)
    forward = [c3 * c2, s3 * c2, -s2]  # columns of R(eta), BODY to NED: Fossen (2011), Eq. 2.18
    right = [-s3 * c1 + c3 * s2 * s1, c3 * c1 + s1 * s2 * s3, c2 * s1]
    down = [s3 * s1 + c3 * c1 * s2, -c3 * s1 + s2 * s3 * c1, c2 * c1]
    eta = {axis: np.array([value], float) for axis, value in zip(AXES, (0, 0, 0, *angles), strict=True)}
    (pose,) = foxglove.poses(eta)
    q = [pose["orientation"][axis] for axis in "xyzw"]

    def enu(v):
        return np.array([v[1], v[0], -v[2]])

    rounding = 1e-14
    np.testing.assert_allclose(turned(q, [1, 0, 0]), enu(forward), atol=rounding)
    np.testing.assert_allclose(turned(q, [0, 1, 0]), -enu(right), atol=rounding)
    np.testing.assert_allclose(turned(q, [0, 0, 1]), -enu(down), atol=rounding)


def test_mcap_keeps_types(export, mixed):
    found, schemas = messages(export(mixed, "mcap"))
    (first, last) = found["/one"][0][1], found["/one"][-1][1]
    assert first == {"y": 0.0, "n": 0, "b": False, "s": "süd"}
    assert type(last["n"]) is int
    assert last["n"] == 5
    assert last["b"] is True
    assert last["s"] == "süd 4"
    kinds = {name: about["type"] for name, about in schemas["/one"][1]["properties"].items()}
    assert kinds == {"y": "number", "n": "integer", "b": "boolean", "s": "string"}


@pytest.mark.parametrize("form", FORMATS)
def test_the_same_run_is_the_same_bytes_whenever_it_ran(export, form, twice):
    first, again = twice
    assert first.attributes["wall_time"] != again.attributes["wall_time"]
    before = export(first, form).read_bytes()
    assert export(again, form).read_bytes() == before


@pytest.mark.parametrize("form", FORMATS)
def test_an_incomplete_run_is_exported_and_says_so(orch, failed, form, tmp_path):
    pytest.importorskip(LIBRARIES.get(form, "pandas"))
    answer = orch("export", failed.path, "--format", form, "-o", "some")
    assert answer.code == 0
    assert answer.out == "some\n"
    assert answer.err == f"{failed.run_id}: failed; these are its 3 rows until t = 0.02 s\n"
    if form == "csv":
        assert pd.read_csv(tmp_path / "some")["time [s]"].tolist() == [0.0, 0.01, 0.02]


def test_the_file_lies_beside_the_record(orch, failed):
    answer = orch("export", failed.path.name, "--format", "csv", cwd=failed.path.parent)
    assert answer.out == "one.csv\n"
    assert failed.path.with_suffix(".csv").is_file()


def test_the_name_of_the_file_says_the_format(orch, mixed, tmp_path):
    assert orch("export", mixed.path, "-o", "new/a.csv").code == 0
    assert (tmp_path / "new" / "a.csv").read_text(encoding="utf-8-sig").startswith("time [s],one.y")
    answer = orch("export", mixed.path, "-o", "a.txt")
    assert answer.code == 2
    assert "give a format: --format csv, parquet, mat, netcdf, mcap, tlog" in answer.err


@pytest.mark.parametrize("form", LIBRARIES)
def test_a_missing_library_is_an_error_message_that_says_what_to_install(orch, mixed, form, tmp_path):
    (tmp_path / "without" / LIBRARIES[form]).mkdir(parents=True)
    (tmp_path / "without" / LIBRARIES[form] / "__init__.py").write_text("raise ImportError('not here')")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "without")}
    answer = orch("export", mixed.path, "--format", form, "-o", "out", env=environment)
    assert answer.code == 2
    assert answer.err == f'the format {form} needs {LIBRARIES[form]}, not installed here: pip install "orch[export]"\n'
    assert not (tmp_path / "out").exists()


def test_the_record_itself_is_never_written_over(orch, mixed, tmp_path):
    before = mixed.path.read_bytes()
    answer = orch("export", mixed.path, "--format", "csv", "-o", mixed.path)
    assert answer.code == 2
    assert "is already used by this command; write to another file" in answer.err
    assert mixed.path.read_bytes() == before


def test_what_cannot_be_written_leaves_nothing_behind(orch, mixed, tmp_path):
    (tmp_path / "file").write_text("")
    answer = orch("export", mixed.path, "-o", "file/a.csv")
    assert answer.code == 2
    assert "file/a.csv cannot be written" in answer.err
    (tmp_path / "a.csv").mkdir()
    answer = orch("export", mixed.path, "-o", "a.csv")
    assert answer.code == 2
    assert answer.err == "a.csv is a folder; give the name of a file in it\n"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "file"]


def test_a_run_without_a_row_says_that_there_is_nothing(orch, mixed, tmp_path):
    target = tmp_path / "empty.h5"
    target.write_bytes(mixed.path.read_bytes())
    with h5py.File(target, "r+") as file:
        file["time"].resize((0,))
    answer = orch("export", target, "--format", "csv")
    assert answer.code == 2
    assert "holds no rows: there is nothing to export" in answer.err


@pytest.mark.parametrize("form", FORMATS)
def test_odd_names_and_arrays_survive(export, form, mixed, tmp_path):
    """A name with a slash, one that is the head of another, and an array of FMI 3."""
    target = tmp_path / "odd.h5"
    target.write_bytes(mixed.path.read_bytes())
    array = np.arange(36.0).reshape(6, 3, 2)
    with h5py.File(target, "r+") as file:
        for name, values in (("a/b", np.arange(6.0)), ("y.z", -np.arange(6.0)), ("M", array)):
            dataset = file["one"].create_dataset(name, data=values)
            dataset.attrs.update({"units": "m", "long_name": name, "causality": "output"})
    with orchestrator.open_run(target) as run:
        path = export(run, form)
    if form == "csv":
        frame = pd.read_csv(path)
        assert frame["one.M[3,2] [m]"].tolist() == array[:, 2, 1].tolist()
        assert frame["one.a/b [m]"].tolist() == [0, 1, 2, 3, 4, 5]
    elif form == "parquet":
        table = pytest.importorskip("pyarrow.parquet").read_table(path)
        assert table["one.M[3,2]"].to_pylist() == array[:, 2, 1].tolist()
        assert table["one.a/b"].to_pylist() == [0, 1, 2, 3, 4, 5]
    elif form == "mat":
        found = pytest.importorskip("scipy.io").loadmat(path, simplify_cells=True)
        np.testing.assert_array_equal(found["one"]["M"], array)
        assert found["names"]["one"]["a_b"] == "one.a/b"
        assert found["one"]["y_z"][5] == -5
    elif form == "netcdf":
        with pytest.importorskip("xarray").open_dataset(path) as data:
            np.testing.assert_array_equal(data["one.M"].values, array)
            assert data["one.M"].dims == ("time", "one.M_dim1", "one.M_dim2")
            assert data["one.a_b"].attrs["name"] == "one.a/b"
    else:
        last = messages(path)[0]["/one"][-1][1]
        assert last["M"] == array[-1].tolist()
        assert (last["y.z"], last["a/b"]) == (-5, 5)
