"""A sweep as one HTML file that needs no network: its statistics, its figures, and how it was made."""

from __future__ import annotations

import json
from pathlib import Path

from markupsafe import Markup

from ....files import write_text
from ....views.figures import svg
from ....views.pages import render
from . import figures as plots
from . import tables
from .analysis import SweepAnalysis

KINDS = {
    "box": "Distributions",
    "ecdf": "Empirical distributions",
    "heatmap": "Over two factors",
    "parallel": "Run by run",
}


def write(analysis: SweepAnalysis, target: Path) -> Path:
    """Write the page.  Raises StoreError where the file cannot be written."""
    table = analysis.table
    kinds = [kind for kind in KINDS if kind != "heatmap" or len(table.keys) > 1]
    text = render(
        "studies/sweep/results/sweep.html",
        title=f"{table.title}: sweep {table.sweep_id}",
        head=table.counts,
        tables=(shown := tables.text_tables(analysis)),
        legend=[*([f"Bold: {tables.BEST}"] if tables.has_best(shown) else []), *tables.legend(analysis)],
        figures=[{"kind": kind, "title": KINDS[kind], "svg": Markup(_svg(analysis, kind))} for kind in kinds],
        made={
            "Distributions": json.dumps(table.description["distributions"], indent=1),
            "FMUs": json.dumps(table.description["fmus"], indent=1),
            "Experiment": table.description["experiment_toml"],
        },
    )
    return write_text(target, text)


def _svg(analysis: SweepAnalysis, kind: str) -> str:
    return svg(plots.figure(analysis, kind), f"{analysis.table.sweep_id}{kind}")
