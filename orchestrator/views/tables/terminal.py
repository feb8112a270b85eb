"""Text in columns, and paths as a reader wants them: what every table on the terminal is made of."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path


def short(path: Path) -> str:
    """The path as seen from here, where that is shorter."""
    relative = os.path.relpath(path)
    return relative if len(relative) < len(str(path)) else str(path)


def columns_of(rows: Sequence[tuple[str, ...]], indent: int = 0, cut: bool = False) -> list[str]:
    """Columns as wide as they need; `cut` shortens the last one to the terminal."""
    width = max(80, shutil.get_terminal_size().columns)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    lines = []
    for row in rows:
        cells = [cell.ljust(w + 2) for cell, w in zip(row, widths, strict=False)]
        line = " " * indent + "".join(cells) + row[-1]
        if cut and len(line) > width:
            line = line[: width - 3].rstrip() + "..."
        lines.append(line.rstrip())
    return lines
