"""Every command over drawn experiments: none ends with a traceback, and the numbers are those of a few lines of numpy.

Drawn are gains, offsets, units, isolation, algorithms, periods, rows left out, names with characters that mean
something elsewhere, swapped FMUs, and runs that fail.  All happens in this process, through the entry that `orch` has.
"""

import os
import shutil
import zipfile
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from fmu_files import PROBE_VARIABLES, SOURCES, needs_compiler, probe_fmu
from orchestrator.cli.main import execute
from orchestrator.models import build
from orchestrator.records.file.run import Run

STEP = 0.01  # s
DRAWS = 100 if os.environ.get("ORCH_FUZZ", "1") == "1" else 2000
NAMES = st.text(
    st.characters(codec="utf-8", exclude_categories=("C", "Zl", "Zp")), min_size=1, max_size=8
) | st.sampled_from(
    [
        "Hull/Speed",
        "a/",
        ".",
        "..",
        "time",
        "50%",
        "x_dim1",
        "eta.x",
        "K[1]",
        "a.",
        "$x$",
        "\\frac",
        "<b>",
        "'",
        '"',
        " ",
    ]
)
FAILURE = 3  # the exit code


@st.composite
def experiments(draw):
    """A source, y = t, of any name, and components n[k+1] = u[k] + 1 m that are fed by it and by each other."""
    many = draw(st.integers(1, 3))
    numbers = st.floats(-2.0, 2.0).map(lambda x: round(x, 3))
    swaps = draw(st.booleans())
    return {
        "name": draw(NAMES),
        "algorithm": draw(st.sampled_from(["gauss-seidel", "jacobi"])),
        "periods": [draw(st.sampled_from([1, 1, 2, 5])) for _ in range(many)],
        "sources": [draw(st.integers(-1, many - 1)) for _ in range(many)],
        "gains": [draw(st.just(1.0) | numbers.filter(bool)) for _ in range(many)],
        "offsets": [draw(st.just(0.0) | numbers) for _ in range(many)],
        "unit": draw(st.sampled_from(["m", "m", "km"])),
        "every": draw(st.sampled_from([1, 1, 4])),
        "isolation": draw(st.sampled_from(["none", "none", "none", "process"])),
        "first": draw(st.booleans()),
        "swaps": swaps,
        "fails": not swaps and draw(st.booleans()),  # a swap drops the parameters
    }


def text_of(drawn, fmu, memory):
    """The experiment file."""
    quoted = drawn["name"].replace("\\", "\\\\").replace('"', '\\"')
    source = f'[components.s]\nfmu = "{fmu}"\nstart = "fmu"\nisolation = "{drawn["isolation"]}"\n'
    if drawn["fails"]:
        source += "parameters = { mode = 1, at = 0.095 }\n"
    others, connections = "", "[connections]\n"
    for i, period in enumerate(drawn["periods"]):
        others += f'[components.m{i}]\nfmu = "{memory}"\nstep = {round(period * STEP, 3)}\n'
        start = f"s.{quoted}" if drawn["sources"][i] < 0 else f"m{drawn['sources'][i]}.n"
        connections += (
            f'"m{i}.u" = {{ from = "{start}", gain = {drawn["gains"][i]}, offset = {drawn["offsets"][i]} }}\n'
        )
    metrics = (
        f'[metrics]\nlast = {{ of = "final", signal = "m0.n" }}\nsource = {{ of = "final", signal = "s.{quoted}" }}\n'
    )
    return (
        f'title = "drawn"\n[master]\nstop_time = 0.2\nstep = {STEP}\nalgorithm = "{drawn["algorithm"]}"\n'
        + (source + others if drawn["first"] else others + source)
        + connections
        + f'[record]\nevery = {round(drawn["every"] * STEP, 3)}\nsignals = ["m*.n", "s.*"]\ninputs = true\n'
        + metrics
    )


def reference(drawn, steps):
    """{component: (steps + 1,)} by the rules of docs/fmus.md, When a value becomes visible."""
    many = len(drawn["periods"])
    order = ["s", *range(many)] if drawn["first"] else [*range(many), "s"]
    factor = 1000.0 if drawn["unit"] == "km" else 1.0
    visible = {"s": 0.0, **dict.fromkeys(range(many), 0.0)}
    later, rows = {}, {name: [0.0] for name in visible}
    for k in range(steps):
        held = dict(visible)
        for name in order:
            if name == "s":
                new, period = (k + 1) * STEP, 1
            elif k % (period := drawn["periods"][name]):
                continue
            else:
                given_by = visible if drawn["algorithm"] == "gauss-seidel" else held
                start = drawn["sources"][name]
                scale = factor if start < 0 else 1.0
                new = (
                    drawn["gains"][name] * scale * given_by["s" if start < 0 else start] + drawn["offsets"][name] + 1.0
                )
            if period == 1:
                visible[name] = new
            else:
                later[name] = (k + period, new)
        for name, (due, value) in list(later.items()):
            if due == k + 1:
                visible[name] = value
        for name, value in visible.items():
            rows[name].append(value)
    return {name: np.array(values) for name, values in rows.items()}


