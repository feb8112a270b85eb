"""`orch report`: records in, one HTML file out, with its script, its style and its numbers inside.

`curves` and `scene` say what of a record is drawn, plotly.js draws it, told by plots.js, scene.js and replay.js;
`facts` and `diagram` are text.  The page forbids itself every request (Content-Security-Policy).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from ...errors import OrchError
from ...files import write_text
from ...records.compare.labels import labels_of
from ...records.compare.vehicles import vehicles
from ..figures.diagram import diagram
from . import curves, facts, scene
from .colours import colours

if TYPE_CHECKING:
    from ...records.file.run import Run

SCRIPTS = ("core.js", "plots.js", "body.js", "scene.js", "replay.js")  # in this order, in one function


def write(runs: Sequence[Run], target: Path) -> Path:
    """Write the report of runs.  Raises OrchError without plotly, StoreError where the file cannot be written."""
    text = page(runs)
    return write_text(target, text)


def page(runs: Sequence[Run]) -> str:
    """The whole page."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise OrchError('orch report draws with plotly, which is not installed; pip install "orch[report]"') from None
    labels = [
        f"{run.run_id}  {what}".strip()
        for run, what in zip(runs, labels_of([run.resolved for run in runs]), strict=True)
    ]
    fleet = [(run, vehicles(run)) for run in runs if len(run.time)]
    shown = [label for run, label in zip(runs, labels, strict=True) if len(run.time)]
    data = {
        "runs": [{"id": run.run_id, "colour": colours(i, 0)} for i, run in enumerate(runs)],
        "keys": curves.keys(fleet, shown),
        "groups": curves.groups(fleet),
        "replay": scene.replay(fleet),
    }
    return Template(_text("template.html")).substitute(
        title=escape(" · ".join(dict.fromkeys(map(facts.title_of, runs)))),
        style=_text("style.css"),
        head=facts.head(runs, labels),
        metrics=facts.numbers(runs, labels),
        diagrams=_diagrams(runs),
        provenance=facts.provenance(runs),
        data=json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c"),
        plotly=get_plotlyjs().replace("</script", "<\\/script"),
        script="\n".join(map(_text, SCRIPTS)),
    )


def _diagrams(runs: Sequence[Run]) -> str:
    """The systems of the runs, each once."""
    drawn: dict[str, list[str]] = {}
    for run in runs:
        names = [vehicle.name for vehicle in vehicles(run)] if len(run.time) else []
        drawn.setdefault(diagram(run.attributes["experiment_resolved"], names), []).append(run.run_id)
    drawn.pop("", None)
    several = len(drawn) > 1
    figures = [
        f'<figure class="scroll" tabindex="0">{svg}'
        + (f"<figcaption>{escape(', '.join(whose))}</figcaption>" if several else "")
        + "</figure>"
        for svg, whose in drawn.items()
    ]
    return f'<section id="system"><h2>System</h2>{"".join(figures)}</section>' if figures else ""


def _text(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
