"""A sweep as one HTML file that needs no network: its statistics, its figures, and how it was made."""

from __future__ import annotations

import json
from html import escape
from importlib import resources
from pathlib import Path

from ....files import write_text
from ....views.figures import svg
from . import figures as plots
from . import tables
from .analysis import SweepAnalysis

KINDS = {
    "box": "Distributions",
    "ecdf": "Empirical distributions",
    "heatmap": "Over two factors",
    "parallel": "Run by run",
}
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>
{style}
figure svg {{ max-width: 100%; height: auto; background: white; }}
</style>
</head>
<body>
<header><h1>{title}</h1><p>{head}</p></header>
<main>
<section id="statistics"><h2>Statistics</h2>{tables}</section>
{figures}
<section id="provenance"><h2>How it was made</h2>{made}</section>
</main>
</body>
</html>
"""


def write(analysis: SweepAnalysis, target: Path) -> Path:
    """Write the page.  Raises StoreError where the file cannot be written."""
    table = analysis.table
    drawn = table.description["distributions"]
    kinds = [kind for kind in KINDS if kind != "heatmap" or len(table.keys) > 1]
    figures = "".join(
        f'<section id="{kind}"><h2>{KINDS[kind]}</h2><figure>{_svg(analysis, kind)}</figure></section>'
        for kind in kinds
    )
    text = PAGE.format(
        title=escape(f"{table.title}: sweep {table.sweep_id}"),
        style=resources.files("orchestrator.views.report").joinpath("style.css").read_text(encoding="utf-8"),
        head=escape(f"{len(table.rows)} runs, {len(table.completed)} completed"),
        tables=tables.html(analysis),
        figures=figures,
        made=f"<h3>Distributions</h3><pre>{escape(json.dumps(drawn, indent=1))}</pre><h3>FMUs</h3>"
        f"<pre>{escape(json.dumps(table.description['fmus'], indent=1))}</pre><h3>Experiment</h3>"
        f"<pre>{escape(table.description['experiment_toml'])}</pre>",
    )
    return write_text(target, text)


def _svg(analysis: SweepAnalysis, kind: str) -> str:
    return svg(plots.figure(analysis, kind), f"{analysis.table.sweep_id}{kind}")
