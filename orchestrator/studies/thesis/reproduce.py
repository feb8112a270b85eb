"""`orch reproduce thesis`: run the thesis's cases, judge its tables and claims, draw its figures."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import OrchError, StoreError
from ...files import write_text
from ...runs.prepare import Report
from .cases.chapter5 import CASES, Case, spirals
from .cases.extremes import extremes_of
from .cases.runs import CaseRecord, run_cases
from .pages import index, summary
from .pages.figures import FIGURES
from .pages.redraw import redraw
from .published import claims as thesis_claims
from .published import claims_gripping, claims_spiral
from .published import steps as thesis_steps
from .published import tables as thesis_tables
from .published.claims import Claim
from .published.outcome import Reproduction
from .published.tables import CAPTIONS

FOLDER = "_thesis"
EVERY_STEP = "every_step"  # in it
FORMS = {"md": thesis_tables.markdown, "csv": thesis_tables.csv_text, "tex": thesis_tables.latex}


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
        cases = [CASES[n].quick() if quick else CASES[n] for n in CASES if n in names]
        return cases + (thesis_steps.cases() if self.study else [])


def reproduce(
    only: Sequence[str] = (), quick: bool = False, results: str | Path = "results", report: Report = lambda _: None
) -> Reproduction:
    """Rebuild the thesis's tables, claims and figures in RESULTS/_thesis.

    only: tables and figures, such as "5.2", "fig5.57", "claims", "steps"; none is all of it.  quick: coarser steps and
    no step study.  report: called with a line for each case.  Cases whose records are in the store are not run again,
    figures whose records have not changed are not drawn again.
    Raises OrchError where a name is unknown or a case cannot run, RunError where one fails.
    """
    selection = select(only, quick)
    folder = Path(results) / FOLDER
    try:
        (folder / "figures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder} cannot be written: {error.strerror}") from None
    records = run_cases(selection.cases(quick), results, report)
    split = len(records) - (len(thesis_steps.cases()) if selection.study else 0)
    main, studied = records[:split], records[split:]
    verdicts = [v for v in thesis_tables.judge(_metrics(main)) if v.cell.table in selection.tables]
    claims = _claims(main, folder / EVERY_STEP, report) if selection.claims else []
    study = thesis_steps.rows([record.metrics for record in studied]) if studied else []
    drawn = redraw(folder / "figures", selection.figures, main, study, report)
    outside = [v.sentence() for v in verdicts if v.met is False] + [c.sentence() for c in claims if c.fails]
    reproduction = Reproduction(
        folder=folder,
        records=tuple(main),
        verdicts=tuple(verdicts),
        claims=tuple(claims),
        figures=selection.figures,
        drawn=drawn,
        outside=tuple(outside),
        study=tuple(study),
        quick=quick,
    )
    _write(reproduction, selection)
    return reproduction


def select(only: Sequence[str], quick: bool = False) -> Selection:
    """What the names mean.  A bare 5.2 to 5.7 is the table, fig5.2 the figure.  Raises OrchError for an unknown one."""
    if not only:
        return Selection(tuple(CAPTIONS), tuple(FIGURES), claims=True, study=not quick, whole=True)
    chosen = Selection((), (), claims=False, study=False)
    for name in only:
        match = re.fullmatch(r"(tab|table|fig|figure)?[ ._]?(5[._]0?\d+)", name.strip().lower())
        kind, number = (match[1] or "", match[2].replace("_", ".").replace(".0", ".")) if match else ("", "")
        if name == "claims":
            chosen = replace(chosen, claims=True)
        elif name == "steps":
            chosen = replace(chosen, study=True)
        elif number in CAPTIONS and not kind.startswith("fig"):
            chosen = replace(chosen, tables=(*chosen.tables, number))
        elif number in FIGURES and not kind.startswith("tab"):
            chosen = replace(chosen, figures=(*chosen.figures, number))
        else:
            raise OrchError(
                f"--only {name}: nothing has that name; name one of the tables 5.2 to 5.7 (5.2, table5.2) or the "
                "figures 5.1 to 5.80 (5.57, fig5.2), claims, or steps"
            )
    return chosen


def _metrics(records: Iterable[CaseRecord]) -> dict[str, Mapping[str, float]]:
    return {record.case.name: record.metrics for record in records}


def _claims(records: Sequence[CaseRecord], folder: Path, report: Report) -> list[Claim]:
    """All claims, judged at every step.  folder: of what the runs reach in their steps."""
    of = extremes_of([record.case for record in records], folder, report)
    verdicts = thesis_tables.judge(_metrics(records))
    return claims_spiral.claims(of, verdicts) + claims_gripping.claims(of)


def _write(reproduction: Reproduction, selection: Selection) -> None:
    """Tables, claims and study as files; with everything selected the index and the summary, too."""
    folder, study = reproduction.folder, reproduction.study
    for table in selection.tables:
        stem = f"table_{table.replace('.', '_')}"
        for suffix, form in FORMS.items():
            write_text(folder / f"{stem}.{suffix}", form(table, reproduction.verdicts))
    if reproduction.claims:
        write_text(folder / "claims.md", thesis_claims.markdown(reproduction.claims))
    if study:
        write_text(folder / f"{thesis_steps.STUDY_STEM}.csv", thesis_steps.csv_text(study))
    if selection.whole:
        write_text(folder / "summary.json", json.dumps(summary.as_json(reproduction), indent=1) + "\n")
        write_text(folder / "index.html", index.page(reproduction))
