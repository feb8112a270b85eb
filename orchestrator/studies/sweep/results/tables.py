"""The statistics as text: for the terminal, and as Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ....records.compare.side_by_side import Column, digits
from ....records.file.marks import DAGGER
from ....views.tables import latex, terminal
from ..engine.worker import FAILED
from .analysis import FEW, LEVEL, ContenderSummary, PairComparison, SweepAnalysis
from .outcomes import NEVER

NO_NUMBER = "-"
LOOSE = " ‡"  # of intervals of few draws
FEWER = " §"  # of a contender that is smaller where it has a number, and has one in fewer draws
BEST = (
    f"least mean on common draws of those without {DAGGER}, where no other has a number in more draws "
    "or is better on the draws that these two have; "
    "whether by chance, the tests say"
)


@dataclass(frozen=True, kw_only=True)
class TextTable:
    """A table of text.  left: how many columns hold words; best: the cells of the best, (row, column)."""

    title: str
    head: list[str]
    rows: list[list[str]]
    left: int
    best: list[tuple[int, int]]

    def cells(self, best: str, text: Callable[[str], str] = str) -> list[list[str]]:
        """The rows, the best ones in the form `best`, such as "**{}**"."""
        return [
            [best.format(text(cell)) if (i, k) in self.best else text(cell) for k, cell in enumerate(row)]
            for i, row in enumerate(self.rows)
        ]


def text_tables(analysis: SweepAnalysis, pairs: bool = True) -> list[TextTable]:
    """Each contender, and each pair of them."""
    shared = all(s.n == s.common for s in analysis.summaries)  # then means are compared as they stand
    head = ["metric", analysis.by, "n", "mean", "95 % interval", "std", "median", "success"]
    tables = [
        TextTable(
            title="",
            head=head if shared else [*head, "common draws"],
            rows=[[*_summary(s), *([] if shared else [_common(s)])] for s in analysis.summaries],
            left=2,
            best=[
                (i, 3 if shared else len(head))
                for i, s in enumerate(analysis.summaries)
                if analysis.best(s.metric) == s.contender
            ],
        )
    ]
    if pairs and analysis.pairs:
        head = ["metric", "first", "second", "n", "first - second", "95 % interval", "p (Holm)", "effect", "smaller"]
        rows = [_pair(p) for p in analysis.pairs]
        tables.append(TextTable(title="Draw by draw", head=head, rows=rows, left=3, best=[]))
    return tables


def head_of(metric: Column) -> str:
    """rmse_x [m]; |final_x| [m] where magnitudes are taken of what has a sign."""
    return (
        metric.head.replace(metric.name, f"|{metric.name}|", 1)
        if metric.of == "final" and metric.ranked
        else metric.head
    )


def _summary(s: ContenderSummary) -> list[str]:
    return [
        head_of(s.metric),
        s.contender,
        str(s.n),
        _shown(s.mean) + DAGGER * bool(s.marks and s.n),
        _interval(s.low, s.high, s.n),
        _shown(s.std),
        _shown(s.median),
        _success(s),
    ]


def _success(s: ContenderSummary) -> str:
    """The draws in which it has a number, with Wilson's interval: 13 of 20 (43 .. 82 %)."""
    mark = DAGGER * bool(s.marks)
    return f"{s.n} of {s.draws} ({100 * s.share[0]:.0f} .. {100 * s.share[1]:.0f} %){mark}" if s.draws else NO_NUMBER


def _common(s: ContenderSummary) -> str:
    return f"{_shown(s.common_mean)} (n {s.common})" if math.isfinite(s.common_mean) else NO_NUMBER


def _pair(p: PairComparison) -> list[str]:
    return [
        head_of(p.metric),
        p.first,
        p.second,
        str(p.n) if p.n == p.numbers else f"{p.n} ({p.numbers})",
        _shown(p.difference),
        _interval(p.low, p.high, p.numbers),
        _probability(p.p_holm),
        f"{p.effect:+.2f}" if math.isfinite(p.effect) else NO_NUMBER,
        f"{p.smaller}{FEWER * (p.fewer == p.smaller)}" if p.smaller else NO_NUMBER,
    ]


def _shown(value: float) -> str:
    return digits(value) if math.isfinite(value) else NO_NUMBER


def _interval(low: float, high: float, n: int) -> str:
    return f"{_shown(low)} .. {_shown(high)}{LOOSE * (n < FEW)}" if math.isfinite(low) else NO_NUMBER


def _probability(p: float) -> str:
    if not math.isfinite(p):
        return NO_NUMBER
    return "< 1e-4" if p < 1e-4 else f"{p:.4f}" if p < 0.0995 else f"{p:.2f}"


