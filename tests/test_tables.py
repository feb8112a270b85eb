"""Tables that commands print: they fit 80 columns, lose nothing, or say what shows the rest."""

import os
import re
import subprocess

import pytest

from commands import DEADLINE, ORCH
from experiments import single, toml

NAME = "a_vehicle_whose_name_is_longer_than_any_that_one_would_give"
METRIC = "a_metric_with_a_name_of_its_own"
TITLE = "A title that is longer than the line. " * 3
WHOLE = [
    f"list --columns metrics.{METRIC},wall_time,master.step,components.{NAME}.fmu,title",
    "diff {one} {other}",
    "check wide.toml",
    "compare {one} {other}",
    "compare --sweep last",
    "converge wide.toml --steps 0.01,0.005,0.0025,0.00125",
    "fmus waves",
    "fmus pid",
    "doctor",
]
CUT = [("sweep wide.toml --dry-run", "shows them"), ("show {one}", "shows the whole")]


@pytest.fixture(scope="module")
def place(models, tmp_path_factory):
    """place(arguments, columns) -> what `orch` prints, where an experiment has long names: two runs of it, a sweep."""
    folder = tmp_path_factory.mktemp("wide")
    table = {
        "title": TITLE,
        **single("waves", name=NAME, heading=0.123456789, place=[0.123456789, 0.123456789, 0.123456789]),
        "metrics": {
            METRIC: {"of": "rms", "signal": f"{NAME}.sine.a"},
            "end": {"of": "final", "signal": f"{NAME}.ramp"},
        },
        "sweep": {"vary": {f"components.{NAME}.parameters.place[{i}]": [0.0, 1.0] for i in (1, 2, 3)}},
    }
    table["components"]["listener"] = {"fmu": "memory"}
    table["connections"] = {"listener.u": f"{NAME}.ramp"}
    text = "\n".join(f"{key} = {toml(value)}" for key, value in table.items())
    (folder / "wide.toml").write_text(text, encoding="utf-8")

    def call(arguments, columns=None):
        env = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
        env |= {"COLUMNS": str(columns)} if columns else {}
        done = subprocess.run([ORCH, *arguments], cwd=folder, env=env, capture_output=True, text=True, timeout=DEADLINE)
        assert done.returncode in (0, 1), done.stderr
        return done.stdout

    sets = [part for i in (1, 2, 3) for part in ("--set", f"components.{NAME}.parameters.place[{i}]=0.{i}123456789")]
    call(["run", "wide.toml"])
    call(["run", "wide.toml", *sets])
    call(["sweep", "wide.toml", "--workers", "1", "--json"])
    one, other = (path.stem for path in sorted((folder / "results" / "wide").glob("*.h5")))
    return lambda line, columns=None: call(line.format(one=one, other=other).split(), columns)


def parts(text):
    """The words of a text, in pieces at which a long one may be broken."""
    return set(re.findall(r"[^\s./_]+", text))


@pytest.mark.parametrize("line", [*WHOLE, *(line for line, _ in CUT), "fmus"])
def test_no_line_is_longer_than_80_characters(place, line):
    lines = place(line).splitlines()
    assert len(lines) > 3
    assert [text for text in lines if len(text) > 80] == []


@pytest.mark.parametrize("line", WHOLE)
def test_what_does_not_fit_is_wrapped_or_stands_below(place, line):
    wide = place(line, 2000)
    assert parts(wide) <= parts(place(line, 80))


@pytest.mark.parametrize(("line", "words"), CUT)
def test_what_is_cut_says_what_shows_it(place, line, words):
    assert re.search(rf"… .*--json {words}", " ".join(place(line, 80).split()))
    assert "--json shows" not in place(line, 2000)
