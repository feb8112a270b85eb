"""Draws the figures whose records, or the code that draws them, have changed, in processes of their own."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ....errors import OrchError
from ....runs.prepare import Report
from ... import processes
from ...progress import CommandProgress
from ..cases.runs import CaseRecord
from ..published.steps import STUDY_STEM
from .figures import FIGURES

CODE = (  # that decides how a figure looks
    f"{__package__}.drawing",
    f"{__package__}.figures",
    "orchestrator.studies.thesis.cases.chapter5",
    "orchestrator.studies.thesis.cases.signals",
    "orchestrator.studies.thesis.published.steps",
    "orchestrator.views.figures",
    "orchestrator.views.figures.panels",
)


def redraw(
    folder: Path,
    numbers: Sequence[str],
    records: Sequence[CaseRecord],
    study: Sequence[Mapping[str, Any]],
    report: Report,
) -> int:
    """Draw what is stale of some figures, and of the step study.  Returns how many that were.

    folder: of the figures.  numbers: of the figures.  records: of all cases that they show.  study: rows of the step
    study, none where it is not asked for.  Raises OrchError where a figure cannot be drawn.
    """
    stamps_file = folder / "stamps.json"
    try:
        stamps = json.loads(stamps_file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        stamps = {}
    digests = {record.case.name: record.plan.digest for record in records}
    fresh = {FIGURES[n].stem: _stamp(n, *(digests[case] for case in FIGURES[n].cases)) for n in numbers}
    if study:
        fresh[STUDY_STEM] = _stamp("study", json.dumps(study))
    stale = [stem for stem, stamp in fresh.items() if stamps.get(stem) != stamp or not _exists(folder / stem)]
    if not stale:
        return 0
    chosen = [n for n in numbers if FIGURES[n].stem in stale]
    paths = {record.case.name: str(record.path) for record in records}
    parts = min(len(chosen), 4 * processes.cores())
    commands = [
        _command(f"figures {k + 1} of {parts}", folder, figures=chosen[k::parts], records=paths) for k in range(parts)
    ]
    if STUDY_STEM in stale:
        commands.append(_command("step study", folder, study=list(study)))
    results = processes.run_all(commands, CommandProgress(len(commands), report, quiet=True))
    if failed := [result for result in results if result.code]:
        raise OrchError("\n".join(f"{result.command.name} cannot be drawn: {result.reason}" for result in failed))
    stamps_file.write_text(json.dumps({**stamps, **fresh}, indent=1), encoding="utf-8")
    return len(stale)


def _command(name: str, folder: Path, **job: Any) -> processes.ChildCommand:
    """The command that draws, see `drawing.main`."""
    stdin = json.dumps({"folder": str(folder), "figures": [], "records": {}, "study": [], **job}).encode()
    return processes.ChildCommand(name=name, arguments=("-m", f"{__package__}.drawing"), stdin=stdin)


def _exists(stem: Path) -> bool:
    return all(stem.with_suffix(suffix).is_file() for suffix in (".png", ".pdf"))


def _stamp(*made_from: str) -> str:
    """The digest of what a figure is made from: records and code."""
    digest = hashlib.sha256("\n".join([*made_from, importlib.metadata.version("matplotlib")]).encode())
    for module in CODE:
        spec = importlib.util.find_spec(module)  # not imported: that would load matplotlib
        if spec is None or spec.origin is None:
            raise ModuleNotFoundError(module)
        digest.update(Path(spec.origin).read_bytes())
    return digest.hexdigest()