def legend(analysis: SweepAnalysis, pairs: bool = True) -> list[str]:
    """What the columns mean, and what limits them."""
    table = analysis.table
    lines = [
        f"sweep {table.sweep_id}: {table.description['draws']} draws ({table.description['design']}, seed "
        f"{table.description['seed']}), the same for every value of {analysis.by}",
        "mean with its 95 % bootstrap interval (BCa); success: draws with a number, with Wilson's 95 % interval",
    ]
    shown = pairs and analysis.pairs
    if shown:
        number = len(analysis.pairs)
        lines[-1] += f"; Wilcoxon's signed-rank test on paired draws, Holm-corrected over {number} "
        lines[-1] += f"comparison{'s' * (number > 1)}, at {LEVEL:g}; effect: rank-biserial, -1 where first is smaller "
        lines[-1] += "in every draw"
    if any(s.n != s.common for s in analysis.summaries):
        lines.append(
            "common draws: mean on draws in which all contenders have a number, but for those that lack half of theirs"
        )
    if shown and any(p.n != p.numbers for p in analysis.pairs):
        lines.append("n (m): n draws are ranked, the difference is of the m in which both have a number")
    samples = [s.n for s in analysis.summaries] + [p.numbers for p in analysis.pairs if shown]
    if any(1 < n < FEW for n in samples):
        lines.append(
            f"{LOOSE.strip()} of fewer than {FEW} draws: not an interval to lean on: it holds the mean less often "
            "than it says (of 3 draws in 60 to 72 of 100 sweeps)"
        )
    if shown and any(p.smaller and p.fewer == p.smaller for p in analysis.pairs):
        lines.append(f"{FEWER.strip()} smaller where it has a number, and has one in fewer draws than the other")
    if analysis.footnotes:
        lines.append(f"{DAGGER} not in the numbers, and never the best: {'; '.join(analysis.footnotes)}")
    return lines + [f"note: {note}" for note in analysis.notes]


def has_best(tables: Sequence[TextTable]) -> bool:
    return any(shown.best for shown in tables)


def table(analysis: SweepAnalysis, pairs: bool = True) -> str:
    """For the terminal; * marks the best."""
    blocks, tables = [], text_tables(analysis, pairs)
    for shown in tables:
        rows = [list(map(terminal.tied, row)) for row in shown.cells("{}*")]
        lines = terminal.table([shown.head, *rows], names=shown.left)
        blocks.append("\n".join([*([shown.title] if shown.title else []), *lines]))
    below = [*([f"* {BEST}"] if has_best(tables) else []), *legend(analysis, pairs)]
    return "\n\n".join([*blocks, "\n".join(map(terminal.wrapped, below))])


def markdown(analysis: SweepAnalysis, pairs: bool = True) -> str:
    blocks, tables = [], text_tables(analysis, pairs)
    for shown in tables:
        rows = shown.cells("**{}**", lambda cell: cell.replace("|", "\\|"))
        rule = ["---"] * shown.left + ["---:"] * (len(shown.head) - shown.left)
        blocks.append("\n".join("| " + " | ".join(line) + " |" for line in [shown.head, rule, *rows]))
    return "\n\n".join([*blocks, *([f"Bold: {BEST}"] if has_best(tables) else []), *legend(analysis, pairs)])


def latex_text(analysis: SweepAnalysis, pairs: bool = True) -> str:
    """Two tables for booktabs."""
    caption = latex.escape(analysis.table.title)
    blocks, tables = [], text_tables(analysis, pairs)
    below = "; ".join([*([f"bold: {BEST}"] if has_best(tables) else []), *legend(analysis, pairs)])
    for shown in tables:
        lines = [
            r"% \usepackage{booktabs}",
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{caption}: {latex.escape(below)}.}}",
            rf"  \begin{{tabular}}{{{'l' * shown.left}{'r' * (len(shown.head) - shown.left)}}}",
            r"    \toprule",
            _row(list(map(_latex, shown.head))),
            r"    \midrule",
        ]
        last = ""
        for row in shown.cells(r"\textbf{{{}}}", _latex):
            if last and row[0] != last:
                lines.append(r"    \addlinespace")
            lines.append(_row(["" if row[0] == last else row[0], *row[1:]]))
            last = row[0]
        lines += [r"    \bottomrule", r"  \end{tabular}", r"\end{table}"]
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks)


def _latex(cell: str) -> str:
    text = re.sub(r"(?<![\w.-])-(?=\d)", "$-$", latex.escape(cell))  # minus signs, not hyphens
    return text.replace(" .. ", " to " if "$-$" in text else " -- ").replace("< ", "$<$ ")


def _row(cells: Sequence[str]) -> str:
    return "    " + " & ".join(cells) + r" \\"


def csv_text(analysis: SweepAnalysis, pairs: bool = True) -> str:
    """In full precision: a line for each contender and metric, then one for each pair and metric."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    head = ["metric", "unit", "contender", "n", "mean", "low", "high", "std", "median"]
    more = ["draws", "share_low", "share_high", "never", "failed", "marked", "common_n", "common_mean", "best"]
    writer.writerow([*head, *more])
    for s in analysis.summaries:
        numbers = (s.mean, s.low, s.high, s.std, s.median)
        lost = [s.lost.get(NEVER, 0), s.lost.get(FAILED, 0), "; ".join(f"{n} {why}" for why, n in s.marks.items())]
        best = analysis.best(s.metric) == s.contender
        row = [s.metric.name, s.metric.unit, s.contender, s.n, *map(repr, numbers), s.draws, *map(repr, s.share), *lost]
        writer.writerow([*row, s.common, repr(s.common_mean), "best" if best else ""])
    if pairs and analysis.pairs:
        writer.writerow([])
        head = ["metric", "unit", "first", "second", "n", "difference", "low", "high", "p", "p_holm", "effect"]
        writer.writerow([*head, "numbers", "smaller", "fewer"])
        for p in analysis.pairs:
            last = map(repr, (p.difference, p.low, p.high, p.p, p.p_holm, p.effect))
            row = [p.metric.name, p.metric.unit, p.first, p.second, p.n, *last]
            writer.writerow([*row, p.numbers, p.smaller, p.fewer])
    return stream.getvalue().rstrip("\n")


FORMATS = {"table": table, "markdown": markdown, "csv": csv_text, "latex": latex_text}
