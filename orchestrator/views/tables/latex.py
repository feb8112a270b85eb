r"""Tables for LaTeX with booktabs and siunitx: numbers aligned in S columns, units as \unit."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence

from ...fmu import units

POWERS = {1: "", 2: r"\squared", 3: r"\cubed"}
SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "…": r"\ldots{}",
    "†": r"\textsuperscript{\dag}",
    "‡": r"\textsuperscript{\ddag}",
    "§": r"\textsuperscript{\S}",
}
SPECIAL |= {letter: f"\\{letter}" for letter in "&%$#_{}"}


def escape(text: str) -> str:
    """Text whose letters have no special meaning to LaTeX."""
    return "".join(SPECIAL.get(letter, letter) for letter in text)


def unit(text: str) -> str:
    r"""A unit as FMUs write it, such as m/s2 or (m)2.s: \unit{\metre\per\second\squared}; as text where unknown."""
    if not text:
        return ""
    try:
        factors = units.factors(re.sub(r"\(([A-Za-z%]+)\)", r"\1", text))
    except ValueError:
        return rf"\unit{{\text{{{escape(text)}}}}}"
    macros = "".join(_macro(symbol, exponent) for symbol, exponent in factors)
    return rf"\unit{{{macros}}}"


def _macro(symbol: str, exponent: int) -> str:
    r"""\per\second\squared of ("s", -2)."""
    power = POWERS.get(abs(exponent), rf"\tothe{{{abs(exponent)}}}")
    return (r"\per" if exponent < 0 else "") + units.SYMBOLS[symbol].latex + power


def number_format(numbers: Sequence[str]) -> str:
    """siunitx's table-format of a column: digits before and after the point, and of the exponent."""
    parts = [re.fullmatch(r"(-?)(\d+)(?:\.(\d+))?(?:e([+-]\d+))?", number) for number in numbers]
    groups = [part.groups(default="") for part in parts if part]
    whole, behind, power = (max((len(part[i]) for part in groups), default=0) for i in (1, 2, 3))
    sign = "-" if any(part[0] for part in groups) else ""
    return f"{sign}{whole or 1}.{behind}" + (f"e-{'9' * (power - 1)}" if power else "")


def table(
    corner: Sequence[str],
    heads: Sequence[Sequence[str]],
    stubs: Sequence[Sequence[str]],
    rows: Sequence[Sequence[str]],
    formats: Sequence[str],
    caption: str,
) -> str:
    """corner: the first line above `stubs`; heads: lines above each column of `rows`; formats: of these columns."""
    columns = "l" * len(corner) + "".join(f"S[table-format = {form}]" for form in formats)
    lines = [
        r"% \usepackage{booktabs, siunitx}",
        r"\begin{table}",
        r"  \centering",
        r"  \sisetup{detect-weight = true}",
        rf"  \caption{{{caption}}}",
        rf"  \begin{{tabular}}{{{columns}}}",
        r"    \toprule",
    ]
    for i, line in enumerate(itertools.zip_longest(*heads, fillvalue="")):
        names = corner if i == 0 else [""] * len(corner)
        lines.append(_row([*names, *(f"{{{text}}}" if text else "" for text in line)]))
    lines.append(r"    \midrule")
    lines += [_row([*stub, *row]) for stub, row in zip(stubs, rows, strict=True)]
    lines += [r"    \bottomrule", r"  \end{tabular}", r"\end{table}"]
    return "\n".join(lines)


def _row(cells: Sequence[str]) -> str:
    return "    " + " & ".join(cells) + r" \\"
