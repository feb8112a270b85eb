"""A sweep before it runs: its experiment is read, its models are built, every combination of its lists is checked."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ....errors import ExperimentError, Problem
from ....experiment import sweep as sections
from ....experiment.experiment import Experiment
from ....experiment.keys import split_key
from ....experiment.reader import parse
from ....experiment.sweep import SweepSpec
from ....plan import resolve
from ....plan.plan import Plan
from ....records.compare.side_by_side import Column
from ....runs.prepare import Report, build_models, load_experiment
from . import matrix
from .matrix import DesignPoint, cells_of, labels

FORMAT = "orch-sweep"
ID_LENGTH = 10
COLUMNS = (
    "run",
    "draw",
    "run_id",
    "status",
    "stopped_at",
    "warnings",
    "error",
)  # of the table, beside what varies and the metrics


@dataclass(frozen=True, kw_only=True)
class SweepJob:
    """What a worker needs to know of a sweep to run any of its runs.

    path, text: of the experiment; set, swap: of the command line; fmus: {name in the experiment: digest}; folder: of
    the sweep, see `storage`; facts: root attributes of every record.
    """

    path: str
    text: str
    set: Mapping[str, Any]
    swap: Mapping[str, str]
    fmus: Mapping[str, str]
    folder: str
    keep: str
    facts: Mapping[str, str]

    def experiment(self, point: DesignPoint) -> Experiment:
        """The experiment of one row of the design matrix."""
        sets, swaps = changes(point.values)
        return parse(Path(self.path), self.text, {**self.set, **sets}, {**self.swap, **swaps})


@dataclass(frozen=True, kw_only=True)
class PreparedSweep:
    """A sweep that can run.  files: {digest: FMU}; columns: of the metrics; notes: what a user should know."""

    experiment: Experiment
    spec: SweepSpec
    points: Sequence[DesignPoint]
    sweep_id: str
    fmus: Mapping[str, str]  # {name in the experiment: digest}
    files: Mapping[str, Path]
    columns: Sequence[Column]
    notes: Sequence[str]

    @property
    def folder(self) -> str:
        """The name of its folder in the store."""
        return f"{self.experiment.path.stem}-{self.sweep_id}"

    def job(self, results: str, facts: Mapping[str, str]) -> SweepJob:
        """results: the store, a folder or a URL."""
        e = self.experiment
        return SweepJob(
            path=str(e.path.resolve()),
            text=e.text,
            set=e.changes["set"],
            swap=e.changes["swap"],
            fmus=self.fmus,
            folder=f"{results.rstrip('/')}/{self.folder}",
            keep=self.spec.keep,
            facts=facts,
        )

    @property
    def keys(self) -> list[str]:
        """What varies, one name a cell of a run, as in the table."""
        return list(self.points[0].cells)

    def describe(self) -> dict[str, Any]:
        """sweep.json: what is needed to read the table, and to know what it is."""
        e, spec = self.experiment, self.spec
        return {
            "format": FORMAT,
            "format_version": 1,
            "sweep_id": self.sweep_id,
            "experiment": e.path.stem,
            "title": e.title,
            "experiment_toml": e.text,
            "changes": e.changes,
            "draws": spec.draws,
            "skip": spec.skip,
            "design": spec.design,
            "seed": spec.seed,
            "keep": spec.keep,
            "keys": self.keys,
            "labels": labels(self.keys),
            "lists": [[list(keys), [list(row) for row in rows]] for keys, rows in spec.lists],
            "distributions": spec.distributions,
            "fmus": self.fmus,
            "metrics": [asdict(c) for c in self.columns],
        }


def prepare(
    path: str | Path,
    set: Mapping[str, Any] | None = None,
    swap: Mapping[str, str] | None = None,
    packaging: str = "auto",
    report: Report = lambda _: None,
) -> PreparedSweep:
    """Read an experiment, build its models, and check every combination of its lists.

    report: called with what is being built.  Raises ExperimentError with the problems of the file and of every
    combination at once.
    """
    experiment = load_experiment(path, set, swap)
    if not experiment.sweep:
        missing = f"is missing; say under [sweep.vary] what varies, {sections.SUCH_AS}"
        raise ExperimentError(path, [*experiment.problems, Problem("sweep", missing)])
    return prepare_as(experiment, sections.read(experiment.sweep)[0], packaging, report)


def prepare_as(experiment: Experiment, spec: SweepSpec, packaging: str, report: Report) -> PreparedSweep:
    """`prepare` for a sweep in place of the experiment's own."""
    problems = [p for p in sections.incomplete(spec) if p not in experiment.problems]
    problems += _overruled(spec, experiment)
    if not experiment.metrics:
        problems.append(Problem("metrics", "the experiment has none; a sweep is judged by its metrics"))
    taken = {*COLUMNS, *(key for keys, _ in spec.lists for key in keys), *spec.distributions}
    words = "is the name of another column of the sweep's table; give the metric another name"
    problems += [Problem(f"metrics.{name}", words) for name in experiment.metrics if name in taken]
    if problems or any(p.key.startswith("sweep") for p in experiment.problems):
        raise ExperimentError(experiment.path, [*experiment.problems, *problems])
    plans = _plans(experiment, spec, packaging, report)
    live = sorted({component.name for plan in plans for component in plan.components if component.hears})
    if live:
        sentence = "is steered from outside; runs of a sweep must give the same numbers again"
        raise ExperimentError(experiment.path, [Problem(f"components.{name}", sentence) for name in live])
    deciding = {"runs": [plan.digest for plan in plans], **matrix.identity(spec)}
    text = json.dumps(deciding, sort_keys=True, separators=(",", ":"))
    cautions = (caution for plan in plans for caution in plan.cautions)
    return PreparedSweep(
        experiment=experiment,
        spec=spec,
        points=matrix.points(spec),
        sweep_id=hashlib.sha256(text.encode()).hexdigest()[:ID_LENGTH],
        fmus={component.fmu_name: component.fmu.sha256 for plan in plans for component in plan.components},
        files={component.fmu.sha256: component.fmu.path for plan in plans for component in plan.components},
        columns=_columns(plans),
        notes=list(dict.fromkeys([*_dropped(experiment, spec), *_balance(spec), *cautions])),
    )


