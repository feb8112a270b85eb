"""The record of a run: readable without this project, and after a kill."""

import json
import os
import shutil
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest
import xarray

import orchestrator
from commands import DEADLINE, ORCH, poll
from experiments import merged, single
from fmu_files import PROBE_VARIABLES, needs_compiler, probe_fmu
from orchestrator.records.store.folder import Store

ATTRIBUTES = {
    "format": str,
    "format_version": int,
    "run_id": str,
    "title": str,
    "status": str,
    "error": str,
    "created": str,
    "wall_time": float,
    "real_time_factor": float,
    "algorithm": str,
    "step": float,
    "experiment_toml": str,
    "experiment_resolved": dict,
    "versions": dict,
    "git_commit": str,
    "Conventions": str,
    "metrics": dict,
    "metrics_never": list,
    "metrics_of": str,
    "metric_units": dict,
    "warnings": list,
    "warning_kinds": list,
    "timing": dict,
    "command": list,
    "platform": str,
    "seed": int,
    "pid": int,
    "hostname": str,
    "digest": str,
}
JSON = (
    "experiment_resolved",
    "versions",
    "metrics",
    "metrics_never",
    "metric_units",
    "warnings",
    "warning_kinds",
    "timing",
    "command",
)
TYPES = {
    "y": np.float64,
    "u": np.float64,
    "hidden": np.float64,
    "steps": np.int32,
    "count": np.int32,
    "level": np.int32,
    "odd": np.int8,
    "flag": np.int8,
}


@pytest.fixture
def recorded(orch, write, tmp_path):
    """recorded(dictionary, ...) -> the path of the record."""

    def run(table, *options):
        answer = orch("run", write(table), "--json", *options)
        assert answer.code == 0, answer.err
        return tmp_path / answer.json["file"]

    return run


@pytest.fixture
def chained(probe):
    """Two probes: the second is fed by the first, with all four types."""
    return {
        "title": "Two probes",
        "master": {"stop_time": 0.05, "step": 0.01, "seed": 3},
        "components": {
            "a": {"fmu": str(probe), "start": {"u": 2.5, "count": 4, "flag": True, "text": "grüß dich"}},
            "b": {"fmu": str(probe)},
        },
        "connections": {"b.u": "a.y", "b.count": "a.steps", "b.flag": "a.odd", "b.text": "a.words"},
        "record": {"inputs": True},
        "metrics": {"last": {"of": "final", "signal": "a.y"}},
    }


# --- What is in it ----------------------------------------------------------------------------------------------------


def test_the_root_attributes_are_those_of_the_contract(recorded, chained, tmp_path):
    path = recorded(chained)
    with h5py.File(path, "r") as file:
        found = {name: json.loads(file.attrs[name]) if name in JSON else file.attrs[name] for name in ATTRIBUTES}
    for name, kind in ATTRIBUTES.items():
        value = found[name].item() if isinstance(found[name], np.generic) else found[name]
        assert isinstance(value, kind), (name, value)
    assert found["format"] == "orch-run"
    assert (found["title"], found["status"], found["error"]) == ("Two probes", "completed", "")
    assert (found["step"], found["algorithm"], found["seed"]) == (0.01, "gauss-seidel", 3)
    assert found["digest"].startswith(found["run_id"])
    assert path.name == f"{found['run_id']}.h5"
    assert found["experiment_toml"] == (tmp_path / "mine.toml").read_text()
    assert found["experiment_resolved"]["components"][0]["start"]["text"] == "grüß dich"
    assert found["versions"].keys() >= {"python", "numpy", "h5py", "FMPy", "pythonfmu"}
    assert found["metrics"] == {"last": 0.05}
    assert found["command"][1:] == ["run", str(tmp_path / "mine.toml"), "--json"]
    assert found["real_time_factor"] == pytest.approx(0.05 / found["wall_time"])


