"""CSV for pandas and spreadsheets: the first line names the columns, `vehicle1.eta.x [m]`, the first column is time."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from .content import Content


def write(content: Content, target: Path) -> None:
    """Numbers in full precision, True and False, texts in quotes where they need them."""
    columns = {"time [s]": content.time}
    for signal in content.signals:
        unit = signal.head.removeprefix(signal.name)
        columns |= {f"{signal.name}{place}{unit}": values for place, values in signal.columns()}
    frame = pd.DataFrame(columns)
    texts = [values for signal in content.signals if signal.kind == "string" for _, values in signal.columns()]
    is_ascii = all(map(str.isascii, columns)) and all(text.isascii() for values in texts for text in values)
    # Without a byte order mark, Excel reads UTF-8 as the local code page; pandas skips the mark.
    frame.to_csv(target, index=False, lineterminator="\n", encoding="ascii" if is_ascii else "utf-8-sig")
