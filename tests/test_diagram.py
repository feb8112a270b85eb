"""orch check: the system as tables, as SVG and as Mermaid."""

import os
import re

import pytest
from lxml import etree

from experiments import EXPERIMENTS, merged
from fmu_files import paper_fmu

SVG = "{http://www.w3.org/2000/svg}"
GRIPPING = EXPERIMENTS / "gripping_currents.toml"


def rows(text):
    """The lines of a table as lists of cells."""
    return [re.split(r"\s{2,}", line.strip()) for line in text.splitlines()]


def test_check_prints_components_and_connections(orch, write, spiral):
    path = write(merged(spiral, {"components.controller.step": 0.002}))
    found = rows(orch("check", path, env={**os.environ, "COLUMNS": "120"}).out)
    assert ["component", "fmu", "version", "packaging", "steps every"] in found
    (controller,) = [row for row in found if row[0] == "controller"]
    assert (controller[1], controller[2], controller[4]) == ("pid", "FMI 2.0", "0.002 s")
    assert ["input", "output", "axes", "unit", "conversion"] in found
    assert ["controller.eta", "vehicle.eta", "x y z phi theta psi", "m, rad", "-"] in found
    assert ["vehicle.u", "allocation.u", "T1 T2 T3 T4 T5 T6", "1", "-"] in found


def test_axes_that_go_another_way_are_shown_so(orch, write, tmp_path):
    def ports(name, axes, causality):
        return [(f"{name}{axis}", "Real", causality, "0" if causality == "input" else None, "m", "") for axis in axes]

    paper_fmu(tmp_path / "giver.fmu", ports("y", (".x", ".y", "[1]"), "output"))
    paper_fmu(tmp_path / "taker.fmu", ports("u", (".x", ".y"), "input") + ports("", ("s",), "input"))
    table = {
        "master": {"stop_time": 0.05, "step": 0.01},
        "components": {"g": {"fmu": "giver.fmu"}, "t": {"fmu": "taker.fmu"}},
        "connections": {"t.u.x": "g.y.y", "t.u.y": "g.y.x", "t.s": "g.y.x"},
    }
    found = rows(orch("check", write(table)).out)
    assert ["t.u", "g.y", "x<-y y<-x", "m", "-"] in found
    assert ["t.s", "g.y.x", "-", "m", "-"] in found


def test_the_svg_holds_every_component_and_stands_alone(orch, tmp_path):
    answer = orch("check", GRIPPING, "--diagram", "deep/system.svg")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.rstrip().endswith("deep/system.svg")
    root = etree.parse(tmp_path / "deep" / "system.svg").getroot()
    assert root.tag == f"{SVG}svg"
    assert float(root.get("width")) > float(root.get("height")) > 100
    titles = [title.text for title in root.iter(f"{SVG}title")]
    assert len(titles) == 9
    assert "controller1: mfsosmc" in titles
    assert len([path for path in root.iter(f"{SVG}path") if path.get("marker-end")]) == 10
    assert len([path for path in root.iter(f"{SVG}path") if "back" in path.get("class", "")]) == 2  # eta and nu
    assert root.find(f"{SVG}style") is not None  # no colours of a page that is not there
    assert "http" not in re.sub(r'xmlns="[^"]*"', "", (tmp_path / "deep" / "system.svg").read_text())


@pytest.mark.parametrize("name", ["system.mmd", "system.md"])
def test_mermaid_holds_every_component_and_every_vector(orch, tmp_path, name):
    assert orch("check", GRIPPING, "--diagram", name, "--json").json["problems"] == []
    lines = (tmp_path / name).read_text().splitlines()
    if name.endswith(".md"):
        assert (lines.pop(0), lines.pop()) == ("```mermaid", "```")
    assert lines[0] == "flowchart LR"
    assert '    controller1["controller1<br/>mfsosmc"]' in lines
    assert '    vehicle1 -.->|"eta, nu"| controller1' in lines
    assert '    reference2 -->|"eta_d, eta_d_dot, eta_d_ddot"| controller2' in lines
    assert len(lines) == 1 + 9 + 10


def test_mermaid_takes_any_name(orch, write, tmp_path):
    """`end` ends a block of Mermaid; a quote ends a label."""
    fmu = paper_fmu(tmp_path / "probe.fmu").rename(tmp_path / 'a"b.fmu')
    table = {"master": {"stop_time": 0.05, "step": 0.01}, "components": {"end": {"fmu": str(fmu), "start": "fmu"}}}
    assert orch("check", write(table), "--diagram", "x.mmd").code == 0
    assert (tmp_path / "x.mmd").read_text() == 'flowchart LR\n    end_["end<br/>a#quot;b.fmu"]\n'


def test_a_diagram_of_another_kind_is_refused(orch, write, spiral, tmp_path):
    path = write(spiral)
    answer = orch("check", path, "--diagram", "x.png")
    assert (answer.code, answer.out) == (2, "")
    assert "x.png: a diagram is a .svg, .mmd or .md file" in answer.err
    assert orch("check", path, "--diagram", "mine.toml/x.svg").code == 2
    assert list(tmp_path.iterdir()) == [path]
