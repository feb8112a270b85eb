"""Figures of runs and of systems: one style for all, one function that writes them."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ... import files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OPTIONS: dict[str, dict[str, Any]] = {  # no dates: the same figure is the same bytes
    ".png": {"pil_kwargs": {"optimize": True}},
    ".pdf": {"metadata": {"CreationDate": None}},
    ".svg": {"metadata": {"Date": None}},
}
DPI = 150  # of a PNG; sharp on a page of 800 to 900 pixels, also where a pixel is two


def target(path: str | Path, used: Iterable[str | Path] = ()) -> Path:
    """`files.target` of a figure."""
    return files.target(path, "a figure", tuple(OPTIONS), used)


@contextlib.contextmanager
def style() -> Iterator[None]:
    """The style in which every figure is drawn and written, whatever the user's settings of matplotlib are."""
    import matplotlib

    from .panels import STYLE

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def save(figure: Figure, target: Path, dpi: float = DPI) -> Path:
    """Write a figure as PNG, PDF or SVG, by the suffix of the file.  Raises StoreError where it cannot be written."""
    suffix = target.suffix.lower()
    with style(), files.replacing(target) as half:
        figure.savefig(half, format=suffix[1:], dpi=dpi, **OPTIONS[suffix])
    return target


def svg(figure: Figure, salt: str) -> str:
    """A figure as an <svg> element.  salt: of its ids, which must differ between the figures of a page."""
    import matplotlib

    stream = io.StringIO()
    with style(), matplotlib.rc_context({"svg.hashsalt": salt}):
        figure.savefig(stream, format="svg", **OPTIONS[".svg"])
    text = stream.getvalue()
    return text[text.index("<svg") :]