@pytest.fixture(scope="module")
def memory(_build_folder):
    return build.build([str(SOURCES / "memory.py")])["memory"]


@pytest.fixture(scope="module")
def probe(tmp_path_factory):
    """probe(path, name, unit): fmus/probe.c with its real output called so; it is compiled once."""
    folder = tmp_path_factory.mktemp("probe")
    variables = [("NAME", *rest) if old == "y" else (old, *rest) for old, *rest in PROBE_VARIABLES]
    original = probe_fmu(folder / "probe.fmu", variables)

    def make(path, name, unit):
        with zipfile.ZipFile(original) as source, zipfile.ZipFile(path, "w") as target:
            for entry in source.namelist():
                content = source.read(entry)
                if entry == "modelDescription.xml":
                    xml = content.decode()
                    begin = xml.index('<ScalarVariable name="NAME"')
                    own = (
                        xml[begin:]
                        .replace('name="NAME"', f"name={quoteattr(name)}", 1)
                        .replace('unit="m"', f'unit="{unit}"', 1)
                    )
                    content = (xml[:begin] + own).encode()
                target.writestr(entry, content)
        return path

    return make


@needs_compiler
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Glyph")  # the font of the figures lacks letters
@settings(
    max_examples=DRAWS,
    deadline=None,
    derandomize=True,
    phases=(Phase.generate,),  # a draw takes seconds
    suppress_health_check=list(HealthCheck),
)
@given(drawn=experiments())
def test_every_command_takes_every_experiment(drawn, memory, probe, tmp_path_factory, monkeypatch, capsys):
    taken = {old for old, *_ in PROBE_VARIABLES if old != "y"}
    drawn["name"] = f"{drawn['name']}_" if drawn["name"] in taken else drawn["name"]
    folder = tmp_path_factory.mktemp("drawn")
    monkeypatch.chdir(folder)
    fmu = probe(folder / "one.fmu", drawn["name"], drawn["unit"])
    (folder / "two").mkdir()
    shutil.copy(fmu, folder / "two" / "other.fmu")
    (folder / "mine.toml").write_text(text_of(drawn, fmu, memory), encoding="utf-8")

    def orch(*command, codes=(0,)):
        code = execute([str(word) for word in command])
        said = capsys.readouterr()
        assert "Traceback" not in said.err + said.out, (command, said.err)
        assert code in codes, (command, code, said.err)

    swap = ("--swap", f"s={folder / 'two' / 'other.fmu'}") if drawn["swaps"] else ()
    orch("check", "mine.toml", *swap)
    orch("run", "mine.toml", "--output", "a.h5", *swap, codes=(FAILURE,) if drawn["fails"] else (0,))
    orch("run", "mine.toml", "--set", "title=again", codes=(FAILURE,) if drawn["fails"] else (0,))
    with Run(folder / "a.h5") as run:
        ticks = np.rint(run.time / STEP).astype(int)
        expected = reference(drawn, 20)
        assert ticks.tolist() == list(range(0, 21, drawn["every"]))[: len(ticks)]
        assert drawn["fails"] or ticks[-1] == 20
        assert run[f"s.{drawn['name']}"] == pytest.approx(expected["s"][ticks], rel=1e-12)
        for i in range(len(drawn["periods"])):
            assert run[f"m{i}.n"] == pytest.approx(expected[i][ticks], rel=1e-12)
        if not drawn["fails"]:
            assert run.metrics["last"] == pytest.approx(expected[0][20], rel=1e-12)
            assert run.metrics["source"] == pytest.approx(expected["s"][20], rel=1e-12)
    (stored,) = (folder / "results" / "mine").glob("*.h5")
    orch("show", "a.h5")
    orch("show", "a.h5", "--json")
    orch("list")
    orch("list", "--where", "metrics.last > 0", codes=(0, 2))  # 2: only runs that failed, which have none
    orch("plot", "a.h5", "--signals", "m0.n", "-o", "a.svg")
    orch("compare", "a.h5", stored, "--plot", "b.svg", "--signals", f"s.{drawn['name']}", codes=(0, 2))
    orch("report", "a.h5", stored, "-o", "a.html")
    orch("diff", "a.h5", stored, codes=(0, 1))
    for suffix in ("csv", "parquet", "mat", "nc", "mcap"):
        orch("export", "a.h5", "-o", f"a.{suffix}")
    orch("export", "a.h5", "-o", "a.tlog", codes=(2,))  # it has no vehicle
    orch("rerun", "a.h5", "--verify", codes=(0, FAILURE) if drawn["fails"] else (0,))
    orch("prune", "--status", "*", "--yes")
    assert not stored.exists()
