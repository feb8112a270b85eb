"""Whether a feedback loop is unstable because of the step that it is sampled with.

Such a run is wrong even where its position errors look right.  Two looks are taken.

The first, at the bursts of every run, finds outputs that move fast: at least SHARE of their mean square lies at periods
of LONGEST steps or fewer.  Limit cycles do, whatever their period; so does the noise of a sensor.

The second compares with the same experiment at half the step, over the first of these bursts and, where those do not
decide, over the whole run.  What a loop does because of its step gets less, and its rms falls by more than CHANGE;
noise does not.  A limit cycle between limits may keep its rms, too; then its rhythm tells: it takes as many steps a
period as before, and a quarter of the step, an eighth and a sixteenth decide.

The thresholds were fixed on some 600 runs; benchmarks/detector.py measures misses and false alarms on others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ..arrays import Reals, Truths
from ..names import split_axis
from .bursts import Bursts, Clock

CHANGE = 0.2  # of the rms of a command: more is wrong
CHANGE_OF_STATE = 0.35  # of any other output: what noise that is new in each step does to a state falls by 0.29
CHANGE_OF_NOISE = 0.45  # upwards, without a rhythm: noise that is given by its density rises by 0.41
SHARE = 0.25  # where all that is fast is gone at half the step, a CHANGE takes 0.36
LONGEST = 64  # steps a period; between its limits a command may take that long
NONE, CERTAIN = 0.08, 0.35  # changes that the first bursts estimate: up to NONE is none, above CERTAIN is one
FEWEST_BURSTS = 8  # to estimate from
FEWEST_STEPS = 16  # of a component, below which nothing is judged
SMALL = 1e-2  # of the largest rms of its vector; what is smaller does no harm
ROUNDING = 1e-9  # of the largest rms of its loop
RHYTHM = 0.6  # of what is fast, within two lines of the strongest one
SAME = 0.7  # ratio of two periods, or of two amplitudes, from which on they are the same


class StabilityVerdict(Enum):
    """On a loop, from a comparison with a shorter step."""

    STEADY = "what is fast is so at the shorter step, too"
    UNSTABLE = "what is fast comes from the step"
    LOCKED = "a limit cycle that takes as many steps as before"
    OPEN = "the first bursts do not decide"


@dataclass(frozen=True)
class Suspect:
    """An output that moves fast.

    output: its place in Bursts.outputs.  clock, column: where its bursts are.  share: of its mean square.  steps: a
    period of the strongest line, of its clock.  rhythm: see RHYTHM.  enough: how many bursts show what is fast as
    strong as it is on average.
    """

    output: int
    clock: int
    column: int
    share: float
    steps: float
    rhythm: float
    enough: int


@dataclass(frozen=True)
class StepComparison:
    """A suspect at two steps.  change: estimated, of its rms; rhythm: at the shorter step; locked: as of a verdict."""

    change: float
    rhythm: float
    locked: bool


def suspects(bursts: Bursts) -> list[Suspect]:
    """The outputs that move fast in a run."""
    rms = bursts.rms
    relevant = _relevant(bursts, rms)
    found: list[Suspect] = []
    for number, clock in enumerate(bursts.clocks):
        values = clock.bursts
        n, length, _ = values.shape
        if n * length < FEWEST_STEPS:
            continue
        weights, first = _weights(bursts, clock), _first_fast(length)
        # Periods of LONGEST steps differ so much from step to step: what is slow is spared its spectra.
        moving = ~(_by_step(values, weights) < SHARE * np.sin(np.pi / LONGEST) ** 2)
        largest = abs(values).max(axis=(0, 1))
        columns = np.flatnonzero(relevant[clock.chosen] & moving & (largest != 0))
        values = values[..., columns] / largest[columns]
        squares = weights @ (values**2).mean(axis=1)
        lines, by_step = _spectra(values), _by_step(values, weights)
        # The window of a spectrum hides what explodes: half of the squares, or more, at the end of the bursts.
        at_end = weights @ (values[:, -(length // 8) :] ** 2).sum(axis=1) / length
        explodes = ~(at_end < 0.5 * squares)
        shown = weights @ (values**2 * _window(length)[:, np.newaxis] ** 2).mean(axis=1)
        for place, column in enumerate(columns.tolist()):
            fast = lines[:, first:, place].sum(axis=1)
            output = int(clock.chosen[column])
            share = float(weights @ fast / squares[place])
            if not share >= SHARE and explodes[place]:  # by_step is a lower bound
                share = max(float(by_step[place]), min(1.0, float(weights @ fast / shown[place])))
            if share >= SHARE:
                steps, rhythm = _strongest(weights @ lines[..., place], first, length)
                found.append(Suspect(output, number, column, share, steps, rhythm, _enough(weights, fast)))
    return found


def first_end(bursts: Bursts, found: Iterable[Suspect]) -> int:
    """The tick up to which a run is compared first: the last one where that would be most of it."""
    clocks = [(bursts.clocks[suspect.clock], suspect.enough) for suspect in found]
    end = max(int(clock.ticks[min(enough * clock.length, clock.done[0]) - 1]) for clock, enough in clocks)
    return end if 2 * (end - bursts.first) < bursts.last - bursts.first else bursts.last


def compare(suspect: Suspect, coarse: Bursts, fine: Bursts, whole: bool) -> StepComparison | None:
    """A suspect of a run in another with shorter steps; None where the other has too little of it.

    whole: in all bursts that both have, not only in the first.
    """
    clocks = coarse.clocks[suspect.clock], fine.clocks[suspect.clock]
    more = clocks[1].length // clocks[0].length
    before, after = (clock.bursts[..., suspect.column] for clock in clocks)
    n, length = min(len(before), len(after)), min(before.shape[1], after.shape[1] // more)
    n = n if whole else min(n, suspect.enough)
    if n * length < FEWEST_STEPS:
        return None
    weights, first, peak = _weights(coarse, clocks[0])[:n], _first_fast(length), abs(before).max()
    with np.errstate(over="ignore", invalid="ignore"):
        lines = [
            weights @ _spectra(values[:n, :steps, np.newaxis] / peak)[..., 0]
            for values, steps in ((before, length), (after, more * length))
        ]
        kept = lines[1][first:].sum() / lines[0][first:].sum()  # of what is fast, squared
        change = float(np.sqrt(max(0.0, 1.0 - suspect.share * (1.0 - kept)))) - 1.0
    (steps, rhythm), (steps_after, rhythm_after) = (
        _strongest(spectrum, first, steps) for spectrum, steps in zip(lines, (length, more * length), strict=True)
    )
    locked = (
        suspect.share > 0.5
        and min(rhythm, rhythm_after) > RHYTHM
        and SAME < steps_after / steps < 1 / SAME
        and not kept < SAME**2
    )
    return StepComparison(change, rhythm_after, locked)


def judge_first(found: Sequence[Suspect], coarse: Bursts, fine: Bursts) -> StabilityVerdict:
    """On a loop, from the first bursts.  found: its suspects."""
    compared = [compare(suspect, coarse, fine, whole=False) for suspect in found]
    if any(c is None or not np.isfinite(c.change) for c in compared):
        return StabilityVerdict.OPEN
    changes = [c.change for c in compared if c]
    if min(changes) < -CERTAIN:
        return StabilityVerdict.UNSTABLE
    if any(c.locked for c in compared if c) and max(map(abs, changes)) <= NONE:
        return StabilityVerdict.LOCKED
    rhythmic = any(suspect.rhythm > RHYTHM for suspect in found)  # a limit cycle may still grow
    return StabilityVerdict.OPEN if rhythmic or max(map(abs, changes)) > NONE else StabilityVerdict.STEADY


def judge_whole(
    found: Sequence[Suspect], coarse: Bursts, fine: Bursts, changes: Mapping[int, float]
) -> StabilityVerdict:
    """On a loop, from all of the run that both have done.  found: its suspects.  changes: see `changes_of`."""
    compared = [(suspect.output, compare(suspect, coarse, fine, whole=True)) for suspect in found]
    rhythmic = {output for output, c in compared if c and c.rhythm > RHYTHM}
    for output, change in changes.items():
        least = CHANGE if coarse.outputs[output].command else CHANGE_OF_STATE
        if change < -least or change > (least if output in rhythmic else CHANGE_OF_NOISE):
            return StabilityVerdict.UNSTABLE
    return StabilityVerdict.LOCKED if any(c.locked for _, c in compared if c) else StabilityVerdict.STEADY


def changes_of(found: Sequence[Suspect], coarse: Bursts, fine: Bursts, whole: bool, exact: bool) -> dict[int, float]:
    """{output: change of its rms, by what it was} of a loop.  found: its suspects.

    exact: from all steps, of all outputs of the loop that are relevant; else estimated from bursts, of the suspects.
    whole: from all bursts.
    """
    if exact:
        loop = coarse.outputs[found[0].output].loop
        before, after = coarse.rms, fine.rms
        of = [i for i in np.flatnonzero(_relevant(coarse, before)).tolist() if coarse.outputs[i].loop == loop]
        with np.errstate(invalid="ignore"):
            changes = {i: float(after[i] / before[i]) - 1.0 for i in of}
        if known := {i: change for i, change in changes.items() if not np.isnan(change)}:
            return known
    compared = [(suspect.output, compare(suspect, coarse, fine, whole)) for suspect in found]
    return {output: c.change for output, c in compared if c and not np.isnan(c.change)}


def _by_step(values: Reals, weights: Reals) -> Reals:
    """(n,) a quarter of the mean square of what changes from step to step, by the mean square; 1 where it alternates.

    A period of k steps has sin^2(pi / k); nan where squares are too large.  values: (bursts, steps, n).
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        changes = values[:, 1:] - values[:, :-1]
        by_step, squares = (weights @ np.einsum("bsn,bsn->bn", v, v) / v.shape[1] for v in (changes, values))
        return np.asarray(by_step / (4.0 * squares))


