"""A sweep made ready: its experiment read, its models built, every combination of its lists checked."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ....errors import ExperimentError, Problem
from ....experiment.experiment import Experiment, load, parse, split_key
from ....metrics import smaller_is_better, unit_of
from ....models import build, catalogue
from ....plan import resolve
from ....plan.plan import Plan
from ....records.compare.side_by_side import Column
from . import matrix as designs
from .matrix import Design, Run, cells_of, labels

FORMAT = "orch-sweep"
ID_LENGTH = 10


@dataclass(frozen=True)
class Job:
    """What a worker must know of a sweep to run any of its runs.

    set, swap: of the command line; fmus: {name in the experiment: digest}; folder: of the sweep, see `storage`;
    facts: root attributes of every record.
    """

    path: str
    text: str
    set: Mapping[str, Any]
    swap: Mapping[str, str]
    fmus: Mapping[str, str]
    folder: str
    keep: str
    facts: Mapping[str, str]

    def experiment(self, run: Run) -> Experiment:
        """The ordinary experiment that a line of the table is."""
        sets, swaps = changes(run.values)
        return parse(Path(self.path), self.text, {**self.set, **sets}, {**self.swap, **swaps})


@dataclass(frozen=True)
class Study:
    """A sweep that can run.  files: {digest: FMU}; columns: of the metrics; notes: what a user should know."""

    experiment: Experiment
    design: Design
    sweep_id: str
    fmus: Mapping[str, str]
    files: Mapping[str, Path]
    columns: Sequence[Column]
    notes: Sequence[str]

    @property
    def folder(self) -> str:
        """The name of its folder in the store."""
        return f"{self.experiment.path.stem}-{self.sweep_id}"

    def job(self, results: str, facts: Mapping[str, str]) -> Job:
        e = self.experiment
        address = f"{results.rstrip('/')}/{self.folder}"
        return Job(
            str(e.path.resolve()),
            e.text,
            e.changes["set"],
            e.changes["swap"],
            self.fmus,
            address,
            self.design.keep,
            facts,
        )

    @property
    def keys(self) -> list[str]:
        """What varies, one name a cell of a run, as in the table."""
        return list(self.design.runs()[0].cells)

    def describe(self) -> dict[str, Any]:
        """sweep.json: what is needed to read the table, and to know what it is."""
        e, d = self.experiment, self.design
        return {
            "format": FORMAT,
            "format_version": 1,
            "sweep_id": self.sweep_id,
            "experiment": e.path.stem,
            "title": e.title,
            "experiment_toml": e.text,
            "changes": e.changes,
            "draws": d.draws,
            "skip": d.skip,
            "design": d.method,
            "seed": d.seed,
            "keep": d.keep,
            "keys": self.keys,
            "labels": labels(self.keys),
            "lists": [[list(keys), [list(row) for row in rows]] for keys, rows in d.lists],
            "distributions": d.distributions,
            "fmus": self.fmus,
            "metrics": [{"name": c.name, "of": c.of, "unit": c.unit, "ranked": c.ranked} for c in self.columns],
        }


def prepare(
    path: str | Path,
    set: Mapping[str, Any] | None = None,
    swap: Mapping[str, str] | None = None,
    packaging: str = "auto",
    told: Callable[[str], None] = lambda _: None,
) -> Study:
    """Read, build and check.  Raises ExperimentError with the problems of [sweep] and of every combination at once."""
    experiment = load(path, set, swap)
    if not experiment.sweep:
        raise ExperimentError(
            path,
            [
                *experiment.problems,
                Problem(
                    "sweep",
                    "is missing; say under [sweep.vary] what "
                    'varies, such as "components.controller.fmu" = ["pid", "mfsosmc"]',
                ),
            ],
        )
    design, problems = designs.read(experiment.sweep)
    varying = [*design.distributions, *(key for keys, _ in design.lists for key in keys)]
    problems += _overruled(varying, experiment)
    if not experiment.metrics:
        problems.append(Problem("metrics", "there is none: a sweep is judged by numbers; name some under [metrics]"))
    if problems:
        raise ExperimentError(path, [*experiment.problems, *problems])
    plans = _plans(experiment, design, packaging, told)
    live = sorted({component.name for plan in plans for component in plan.components if component.live})
    if live:
        raise ExperimentError(
            path,
            [
                Problem(
                    f"components.{name}", "is steered from outside; runs of a sweep must give the same numbers again"
                )
                for name in live
            ],
        )
    fmus = {component.fmu_name: component.fmu.sha256 for plan in plans for component in plan.components}
    files = {component.fmu.sha256: component.fmu.path for plan in plans for component in plan.components}
    deciding = {"runs": [plan.digest for plan in plans], **design.identity}
    text = json.dumps(deciding, sort_keys=True, separators=(",", ":"))
    sweep_id = hashlib.sha256(text.encode()).hexdigest()[:ID_LENGTH]
    cautions = (caution for plan in plans for caution in plan.cautions)
    notes = list(dict.fromkeys([*_dropped(experiment, design), *_balance(design), *cautions]))
    return Study(experiment, design, sweep_id, fmus, files, _columns(plans), notes)


def changes(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """What a run lays over the file: `set`, and `swap` where the FMU of a component varies.

    A swapped component loses the parameters that the file has for it, as with --swap, and in every run, the file's own
    FMU included: each FMU is at its defaults unless the sweep says otherwise.
    """
    swaps = {components[1]: value for key, value in values.items() if (components := _swapped(key))}
    return {key: value for key, value in cells_of(values).items() if not _swapped(key)}, swaps


def _swapped(key: str) -> list[str]:
    components = split_key(key)
    return components if len(components) == 3 and components[0] == "components" and components[2] == "fmu" else []


def _overruled(varying: Sequence[str], experiment: Experiment) -> list[Problem]:
    """What the command line says and the sweep would say otherwise."""
    swapped = {f"components.{name}.fmu" for name in experiment.changes["swap"]}
    given = [f"--set {key}" for key in experiment.changes["set"] if key in varying]
    given += [f"--swap {key.split('.')[1]}" for key in varying if key in swapped]
    return [Problem(option, "varies in the sweep; change [sweep.vary] instead") for option in given]


def _plans(experiment: Experiment, design: Design, packaging: str, told: Callable[[str], None]) -> list[Plan]:
    """The first draw of every combination.  Raises ExperimentError with the problems of all."""
    first = replace(design, draws=1) if design.method != "lhs" else design
    runs = [run for run in first.runs() if run.draw == design.skip]
    laid = []
    for run in runs:
        sets, swaps = changes(run.values)
        given = experiment.changes
        laid.append(parse(experiment.path, experiment.text, {**given["set"], **sets}, {**given["swap"], **swaps}))
    known = catalogue.known()
    named = sorted({c.fmu for e in laid for c in e.components if c.fmu in known})
    try:
        built, unbuilt = build.build(named, told, packaging=packaging), {}
    except build.BuildError as error:
        built, unbuilt = error.built, error.reasons
    plans: list[Plan] = []
    found: dict[tuple[str, str], list[str]] = {}
    for run, one in zip(runs, laid, strict=True):
        try:
            plans.append(resolve.resolve(one, built, unbuilt))
        except ExperimentError as error:
            listed = {key: value for key, value in run.values.items() if key not in design.distributions}
            where = ", ".join(f"{key} = {value!r}" for key, value in listed.items())
            for problem in error.problems:
                key = problem.key.removeprefix("--set ").removeprefix("--swap ")
                key = f'sweep.vary."{key}"' if key in run.values else problem.key
                found.setdefault((key, problem.sentence), []).append(where)
    if found:
        raise ExperimentError(
            experiment.path,
            [
                Problem(key, sentence if len(where) == len(runs) else f"{sentence} (with {'; '.join(where[:3])})")
                for (key, sentence), where in found.items()
            ],
        )
    return plans


def _columns(plans: Sequence[Plan]) -> list[Column]:
    units: dict[str, str] = {}
    for plan in plans:
        units |= {f"{component}.{variable.name}": variable.unit for component, variable in plan.recorded}
    specs = plans[0].experiment.metrics
    found = []
    for name, spec in specs.items():
        unit = unit_of(spec, units)
        found.append(Column(name, spec["of"], "" if unit == "1" else unit, smaller_is_better(spec)))
    return found


def _dropped(experiment: Experiment, design: Design) -> list[str]:
    swapped = [components[1] for keys, _ in design.lists for key in keys if (components := _swapped(key))]
    return [
        f"{c.name}: its fmu varies, so the file's {', '.join(c.parameters)} apply to no run"
        for c in experiment.components
        if c.name in swapped and c.parameters
    ]


def _balance(design: Design) -> list[str]:
    if design.method != "sobol" or design.draws & (design.draws - 1) == 0:
        return []
    below = 1 << design.draws.bit_length() - 1
    return [f"Sobol points are balanced at powers of two: {below} or {2 * below} draws, not {design.draws}"]
