"""What the README promises."""

import re
from pathlib import Path

from orchestrator.models import build

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLE = ROOT / "examples" / "pd_numpy.py"


def test_the_example_controller_stands_in_the_readme_and_is_short():
    source = EXAMPLE.read_text(encoding="utf-8")
    assert f"```python\n{source}```" in README
    assert len(source.splitlines()) <= 25


def test_the_example_controller_flies_the_spiral(orch, spiral, write):
    build.build([str(EXAMPLE)])
    spiral["master"]["stop_time"] = 10.0
    late = {"of": "max_abs", "signal": "vehicle.eta.x", "reference": "reference.eta_d.x", "after": 6}
    spiral["metrics"] = {"late": late}
    answer = orch("run", write(spiral), "--swap", "controller=pd_numpy", "--json")
    assert answer.code == 0, answer.err
    # PD without feed-forward lags behind a circle of 1 m at 0.52 m/s by a fraction of it
    assert answer.json["metrics"]["late"] < 0.25


def test_every_file_and_command_that_the_readme_names_exists(orch):
    for name in set(re.findall(r"(?:experiments|fmus|docs|examples|tests)/[\w/]+\.(?:toml|py|md|png)", README)):
        assert (ROOT / name).is_file(), name
    commands = orch("--help").out
    for name in set(re.findall(r"orch ([a-z]+)", README)):
        assert f"\n  {name} " in commands, name


def test_the_readme_shows_the_two_commands_before_pip():
    assert README.index("make run") < README.index("make test") < README.index("pip install")
