"""The parts of the page that are text: what ran, how it ended, its numbers.  Everything from a record is escaped."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from ... import metrics
from ...files import short

if TYPE_CHECKING:
    from ...records.file.run import Run

CUT = 12  # digits of a digest in a table


def head(runs: Sequence[Run], labels: Sequence[str]) -> str:
    """Titles, how each run ended, errors and warnings."""
    several = len(runs) > 1
    parts = [f"<h1>{escape(title)}</h1>" for title in dict.fromkeys(map(title_of, runs))]
    parts.append('<ul class="runs">')
    for i, (run, label) in enumerate(zip(runs, labels, strict=True)):
        facts = run.attributes
        good = "good" if run.status == "completed" else "bad"
        chip = f'<i class="chip" data-colour="run{i}"></i>' if several else ""
        last = f"{run.time[-1]:.6g} s" if len(run.time) else "no row"
        parts.append(
            f'<li>{chip}<b class="{good}">{escape(run.status)}</b> <span>{escape(label)}</span> <span class="soft">'
            f"{last} in steps of {facts['step']:g} s, {escape(str(facts['algorithm']))}; "
            f"wall time {facts['wall_time']:.3g} s, {facts['real_time_factor']:.3g} × real time</span></li>"
        )
    parts.append("</ul>")
    for run in runs:
        whose = f"{escape(run.run_id)}: " if several else ""
        if error := run.attributes["error"]:
            at = f" at t = {run.attributes['failed_at']:.10g} s" if "failed_at" in run.attributes else ""
            what = f"<b>{whose}failed{at}.</b><pre>{escape(error)}</pre>"
            parts.append(f'<div class="note bad" role="alert">{what}</div>')
        if "stopped_at" in run.attributes:
            parts.append(f'<p class="note">{whose}an FMU ended the run at {run.attributes["stopped_at"]:.10g} s.</p>')
        parts += [f'<p class="note mid"><b>{whose}warning.</b> {escape(w)}</p>' for w in run.attributes["warnings"]]
    return "\n".join(parts)


def title_of(run: Run) -> str:
    return str(run.attributes["title"] or run.attributes["experiment"])


def numbers(runs: Sequence[Run], labels: Sequence[str]) -> str:
    """The metrics, runs beside each other; "" where there is none."""
    specs: dict[str, Mapping[str, Any]] = {}
    for run in runs:
        specs |= run.attributes["experiment_resolved"].get("metrics", {})
    values = [run.metrics for run in runs]
    names = [name for name in specs if any(name in v for v in values)]
    if not names:
        return ""
    units = {name: run.units(name) for run in reversed(runs) for name in run.signals}
    rows = []
    for name in names:
        unit = metrics.unit_of(specs[name], units)
        shown = [_number(v[name]) if name in v else "" for v in values]
        rows.append([escape(name), *shown, "" if unit == "1" else escape(unit), escape(_meaning(specs[name]))])
    heads = ["metric", *(labels if len(runs) > 1 else ["value"]), "unit", "of"]
    return _section("metrics", "Metrics", table(heads, rows, words=(0, len(heads) - 2, len(heads) - 1)))


def provenance(runs: Sequence[Run]) -> str:
    """What made each record, from the command line to the digests of the FMUs."""
    parts = []
    for i, run in enumerate(runs):
        facts = run.attributes
        made = [
            ("record", escape(short(run.path))),
            ("run id", _code(run.run_id)),
            ("digest", _code(str(facts["digest"]))),
            ("created", escape(str(facts["created"]))),
            ("command", _code(shlex.join(facts["command"]))),
            ("git commit", _code(str(facts["git_commit"])) if facts["git_commit"] else "unknown"),
            ("versions", escape(", ".join(f"{name} {version}" for name, version in facts["versions"].items()))),
            ("platform", escape(str(facts["platform"]))),
            ("seed", escape(str(facts.get("seed", "")))),
            ("rows", f"{len(run.time)} of {len(run.signals)} signals"),
        ]
        listed = "".join(f"<dt>{name}</dt><dd>{value}</dd>" for name, value in made if value)
        whole = f'<dl>{listed}</dl>{_components(run)}<details><summary>Experiment file</summary><pre tabindex="0">'
        whole += f"{escape(str(facts['experiment_toml']))}</pre></details>"
        if len(runs) > 1:
            opened = " open" if i == 0 else ""
            whole = f"<details{opened}><summary>Run {escape(run.run_id)}</summary>{whole}</details>"
        parts.append(whole)
    return _section("provenance", "Provenance", "\n".join(parts))


def _components(run: Run) -> str:
    rows = []
    for component in run.attributes["experiment_resolved"].get("components", []):
        name, fmu, digest = (str(component.get(key, "")) for key in ("name", "fmu", "fmu_sha256"))
        attributes = run.file[name].attrs if name in run.file else {}  # a component of which nothing was recorded
        packed = " ".join(str(attributes.get(key, "")) for key in ("packaging", "fmi_version"))
        parameters = ", ".join(f"{k} = {json.dumps(v)}" for k, v in component.get("parameters", {}).items())
        rows.append(
            [
                escape(name),
                escape(fmu),
                escape(packed),
                f'<code title="{escape(digest)}">{escape(digest[:CUT])}</code>',
                f"<small>{escape(parameters)}</small>",
            ]
        )
    heads = ["component", "FMU", "packaging, FMI", "SHA-256", "parameters"]
    return table(heads, rows, words=range(5)) if rows else ""


def table(heads: Iterable[str], rows: Iterable[Sequence[str]], words: Iterable[int]) -> str:
    """A table that scrolls within itself.  rows: HTML; words: the columns that are no numbers."""
    left = set(words)
    names = "".join(f'<th scope="col"{_align(i in left)}>{escape(name)}</th>' for i, name in enumerate(heads))
    body = "".join(
        "<tr>" + "".join(f"<td{_align(i in left)}>{cell}</td>" for i, cell in enumerate(row)) + "</tr>" for row in rows
    )
    return f'<div class="scroll" tabindex="0"><table><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table></div>'


def _align(word: bool) -> str:
    return ' class="word"' if word else ""


def _section(anchor: str, title: str, body: str) -> str:
    return f'<section id="{anchor}"><h2>{title}</h2>{body}</section>'


def _code(text: str) -> str:
    return f"<code>{escape(text)}</code>"


def _number(value: float) -> str:
    if math.isnan(value):
        return "no sample"
    return f"{value:.6g}" if math.isfinite(value) else "never"


def _meaning(spec: Mapping[str, Any]) -> str:
    """A metric in words: "rmse of vehicle1.eta.x against reference1.eta_d.x, from 6 s"."""
    words = f"{spec.get('stat', '')} {spec['of'].replace('_', ' ')} of {spec['signal']}".strip()
    if "reference" in spec:
        words += f" against {spec['reference']}"
    if "band" in spec:
        words += f" within {spec['band']:g}"
    if "after" in spec:
        words += f", from {spec['after']:g} s"
    if "before" in spec:
        words += f"{' ' if 'after' in spec else ', '}until {spec['before']:g} s"
    return words
