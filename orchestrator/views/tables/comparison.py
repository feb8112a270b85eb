"""A comparison of runs as text: for the terminal, and as Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from ...records.compare.side_by_side import DIGITS, Column, Comparison, Entry, digits
from ...records.file.marks import DAGGER
from . import latex, terminal
from .terminal import TIED

MARK = "*"  # of the best, in the terminal
BEST = f"nearest to zero of the runs that may be compared, at {DIGITS} digits; one run each, which is no statistics"
NOT_COMPARED = "not compared"
NO_NUMBER, NEVER = "-", "never"
HEAD = 24  # characters of a line of a label above its run, at most


@dataclass(frozen=True)
class Cell:
    """A number, NEVER, NO_NUMBER, or "" where the run does not have the metric."""

    text: str
    is_best: bool = False
    is_marked: bool = False

    @property
    def marked(self) -> str:
        """The number, with its dagger if it has one."""
        return self.text + DAGGER * self.is_marked


@dataclass(frozen=True)
class ComparisonTable:
    """`stubs` name the rows, with `corner` above them; `heads` name the columns; `rows` are cells.

    runs_down: rows are runs and columns metrics; else the other way round.
    """

    corner: list[str]
    stubs: list[list[str]]
    heads: list[list[str]]
    rows: list[list[Cell]]
    runs_down: bool

    def column(self, k: int) -> list[Cell]:
        return [row[k] for row in self.rows]


def laid_out(comparison: Comparison) -> ComparisonTable:
    """A row for each run and a column for each metric or, where there are more metrics than runs, transposed."""
    entries, columns = comparison.entries, comparison.columns
    best = {column: comparison.best(column) for column in columns}
    cells = [[_cell(e, c, any(e is b for b in best[c])) for c in columns] for e in entries]
    if len(columns) <= len(entries):
        titled = any(entry.title for entry in entries)
        stubs = [[e.name, e.title] if titled else [e.name] for e in entries]
        heads = [[c.name, f"[{c.unit}]" if c.unit else ""] for c in columns]
        return ComparisonTable(["run", "what differs"] if titled else ["run"], stubs, heads, cells, runs_down=True)
    stubs = [[column.name, column.unit] for column in columns]
    across = [list(row) for row in zip(*cells, strict=True)]
    return ComparisonTable(["metric", "unit"], stubs, [[e.name, e.title] for e in entries], across, runs_down=False)


def _cell(entry: Entry, column: Column, is_best: bool) -> Cell:
    if column not in entry.metrics:
        return Cell("")
    return Cell(_shown(entry.metrics[column]), is_best, bool(entry.marks_of(column)))


def _shown(value: float) -> str:
    return digits(value) if math.isfinite(value) else NO_NUMBER if math.isnan(value) else NEVER


def table(comparison: Comparison) -> str:
    """For the terminal."""
    shown = laid_out(comparison)
    rows = [[*shown.corner, *("\n".join(f"{line}{TIED}" for line in _title(head)) for head in shown.heads)]]
    for stub, row in zip(shown.stubs, shown.rows, strict=True):
        rows.append([*stub, *(cell.marked + (MARK * cell.is_best or TIED * (not cell.is_marked)) for cell in row)])
    numbers = range(len(shown.corner), len(rows[0]))
    lines = terminal.table(rows, names=1 if shown.runs_down else len(shown.corner), right=numbers)
    return "\n\n".join(["\n".join(lines), *_legend(comparison, shown)])


def _title(head: Sequence[str]) -> list[str]:
    first, *rest = head
    return [first, *(line for text in rest for line in textwrap.wrap(text, HEAD))]


def _legend(comparison: Comparison, shown: ComparisonTable) -> list[str]:
    cells = [cell for row in shown.rows for cell in row]
    lines = []
    if _has_best(shown):
        lines.append(f"{MARK} {BEST}")
    if comparison.footnotes:
        lines.append(f"{DAGGER} {NOT_COMPARED}: {'; '.join(comparison.footnotes)}")
    if any(cell.text == NO_NUMBER for cell in cells):
        lines.append(f"{NO_NUMBER} no number: no sample in its window, or no value")
    lines += [f"note: {note}" for note in comparison.notes]
    return ["\n".join(map(terminal.wrapped, lines))] if lines else []


def markdown(comparison: Comparison) -> str:
    """The best in bold."""
    shown = laid_out(comparison)
    heads = [" ".join(filter(None, head)) for head in shown.heads]
    lines = [[*map(_escaped, [*shown.corner, *heads])], [*("---" for _ in shown.corner), *("---:" for _ in heads)]]
    for stub, row in zip(shown.stubs, shown.rows, strict=True):
        lines.append([*map(_escaped, stub), *(f"**{cell.text}**" if cell.is_best else cell.marked for cell in row)])
    text = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    below = [f"Bold: {BEST}"] if _has_best(shown) else []
    below += [f"{DAGGER} {NOT_COMPARED}: {'; '.join(comparison.footnotes)}"] if comparison.footnotes else []
    return "\n\n".join([text, *map(_escaped, [*below, *(f"Note: {note}" for note in comparison.notes)])])


def _has_best(shown: ComparisonTable) -> bool:
    return any(cell.is_best for row in shown.rows for cell in row)


def _escaped(text: str) -> str:
    return re.sub(r"([|*_`<\\])", r"\\\1", text)


def csv_text(comparison: Comparison) -> str:
    """Always a line for each run, in full precision: inf for never, an empty cell where there is no number.

    The last column has what speaks against comparing the numbers of the run, of single metrics with their names.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["run", "experiment", "what differs", "status", *(c.head for c in comparison.columns), "marks"])
    for e in comparison.entries:
        numbers = [e.metrics.get(column, math.nan) for column in comparison.columns]
        cells = ["" if math.isnan(value) else repr(value) for value in numbers]
        marks = e.standing.marks
        single = [f"{c.name}: {m}" for c in comparison.columns if c in e.metrics for m in e.marks_of(c)[len(marks) :]]
        writer.writerow([e.name, e.attributes["experiment"], e.label, e.status, *cells, "; ".join([*marks, *single])])
    return stream.getvalue().rstrip("\n")


