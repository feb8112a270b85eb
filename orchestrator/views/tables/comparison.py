"""A comparison of runs as text: for the terminal, and as Markdown, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import math
import re
import shutil
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ...records.compare.side_by_side import Comparison, digits
from . import latex

MARK = "*"  # of the best, in the terminal
NO_NUMBER = "-"
GAP = 2  # spaces between columns of the terminal
LABEL = 32  # characters that a label beside its run has at least in the terminal; other formats do not shorten it
HEAD = 24  # characters of a line of a label above its run, at most


@dataclass(frozen=True)
class Cell:
    """A number, NO_NUMBER, or "" where the run does not have the metric."""

    text: str
    is_best: bool = False


@dataclass(frozen=True)
class Grid:
    """A table: `corner` and below it `stubs` name the rows, `heads` the columns; `rows` are cells.

    runs_down: a run has a row and a metric a column; else the other way round.
    """

    corner: list[str]
    stubs: list[list[str]]
    heads: list[list[str]]
    rows: list[list[Cell]]
    runs_down: bool

    def column(self, k: int) -> list[Cell]:
        return [row[k] for row in self.rows]


def grid(comparison: Comparison) -> Grid:
    """Runs down and metrics across or, where there are more metrics than runs, the other way round."""
    entries, columns = comparison.entries, comparison.columns
    best = {column: comparison.best(column) for column in columns}
    cells = [
        [Cell(_shown(e.metrics[c]) if c in e.metrics else "", any(e is b for b in best[c])) for c in columns]
        for e in entries
    ]
    if len(columns) <= len(entries):
        titled = any(entry.title for entry in entries)
        stubs = [[e.name, e.title] if titled else [e.name] for e in entries]
        heads = [[c.name, f"[{c.unit}]" if c.unit else ""] for c in columns]
        return Grid(["run", "what differs"] if titled else ["run"], stubs, heads, cells, runs_down=True)
    stubs = [[column.name, column.unit] for column in columns]
    across = [list(row) for row in zip(*cells, strict=True)]
    return Grid(["metric", "unit"], stubs, [[e.name, e.title] for e in entries], across, runs_down=False)


def _shown(value: float) -> str:
    return digits(value) if math.isfinite(value) else NO_NUMBER


@dataclass(frozen=True)
class _Column:
    """Of a table in the terminal.  Numbers end at the right, a place for the mark behind them."""

    head: list[str]
    body: list[str]
    is_number: bool = False

    @property
    def width(self) -> int:
        return max(map(len, self.head + self.body))

    def line(self, k: int, depth: int) -> str:
        """The k-th line below the top, the head having `depth` lines."""
        text = ([*self.head, *[""] * (depth - len(self.head)), *self.body])[k]
        return text.rjust(self.width) if self.is_number else text.ljust(self.width)


def table(comparison: Comparison) -> str:
    """For the terminal: columns that do not fit beside each other stand below each other, with the names again."""
    shown = grid(comparison)
    width = max(80, shutil.get_terminal_size().columns)
    numbers = [_numbers(shown, k, width) for k in range(len(shown.heads))]
    left = width - max(len(stub[0]) for stub in [shown.corner, *shown.stubs]) - GAP
    label = max(LABEL, left - sum(column.width + GAP for column in numbers))
    texts = [[textwrap.shorten(text, label, placeholder=" …") for text in stub] for stub in shown.stubs]
    names = [_Column([corner], [text[i] for text in texts]) for i, corner in enumerate(shown.corner)]
    room = width - sum(column.width + GAP for column in names) + GAP
    blocks = [_block([*names, *columns]) for columns in _fitting(numbers, room)]
    return "\n\n".join([*blocks, *_legend(comparison, shown)])


def _numbers(shown: Grid, k: int, width: int) -> _Column:
    """The k-th column below its heads, these wrapped so that all columns fit where possible."""
    first, *rest = shown.heads[k]
    body = [cell.text + (MARK if cell.is_best else " ") for cell in shown.column(k)]
    stubs = sum(max(map(len, texts)) + GAP for texts in zip(*shown.stubs, strict=True))
    fair = (width - stubs) // len(shown.heads) - GAP - 1
    words = [len(word) for text in rest for word in text.split()]
    wide = max(len(first), *(len(text) - 1 for text in body), min(HEAD, max(fair, *words, 0)))
    return _Column(
        [f"{line} " for line in (first, *(line for text in rest for line in textwrap.wrap(text, wide)))],
        body,
        is_number=True,
    )


def _fitting(columns: Sequence[_Column], room: int) -> Iterator[list[_Column]]:
    """As many as fit beside each other, and again."""
    block: list[_Column] = []
    for column in columns:
        if block and sum(c.width + GAP for c in [*block, column]) > room:
            yield block
            block = []
        block.append(column)
    yield block


def _block(columns: Sequence[_Column]) -> str:
    depth = max(len(column.head) for column in columns)
    lines = depth + len(columns[0].body)
    return "\n".join((" " * GAP).join(c.line(k, depth) for c in columns).rstrip() for k in range(lines))


def _legend(comparison: Comparison, shown: Grid) -> list[str]:
    cells = [cell for row in shown.rows for cell in row]
    lines = []
    if any(cell.is_best for cell in cells):
        lines.append(f"{MARK} best of the completed runs: nearest to zero")
    if any(cell.text == NO_NUMBER for cell in cells):
        lines.append(f"{NO_NUMBER} no number: no sample in its window, or never reached")
    lines += [f"note: {note}" for note in comparison.notes]
    return ["\n".join(lines)] if lines else []


def markdown(comparison: Comparison) -> str:
    """The best in bold."""
    shown = grid(comparison)
    heads = [" ".join(filter(None, head)) for head in shown.heads]
    lines = [[*map(_escaped, [*shown.corner, *heads])], [*("---" for _ in shown.corner), *("---:" for _ in heads)]]
    for stub, row in zip(shown.stubs, shown.rows, strict=True):
        lines.append([*map(_escaped, stub), *(f"**{cell.text}**" if cell.is_best else cell.text for cell in row)])
    text = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return "\n\n".join([text, *(f"Note: {_escaped(note)}" for note in comparison.notes)])


def _escaped(text: str) -> str:
    return re.sub(r"([|*_`<\\])", r"\\\1", text)


def csv_text(comparison: Comparison) -> str:
    """One line a run in full precision, whatever there is more of; no number is an empty cell."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["run", "experiment", "what differs", "status", *(c.head for c in comparison.columns)])
    for e in comparison.entries:
        numbers = [e.metrics.get(column, math.nan) for column in comparison.columns]
        cells = [repr(value) if math.isfinite(value) else "" for value in numbers]
        writer.writerow([e.name, e.attributes["experiment"], e.label, e.status, *cells])
    return stream.getvalue().rstrip("\n")


