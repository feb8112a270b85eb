"""A reproduction in a few lines for the terminal, and as JSON."""

from __future__ import annotations

import math
from typing import Any

from ....views.tables.terminal import table
from ..published import claims as thesis_claims
from ..published.outcome import Reproduction
from .figures import FIGURES


def text(reproduction: Reproduction, folder: str) -> str:
    """What the command prints: counts, what lies outside its band, the folder of the files."""
    rows = []
    for label, row in reproduction.counts.items():
        gate = f"{row['gated'] - row['outside']} of {row['gated']}" if row["gated"] else "not gated"
        grades = {name: str(n) for name, n in row.items() if name.startswith("within")}
        rows.append({"controller": label, "cells": str(row["cells"]), **grades, "in band": gate})
    lines = table([list(rows[0]), *(list(row.values()) for row in rows)]) if rows else []
    if reproduction.claims:
        lines.append(thesis_claims.tally(reproduction.claims))
    if reproduction.figures:
        lines.append(f"figures: {len(reproduction.figures)}, redrawn: {reproduction.drawn}")
    lines += [f"OUTSIDE  {sentence}" for sentence in reproduction.outside]
    return "\n".join([*lines, folder])


def as_json(reproduction: Reproduction) -> dict[str, Any]:
    """The whole, as JSON can hold it."""
    return {
        "passed": not reproduction.outside,
        "quick": reproduction.quick,
        "counts": reproduction.counts,
        "outside": list(reproduction.outside),
        "cases": {
            r.case.name: {
                "record": f"{r.path.parent.name}/{r.path.name}",
                "run_id": r.path.stem,
                "step": r.plan.experiment.master.step,
                "warnings": list(r.warnings),
            }
            for r in reproduction.records
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
            for v in reproduction.verdicts
        ],
        "claims": [claim.as_json() for claim in reproduction.claims],
        "figures": {
            n: {"title": FIGURES[n].title, "file": f"figures/{FIGURES[n].stem}.png"} for n in reproduction.figures
        },
        "step_study": [dict(row) for row in reproduction.study],
    }