def latex_text(comparison: Comparison) -> str:
    """The best in bold; siunitx aligns the numbers.  What limits them is in the caption, where readers see it."""
    shown = laid_out(comparison)
    heads, stubs = [], []
    for first, second in shown.heads:
        unit = [f"({latex.unit(second[1:-1])})" if second else ""]
        heads.append([latex.escape(first), *(unit if shown.runs_down else _wrapped(second))])
    for first, *rest in shown.stubs:
        stubs.append([latex.escape(first), *map(latex.escape if shown.runs_down else latex.unit, rest)])
    rows = [[_latex_cell(cell) for cell in row] for row in shown.rows]
    formats = [latex.number_format([cell.text for cell in shown.column(k)]) for k in range(len(shown.heads))]
    titles = dict.fromkeys(str(e.attributes["title"] or e.attributes["experiment"]) for e in comparison.entries)
    sentences = ["; ".join(titles), *([f"Bold: {BEST}"] if _has_best(shown) else [])]
    sentences += [f"{DAGGER} {NOT_COMPARED}: {'; '.join(comparison.footnotes)}"] if comparison.footnotes else []
    caption = latex.escape(". ".join([*sentences, *(f"Note: {note}" for note in comparison.notes)])) + "."
    return latex.table([part.capitalize() for part in shown.corner], heads, stubs, rows, formats, caption)


def _wrapped(text: str) -> list[str]:
    return [latex.escape(line) for line in textwrap.wrap(text, HEAD)]


def _latex_cell(cell: Cell) -> str:
    """A number that siunitx aligns; its dagger in braces, which stands behind the number."""
    mark = f" {{{latex.escape(DAGGER)}}}" if cell.is_marked else ""
    if cell.text in (NO_NUMBER, NEVER):
        return f"{{{'--' if cell.text == NO_NUMBER else NEVER}{mark.strip()}}}"
    return (r"\bfseries " if cell.is_best else "") + cell.text + (mark if cell.text else "")


FORMATS = {"table": table, "markdown": markdown, "csv": csv_text, "latex": latex_text}
SUFFIXES = {".md": "markdown", ".csv": "csv", ".tex": "latex"}
