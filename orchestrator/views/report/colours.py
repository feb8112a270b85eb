"""Colours on light and on dark ground: those of the figures, and lighter ones of the same hues."""

from __future__ import annotations

from matplotlib.colors import to_hex

from ..figures.panels import OKABE_ITO, tint

ON_DARK = ("#4aa8e8", "#ff8b3d", "#2fc79a", "#e39cc6", "#f3b93c", "#8fd0f7", "#f2f2f2")


def colours(k: int, shade: int) -> list[str]:
    """The k-th colour, on light and on dark ground, half way to white `shade` times."""
    lightness = shade + k // len(OKABE_ITO)
    return [to_hex(tint(palette[k % len(palette)], lightness)) for palette in (OKABE_ITO, ON_DARK)]