def test_a_component_says_what_it_was(recorded, chained, probe):
    with h5py.File(recorded(chained), "r") as file:
        attributes = dict(file["a"].attrs)
    assert attributes["fmu"] == str(probe)
    assert len(attributes["fmu_sha256"]) == 64
    assert (attributes["fmi_version"], attributes["packaging"]) == ("2.0", "native")
    assert json.loads(attributes["parameters"]) == {}


def test_time_is_the_dimension_of_every_signal(recorded, chained):
    with h5py.File(recorded(chained), "r") as file:
        assert file["time"].dtype == np.float64
        assert file["time"].attrs["units"] == "s"
        assert file["time"].is_scale
        assert file["time"][:].tolist() == [0.0, 0.01, 0.02, 0.03, 0.04, 0.05]
        for component in ("a", "b"):
            for dataset in file[component].values():
                assert dataset.dims[0][0] == file["time"]
                assert dataset.shape == file["time"].shape


def test_each_type_is_recorded_as_itself(recorded, chained):
    with h5py.File(recorded(chained), "r") as file:
        for name, dtype in TYPES.items():
            assert file["a"][name].dtype == dtype, name
        assert h5py.check_string_dtype(file["a"]["words"].dtype).encoding == "utf-8"
        steps = [0, 4, 8, 12, 16, 20]
        assert file["a"]["steps"][:].tolist() == steps
        assert file["a"]["odd"][:].tolist() == [0, 1, 0, 1, 0, 1]
        assert file["a"]["level"][:].tolist()[1:] == [7, 1, 7, 1, 7]
        assert file["a"]["words"].asstr()[:].tolist() == ["hallo 0", *(f"grüß dich {n}" for n in steps[1:])]
        assert file["a"]["hidden"][:].tolist() == [0.0, 0.0, -0.01, -0.02, -0.03, -0.04]
        # Inputs that nothing drives hold their start values; driven ones what they were set to.
        assert file["a"]["u"][:].tolist() == [2.5] * 6
        assert file["a"]["count"][:].tolist() == [4] * 6
        assert file["a"]["flag"][:].tolist() == [1] * 6
        assert file["a"]["text"].asstr()[:].tolist() == ["grüß dich"] * 6
        for sink, source in chained["connections"].items():
            fed, feeding = sink.replace(".", "/"), source.replace(".", "/")
            assert file[fed][:].tolist() == file[feeding][:].tolist(), sink
        # The second probe computed with what the first gave, of every type.
        assert file["b"]["steps"][:].tolist() == np.cumsum(steps).tolist()
        assert file["b"]["words"].asstr()[-1] == "grüß dich 20 60"


def test_inputs_that_keep_the_fmu_s_own_values_are_recorded_as_such(recorded, probe):
    table = merged(single(probe), {"record": {"inputs": True}})
    with h5py.File(recorded(table), "r") as file:
        one = file["one"]
        assert (one["u"][0], one["count"][0], one["flag"][0], one["text"][0]) == (1.5, 3, 1, b"hallo")
        assert one["u"].attrs["causality"] == "input"
        assert one["hidden"].attrs["causality"] == "local"


def test_a_run_shows_what_it_is_and_completes_its_names(recorded, chained, spiral):
    with orchestrator.open_run(recorded(chained)) as run:
        assert repr(run) == f"<Run mine {run.run_id}: completed, 6 rows>"
        assert "a.words" in run._ipython_key_completions_()
        path = run.path
    assert repr(run) == f"<Run {path}: closed>"
    with orchestrator.open_run(recorded(spiral)) as run:
        names = run._ipython_key_completions_()
        assert {"vehicle.eta", "vehicle.eta.x"} <= set(names)
        assert all(len(run[name]) == len(run.time) for name in names)


def test_python_reads_texts_as_texts(recorded, chained):
    with orchestrator.open_run(recorded(chained)) as run:
        assert run["a.words"].tolist()[1] == "grüß dich 4"
        assert run.to_dataframe()["b.text"].iloc[-1] == "grüß dich 20"


