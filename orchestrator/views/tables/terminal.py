"""Tables for the terminal: they fit its width, or 80 columns."""

from __future__ import annotations

import itertools
import re
import shutil
import textwrap
from collections.abc import Iterator, Mapping, Sequence

GAP = 2  # spaces between columns
WORD = 22  # characters; a longer word may be broken, a title longer than that and than its cells is wrapped
LINES = 3  # of a cell, where another command shows the whole
TIED = "\u00a0"  # a space at which a cell is not wrapped; it is printed as a space
PIECE = re.compile(rf"(?:\.\.|\d\.(?=\d)|[^./_{TIED}])*(?:[./_{TIED}]|$)")


def table(
    rows: Sequence[Sequence[str]],
    indent: int = 0,
    *,
    title: bool = True,
    names: int = 1,
    right: Sequence[int] = (),
    rest: str = "",
) -> list[str]:
    """Rows of cells as lines that fit the terminal; cells that are too wide are wrapped.

    title: the first row holds the titles; names: as many columns name the row; right: columns aligned to the right.
    Columns that do not fit beside each other stand below each other, with the names again.  But where `rest` names an
    option that shows everything, such as "--json", they are left out, long cells are cut, and a last line says so.
    """
    room = _width() - indent
    columns = list(zip(*rows, strict=True))
    wide = [_widest(cells, title) for cells in columns]
    narrow = [_narrowest(cells, title, most) for cells, most in zip(columns, wide, strict=True)]
    blocks = _blocks(narrow, names, room)
    lines: list[str] = []
    for block in blocks[:1] if rest else blocks:
        least = [min(n, max(_longest_piece(cells), 1)) for n, cells in zip(narrow, columns, strict=True)]
        widths = _fitted(_fitted({k: wide[k] for k in block}, narrow, room), least, room)
        cells = {k: [_wrapped(cell, width) for cell in columns[k]] for k, width in widths.items()}
        long = [cell for column in cells.values() for cell in column[title:] if rest and len(cell) > LINES]
        for cell in long:
            cell[LINES - 1 :] = [f"{cell[LINES - 1][:-2]} …"]
        lines += ["", *_beside(cells, widths, right)]
    if rest and len(blocks) > 1:
        left_out = [columns[k][0] for block in blocks[1:] for k in block[names:]]
        lines += textwrap.wrap(f"… and {len(left_out)} more: {', '.join(left_out)}; {rest} shows them", room)
    elif long:
        lines.append(f"… {rest} shows the whole")
    return [f"{' ' * indent}{line}".replace(TIED, " ").rstrip() for line in lines[1:]]


def tied(text: str) -> str:
    """A text that is not wrapped."""
    return text.replace(" ", TIED)


def wrapped(text: str) -> str:
    """A line of text below a table, as lines that fit the terminal."""
    return "\n".join(_wrapped(text, _width()))


def _width() -> int:
    return max(80, shutil.get_terminal_size().columns)


def _widest(cells: Sequence[str], title: bool) -> int:
    """The width at which no cell is wrapped, but for a title much longer than the cells below it."""
    head, *body = [max(map(len, cell.split("\n"))) for cell in cells] or [0]
    below = max(body, default=0)
    return max(below, min(head, max(WORD, below)) if title else head)


def _narrowest(cells: Sequence[str], title: bool, widest: int) -> int:
    """The least width: words are whole, and a third of the longest cell fits on a line, up to WORD characters."""
    word = max((len(word) for cell in cells for word in cell.replace("\n", " ").split(" ")), default=0)
    body = max(map(len, cells[title:]), default=0)
    return min(widest, max(min(word, WORD), min(body // 3, WORD)))


def _longest_piece(cells: Sequence[str]) -> int:
    """The width below which a word would be broken where it may not."""
    words = (word for cell in cells for word in cell.replace("\n", " ").split(" "))
    return max((len(piece.rstrip(TIED)) for word in words for piece in PIECE.findall(word)), default=0)


def _blocks(narrow: Sequence[int], names: int, room: int) -> list[list[int]]:
    """Numbers of the columns that stand beside each other, those of the names in every block."""
    blocks = [list(range(names))]
    for k in range(names, len(narrow)):
        if sum(narrow[i] + GAP for i in [*blocks[-1], k]) - GAP > room and len(blocks[-1]) > names:
            blocks.append(list(range(names)))
        blocks[-1].append(k)
    return blocks


def _fitted(widths: dict[int, int], narrow: Sequence[int], room: int) -> dict[int, int]:
    """{column: width}, the widest narrowed until all fit."""
    while sum(widths.values()) + GAP * (len(widths) - 1) > room:
        loose = [k for k in widths if widths[k] > narrow[k]]
        if not loose:
            break
        widths[max(loose, key=lambda k: widths[k])] -= 1
    return widths


def _beside(
    columns: Mapping[int, Sequence[list[str]]], widths: Mapping[int, int], right: Sequence[int]
) -> Iterator[str]:
    """The lines of columns whose cells are lines."""
    for row in zip(*columns.values(), strict=True):
        for texts in itertools.zip_longest(*row, fillvalue=""):
            parts = zip(texts, widths.items(), strict=True)
            yield (" " * GAP).join(text.rjust(w) if k in right else text.ljust(w) for text, (k, w) in parts)


def _wrapped(cell: str, width: int) -> list[str]:
    lines = []
    for line in cell.split("\n"):
        words = " ".join(_pieces(word, width) for word in line.split(" "))
        lines += [line] if len(line) <= width else textwrap.wrap(words, width, break_on_hyphens=False)
    return lines


def _pieces(word: str, width: int) -> str:
    """A word with spaces at which it may be broken: none, or behind a point, a slash, an underscore or what is tied.

    A number is not broken behind its point.
    """
    if len(word) <= width:
        return word
    pieces = [""]
    for part in PIECE.findall(word):
        if pieces[-1] and len(pieces[-1] + part) > width:
            pieces.append("")
        pieces[-1] += part
    return " ".join(pieces)
