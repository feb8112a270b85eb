"""The reference of the experiment file: its page, its examples, and the JSON Schema for editors."""

import json
import re
import tomllib

import jsonschema
import pytest

import orchestrator
from experiments import EXPERIMENTS, merged
from orchestrator.experiment.reader import parse
from orchestrator.experiment.schema import reference
from orchestrator.experiment.schema.sections import SECTIONS

ROOT = EXPERIMENTS.parent
PAGE = (ROOT / "docs" / "experiment.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
SCHEMA = json.loads(reference.SCHEMA.read_text(encoding="utf-8"))
SHIPPED = sorted(EXPERIMENTS.rglob("*.toml"))


def refuses(table):
    """Where the schema finds something wrong, as dotted keys."""
    return [".".join(map(str, error.absolute_path)) for error in jsonschema.Draft7Validator(SCHEMA).iter_errors(table)]


def test_the_page_and_the_schema_are_those_of_the_reader():
    """Else: make reference."""
    assert reference.with_tables(PAGE) == PAGE
    assert reference.json_schema() == reference.SCHEMA.read_text(encoding="utf-8")
    jsonschema.Draft7Validator.check_schema(SCHEMA)


def test_a_section_without_a_table_on_the_page_is_reported():
    without = PAGE.replace("<!-- keys of [record] -->", "")
    with pytest.raises(KeyError, match=re.escape("no table of [record]")):
        reference.with_tables(without)


@pytest.mark.parametrize("section", SECTIONS[1:], ids=lambda section: section.heading)
def test_every_example_of_a_key_is_a_value_of_it(section):
    for key in section.keys:
        if key.example != "{ ... }":
            value = tomllib.loads(f"value = {key.example}")["value"]
            assert key.type.problem(value) == ""
            assert not list(jsonschema.Draft7Validator(key.type.json).iter_errors(value)), key.name


@pytest.mark.parametrize("text", EXAMPLES, ids=lambda text: tomllib.loads(text)["title"])
def test_the_worked_examples_run(shipped, tmp_path, text):
    path = tmp_path / "example.toml"
    path.write_text(text, encoding="utf-8")
    run = orchestrator.run(path, results=tmp_path)
    assert (run.status, run.warnings) == ("completed", [])
    assert set(run.metrics) == set(tomllib.loads(text)["metrics"])
    assert not refuses(tomllib.loads(text))


def test_the_example_of_a_sweep_is_one(orch, write):
    many = next(text for text in EXAMPLES if "[sweep]" in text)
    answer = orch("sweep", write(tomllib.loads(many)), "--dry-run", "--json")
    assert len(answer.json["runs"]) == 8


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_experiments_fit_the_schema(path):
    assert not refuses(tomllib.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"titel": "a slip"}, ""),
        ({"title": 3}, "title"),
        ({"master": 3}, "master"),
        ({"master.stop_time": None}, "master"),
        ({"master.step": 0}, "master.step"),
        ({"master.step": "1 ms"}, "master.step"),
        ({"master.algorithm": "gauss-seidl"}, "master.algorithm"),
        ({"components.controller.fmus": "pid"}, "components.controller"),
        ({"components.controller.fmu": None}, "components.controller"),
        ({"components.controller.builtin": "mavlink_manual"}, "components.controller"),
        ({"components.controller.isolation": "yes"}, "components.controller.isolation"),
        ({"components.controller.start": "mine"}, "components.controller.start"),
        ({"components.2nd": {"fmu": "pid"}}, "components"),
        ({"components.time": {"fmu": "pid"}}, "components"),
        ({"connections.vehicle.u": 3}, "connections.vehicle.u"),
        ({"connections.vehicle.u": {"from": "allocation.u", "gian": 2}}, "connections.vehicle.u"),
        ({"record.every": "often"}, "record.every"),
        ({"record.signals": "*"}, "record.signals"),
        ({"metrics.rmse_x.of": "rsme"}, "metrics.rmse_x.of"),
        ({"metrics.rmse_x.reference": None}, "metrics.rmse_x"),
        ({"metrics.rmse_x.band": 0.1}, "metrics.rmse_x"),
        ({"mavlink": {"vehicles": {"vehicle": 0}}}, "mavlink.vehicles.vehicle"),
        ({"mavlink": {"origin": {"lat": 91, "lon": 0}}}, "mavlink.origin.lat"),
        ({"mavlink": {"origin": {"lat": 1}}}, "mavlink.origin"),
        ({"mavlink": {"rates": {"EXTRA1": 51}}}, "mavlink.rates.EXTRA1"),
        ({"sweep": {"draws": 0, "vary": {"master.seed": [1, 2]}}}, "sweep.draws"),
        ({"sweep": {"draws": 2, "vary": {"master.seed": {"distribution": "unifrom"}}}}, "sweep.vary.master.seed"),
        ({"sweep": {"draws": 2, "vary": {"master.seed": {"distribution": "normal", "mean": 1}}}}, "sweep.vary"),
        ({"sweep": {"keep": "some", "vary": {"master.seed": [1, 2]}}}, "sweep.keep"),
        ({"sweep": {"tune": {"goal": "least"}}}, "sweep.tune"),
    ],
    ids=str,
)
def test_what_the_reader_refuses_the_schema_refuses(orch, write, spiral, changes, key):
    table = merged(spiral, changes)
    assert any(found.startswith(key) for found in refuses(table))
    assert orch("check", write(table)).code == 2


def test_a_new_experiment_names_the_schema_and_fits_it(orch, tmp_path):
    orch("new", "experiment", "mine")
    first, _, rest = (tmp_path / "mine.toml").read_text(encoding="utf-8").partition("\n")
    assert first == f"#:schema {reference.SCHEMA.as_uri()}"
    assert not refuses(tomllib.loads(rest))


def test_the_schema_is_printed_for_a_file_of_ones_own(orch):
    assert orch("schema").json == SCHEMA


def test_every_key_of_a_metric_stands_in_the_reference():
    """What a metric needs and takes is checked where the FMUs are known, the rest by the reader."""
    metric = next(section for section in SECTIONS if section.by == "of")
    known = {"of", "signal", "after", "before", "every"}
    known |= {key for variant in metric.variants.values() for key in (*variant.needs, *variant.takes)}
    assert set(metric.names) == known


def test_a_misspelled_key_names_the_nearest_of_its_section():
    text = '[master]\nstop_tim = 1.0\nstep = 0.1\n[components.a]\nfmu = "pid"\n'
    problems = {problem.key: problem.sentence for problem in parse(ROOT / "mine.toml", text).problems}
    assert problems["master.stop_tim"].startswith("unknown key; did you mean 'stop_time'?")
    assert problems["master.stop_time"] == "is missing; give it in s"