def test_an_fmu_of_another_tool_is_recorded_with_all_its_types(recorded, foreign):
    with h5py.File(recorded(single(foreign.south)), "r") as file:
        one = file["one"]
        assert file["one"].attrs["packaging"] == "python"
        assert {name: one[name].dtype.kind for name in ("y", "n", "b", "s")} == {"y": "f", "n": "i", "b": "i", "s": "O"}
        assert one["y"][:].tolist() == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.04, 0.05], abs=1e-15)  # t + h
        assert one["n"][:].tolist() == [0, 1, 2, 3, 4, 5]
        assert one["b"][:].tolist() == [0, 1, 0, 1, 0, 1]
        assert one["s"].asstr()[-1] == "süd 4"


def test_signals_say_their_unit_and_meaning(recorded, spiral):
    with h5py.File(recorded(spiral), "r") as file:
        assert dict(file["vehicle"]["eta.phi"].attrs)["units"] == "rad"
        assert file["vehicle"]["eta.phi"].attrs["long_name"] == "phi: position in NED and zyx Euler angles"
        assert file["vehicle"]["eta.phi"].attrs["causality"] == "output"
        assert file["allocation"]["u.T1"].attrs["units"] == "1"
        assert [name for name in file] == ["time", *spiral["components"], "_envelope"]  # noqa: C416 - in the file's order


def test_numbers_carry_checksums_and_a_flipped_byte_is_noticed(recorded, spiral):
    path = recorded(spiral)
    with h5py.File(path, "r") as file:
        for dataset in [file["time"], *file["vehicle"].values()]:
            assert dataset.fletcher32
        chunk = file["vehicle"]["eta.x"].id.get_chunk_info(0)
        expected = file["vehicle"]["eta.x"][:].tobytes()
    content = bytearray(path.read_bytes())
    assert content[chunk.byte_offset :][: len(expected)] == expected
    content[chunk.byte_offset] ^= 1
    path.write_bytes(content)
    with orchestrator.open_run(path) as run:
        assert run["vehicle.eta.y"][0] == -1.0
        with pytest.raises(orchestrator.StoreError, match=r"vehicle\.eta\.x cannot be read"):
            run["vehicle.eta.x"]


def test_parameters_are_kept_as_they_were_set(recorded, spiral):
    path = recorded(merged(spiral, {"components.controller.parameters": {"K_p": {"z": 90.0}}}))
    with h5py.File(path, "r") as file:
        assert json.loads(file["controller"].attrs["parameters"]) == {"K_p.z": 90.0}
        assert file["controller"].attrs["fmu"] == "pid"


def test_a_run_that_records_nothing_has_its_times(recorded, spiral):
    path = recorded(merged(spiral, {"record.signals": [], "metrics": {}}))
    with orchestrator.open_run(path) as run:
        assert run.signals == []
        assert len(run.time) == 6


@needs_compiler
@pytest.mark.parametrize("name", ["a/b", "der(x)", "x y", "pump.motor[2].w"])
def test_a_variable_may_have_any_name(recorded, tmp_path, name):
    variables = [("u", *PROBE_VARIABLES[0][1:]), (name, *PROBE_VARIABLES[1][1:])]
    path = recorded(single(probe_fmu(tmp_path / "odd.fmu", variables)))
    with orchestrator.open_run(path) as run:
        assert run.signals == [f"one.{name}"]
        assert run[f"one.{name}"].tolist() == [0.0, 0.01, 0.02, 0.03, 0.04, 0.05]


# --- Read by others ---------------------------------------------------------------------------------------------------


