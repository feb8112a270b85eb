"""What an FMU may legally be called means nothing else in the record, in its readers, or in a file that is exported."""

from urllib.parse import unquote

import h5py
import numpy as np
import pytest
import xarray
from scipy.io import loadmat

from experiments import single
from fmu_files import PROBE_VARIABLES, needs_compiler, probe_fmu
from orchestrator.names import split_axis
from orchestrator.records.file.format import link_of
from orchestrator.records.file.run import Run

ODD = (
    "Hull",
    "Hull/Speed",
    "a/",
    ".",
    "..",
    "/",
    "time",
    "50%",
    "a%2Fb",
    "x_dim1",
    " b ",
    "der(v)",
    "a.",
    "b]",
    "$x$",
    "ü",
)


def odd_fmu(path, name):
    """The probe, whose real output has that name."""
    variables = [(name, *rest) if old == "y" else (old, *rest) for old, *rest in PROBE_VARIABLES]
    return probe_fmu(path, variables)


@pytest.mark.parametrize("name", [*ODD, "%", "%%", "_dim1", "a\tb", "a.b/c", "日本"])
def test_a_link_is_a_plain_name_and_leads_back(name):
    link = link_of(name)
    assert unquote(link) == name
    assert "/" not in link
    assert link.strip(" .") == link.rstrip(" ").lstrip(" .") or set(link) != {"."}
    assert link not in (".", "..", "time")


def test_links_of_different_names_differ():
    assert len({link_of(name) for name in ODD}) == len(ODD)
    assert link_of("eta.x") == "eta.x"
    assert link_of("der(eta[1,2])") == "der(eta[1,2])"


@pytest.mark.parametrize("name", ["a.", "b]", "[1]", ".x", ".", "..", "x[]"])
def test_a_name_that_only_looks_like_an_axis_is_whole(name):
    assert split_axis(name) == (name, "")


@needs_compiler
def test_every_command_takes_names_that_mean_something_else_in_a_record(orch, write, tmp_path):
    components = {}
    for i, name in enumerate(ODD):
        fmu = odd_fmu(tmp_path / f"odd{i}.fmu", name)
        components |= single(fmu, name=f"c{i}")["components"]
    metrics = {f"m{i}": {"of": "final", "signal": f"c{i}.{name}"} for i, name in enumerate(ODD)}
    names = [f"c{i}.{name}" for i, name in enumerate(ODD)]
    table = single(fmu) | {"components": components, "metrics": metrics, "record": {"signals": names}}
    answer = orch("run", write(table), "--output", "a.h5")
    assert answer.code == 0, answer.err
    with Run(tmp_path / "a.h5") as run:
        times = run.time
        for i, name in enumerate(ODD):
            assert f"c{i}.{name}" in run.signals
            assert np.array_equal(run[f"c{i}.{name}"], times)
            assert run.units(f"c{i}.{name}") == "m"
            assert run.metrics[f"m{i}"] == times[-1]
    with h5py.File(tmp_path / "a.h5") as file:
        stored = file["c1/Hull%2FSpeed"]
        assert stored.attrs["variable"] == "Hull/Speed"
        assert "variable" not in file["c0/Hull"].attrs
    tree = xarray.open_datatree(tmp_path / "a.h5", engine="h5netcdf")
    for i, name in enumerate(ODD):
        assert np.array_equal(tree[f"c{i}"].dataset[link_of(name)].values, times)
    for command in (
        ("show", "a.h5"),
        ("plot", "a.h5", "-o", "a.svg"),
        ("report", "a.h5", "-o", "a.html"),
        ("compare", "a.h5", "a.h5"),
        ("diff", "a.h5", "a.h5"),
        ("rerun", "a.h5", "--verify"),
        *(
            ("export", "a.h5", "--format", form, "-o", f"a.{form}")
            for form in ("csv", "parquet", "mat", "netcdf", "mcap")
        ),
    ):
        answer = orch(*command)
        assert answer.code == 0, (command, answer.err, answer.out)
    exported = xarray.open_dataset(tmp_path / "a.netcdf", engine="h5netcdf")
    named = {v.attrs.get("name", key): v.values for key, v in exported.data_vars.items()}
    matlab = loadmat(tmp_path / "a.mat", simplify_cells=True)
    for i, name in enumerate(ODD):
        assert np.array_equal(named[f"c{i}.{name}"], times)
        (field,) = (key for key, full in matlab["names"][f"c{i}"].items() if full == f"c{i}.{name}")
        assert np.array_equal(matlab[f"c{i}"][field], times)


@needs_compiler
def test_signals_of_a_component_whose_name_begins_with_an_underscore_are_listed(orch, write, tmp_path):
    fmu = odd_fmu(tmp_path / "odd.fmu", "y")
    assert orch("run", write(single(fmu, name="_a")), "--output", "a.h5").code == 0
    with Run(tmp_path / "a.h5") as run:
        assert np.array_equal(run["_a.y"], run.time)
    for name in ("_envelope", "_heard", "time"):
        answer = orch("run", write(single(fmu, name=name)), "--output", "b.h5")
        assert (answer.code, "is reserved for the record" in answer.err) == (2, True)
