"""The definitions of the metrics, over samples that come in blocks, in order.

The first line of a class is what docs/experiment.md says of the metric.  Integrals over time are trapezoidal between
the samples.  The error is signal - reference, or the signal itself where no reference is given.  The error of an angle
against a reference is on the circle, in half a turn either way, where one of them is declared an angle or the key
`wrap` says so; an angle without a reference is the number as it stands, turns included.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from .thrusters import PowerCurve

if TYPE_CHECKING:
    from ..arrays import Reals

SETTLED_SHARE = 0.1  # of the window: a signal that is inside the band for less is passing through
ROUNDING = 1e-12  # of the largest error: an error that begins smaller begins at zero
OPPOSITE = 180.0005  # deg: a mean that shows as -180 is written as 180, and so are the extremes around it


class Accumulator(ABC):
    """A metric in the making."""

    @abstractmethod
    def update(self, time: Reals, *values: Reals) -> None:
        """The next samples, at least one.

        time: (n,) [s].  values: the error (n,); or the vectors that `signal` and `reference` name, (axes, n) each.
        """

    @abstractmethod
    def result(self) -> float:
        """Of the samples so far, at least one."""

    def warning(self) -> str:
        """What makes the result doubtful, or ""."""
        return ""


class Rms(Accumulator):
    """Root mean square of the error over the samples (thesis Eq. 4.51)"""

    def __init__(self) -> None:
        self._sum, self._n = 0.0, 0

    def update(self, time: Reals, *values: Reals) -> None:
        (error,) = values
        self._sum += float((error * error).sum())
        self._n += len(error)

    def result(self) -> float:
        return math.sqrt(self._sum / self._n)


class MaxAbs(Accumulator):
    """Largest magnitude"""

    def __init__(self) -> None:
        self._largest = 0.0

    def update(self, time: Reals, *values: Reals) -> None:
        (error,) = values
        self._largest = max(self._largest, float(error.max()), -float(error.min()))

    def result(self) -> float:
        return self._largest


class Final(Accumulator):
    """The last sample"""

    def __init__(self) -> None:
        self._last = math.nan

    def update(self, time: Reals, *values: Reals) -> None:
        self._last = float(values[0][-1])

    def result(self) -> float:
        return self._last


class SettlingTime(Accumulator):
    """Time after which |error| <= band holds to the end, at least a tenth of the window [s]; inf if it never does"""

    def __init__(self, band: float):
        self._band = band
        self._first = self._last = math.nan  # samples
        self._entered: float | None = None  # since when the error has been inside; None: it is outside

    def update(self, time: Reals, *values: Reals) -> None:
        (error,) = values
        if math.isnan(self._first):
            self._first = float(time[0])
        outside = (abs(error) > self._band).nonzero()[0]
        if len(outside):
            last = int(outside[-1])
            self._entered = float(time[last + 1]) if last + 1 < len(time) else None
        elif self._entered is None:
            self._entered = float(time[0])
        self._last = float(time[-1])

    def result(self) -> float:
        if self._entered is None or self._last - self._entered < SETTLED_SHARE * (self._last - self._first):
            return math.inf
        return self._entered


class ConvergenceTime(Accumulator):
    """Time from which |error| <= band first holds for a tenth of the window [s]; inf if it never does"""

    def __init__(self, band: float):
        self._band = band
        self._first = self._last = math.nan  # samples
        self._since: float | None = None  # the error has been inside; None: it is outside
        self._stays: list[tuple[float, float]] = []  # first and last sample of each that is longer than all before it
        self._longest = -1.0

    def update(self, time: Reals, *values: Reals) -> None:
        if math.isnan(self._first):
            self._first = float(time[0])
        inside = abs(values[0]) <= self._band
        changes = (inside != np.r_[self._since is not None, inside[:-1]]).nonzero()[0]
        starts = time[changes[inside[changes]]]
        ends = np.r_[self._last, time[:-1]][changes[~inside[changes]]]
        if self._since is not None:
            starts = np.r_[self._since, starts]
        self._since = float(starts[-1]) if inside[-1] else None
        lengths = ends - starts[: len(ends)]
        longest = np.maximum.accumulate(np.r_[self._longest, lengths])
        for i in (lengths > longest[:-1]).nonzero()[0]:
            self._stays.append((float(starts[i]), float(ends[i])))
        self._longest, self._last = float(longest[-1]), float(time[-1])

    def result(self) -> float:
        enough = SETTLED_SHARE * (self._last - self._first)
        stays = self._stays if self._since is None else [*self._stays, (self._since, self._last)]
        return next((first for first, last in stays if last - first >= enough), math.inf)


class Overshoot(Accumulator):
    """Largest error of the opposite sign, in percent of the first sample; 0 if the sign never changes

    No value where the error begins at zero, but for rounding.
    """

    def __init__(self) -> None:
        self._first, self._least, self._largest = math.nan, math.inf, -math.inf

    def update(self, time: Reals, *values: Reals) -> None:
        (error,) = values
        if math.isnan(self._first):
            self._first = float(error[0])
        self._least, self._largest = min(self._least, float(error.min())), max(self._largest, float(error.max()))

    def result(self) -> float:
        if abs(self._first) <= ROUNDING * max(-self._least, self._largest):
            return math.nan
        opposite = -self._least if self._first > 0 else self._largest
        return max(0.0, opposite / abs(self._first)) * 100.0


class TotalVariation(Accumulator):
    """Sum of |change| from sample to sample, a measure of chattering"""

    def __init__(self) -> None:
        self._sum, self._last = 0.0, math.nan

    def update(self, time: Reals, *values: Reals) -> None:
        (signal,) = values
        if not math.isnan(self._last):
            self._sum += abs(float(signal[0]) - self._last)
        self._sum += float(abs(signal[1:] - signal[:-1]).sum())
        self._last = float(signal[-1])

    def result(self) -> float:
        return self._sum


class Integral(Accumulator):
    """Trapezoidal, of what `integrand` makes of the samples; t counts from the first of them."""

    def __init__(self) -> None:
        self._sum = 0.0
        self._start = self._time = self._value = math.nan  # of the first sample, and of the last so far

    def integrand(self, time: Reals, *values: Reals) -> Reals:
        """(n,)"""
        return values[0]

    def update(self, time: Reals, *values: Reals) -> None:
        if math.isnan(self._start):
            self._start = float(time[0])
        integrand = self.integrand(time - self._start, *values)
        if not math.isnan(self._time):
            self._sum += float((integrand[0] + self._value) / 2 * (time[0] - self._time))
        self._sum += float(((integrand[1:] + integrand[:-1]) / 2 * (time[1:] - time[:-1])).sum())
        self._time, self._value = float(time[-1]), float(integrand[-1])

    def result(self) -> float:
        return self._sum


class Iae(Integral):
    """Integral of |error| over time"""

    def integrand(self, time: Reals, *values: Reals) -> Reals:
        return abs(values[0])


class Ise(Integral):
    """Integral of error^2 over time"""

    def integrand(self, time: Reals, *values: Reals) -> Reals:
        return values[0] * values[0]


class Itae(Integral):
    """Integral of t |error| over time, t from the first sample"""

    def integrand(self, time: Reals, *values: Reals) -> Reals:
        return time * abs(values[0])


class Energy(Integral):
    """Electrical energy drawn by the thrusters over the window [J]"""

    def __init__(
        self,
        max_power: float | None = None,
        thruster: str = "",
        voltage: float = math.nan,
        max_thrust: float = math.nan,
    ):
        super().__init__()
        self._max_power, self._max_thrust = max_power, max_thrust
        self._curve = PowerCurve(thruster, voltage) if max_power is None else None
        self._beyond = 0.0  # largest thrust that the thruster does not give [N]

    def integrand(self, time: Reals, *values: Reals) -> Reals:
        (u,) = values
        if self._curve is None:
            size = abs(u)
            power: Reals = (size * np.sqrt(size)).sum(axis=0) * self._max_power
            return power
        thrust = u * self._max_thrust
        beyond = thrust[~self._curve.gives(thrust)]
        if len(beyond):
            self._beyond = max(self._beyond, float(beyond.max()), float(beyond.min()), key=abs)
        drawn: Reals = self._curve.power(thrust).sum(axis=0)
        return drawn

    def result(self) -> float:
        return math.nan if self._beyond else super().result()

    def warning(self) -> str:
        if not self._beyond or self._curve is None:
            return ""
        return f"has no value: a command asks for {self._beyond:.3g} N, and {self._curve}"


class MeanPower(Energy):
    """Electrical energy divided by the duration of the window [W]"""

    def result(self) -> float:
        duration = self._time - self._start
        return super().result() / duration if duration else math.nan


class Distance(Accumulator):
    """Euclidean distance between two points"""

    def __init__(self, stat: str = "mean"):
        self._stat, self._sum, self._n = stat, 0.0, 0
        self._least, self._largest = math.inf, -math.inf

    def update(self, time: Reals, *values: Reals) -> None:
        position, other = values
        numbers = distance(position.T, other.T)
        self._sum += float(numbers.sum())
        self._n += len(numbers)
        self._least, self._largest = min(self._least, float(numbers.min())), max(self._largest, float(numbers.max()))

    def result(self) -> float:
        return {"mean": self._sum / self._n, "min": self._least, "max": self._largest}[self._stat]


class HeadingDifference(Accumulator):
    """heading - other, its circular mean in (-180, 180]; min and max: that plus the farthest deviations to either side

    Deviations are followed from sample to sample, so that passing +-180 degrees is no jump.
    """

    def __init__(self, stat: str = "mean"):
        self._stat = stat
        self._sine = self._cosine = self._sum = 0.0
        self._n = 0
        self._last = self._turned = math.nan  # the last difference [deg], as it came and without jumps
        self._least, self._largest = math.inf, -math.inf  # without jumps

    def update(self, time: Reals, *values: Reals) -> None:
        heading, other = values
        angle = heading[0] - other[0]
        self._sine += float(np.sin(angle).sum())
        self._cosine += float(np.cos(angle).sum())
        difference = angle * (180 / math.pi)
        if math.isnan(self._last):
            self._last = self._turned = float(difference[0])
        jumps = np.round((difference - np.r_[self._last, difference[:-1]]) / 360.0)
        turned = difference + (self._turned - self._last)
        if jumps.any():
            turned = turned - 360.0 * np.cumsum(jumps)
        self._last, self._turned = float(difference[-1]), float(turned[-1])
        self._sum += float(turned.sum())
        self._n += len(turned)
        self._least, self._largest = min(self._least, float(turned.min())), max(self._largest, float(turned.max()))

    def result(self) -> float:
        mean = math.degrees(math.atan2(self._sine, self._cosine))
        if mean < OPPOSITE - 360.0:
            mean += 360.0
        if self._stat == "mean":
            return mean
        arithmetic = self._sum / self._n
        center = arithmetic - math.remainder(arithmetic - mean, 360.0)  # the mean, as many turns on
        low, high = self._least - center, self._largest - center
        if low < -180.0 or high > 180.0:  # it passed the side opposite to its mean
            low, high = -180.0, 180.0
        return mean + (low if self._stat == "min" else high)


def on_circle(difference: Reals, turn: float) -> Reals:
    """difference - turn round(difference / turn): the shortest way round, exact where that is the difference itself.

    difference: (N,); turn: 2 pi, or 360, in its unit.  Returns (N,).
    """
    result: Reals = difference - turn * np.round(difference / turn)
    return result


def distance(position: Reals, other: Reals) -> Reals:
    """Euclidean distance between two points.  position, other: (N, 3) in NED [m].  Returns (N,) [m]."""
    difference = position - other
    result: Reals = (difference * difference).sum(axis=1) ** 0.5
    return result


def settling_time(time: Reals, error: Reals, band: float) -> float:
    """`SettlingTime` of samples that are all there.  time: (N,) [s]; error, band: in one unit.  In s."""
    return _whole(SettlingTime(band), time, error)


def overshoot(time: Reals, error: Reals) -> float:
    """`Overshoot` of samples that are all there, (N,).  In percent."""
    return _whole(Overshoot(), time, error)


def _whole(metric: Accumulator, time: Reals, error: Reals) -> float:
    metric.update(time, error)
    return metric.result()