def test_xarray_opens_it_with_time_as_coordinate(recorded, chained):
    path = recorded(chained)
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        y = tree["b"]["y"]
        assert y.dims == ("time",)
        assert list(y.coords) == ["time"]
        assert y.attrs["units"] == "m"
        assert float(y.sel(time=0.03)) == 0.03
        assert y.time.attrs["units"] == "s"
        assert tree["b"]["words"].values[-1] == "grüß dich 20 60"
        assert tree.attrs["status"] == "completed"
        assert tree["b"].attrs["fmi_version"] == "2.0"


def test_xarray_opens_hundreds_of_signals_in_a_moment(recorded, spiral):
    """h5netcdf takes quadratic time where the dimension of time is unlimited: a minute for 400 signals."""
    vehicles = {f"vehicle{i}": {"fmu": "bluerov2_thesis", "start": "fmu"} for i in range(6)}
    path = recorded({"master": {"stop_time": 0.01, "step": 0.01}, "components": vehicles})
    script = f"""
import time, h5netcdf, xarray
began = time.process_time()
tree = xarray.open_datatree({str(path)!r}, engine="h5netcdf")
print(sum(len(group.data_vars) for group in tree.subtree), time.process_time() - began)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=DEADLINE, check=True)
    signals, seconds = done.stdout.split()
    assert int(signals) > 120
    assert float(seconds) < 3.0  # it takes 0.4; quadratic 6


def test_netcdf_opens_it(recorded, chained):
    netCDF4 = pytest.importorskip("netCDF4")
    with netCDF4.Dataset(recorded(chained)) as file:
        assert file.dimensions["time"].size == 6
        assert file["a"]["steps"].dimensions == ("time",)
        assert file["a"]["steps"][:].tolist() == [0, 4, 8, 12, 16, 20]


@pytest.mark.skipif(shutil.which("h5dump") is None, reason="h5dump is not installed")
def test_h5dump_shows_it(recorded, chained):
    command = ["h5dump", "-a", "status", "-d", "/time", recorded(chained)]
    assert '"completed"' in subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_a_failed_record_opens_everywhere(orch, write, models, tmp_path):
    """Its datasets are shorter than they might have become."""
    path = tmp_path / orch("run", write(single("trouble", kind=1)), "--json").json["file"]
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        assert tree["one"]["y"].time.values.tolist() == [0.0, 0.01, 0.02]
    netCDF4 = pytest.importorskip("netCDF4")
    with netCDF4.Dataset(path) as file:
        assert file["one"]["y"][:].tolist() == [0.0, 0.01, 0.02]


def test_the_format_is_hdf5_1_8(recorded, spiral):
    """Later superblocks mark an open file: it does not open after a kill."""
    content = recorded(spiral).read_bytes()
    assert content[:8] == b"\x89HDF\r\n\x1a\n"
    assert content[8] <= 2  # version of the superblock; 3 came with 1.10


# --- While it is written, and after a kill ----------------------------------------------------------------------------


@pytest.fixture
def endless(shipped, write, spiral, tmp_path):
    """endless(name, ...) -> [(process, record)] of runs that go on until they are stopped; each record has rows."""
    table = merged(spiral, {"master.stop_time": 1000.0, "record.every": 1e-3, "metrics": {}})
    processes = []

    def begin(*names):
        for name in names:
            command = [ORCH, "run", str(write(table, f"{name}.toml")), "-q", "--packaging", "python"]
            processes.append(subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL))
        paths = [
            poll(lambda name=name: next(tmp_path.glob(f"results/{name}/*.h5"), None), process)
            for name, process in zip(names, processes, strict=True)
        ]
        for path, process in zip(paths, processes, strict=True):
            poll(lambda path=path: length(path), process)
        return list(zip(processes, paths, strict=True))

    yield begin
    for process in processes:
        process.kill()
        process.wait()


def length(path):
    try:
        with h5py.File(path, "r", locking=False) as file:
            return len(file["time"])
    except (OSError, KeyError):
        return 0


def check_rows(file, n):
    """Every signal has the first n rows, and they are those of the run."""
    assert file["time"][:n].tolist() == [k / 1000 for k in range(n)]
    for group in ("controller", "vehicle", "reference", "current"):
        for dataset in file[group].values():
            assert len(dataset) >= n
            assert np.isfinite(dataset[:n]).all()
    assert len(np.unique(file["vehicle"]["eta.x"][:n])) == n  # it moves all the time: no row is a gap


def test_after_a_kill_every_flushed_row_is_readable(endless):
    for i, (process, path) in enumerate(endless("one", "two", "three")):
        seen = length(path)
        if i:
            poll(lambda path=path, least=seen: length(path) > least, process)
        process.kill()
        process.wait()
        with h5py.File(path, "r") as file:  # plainly, as anybody would
            n = len(file["time"])
            assert n >= seen > 0
            check_rows(file, n)
            assert file.attrs["status"] == "running"
        with orchestrator.open_run(path) as run:
            assert run.status == "interrupted (killed)"
            assert len(run["vehicle.eta.x"]) == n
            assert run.to_dataframe().shape == (n, len(run.signals))


def test_what_a_kill_left_is_run_again_and_replaced(orch, write, models, tmp_path):
    path = write(single("moody", pause=0.1))
    with subprocess.Popen([ORCH, "run", str(path), "-q"], cwd=tmp_path) as process:
        record = poll(lambda: next(tmp_path.glob("results/*/*.h5"), None), process)
        process.kill()
    answer = orch("run", path, "--json")
    assert (answer.code, answer.json["status"]) == (0, "completed")
    assert list(tmp_path.glob("results/*/*")) == [record]
    assert orchestrator.open_run(record).status == "completed"


def test_a_time_reaches_the_disk_after_its_row(python, write, models):
    """A kill between the two flushes leaves rows without a time, never a time without its row."""
    write(single("clock"))
    answer = python("""
