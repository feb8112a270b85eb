"""What chapter 5 of the thesis claims in words, each with the number that our runs give and a verdict.

One yardstick for all controllers and both tasks; docs/thesis.md has the same:

* Every communication step counts, from the time that the statement names to the end of the run.
* An error is zero, has converged or is in a vicinity of zero while it is at most `BAND` of what it was at the start; an
  angle that starts at its desired value, at most `ANGLE`.  Velocities have converged while their errors, linear and
  angular, are at most `BAND` of the largest before.  Numbers that differ by no more than `BAND` are the same.
* A command is saturated where |u| = 1.  It is smooth where it changes by at most `SMOOTH` in one step.
* A number that the thesis reads off a figure or calls approximate is met within `ABOUT` of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ....arrays import Reals
from ..cases.extremes import Extremes, magnitude

POSITIONS = ("x", "y", "z")
HOLDS, PARTLY, FAILS = "holds", "holds in part", "does not hold"
BAND = 0.01  # what a figure lets one tell from zero: the width of a line in a diagram of some 100 widths
ANGLE = 0.2  # deg, a fifth of the narrowest bound of an angle in the thesis (1 deg)
SMOOTH = 0.01  # of the full command, likewise the width of a line, in a step of at most 1 ms
ABOUT = 0.25  # the thesis rounds such numbers to one digit


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


def about(value: float, published: float) -> bool:
    """Whether a number meets one that is read off a figure."""
    return abs(value / published - 1) <= ABOUT


def band(error: Reals) -> float:
    """What counts as zero [m or deg].  error: (N,) magnitude of one axis from the start on."""
    return BAND * float(error[0]) or ANGLE


def converged(of: Extremes, after: float, axes: Iterable[str]) -> dict[str, bool]:
    """{axis: whether its error stays in the band from that time on}.  after: [s]."""
    return {axis: peak(of.of(axis)[of.time >= after]) <= band(of.of(axis)) for axis in axes}


def settled(of: Extremes, axis: str) -> float:
    """The time from which on an error stays in the band [s], to 10 ms; inf if it never does."""
    outside = (of.of(axis) > band(of.of(axis))).nonzero()[0]
    later = of.time[outside[-1] + 1 :] if len(outside) else of.time
    return float(later[0]) if len(later) else math.inf


@dataclass(frozen=True)
class Velocities:
    """What is left of velocity errors after a time base: of u, v, w [m/s], and of p, r [deg/s]; q is not controlled.

    share: of the largest before.
    """

    left: tuple[float, float]
    share: tuple[float, float]

    @property
    def converged(self) -> tuple[bool, bool]:
        return self.share[0] <= BAND, self.share[1] <= BAND

    @property
    def text(self) -> str:
        linear, angular = (f"{100 * share:.2g} % of the largest error before" for share in self.share)
        return f"at most {self.left[0]:.2g} m/s ({linear}) and {self.left[1]:.2g} deg/s ({angular}) away"


def velocities(of: Extremes, after: float) -> Velocities:
    """after: when they are to have converged [s]."""
    off = magnitude(of.off)
    late = of.time >= after
    linear, angular = off[:, :3], off[:, [3, 5]]
    left = peak(linear[late]), peak(angular[late])
    return Velocities(left, (left[0] / peak(linear[~late]), left[1] / peak(angular[~late])))


def peak(values: Reals) -> float:
    return float(abs(values).max())


def markdown(claims: Sequence[Claim]) -> str:
    """All claims as a list by section."""
    counts = f"{tally(claims)}, by the yardstick of docs/thesis.md"
    lines = ["# Claims of chapter 5", "", f"{counts}. A claim marked * decides the exit code.", ""]
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
