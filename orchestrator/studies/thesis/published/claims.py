"""What chapter 5 of the thesis claims in words, each with the number that our runs give and a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

HOLDS, PARTLY, FAILS = "holds", "holds in part", "does not hold"


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One statement of the thesis, in our words.

    figures: those that show it.  published, ours: its numbers, or what they say.  gated: the command fails without it.
    """

    section: str
    text: str
    figures: tuple[str, ...]
    published: str
    ours: str
    verdict: str
    gated: bool = False

    @property
    def fails(self) -> bool:
        return self.gated and self.verdict != HOLDS

    def sentence(self) -> str:
        return f"section {self.section}, {self.text}: published {self.published}, ours {self.ours}; {self.verdict}"

    def as_json(self) -> dict[str, Any]:
        return {**self.__dict__, "figures": list(self.figures)}


def verdict(*parts: bool) -> str:
    """The word for a claim of several parts."""
    return HOLDS if all(parts) else PARTLY if any(parts) else FAILS


def markdown(claims: Sequence[Claim]) -> str:
    """All claims as a list by section."""
    lines = ["# Claims of chapter 5", "", f"{tally(claims)}. A claim marked * decides the exit code.", ""]
    section = ""
    for claim in claims:
        if claim.section != section:
            section = claim.section
            lines += [f"## Section {section}", ""]
        figures = ", ".join(claim.figures)
        lines.append(
            f"* **{claim.verdict}**{' *' if claim.gated else ''}: {claim.text}. Published: {claim.published}. "
            f"Ours: {claim.ours}. ({figures})"
        )
        lines.append("")
    return "\n".join(lines)


def tally(claims: Sequence[Claim]) -> str:
    counts = {word: sum(claim.verdict == word for claim in claims) for word in (HOLDS, PARTLY, FAILS)}
    return f"{len(claims)} claims: " + ", ".join(f"{n} {word}" for word, n in counts.items())


def listed(values: Mapping[str, float], form: str = ".3g", unit: str = "") -> str:
    """ "x 47 %, y 75 %" """
    return ", ".join(f"{name} {value:{form}}{unit}" for name, value in values.items())