import shutil
import h5py
import orchestrator as orch

flush, seen = h5py.File.flush, []


def spy(file):
    flush(file)
    shutil.copy(file.filename, "copy.h5")
    with h5py.File("copy.h5", "r") as copy:
        seen.append((len(copy["time"]), len(copy["one"]["y"])))


h5py.File.flush = spy
orch.run("mine.toml")
print(list(dict.fromkeys(seen)))
""")
    assert answer.out == "[(0, 6), (6, 6)]\n", answer.err


def test_a_record_can_be_read_while_it_is_written(endless):
    ((process, path),) = endless("live")
    lengths = []
    for _ in range(40):
        with orchestrator.open_run(path) as run:
            assert run.status == "running"
            n = len(run.time)
            assert run.time.tolist() == [k / 1000 for k in range(n)]
            assert len(run["vehicle.eta"]) == n
            assert np.isfinite(run["vehicle.eta"]).all()
            lengths.append(n)
    assert lengths == sorted(lengths)
    assert process.poll() is None


def test_rows_reach_the_disk_at_least_every_second(endless):
    """Between one look and the next there are more rows within a second, and another for a loaded machine."""
    ((process, path),) = endless("steady")
    before, began = length(path), time.monotonic()
    poll(lambda: length(path) > before, process)
    assert time.monotonic() - began < 2.0


# --- The store --------------------------------------------------------------------------------------------------------


def test_a_store_finds_a_record_by_id_prefix_file_and_last(orch, write, probe, tmp_path):
    ids = [orch("run", write(single(probe, at=at)), "--json").json["run_id"] for at in (1.0, 2.0)]
    store = Store(tmp_path / "results")
    os.utime(store.find(ids[0]), (0, 0))  # the clock of a file system is coarse
    assert store.find("last").stem == ids[1]
    shortest = next(n for n in range(1, 11) if ids[0][:n] != ids[1][:n])
    assert store.find(ids[0][:shortest]).stem == ids[0]
    assert store.find(str(store.find(ids[0]))).stem == ids[0]
    assert [path.stem for path in store.records()] == ids


def test_a_store_says_what_it_does_not_have(orch, write, probe, tmp_path):
    store = Store(tmp_path / "results")
    with pytest.raises(orchestrator.StoreError, match="holds no record; run an experiment first"):
        store.find("last")
    run_id = orch("run", write(single(probe)), "--json").json["run_id"]
    with pytest.raises(orchestrator.StoreError, match=f"no record '{run_id[:-1]}x' in .*; did you mean '{run_id}'"):
        store.find(f"{run_id[:-1]}x")
    (tmp_path / "results" / "mine" / f"{run_id}0.h5").write_bytes(b"")
    with pytest.raises(orchestrator.StoreError, match="means several records"):
        store.find(run_id[:5])


def test_a_store_ignores_folders_that_begin_with_an_underscore(orch, write, probe, tmp_path):
    path = tmp_path / orch("run", write(single(probe)), "--json").json["file"]
    (tmp_path / "results" / "_thesis").mkdir()
    path.rename(tmp_path / "results" / "_thesis" / path.name)
    assert Store(tmp_path / "results").records() == []


def test_a_clash_of_prefixes_lengthens_the_name(recorded, probe, tmp_path):
    path = recorded(single(probe))
    with h5py.File(path, "a") as file:
        digest = file.attrs["digest"]
        file.attrs["digest"] = digest[:20] + "f" * 44
    content = path.read_bytes()
    second = recorded(single(probe))
    assert second.name == f"{digest[:11]}.h5"
    assert path.read_bytes() == content
    with orchestrator.open_run(second) as run:
        assert run.run_id == digest[:11]


@pytest.mark.parametrize("content", [b"", b"no record", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_what_is_no_record_says_so(tmp_path, content):
    path = tmp_path / "some.h5"
    path.write_bytes(content)
    with pytest.raises(orchestrator.StoreError, match=r"some\.h5"):
        orchestrator.open_run(path)


def test_a_file_of_hdf5_that_is_no_record_says_so(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = 1.0
    with pytest.raises(orchestrator.StoreError, match=r"other\.h5 is no record of a run"):
        orchestrator.open_run(tmp_path / "other.h5")


@needs_compiler
@pytest.mark.slow
def test_thousands_of_signals_are_recorded(recorded, tmp_path):
    """HDF5's own way of attaching a dimension fails at 4085 signals."""
    count = 6000
    variables = [*PROBE_VARIABLES, *((f"z[{i}]", "Real", "output", None, "m", "z") for i in range(count - 20))]
    fmu = probe_fmu(tmp_path / "wide.fmu", variables, f"-DSIZE={count + 10}")
    path = recorded(single(fmu))
    with h5py.File(path, "r") as file:
        assert len(file["one"]) == count - 20 + 5
        assert len(file["time"].attrs["REFERENCE_LIST"]) == len(file["one"])
        assert file["one"]["z[5000]"].dims[0][0] == file["time"]
    netCDF4 = pytest.importorskip("netCDF4")
    with netCDF4.Dataset(path) as file:
        assert file["one"]["z[5000]"].dimensions == ("time",)


def test_a_damaged_record_is_an_error_with_a_message_and_is_run_again(orch, write, probe, tmp_path):
    """A kill in the middle of the first write leaves such a file."""
    path = write(single(probe))
    record = tmp_path / orch("run", path, "--json").json["file"]
    content = record.read_bytes()
    for size in (9, 100, 1000, 3000, len(content) // 2, len(content) - 1):
        record.write_bytes(content[:size])
        with pytest.raises(orchestrator.StoreError, match=record.name):
            orchestrator.open_run(record)["one.y"]
    record.write_bytes(content[:1000])
    assert orch("run", path, "--json").json["status"] == "completed"
    assert orchestrator.open_run(record)["one.y"][-1] == 0.05