def changes(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """What a run sets over the file: `set`, and `swap` for components whose FMU varies.

    As with --swap, such a component loses the parameters that the file has for it, in every run, that with the file's
    own FMU included: each FMU has its defaults unless the sweep says otherwise.
    """
    swaps = {parts[1]: value for key, value in values.items() if (parts := _swapped(key))}
    return {key: value for key, value in cells_of(values).items() if not _swapped(key)}, swaps


def _swapped(key: str) -> list[str]:
    parts = split_key(key)
    return parts if len(parts) == 3 and parts[0] == "components" and parts[2] == "fmu" else []


def _overruled(spec: SweepSpec, experiment: Experiment) -> list[Problem]:
    """Keys that the command line sets although they vary in the sweep, or lie in a table that does."""
    varying = [split_key(key) for key in (*spec.distributions, *(key for keys, _ in spec.lists for key in keys))]
    given = [
        f"--set {key}"
        for key in experiment.changes["set"]
        if any(split_key(key)[: len(parts)] == parts for parts in varying)
    ]
    given += [f"--swap {name}" for name in experiment.changes["swap"] if ["components", name, "fmu"] in varying]
    return [Problem(option, "varies in the sweep; change [sweep.vary] instead") for option in given]


def _plans(experiment: Experiment, spec: SweepSpec, packaging: str, report: Report) -> list[Plan]:
    """The first draw of every combination.  Raises ExperimentError with the problems of all."""
    first = replace(spec, draws=1) if spec.design != "lhs" else spec
    points = [point for point in matrix.points(first) if point.draw == spec.skip]
    experiments = []
    for point in points:
        sets, swaps = changes(point.values)
        sets, swaps = {**experiment.changes["set"], **sets}, {**experiment.changes["swap"], **swaps}
        experiments.append(parse(experiment.path, experiment.text, sets, swaps))
    built, unbuilt = build_models({c.fmu: packaging for e in experiments for c in e.components}, report)
    plans: list[Plan] = []
    problems: dict[tuple[str, str], list[str]] = {}  # {key and sentence: the combinations that have it}
    for point, one in zip(points, experiments, strict=True):
        try:
            plans.append(resolve.resolve(one, built, unbuilt))
        except ExperimentError as error:
            listed = {key: value for key, value in point.values.items() if key not in spec.distributions}
            where = ", ".join(f"{key} = {value!r}" for key, value in listed.items())
            for problem in error.problems:
                key = problem.key.removeprefix("--set ").removeprefix("--swap ")
                key = f'sweep.vary."{key}"' if key in point.values else problem.key
                problems.setdefault((key, problem.sentence), []).append(where)
    if problems:
        raise ExperimentError(
            experiment.path,
            [
                Problem(key, sentence if len(where) == len(points) else f"{sentence} (with {'; '.join(where[:3])})")
                for (key, sentence), where in problems.items()
            ],
        )
    return plans


def _columns(plans: Sequence[Plan]) -> list[Column]:
    """Raises ExperimentError where a metric has not the same unit in every combination."""
    angles = {name for plan in plans for name in plan.angles}
    columns, problems = [], []
    for name, spec in plans[0].experiment.metrics.items():
        of = dict.fromkeys(Column.of_spec(name, spec, plan.units, angles) for plan in plans)
        columns.append(next(iter(of)))
        if len(of) > 1:
            units = " and in ".join(repr(column.unit or "1") for column in of)
            sentence = f"is in {units}, by what the FMUs that vary declare; say in which: unit = ..."
            problems.append(Problem(f"metrics.{name}", sentence))
    if problems:
        raise ExperimentError(plans[0].experiment.path, problems)
    return columns


def _dropped(experiment: Experiment, spec: SweepSpec) -> list[str]:
    swapped = [parts[1] for keys, _ in spec.lists for key in keys if (parts := _swapped(key))]
    return [
        f"{c.name}: its fmu varies, so the file's {', '.join(c.parameters)} apply to no run"
        for c in experiment.components
        if c.name in swapped and c.parameters
    ]


def _balance(spec: SweepSpec) -> list[str]:
    if spec.design != "sobol" or spec.draws & (spec.draws - 1) == 0:
        return []
    below = 1 << spec.draws.bit_length() - 1
    return [f"Sobol points are balanced at powers of two: {below} or {2 * below} draws, not {spec.draws}"]