def latex_text(comparison: Comparison) -> str:
    """The best in bold; siunitx aligns the numbers."""
    shown = grid(comparison)
    heads, stubs = [], []
    for first, second in shown.heads:
        unit = [f"({latex.unit(second[1:-1])})" if second else ""]
        heads.append([latex.escape(first), *(unit if shown.runs_down else _wrapped(second))])
    for first, *rest in shown.stubs:
        stubs.append([latex.escape(first), *map(latex.escape if shown.runs_down else latex.unit, rest)])
    rows = [[_latex_cell(cell) for cell in row] for row in shown.rows]
    formats = [latex.number_format([cell.text for cell in shown.column(k)]) for k in range(len(shown.heads))]
    titles = dict.fromkeys(str(e.attributes["title"] or e.attributes["experiment"]) for e in comparison.entries)
    caption = latex.escape("; ".join(titles)) + ". Best values in bold."
    text = latex.table([part.capitalize() for part in shown.corner], heads, stubs, rows, formats, caption)
    return "\n".join([text, *(f"% {note}" for note in comparison.notes)])


def _wrapped(text: str) -> list[str]:
    return [latex.escape(line) for line in textwrap.wrap(text, HEAD)]


def _latex_cell(cell: Cell) -> str:
    return "{--}" if cell.text == NO_NUMBER else (r"\bfseries " if cell.is_best else "") + cell.text


FORMATS = {"table": table, "markdown": markdown, "csv": csv_text, "latex": latex_text}
SUFFIXES = {".md": "markdown", ".csv": "csv", ".tex": "latex"}