def _relevant(bursts: Bursts, sizes: Reals) -> Truths:
    """(outputs,) whether an rms is more than rounding, and not small in its vector.  sizes: of all outputs."""
    keys = [(o.component, split_axis(o.variable.name)[0], o.variable.unit) for o in bursts.outputs]
    vectors: dict[tuple[str, str, str], float] = {}
    loops: dict[int, float] = {}
    for output, key, size in zip(bursts.outputs, keys, sizes, strict=True):
        vectors[key] = max(vectors.get(key, 0.0), float(size))
        loops[output.loop] = max(loops.get(output.loop, 0.0), float(size))
    least = [
        max(SMALL * vectors[key], ROUNDING * loops[output.loop])
        for output, key in zip(bursts.outputs, keys, strict=True)
    ]
    return np.asarray((sizes > 0.0) & (sizes >= np.array(least)))


def _weights(bursts: Bursts, clock: Clock) -> Reals:
    """(whole bursts,) what share of the run each of them stands for: until the next one begins."""
    begins = clock.starts[: len(clock.bursts)]
    spans = np.diff(np.append(begins, bursts.last)).astype(float)
    return np.asarray(spans / spans.sum())


def _first_fast(length: int) -> int:
    """The line from which on the spectrum of so many steps is fast; the lines below it take up trends."""
    return max(2, -(-length // LONGEST))


def _spectra(values: Reals) -> Reals:
    """(bursts, lines, n): mean squares by frequency, straight trends taken off.  values: (bursts, steps, n)."""
    length = values.shape[1]
    window = _window(length)
    time = np.arange(length) - (length - 1) / 2
    slopes = np.tensordot(values, time, (1, 0)) / (time @ time)
    rest = values - values.mean(axis=1, keepdims=True) - slopes[:, np.newaxis] * time[:, np.newaxis]
    lines = 2 * abs(np.fft.rfft(rest * window[:, np.newaxis], axis=1)) ** 2 / length**2
    if length % 2 == 0:
        lines[:, -1] /= 2
    return np.asarray(lines)


def _window(length: int) -> Reals:
    """Hann's, (length,), of the mean square 1."""
    window = np.hanning(length)
    return np.asarray(window / np.sqrt((window**2).mean()))


def _strongest(lines: Reals, first: int, length: int) -> tuple[float, float]:
    """Steps a period of the strongest line from `first` on, and the share of it and its neighbours in all of those."""
    fast = lines[first:]
    place = int(fast.argmax())
    near, whole = fast[max(0, place - 2) : place + 3].sum(), fast.sum()
    return length / (first + place), float(near / whole) if whole else 0.0


def _enough(weights: Reals, fast: Reals) -> int:
    """How many of the bursts show what is fast at least half as strong as it is on average.  fast: (bursts,)."""
    strength = np.cumsum(weights * fast) / np.cumsum(weights)
    fewest = min(FEWEST_BURSTS, len(fast)) - 1
    strong = np.flatnonzero(strength[fewest:] >= 0.5 * (weights @ fast))
    return fewest + 1 + int(strong[0]) if len(strong) else len(fast)
