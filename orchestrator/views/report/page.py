"""`orch report`: records in, one HTML file out, with its script, its style and its numbers inside.

`curves` and `scene` choose what of a record is drawn; plots.js, scene.js and replay.js draw it with plotly.js.  `facts`
is the text.  The page's Content-Security-Policy forbids every request.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from ...errors import OrchError
from ...files import write_text
from ...records.compare.labels import labels_of
from ...records.compare.vehicles import vehicles
from ...records.file.marks import marked
from ..figures.diagram import diagram
from ..pages import render
from . import curves, facts, scene
from .colours import colours

if TYPE_CHECKING:
    from ...records.file.run import Run


def write(runs: Sequence[Run], target: Path) -> Path:
    """Write the report of runs.  Raises OrchError without plotly, StoreError where the file cannot be written."""
    return write_text(target, page(runs))


def page(runs: Sequence[Run]) -> str:
    """The whole page."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise OrchError('orch report draws with plotly, which is not installed; pip install "orch[report]"') from None
    labels = [
        f"{run.run_id}  {marked(run.standing, what)}".strip()
        for run, what in zip(runs, labels_of([run.resolved for run in runs]), strict=True)
    ]
    fleet = [(run, vehicles(run)) for run in runs if len(run.time)]
    shown = [label for run, label in zip(runs, labels, strict=True) if len(run.time)]
    groups = curves.groups(fleet)
    data = {
        "runs": [{"id": run.run_id, "colour": colours(i, 0)} for i, run in enumerate(runs)],
        "keys": [*curves.keys(fleet, shown), *curves.band_keys(groups)],
        "groups": groups,
        "replay": scene.replay(fleet),
    }
    titles = list(dict.fromkeys(map(facts.title_of, runs)))
    return render(
        "views/report/report.html",
        title=" · ".join(titles),
        titles=titles,
        several=len(runs) > 1,
        runs=[facts.of(run, label) for run, label in zip(runs, labels, strict=True)],
        metrics=facts.numbers(runs, labels),
        diagrams=_diagrams(runs),
        data=Markup(json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")),
        plotly=Markup(get_plotlyjs().replace("</script", "<\\/script")),
    )


def _diagrams(runs: Sequence[Run]) -> list[dict[str, str]]:
    """The systems of the runs, each once, and the runs that have it."""
    drawn: dict[str, list[str]] = {}
    for run in runs:
        names = [vehicle.name for vehicle in vehicles(run)] if len(run.time) else []
        drawn.setdefault(diagram(run.attributes["experiment_resolved"], names), []).append(run.run_id)
    return [{"svg": Markup(svg), "runs": ", ".join(whose)} for svg, whose in drawn.items() if svg]
