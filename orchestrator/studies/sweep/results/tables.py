"""The statistics as text: for the terminal, and as Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

from ....records.compare.side_by_side import digits
from ....views.tables import latex, terminal
from .analysis import LEVEL, ContenderSummary, PairComparison, SweepAnalysis

NO_NUMBER = "-"


@dataclass(frozen=True, kw_only=True)
class TextTable:
    """A table of text.  left: how many columns hold words; bold: rows whose mean is the best."""

    title: str
    head: list[str]
    rows: list[list[str]]
    left: int
    bold: list[bool]

    @property
    def best(self) -> list[tuple[int, int]]:
        """The cells in bold: (row, column)."""
        return [(row, self.left + 1) for row, is_bold in enumerate(self.bold) if is_bold]


def text_tables(analysis: SweepAnalysis, pairs: bool = True) -> list[TextTable]:
    """Each contender, and each pair of them."""
    tables = [
        TextTable(
            title="",
            head=["metric", analysis.by, "n", "mean", "95 % interval", "std", "median"],
            rows=[_summary(s) for s in analysis.summaries],
            left=2,
            bold=[analysis.best(s.metric) == s.contender for s in analysis.summaries],
        )
    ]
    if pairs and analysis.pairs:
        head = ["metric", "first", "second", "n", "first - second", "95 % interval", "p (Holm)", "effect", "smaller"]
        rows = [_pair(p) for p in analysis.pairs]
        tables.append(TextTable(title="Draw by draw", head=head, rows=rows, left=3, bold=[False] * len(rows)))
    return tables


def _summary(s: ContenderSummary) -> list[str]:
    return [
        s.metric.head,
        s.contender,
        str(s.n),
        _shown(s.mean),
        _interval(s.low, s.high),
        _shown(s.std),
        _shown(s.median),
    ]


def _pair(p: PairComparison) -> list[str]:
    return [
        p.metric.head,
        p.first,
        p.second,
        str(p.n),
        _shown(p.difference),
        _interval(p.low, p.high),
        _probability(p.p_holm),
        f"{p.effect:+.2f}" if math.isfinite(p.effect) else NO_NUMBER,
        p.smaller or NO_NUMBER,
    ]


def _shown(value: float) -> str:
    return digits(value) if math.isfinite(value) else NO_NUMBER


def _interval(low: float, high: float) -> str:
    return f"{_shown(low)} .. {_shown(high)}" if math.isfinite(low) else NO_NUMBER


def _probability(p: float) -> str:
    if not math.isfinite(p):
        return NO_NUMBER
    return "< 1e-4" if p < 1e-4 else f"{p:.4f}" if p < 0.0995 else f"{p:.2f}"


def legend(analysis: SweepAnalysis, pairs: bool = True) -> list[str]:
    """What the columns mean, and what limits them."""
    table = analysis.table
    lines = [
        f"sweep {table.sweep_id}: {table.description['draws']} draws ({table.description['design']}, seed "
        f"{table.description['seed']}), the same for every value of {analysis.by}"
    ]
    lines.append("mean with its 95 % bootstrap interval (BCa)")
    if pairs and analysis.pairs:
        lines[-1] += f"; Wilcoxon's signed-rank test on paired draws, Holm-corrected over {len(analysis.pairs)} "
        lines[-1] += f"comparisons, at {LEVEL:g}; effect: rank-biserial, -1 where first is smaller in every draw"
    return lines + [f"note: {note}" for note in analysis.notes]


def table(analysis: SweepAnalysis, pairs: bool = True) -> str:
    """For the terminal; * marks the mean nearest to zero."""
    blocks = []
    for shown in text_tables(analysis, pairs):
        rows = [
            [terminal.tied(f"{cell}*" if bold and i == 3 else cell) for i, cell in enumerate(row)]
            for row, bold in zip(shown.rows, shown.bold, strict=True)
        ]
        lines = terminal.table([shown.head, *rows], names=shown.left)
        blocks.append("\n".join([*([shown.title] if shown.title else []), *lines]))
    return "\n\n".join([*blocks, "\n".join(map(terminal.wrapped, legend(analysis, pairs)))])


def markdown(analysis: SweepAnalysis, pairs: bool = True) -> str:
    blocks = []
    for shown in text_tables(analysis, pairs):
        rows = [
            [f"**{cell}**" if bold and i == 3 else cell.replace("|", "\\|") for i, cell in enumerate(row)]
            for row, bold in zip(shown.rows, shown.bold, strict=True)
        ]
        rule = ["---"] * shown.left + ["---:"] * (len(shown.head) - shown.left)
        blocks.append("\n".join("| " + " | ".join(line) + " |" for line in [shown.head, rule, *rows]))
    return "\n\n".join([*blocks, *legend(analysis, pairs)])


def latex_text(analysis: SweepAnalysis, pairs: bool = True) -> str:
    """Two tables for booktabs."""
    caption = latex.escape(analysis.table.title)
    blocks = []
    for shown in text_tables(analysis, pairs):
        lines = [
            r"% \usepackage{booktabs}",
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{caption}: {latex.escape('; '.join(legend(analysis, pairs)))}.}}",
            rf"  \begin{{tabular}}{{{'l' * shown.left}{'r' * (len(shown.head) - shown.left)}}}",
            r"    \toprule",
            _row(shown.head, False),
            r"    \midrule",
        ]
        last = ""
        for row, bold in zip(shown.rows, shown.bold, strict=True):
            if last and row[0] != last:
                lines.append(r"    \addlinespace")
            lines.append(_row(["" if row[0] == last else row[0], *row[1:]], bold))
            last = row[0]
        lines += [r"    \bottomrule", r"  \end{tabular}", r"\end{table}"]
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks)


def _row(cells: Sequence[str], bold: bool) -> str:
    texts = [latex.escape(cell).replace(" .. ", " -- ").replace("< ", "$<$ ") for cell in cells]
    texts = [rf"\textbf{{{text}}}" if bold and i == 3 else text for i, text in enumerate(texts)]
    return "    " + " & ".join(texts) + r" \\"


def csv_text(analysis: SweepAnalysis, pairs: bool = True) -> str:
    """In full precision: a line for each contender and metric, then one for each pair and metric."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["metric", "unit", "contender", "n", "mean", "low", "high", "std", "median"])
    for s in analysis.summaries:
        numbers = (s.mean, s.low, s.high, s.std, s.median)
        writer.writerow([s.metric.name, s.metric.unit, s.contender, s.n, *map(repr, numbers)])
    if pairs and analysis.pairs:
        writer.writerow([])
        writer.writerow(
            ["metric", "unit", "first", "second", "n", "difference", "low", "high", "p", "p_holm", "effect"]
        )
        for p in analysis.pairs:
            last = map(repr, (p.difference, p.low, p.high, p.p, p.p_holm, p.effect))
            writer.writerow([p.metric.name, p.metric.unit, p.first, p.second, p.n, *last])
    return stream.getvalue().rstrip("\n")


FORMATS = {"table": table, "markdown": markdown, "csv": csv_text, "latex": latex_text}
