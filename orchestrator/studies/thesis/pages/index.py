"""The index page of `orch reproduce thesis`: one HTML file, light and dark, readable on a phone."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from ..cases.chapter5 import CASES
from ..published import claims as thesis_claims
from ..published import steps as thesis_steps
from ..published.outcome import Reproduction
from ..published.tables import CAPTIONS, Verdict, best
from .figures import FIGURES

STYLE = """
:root { color-scheme: light dark; --ink: #1c1e21; --soft: #60656c; --paper: #fff; --line: #dfe2e6; --card: #f6f7f8;
  --good: #156f3f; --mid: #8a5a00; --bad: #b3261e; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e7e9; --soft: #a2a8b0; --paper: #15171a; --line: #363a40;
  --card: #1f2226; --good: #62c98d; --mid: #e0ad4c; --bad: #ff8a80; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 70rem; padding: 1.2rem; color: var(--ink); background: var(--paper);
  font: 1rem/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.2; } h2 { margin-top: 2.4rem; border-top: 1px solid var(--line);
  padding-top: 1rem; } h3 { margin-bottom: .4rem; font-size: 1.05rem; }
a { color: inherit; } nav a { margin-right: 1rem; } .soft { color: var(--soft); }
.good { color: var(--good); } .mid { color: var(--mid); } .bad { color: var(--bad); font-weight: 600; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .7rem; border-bottom: 1px solid var(--line); text-align: right; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } td small { display: block; }
ul.claims { list-style: none; padding: 0; } ul.claims li { padding: .6rem 0; border-bottom: 1px solid var(--line); }
.figures { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 20rem), 1fr)); }
figure { margin: 0; padding: .6rem; background: var(--card); border-radius: .4rem; }
figure img { width: 100%; height: auto; background: #fff; border-radius: .2rem; }
figcaption { font-size: .85rem; padding-top: .3rem; }
"""
CLASSES = {thesis_claims.HOLDS: "good", thesis_claims.PARTLY: "mid", thesis_claims.FAILS: "bad"}


def page(reproduction: Reproduction) -> str:
    """The whole page.  Images are linked relative to it."""
    parts = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>The thesis, reproduced</title><style>{STYLE}</style></head><body>",
        "<h1>The thesis, reproduced</h1>",
        *_head(reproduction),
        '<h2 id="tables">Tables</h2><p class="soft">Ours; below it the published value and the relative error. Bold: '
        "the best of a column. Green lies within its band, red outside, grey is reported only.</p>",
        *(_table(table, reproduction.verdicts) for table in CAPTIONS),
        '<h2 id="claims">Claims of chapter 5</h2>',
        f'<p class="soft">{thesis_claims.tally(reproduction.claims)}. * decides the exit code.</p>',
        '<ul class="claims">',
        *_claims(reproduction),
        "</ul>",
        '<h2 id="figures">Figures</h2><p class="soft">NED: z and its error point down; what is desired is dashed.</p>',
        '<div class="figures">',
        *(_figure(FIGURES[n].stem, f"Figure {n}", FIGURES[n].title) for n in reproduction.figures),
        "</div>",
    ]
    if reproduction.study:
        parts += ['<h2 id="steps">Step study</h2>', _figure(thesis_steps.STUDY_STEM, "", thesis_steps.CAPTION)]
    return "\n".join([*parts, "</body></html>"]) + "\n"


def _head(reproduction: Reproduction) -> list[str]:
    passed = not reproduction.outside
    verdict = "every gated cell lies within its band" if passed else f"{len(reproduction.outside)} outside"
    counts = reproduction.counts
    names = list(next(iter(counts.values())))
    rows = [[label, *(str(row[n]) for n in names)] for label, row in counts.items()]
    runs = [
        [escape(r.case.name), f"{r.plan.experiment.master.step * 1e3:g} ms", r.path.stem, str(len(r.warnings) or "")]
        for r in reproduction.records
    ]
    return [
        f'<p>Tables 5.2-5.7, the claims and Figures 5.1-5.80 from {len(runs)} runs of FMUs. <b class="'
        f'{"good" if passed else "bad"}">{verdict}</b>{", quick: coarser steps" if reproduction.quick else ""}.</p>',
        '<nav><a href="#tables">Tables</a> <a href="#claims">Claims</a> <a href="#figures">Figures</a>'
        + (' <a href="#steps">Step study</a>' if reproduction.study else "")
        + "</nav>",
        "<ul>" + "".join(f'<li class="bad">{escape(s)}</li>' for s in reproduction.outside) + "</ul>"
        if not passed
        else "",
        _grid(["controller", *names], rows),
        "<details><summary>Runs</summary>",
        _grid(["run", "step", "id", "warnings"], runs),
        "</details>",
    ]


def _table(table: str, verdicts: Iterable[Verdict]) -> str:
    """One table in the thesis's layout: controllers down, quantities across."""
    cells = [v for v in verdicts if v.cell.table == table]
    _, ours = best(cells)
    quantities = list(dict.fromkeys(v.cell.quantity for v in cells))
    rows = []
    for case in dict.fromkeys(v.cell.case for v in cells):
        row = [_label(case)]
        for quantity in quantities:
            (v,) = [v for v in cells if v.cell.case == case and v.cell.quantity == quantity]
            number = f"<b>{v.ours:.4f}</b>" if v.cell in ours else f"{v.ours:.4f}"
            error = f"{100 * v.error:+.1f} %" if abs(v.error) < 1e3 else "-"
            hue = {True: "good", False: "bad", None: "soft"}[v.met]
            note = f' title="{escape(v.cell.note)}"' if v.cell.note else ""
            mark = "*" if v.cell.note else ""
            row.append(f'{number}<small class="{hue}"{note}>{v.cell.corrected:.4f}{mark} {error}</small>')
        rows.append(row)
    units = {v.cell.quantity: v.cell.unit for v in cells}
    head = [q.replace("_", " ") + ("" if units[q] == "1" else f" [{units[q]}]") for q in quantities]
    links = " ".join(f'<a href="table_{table.replace(".", "_")}.{s}">{s}</a>' for s in ("md", "csv", "tex"))
    notes = dict.fromkeys(v.cell.note for v in cells if v.cell.note)
    below = "".join(f'<p class="soft">* {escape(note)}</p>' for note in notes)
    return f"<h3>Table {table}: {CAPTIONS[table]} {links}</h3>{_grid(['', *head], rows)}{below}"


def _claims(reproduction: Reproduction) -> list[str]:
    items = []
    for claim in reproduction.claims:
        shown = ", ".join(_link(f) for f in claim.figures)
        items.append(
            f'<li><b class="{CLASSES[claim.verdict]}">{claim.verdict}{" *" if claim.gated else ""}</b> '
            f'<span class="soft">{claim.section}</span> {escape(claim.text)}.<br>'
            f'<span class="soft">Published: {escape(claim.published)}. Ours: {escape(claim.ours)}. {shown}</span></li>'
        )
    return items


def _link(figure: str) -> str:
    return f'<a href="#{FIGURES[figure].stem}">{figure}</a>' if figure in FIGURES else escape(figure)


def _figure(stem: str, number: str, title: str) -> str:
    head = f"<b>{number}</b> " if number else ""
    return (
        f'<figure id="{stem}"><a href="figures/{stem}.png"><img src="figures/{stem}.png" loading="lazy" '
        f'alt="{escape(title)}"></a><figcaption>{head}{escape(title)} (<a href="figures/{stem}.pdf">PDF</a>)'
        "</figcaption></figure>"
    )


def _label(case: str) -> str:
    return CASES[case].label.replace("$t_b$", "t<sub>b</sub>")


def _grid(head: list[str], rows: list[list[str]]) -> str:
    top = "".join(f"<th>{name}</th>" for name in head)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
