"""The index page of `orch reproduce thesis`: one HTML file, light and dark, readable on a phone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from markupsafe import Markup, escape

from ....views.pages import render
from ..cases.chapter5 import CASES
from ..published import claims as thesis_claims
from ..published import steps as thesis_steps
from ..published.outcome import Reproduction
from ..published.tables import CAPTIONS, Verdict, best
from .figures import FIGURES

CLASSES = {thesis_claims.HOLDS: "good", thesis_claims.PARTLY: "mid", thesis_claims.FAILS: "bad"}


def page(reproduction: Reproduction) -> str:
    """The whole page.  Images are linked relative to it."""
    counts = reproduction.counts
    names = list(next(iter(counts.values())))
    return render(
        "studies/thesis/pages/index.html",
        title="The thesis, reproduced",
        outside=reproduction.outside,
        quick=reproduction.quick,
        counts={
            "heads": ["controller", *names],
            "rows": [[label, *(row[name] for name in names)] for label, row in counts.items()],
        },
        runs=[
            [r.case.name, f"{r.plan.experiment.master.step * 1e3:g} ms", r.path.stem, len(r.warnings) or ""]
            for r in reproduction.records
        ],
        tables=[_table(table, reproduction.verdicts) for table in CAPTIONS],
        tally=thesis_claims.tally(reproduction.claims),
        claims=reproduction.claims,
        classes=CLASSES,
        figures={number: FIGURES[number] for number in reproduction.figures},
        known=FIGURES,
        study={"stem": thesis_steps.STUDY_STEM, "title": thesis_steps.CAPTION} if reproduction.study else None,
    )


def _table(table: str, verdicts: Iterable[Verdict]) -> dict[str, Any]:
    """One table in the thesis's layout: controllers down, quantities across."""
    cells = [v for v in verdicts if v.cell.table == table]
    _, ours = best(cells)
    quantities = list(dict.fromkeys(v.cell.quantity for v in cells))
    rows = []
    for case in dict.fromkeys(v.cell.case for v in cells):
        row = []
        for quantity in quantities:
            (v,) = [v for v in cells if v.cell.case == case and v.cell.quantity == quantity]
            row.append(
                {
                    "ours": f"{v.ours:.4f}",
                    "best": v.cell in ours,
                    "published": f"{v.cell.corrected:.4f}",
                    "error": f"{100 * v.error:+.1f} %" if abs(v.error) < 1e3 else "-",
                    "hue": {True: "good", False: "bad", None: "soft"}[v.met],
                    "note": v.cell.note,
                }
            )
        rows.append({"label": _label(case), "cells": row})
    units = {v.cell.quantity: v.cell.unit for v in cells}
    return {
        "number": table,
        "caption": CAPTIONS[table],
        "stem": f"table_{table.replace('.', '_')}",
        "heads": [q.replace("_", " ") + ("" if units[q] == "1" else f" [{units[q]}]") for q in quantities],
        "rows": rows,
        "notes": list(dict.fromkeys(v.cell.note for v in cells if v.cell.note)),
    }


def _label(case: str) -> Markup:
    return escape(CASES[case].label).replace("$t_b$", Markup("t<sub>b</sub>"))
