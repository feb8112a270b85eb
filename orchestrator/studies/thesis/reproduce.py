"""`orch reproduce thesis`: run the thesis's cases, judge its tables and claims, draw its figures."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...errors import OrchError, StoreError
from ...models import catalogue
from ...records.file.run import Run
from .. import processes
from .cases import signals as thesis_signals
from .cases.chapter5 import CASES, Case, grippings, spirals
from .cases.runs import Progress, Record, Tell, reason, run_cases
from .pages.figures import FIGURES
from .published import claims as thesis_claims
from .published import claims_gripping, claims_spiral
from .published import steps as thesis_steps
from .published import tables as thesis_tables
from .published.claims import Claim
from .published.tables import CAPTIONS, Verdict

FOLDER = "_thesis"
FORMS = {"md": thesis_tables.markdown, "csv": thesis_tables.csv_text, "tex": thesis_tables.latex}
DRAWING = ("thesis/drawing", "thesis/figures", "thesis/signals", "thesis/cases", "thesis/steps", "panels")


@dataclass(frozen=True)
class Selection:
    """What to do: numbers of tables and figures, the claims, the step study."""

    tables: tuple[str, ...]
    figures: tuple[str, ...]
    claims: bool
    study: bool
    whole: bool = False

    def cases(self, quick: bool) -> list[Case]:
        """The runs that it needs, each once, those of the step study last."""
        names = [c.name for t in self.tables for c in spirals(currents=t in ("5.5", "5.6", "5.7"))]
        names += [name for number in self.figures for name in FIGURES[number].cases]
        names += list(CASES) if self.claims else []
        found = [CASES[n].quick() if quick else CASES[n] for n in CASES if n in names]
        return found + (thesis_steps.cases() if self.study else [])


@dataclass(frozen=True)
class Outcome:
    """What came of it.  outside: a sentence for every gated cell and claim that is not met."""

    folder: Path
    records: tuple[Record, ...]
    verdicts: tuple[Verdict, ...]
    claims: tuple[Claim, ...]
    figures: tuple[str, ...]
    drawn: int
    outside: tuple[str, ...]
    study: tuple[Mapping[str, Any], ...]
    quick: bool

    @property
    def counts(self) -> dict[str, dict[str, int]]:
        return thesis_tables.counts(self.verdicts)


def reproduce(
    only: Sequence[str] = (), quick: bool = False, results: str | Path = "results", tell: Tell = lambda _: None
) -> Outcome:
    """Rebuild the thesis's tables, claims and figures in RESULTS/_thesis.

    only: tables and figures, such as "5.2", "fig5.57", "claims", "steps"; none is all of it.  quick: coarser steps and
    no step study.  tell: called with a line for each case.  Records that the store has are not run again, figures whose
    records have not changed are not drawn again.
    Raises OrchError where a name is unknown or a case cannot run, RunError where one fails.
    """
    selection = select(only, quick)
    folder = Path(results) / FOLDER
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder} cannot be written: {error.strerror}") from None
    records = run_cases(selection.cases(quick), results, tell)
    split = len(records) - (len(thesis_steps.cases()) if selection.study else 0)
    main, studied = records[:split], records[split:]
    verdicts = [v for v in thesis_tables.judge(_metrics(main)) if v.cell.table in selection.tables]
    claims = _claims(main) if selection.claims else []
    study = thesis_steps.rows([record.metrics for record in studied]) if studied else []
    drawn = _draw(folder / "figures", selection.figures, main, study, tell)
    outside = [v.sentence() for v in verdicts if v.met is False] + [c.sentence() for c in claims if c.fails]
    outcome = Outcome(
        folder,
        tuple(main),
        tuple(verdicts),
        tuple(claims),
        selection.figures,
        drawn,
        tuple(outside),
        tuple(study),
        quick,
    )
    _write(outcome, selection)
    return outcome


def select(only: Sequence[str], quick: bool = False) -> Selection:
    """What the names mean.  A bare 5.2 to 5.7 is the table, fig5.2 the figure.  Raises OrchError for an unknown one."""
    if not only:
        return Selection(tuple(CAPTIONS), tuple(FIGURES), claims=True, study=not quick, whole=True)
    found = Selection((), (), claims=False, study=False)
    for name in only:
        match = re.fullmatch(r"(tab|table|fig|figure)?[ ._]?(5[._]0?\d+)", name.strip().lower())
        kind, number = (match[1] or "", match[2].replace("_", ".").replace(".0", ".")) if match else ("", "")
        if name == "claims":
            found = replace(found, claims=True)
        elif name == "steps":
            found = replace(found, study=True)
        elif number in CAPTIONS and not kind.startswith("fig"):
            found = replace(found, tables=(*found.tables, number))
        elif number in FIGURES and not kind.startswith("tab"):
            found = replace(found, figures=(*found.figures, number))
        else:
            raise OrchError(
                f"--only {name}: there are the tables 5.2 to 5.7 (5.2, table5.2), the figures 5.1 to 5.80 "
                "(5.57, fig5.2), claims and steps"
            )
    return found


def _metrics(records: Iterable[Record]) -> dict[str, Mapping[str, float]]:
    return {record.case.name: record.metrics for record in records}


def _claims(records: Sequence[Record]) -> list[Claim]:
    paths = {record.case.name: record.path for record in records}
    alone, pairs = {}, {}
    for case in [*spirals(False), *spirals(True)]:
        with Run(paths[case.name]) as run:
            alone[case.name] = thesis_signals.track(run)
    for case in [*grippings(False), *grippings(True)]:
        with Run(paths[case.name]) as run:
            pairs[case.name] = (thesis_signals.track(run, "1"), thesis_signals.track(run, "2"))
    return claims_spiral.claims(alone, thesis_tables.judge(_metrics(records))) + claims_gripping.claims(pairs)


def _draw(
    folder: Path, numbers: Sequence[str], records: Sequence[Record], study: Sequence[Mapping[str, Any]], tell: Tell
) -> int:
    """Draw the figures whose records, or the code that draws them, have changed.  Returns how many that were."""
    stamps_file = folder / "stamps.json"
    try:
        stamps = json.loads(stamps_file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        stamps = {}
    digests = {record.case.name: record.plan.digest for record in records}
    wanted = {FIGURES[n].stem: _stamp(n, *(digests[case] for case in FIGURES[n].cases)) for n in numbers}
    if study:
        wanted[thesis_steps.STUDY_STEM] = _stamp("study", json.dumps(study))
    stale = [stem for stem, stamp in wanted.items() if stamps.get(stem) != stamp or not _drawn(folder / stem)]
    if not stale:
        return 0
    chosen = [n for n in numbers if FIGURES[n].stem in stale]
    paths = {record.case.name: str(record.path) for record in records}
    with tempfile.TemporaryDirectory() as scratch:
        jobs = []
        for k in range(parts := min(len(chosen), 4 * processes.cores())):
            job = {"folder": str(folder), "figures": chosen[k::parts], "records": paths}
            jobs.append(_drawing_job(Path(scratch) / f"{k}.json", job, f"figures {k + 1} of {parts}"))
        if thesis_steps.STUDY_STEM in stale:
            study_job = {"folder": str(folder), "figures": [], "records": {}, "study": list(study)}
            jobs.append(_drawing_job(Path(scratch) / "study.json", study_job, "step study"))
        failed = [done for done in processes.run_all(jobs, Progress(len(jobs), tell, quiet=True).told) if done.code]
    if failed:
        raise OrchError("\n".join(f"{done.job.name} cannot be drawn: {reason(done)}" for done in failed))
    stamps_file.write_text(json.dumps({**stamps, **wanted}, indent=1), encoding="utf-8")
    return len(stale)


def _drawing_job(path: Path, job: Mapping[str, Any], name: str) -> processes.Job:
    path.write_text(json.dumps(job), encoding="utf-8")
    return processes.Job(name, ("-m", "orchestrator.studies.thesis.pages.drawing", str(path)))


def _drawn(stem: Path) -> bool:
    return all(stem.with_suffix(suffix).is_file() for suffix in (".png", ".pdf"))


def _stamp(*parts: str) -> str:
    """What a figure is made from: records and code."""
    digest = hashlib.sha256("\n".join([*parts, importlib.metadata.version("matplotlib")]).encode())
    for module in DRAWING:
        digest.update((catalogue.PACKAGE / f"{module}.py").read_bytes())
    return digest.hexdigest()


def _write(outcome: Outcome, selection: Selection) -> None:
    """Tables, claims and study as files; with everything selected the index and the summary, too."""
    from .pages import index

    folder = outcome.folder
    for table in selection.tables:
        stem = f"table_{table.replace('.', '_')}"
        for suffix, form in FORMS.items():
            (folder / f"{stem}.{suffix}").write_text(form(table, outcome.verdicts), encoding="utf-8")
    if outcome.claims:
        (folder / "claims.md").write_text(thesis_claims.markdown(outcome.claims), encoding="utf-8")
    if outcome.study:
        (folder / f"{thesis_steps.STUDY_STEM}.csv").write_text(thesis_steps.csv_text(outcome.study), encoding="utf-8")
    if selection.whole:
        (folder / "summary.json").write_text(json.dumps(summary(outcome), indent=1) + "\n", encoding="utf-8")
        (folder / "index.html").write_text(index.page(outcome), encoding="utf-8")


def report(outcome: Outcome, folder: str) -> str:
    """What the command prints: counts, what lies outside, where the rest is."""
    lines = []
    for label, row in outcome.counts.items():
        gate = f"{row['gated'] - row['outside']} of {row['gated']} in band" if row["gated"] else "not gated"
        grades = ", ".join(f"{n} {name}" for name, n in row.items() if name.startswith("within"))
        lines.append(f"{label}: {row['cells']} cells, {grades}; {gate}")
    if outcome.claims:
        lines.append(thesis_claims.tally(outcome.claims))
    if outcome.figures:
        lines.append(f"figures: {len(outcome.figures)}, drawn anew: {outcome.drawn}")
    lines += [f"OUTSIDE  {sentence}" for sentence in outcome.outside]
    return "\n".join([*lines, folder])


def summary(outcome: Outcome) -> dict[str, Any]:
    """The whole as JSON holds it."""
    return {
        "passed": not outcome.outside,
        "quick": outcome.quick,
        "counts": outcome.counts,
        "outside": list(outcome.outside),
        "cases": {
            r.case.name: {
                "record": f"{r.path.parent.name}/{r.path.name}",
                "run_id": r.path.stem,
                "step": r.plan.experiment.master.step,
                "warnings": list(r.warnings),
            }
            for r in outcome.records
        },
        "cells": [
            {
                "table": v.cell.table,
                "case": v.cell.case,
                "quantity": v.cell.quantity,
                "unit": v.cell.unit,
                "published": v.cell.corrected,
                "ours": v.ours,
                "relative_error": v.error if math.isfinite(v.error) else None,
                "band": v.cell.band,
                "verdict": v.word,
            }
            for v in outcome.verdicts
        ],
        "claims": [claim.as_json() for claim in outcome.claims],
        "figures": {n: {"title": FIGURES[n].title, "file": f"figures/{FIGURES[n].stem}.png"} for n in outcome.figures},
        "step_study": [dict(row) for row in outcome.study],
    }
