"""Files that commands write: where one cannot be written, the command says so before its work, and changes nothing."""

import os
import re
import shutil
import subprocess
import tomllib

import pytest

from commands import DEADLINE, ORCH
from experiments import EXPERIMENTS, toml

FIGURE = "a figure is a .png, .pdf or .svg file; let its name end in one of these"
PAGE = "a report is a .html or .htm file; let its name end in one of these"
DIAGRAM = "a diagram is a .svg, .mmd or .md file; let its name end in one of these"
EXPERIMENT = "an experiment is a .toml file; let its name end in .toml"
# what `orch` is called with before the name of the file, and a suffix that fits
TARGETS = [
    ("run mine.toml --force -o", ".h5"),
    ("run mine.toml --force --tlog", ".tlog"),
    ("check mine.toml --diagram", ".svg"),
    ("converge mine.toml -o", ".png"),
    ("plot last -o", ".png"),
    ("report last -o", ".html"),
    ("compare last run.h5 -o", ".md"),
    ("compare last run.h5 --plot", ".pdf"),
    ("export run.h5 --format csv -o", ".csv"),
    ("export mine.toml --format ssp -o", ".ssp"),
    ("import mine.ssp --force -o", ".toml"),
    ("report --sweep last --results swept -o", ".html"),
    ("compare --sweep last --results swept -o", ".tex"),
    ("compare --sweep last --results swept --plot", ".svg"),
]
SUFFIXES = [
    ("check mine.toml --diagram", DIAGRAM),
    ("converge mine.toml -o", FIGURE),
    ("plot last -o", FIGURE),
    ("report last -o", PAGE),
    ("compare last run.h5 --plot", FIGURE),
    ("import mine.ssp --force -o", EXPERIMENT),
    ("report --sweep last --results swept -o", PAGE),
    ("compare --sweep last --results swept --plot", FIGURE),
]
USED = [
    "run mine.toml --force -o mine.toml",
    "run mine.toml --force --tlog mine.toml",
    "run mine.toml --force -o other.h5 --tlog other.h5",
    "compare last run.h5 -o folder/../run.h5",
    "compare last run.h5 -o both.svg --plot both.svg",
    "compare --sweep last --results swept -o {table}",
    "export run.h5 --format csv -o run.h5",
    "export mine.toml --format ssp -o mine.toml",
]
STORES = ["run mine.toml", "converge mine.toml", "sweep sweep.toml", "tune tune.toml", "reproduce thesis --quick"]


@pytest.fixture(scope="module")
def place(shipped, tmp_path_factory):
    """A folder with an experiment, its record, its SSP, and a sweep of two runs."""
    folder = tmp_path_factory.mktemp("files")
    with (EXPERIMENTS / "spiral_pid.toml").open("rb") as file:
        spiral = tomllib.load(file)
    spiral["master"]["stop_time"] = 0.05
    spiral["metrics"] = {"rmse_x": spiral["metrics"]["rmse_x"]}
    vary = {"components.current.parameters.velocity.x": {"distribution": "uniform", "low": -1.0, "high": 1.0}}
    search = {"pid": {"K_p.x": {"distribution": "loguniform", "low": 10.0, "high": 1000.0}}}
    tune = {"objective": "rmse_x", "trials": 2, "draws": 2, "held_out": 2, "search": search}
    swept = {**spiral, "sweep": {"draws": 2, "vary": {**vary, "components.controller.fmu": ["pid"]}}}
    tuned = {**swept, "sweep": {**swept["sweep"], "tune": tune}}
    for name, table in (("mine", spiral), ("sweep", swept), ("tune", tuned)):
        text = "\n".join(f"{key} = {toml(value)}" for key, value in table.items())
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    (folder / "folder").mkdir()
    (folder / "file").write_text("")
    for line in ("run mine.toml", "export mine.toml -o mine.ssp", "sweep sweep.toml --workers 1 --results swept"):
        done = call(folder, line.split())
        assert done.returncode == 0, done.stderr
    (record,) = (folder / "results" / "mine").glob("*.h5")
    shutil.copy(record, folder / "run.h5")
    return folder


def call(folder, arguments, before=()):
    return subprocess.run([*before, ORCH, *arguments], cwd=folder, capture_output=True, text=True, timeout=DEADLINE)


def state(folder):
    """Every file with its content's size and time of change; the index of a store is a cache."""
    files = (path for path in folder.rglob("*") if not path.name.startswith("_index"))
    return {path: (path.stat().st_size, path.stat().st_mtime_ns) for path in files if path.is_file()}


@pytest.fixture
def refused(place):
    """refused(arguments) -> what the command says; it ends with exit code 2 and has changed nothing."""

    def refuse(arguments, before=()):
        earlier = state(place)
        done = call(place, arguments, before)
        assert done.returncode == 2, done.stderr
        assert done.stdout == ""
        assert "Traceback" not in done.stderr
        assert state(place) == earlier
        return done.stderr

    return refuse


@pytest.mark.parametrize(("line", "suffix"), TARGETS)
def test_a_folder_is_no_file(refused, line, suffix):
    assert refused([*line.split(), "folder"]) == "folder is a folder; give the name of a file in it\n"


@pytest.mark.parametrize(("line", "suffix"), TARGETS)
def test_a_file_is_no_folder(refused, line, suffix):
    target = f"file/below/target{suffix}"
    assert (
        refused([*line.split(), target])
        == f"{target} cannot be written: file is a file, not a folder; give another folder\n"
    )


@pytest.mark.parametrize(("line", "suffix"), TARGETS)
def test_a_folder_without_permission(refused, place, line, suffix):
    (place / "locked").mkdir(exist_ok=True)
    (place / "locked").chmod(0o555)
    before = ()
    if os.geteuid() == 0:  # root may write everywhere, unless that is taken from it
        if not shutil.which("setpriv"):
            pytest.skip("run as root, without setpriv")
        before = ("setpriv", "--bounding-set=-dac_override")
    target = f"locked/new/target{suffix}"
    words = refused([*line.split(), target], before)
    assert words == f"{target} cannot be written: no permission to write into locked; give another folder\n"


@pytest.mark.parametrize(("line", "suffix"), TARGETS)
def test_a_name_that_is_too_long(refused, line, suffix):
    target = f"{'n' * 300}{suffix}"
    assert refused([*line.split(), target]) == f"{target} cannot be written: File name too long\n"


@pytest.mark.parametrize(("line", "words"), SUFFIXES)
def test_another_suffix_is_refused_with_those_that_fit(refused, line, words):
    assert refused([*line.split(), "target.xyz"]) == f"target.xyz: {words}\n"


@pytest.mark.parametrize("line", USED)
def test_what_the_command_reads_or_writes_already_is_not_written_over(refused, place, line):
    (table,) = (place / "swept").glob("*/table.csv")
    *arguments, target = line.format(table=table.relative_to(place)).split()
    assert refused([*arguments, target]) == f"{target} is already used by this command; write to another file\n"


@pytest.mark.parametrize("line", STORES)
def test_a_file_is_no_store(refused, line):
    assert re.search(r"file\b.* cannot be written: ", refused([*line.split(), "--results", "file"]))


@pytest.mark.parametrize(("line", "suffix"), [pair for pair in TARGETS if "import" not in pair[0]])
def test_folders_that_are_missing_are_made(place, line, suffix):
    target = f"made/{line.replace(' ', '_')}/target{suffix}"
    done = call(place, [*line.split(), target])
    assert done.returncode == 0, done.stderr
    assert (place / target).stat().st_size > 50
    assert list((place / target).parent.iterdir()) == [place / target]
