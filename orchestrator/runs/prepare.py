"""The only road from the path of an experiment to a plan: the file is read, stale models are built, names resolved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..experiment.experiment import Experiment
from ..experiment.keys import split_key
from ..experiment.reader import load, parse
from ..models import build, catalogue
from ..plan.plan import Plan
from ..plan.resolve import resolve

if TYPE_CHECKING:
    from .checkpoint.file import Checkpoint

Report = Callable[[str], None]


def _ignore(message: str) -> None:
    """The `report` of those who do not listen."""


def prepare(
    path: str | Path | None = None,
    set: Mapping[str, Any] | None = None,
    swap: Mapping[str, str] | None = None,
    *,
    packaging: str = "auto",
    start_from: str | Path | None = None,
    report: Report = _ignore,
) -> Plan:
    """The plan of an experiment, its stale models built.

    path: a .toml or .ssp; with `start_from` it may be None: then the experiment is the checkpoint's, and `set` and
    `swap` lie over those that it had.  set: {dotted key: value} laid over the file.  swap: {component: FMU}; in a run
    that goes on from a checkpoint, these components are initialized there.  packaging: of named models, "native",
    "python", or "auto": native where there is a C compiler; components that go on from a checkpoint keep theirs.
    report: called with each model that is built.
    Raises ExperimentError with every problem of the file, its FMUs and the checkpoint, StoreError where the checkpoint
    cannot be read, BuildError where no model can be built, for one reason.
    """
    if start_from is not None:
        return _continued(start_from, path, set or {}, swap or {}, packaging, report)
    if path is None:
        raise TypeError("give the path of an experiment, or start_from a checkpoint")
    experiment = load_experiment(path, set, swap)
    return resolve(experiment, *build_models({c.fmu: packaging for c in experiment.components}, report))


def load_experiment(
    path: str | Path, set: Mapping[str, Any] | None = None, swap: Mapping[str, str] | None = None
) -> Experiment:
    """Read an experiment, a .ssp by that suffix, all else as TOML; arguments and errors as of `reader.load`."""
    if Path(path).suffix.lower() == ".ssp":
        from ..ssp import importing

        return importing.load(Path(path), set, swap)
    return load(path, set, swap)


def build_models(packagings: Mapping[str, str], report: Report = _ignore) -> tuple[dict[str, Path], dict[str, str]]:
    """Build what is stale of some models.

    packagings: {name: its packaging, see `prepare`}; names of other FMUs are passed over.  Returns {model: its FMU} and
    {model: why it cannot be built}.  Raises BuildError where several cannot, all for the same reason: then it is that
    of no component.
    """
    known, built, unbuilt = catalogue.known(), dict[str, Path](), dict[str, str]()
    wanted = {name: packaging for name, packaging in packagings.items() if name in known}
    for packaging in sorted({*wanted.values()}):
        names = sorted(name for name, its in wanted.items() if its == packaging)
        try:
            built |= build.build(names, report, packaging=packaging)
        except build.BuildError as error:
            if len(error.reasons) > 1 and len({*error.reasons.values()}) == 1:
                raise
            built |= error.built
            unbuilt |= error.reasons
    return built, unbuilt


def _continued(
    start_from: str | Path,
    path: str | Path | None,
    set: Mapping[str, Any],
    swap: Mapping[str, str],
    packaging: str,
    report: Report,
) -> Plan:
    """`prepare` for a run that goes on from a checkpoint."""
    from .checkpoint.file import open_checkpoint
    from .checkpoint.fit import attach

    checkpoint = open_checkpoint(start_from)
    experiment = load_experiment(path, set, swap) if path is not None else _saved(checkpoint, set, swap)
    packagings = {c.fmu: packaging for c in experiment.components}
    for c in experiment.components:
        if c.name not in swap and c.name in checkpoint.components:
            packagings[c.fmu] = checkpoint.components[c.name]["packaging"]
    return attach(resolve(experiment, *build_models(packagings, report)), checkpoint, swap)


def _saved(checkpoint: Checkpoint, set: Mapping[str, Any], swap: Mapping[str, str]) -> Experiment:
    """The experiment of a checkpoint; what was set for a component that is swapped now does not apply to it."""
    about = checkpoint.about
    kept = {key: value for key, value in about["changes"]["set"].items() if _component_of(key) not in swap}
    return parse(
        Path(about["experiment"]), about["experiment_toml"], {**kept, **set}, {**about["changes"]["swap"], **swap}
    )


def _component_of(key: str) -> str:
    """The component that a dotted key is about, or ""."""
    parts = split_key(key)
    return parts[1] if len(parts) > 1 and parts[0] == "components" else ""
