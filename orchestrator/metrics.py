"""Metrics: numbers that summarize a run.  Each is a pure function; the table METRICS names them for [metrics].

A window holds the samples with after <= t <= before; integrals over time are trapezoidal over these samples, and t in
ITAE counts from the first of them.  The error is signal - reference, or the signal itself where no reference is given.
The error of an angle against a reference is on the circle, in half a turn either way, where one of them is declared an
angle or the key `wrap` says so; an angle without a reference is the number as it stands, turns included.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .errors import Problem, did_you_mean
from .fmu.units import alternatives, conversion

if TYPE_CHECKING:
    from .arrays import Reals, Signals, Table


def rms(time: Reals, error: Reals) -> float:
    """Root mean square over the samples (thesis Eq. 4.51).  time, error: (N,).  In the signal's unit."""
    return math.sqrt(float((error * error).mean()))


def max_abs(time: Reals, error: Reals) -> float:
    """Largest magnitude.  In the signal's unit."""
    return float(abs(error).max())


def final(time: Reals, error: Reals) -> float:
    """The last sample.  In the signal's unit."""
    return float(error[-1])


def settling_time(time: Reals, error: Reals, band: float) -> float:
    """Time after which |error| <= band holds to the end [s]; inf if it never does.  band: in the signal's unit."""
    outside = abs(error) > band
    if not outside.any():
        return float(time[0])
    last = int(outside.nonzero()[0][-1])
    return float(time[last + 1]) if last + 1 < len(time) else math.inf


def iae(time: Reals, error: Reals) -> float:
    """Integral of |error| over time.  In the signal's unit times s."""
    return _integral(time, abs(error))


def ise(time: Reals, error: Reals) -> float:
    """Integral of error^2 over time.  In the signal's unit squared times s."""
    return _integral(time, error * error)


def itae(time: Reals, error: Reals) -> float:
    """Integral of t |error| over time, t from the first sample.  In the signal's unit times s^2."""
    return _integral(time, (time - time[0]) * abs(error))


def convergence_time(time: Reals, error: Reals, band: float) -> float:
    """Time at which |error| <= band holds first [s]; inf if it never does.  band: in the signal's unit."""
    inside = (abs(error) <= band).nonzero()[0]
    return float(time[inside[0]]) if len(inside) else math.inf


def overshoot(time: Reals, error: Reals) -> float:
    """Largest error of the opposite sign, in percent of the first sample; 0 if the sign never changes."""
    if error[0] == 0.0:
        return math.nan
    return max(0.0, float((-error / error[0]).max()) * 100.0)


def total_variation(time: Reals, signal: Reals) -> float:
    """Sum of |change| between successive rows, a measure of chattering.  In the signal's unit; finer rows give more."""
    return float(abs(signal[1:] - signal[:-1]).sum())


def power(u: Reals, max_power: float) -> Reals:
    """Power drawn by the thrusters: the sum of max_power |u|^(3/2), as a propeller's thrust grows with power^(2/3).

    u: (N, thrusters), normalized thrust.  max_power: of one thruster at full thrust [W].  Returns (N,) [W].
    """
    total: Reals = (abs(u) ** 1.5).sum(axis=1) * max_power
    return total


def energy(time: Reals, u: Reals, max_power: float) -> float:
    """Energy drawn by the thrusters over the window [J]; see `power`."""
    return _integral(time, power(u, max_power))


def mean_power(time: Reals, u: Reals, max_power: float) -> float:
    """Energy divided by the duration of the window [W]; see `power`."""
    return energy(time, u, max_power) / float(time[-1] - time[0]) if len(time) > 1 else math.nan


def on_circle(difference: Reals, turn: float) -> Reals:
    """difference - turn round(difference / turn): the shortest way round, exact where that is the difference itself.

    difference: (N,); turn: 2 pi, or 360, in its unit.  Returns (N,).
    """
    import numpy as np

    result: Reals = difference - turn * np.round(difference / turn)
    return result


def distance(time: Reals, position: Reals, other: Reals) -> Reals:
    """Euclidean distance between two points.  position, other: (N, 3) in NED [m].  Returns (N,) [m]."""
    difference = position - other
    result: Reals = (difference * difference).sum(axis=1) ** 0.5
    return result


def heading_difference(time: Reals, heading: Reals, other: Reals) -> Reals:
    """heading - other.  heading, other: (N, 1) [rad].  Returns (N,) in [0, 360) degrees."""
    result: Reals = (heading - other)[:, 0] * (180 / math.pi) % 360.0
    result[result == 360.0] = 0.0  # the remainder of a difference just below zero rounds to 360
    return result


def _integral(time: Reals, values: Reals) -> float:
    return float(((values[1:] + values[:-1]) / 2 * (time[1:] - time[:-1])).sum())


STATISTICS: dict[str, Callable[[Reals], float]] = {
    "mean": lambda values: values.mean(),
    "min": lambda values: values.min(),
    "max": lambda values: values.max(),
}


@dataclass(frozen=True)
class Metric:
    """A metric's function, and its entry in [metrics]: the keys it needs and takes beside `of`, `signal`, `after`,
    `before`."""

    function: Callable[..., Any]
    unit: str = "{}"  # of the result; {} is the signal's, or the one that the key `unit` names
    needs: tuple[str, ...] = ()
    takes: tuple[str, ...] = ("reference", "unit", "wrap")
    axes: tuple[str, ...] = ()  # of the vectors that `signal` and `reference` name; ("*",): every axis
    ranks: str = "always"  # whether a smaller magnitude is better: "always", "never", "of an error" (with a reference)
    counts: bool = False  # what happens from step to step: no power law of the step


POWER_UNIT = "1"  # of commands, which energy and mean_power take
WHAT = {"1": "commands, which have the unit 1", "m": "positions, in a unit of length", "rad": "an angle"}
NUMBERS = ("band", "max_power")  # keys that are arguments of the function

METRICS = {
    "rmse": Metric(rms, needs=("reference",), takes=("unit", "wrap")),
    "rms": Metric(rms),
    "iae": Metric(iae, "{}.s"),
    "ise": Metric(ise, "({})2.s"),
    "itae": Metric(itae, "{}.s2"),
    "max_abs": Metric(max_abs),
    "final": Metric(final, ranks="of an error"),
    "settling_time": Metric(settling_time, "s", needs=("band",)),
    "convergence_time": Metric(convergence_time, "s", needs=("band",)),
    "overshoot": Metric(overshoot, "%", needs=("reference",), takes=("wrap",)),
    "total_variation": Metric(total_variation, takes=("unit",), counts=True),
    "energy": Metric(energy, "J", needs=("max_power",), takes=(), axes=("*",)),
    "mean_power": Metric(mean_power, "W", needs=("max_power",), takes=(), axes=("*",)),
    "distance": Metric(distance, "m", needs=("reference",), takes=("stat",), axes=("x", "y", "z"), ranks="never"),
    "heading_difference": Metric(
        heading_difference, "deg", needs=("reference",), takes=("stat",), axes=("psi",), ranks="never"
    ),
}


def evaluate(run: Signals, specs: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Evaluate every entry of [metrics]; `problems` must have accepted each.

    Returns {name: number}, nan where no sample falls into the window: a run shortened by --set master.stop_time keeps
    its other metrics.
    """
    return {name: _evaluate(run, spec) for name, spec in specs.items()}


def finite(metrics: Mapping[str, float]) -> dict[str, float | None]:
    """The metrics as JSON can hold them: None for nan and inf."""
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}


def unit_of(spec: Mapping[str, Any], units: Mapping[str, str]) -> str:
    """The unit of a metric.  units: {signal: unit}."""
    unit = spec.get("unit") or units.get(spec["signal"], "")
    shown = METRICS[spec["of"]].unit.format(unit)
    return shown.replace("1.s", "s").replace("(1)2.s", "s") if unit == "1" else shown


def smaller_is_better(spec: Mapping[str, Any]) -> bool:
    """Whether the smaller magnitude of this metric is the better one; otherwise the metric ranks nothing."""
    ranks = METRICS[spec["of"]].ranks
    return ranks == "always" or (ranks == "of an error" and "reference" in spec)


def problems(key: str, spec: Mapping[str, Any], units: Mapping[str, str]) -> list[Problem]:
    """Check one entry of [metrics].  key: its dotted key; units: {recorded signal: unit}.  Returns its problems."""
    result: list[Problem] = []

    def problem(name: str, sentence: str) -> None:
        result.append(Problem(f"{key}.{name}", sentence))

    no_texts = [n for n in ("of", "signal", "reference", "unit", "stat") if not isinstance(spec.get(n, ""), str)]
    for name in no_texts:
        problem(name, f"is {spec[name]!r}, not a text")
    if no_texts:
        return result
    of = spec.get("of")
    if of not in METRICS:
        problem("of", ("is missing" if of is None else f"no metric {of!r}") + did_you_mean(str(of), METRICS))
        return result
    metric = METRICS[of]
    keys = ("of", "signal", "after", "before", *metric.needs, *metric.takes)
    for name in spec:
        if name not in keys:
            problem(name, f"{of} takes no {name!r}{did_you_mean(name, keys)}")
    for name in ("signal", *metric.needs):
        if name not in spec:
            problem(name, "is missing")
    for name in ("signal", "reference"):
        if name in spec:
            missing = [s for s in _signals(str(spec[name]), metric, units) if s not in units]
            if missing:
                choices = {s.rpartition(".")[0] for s in units} if metric.axes else units
                near = did_you_mean(str(spec[name]), sorted(choices), "recorded")
                problem(name, f"no recorded signal {spec[name]!r}{near}")
    for name in ("after", "before", *NUMBERS):
        value = spec.get(name, 0.0)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            problem(name, f"is {value!r}, not a number")
        elif name in NUMBERS and name in spec and value <= 0:
            problem(name, f"is {value!r}; give a positive number")
    if not isinstance(spec.get("wrap", False), bool):
        problem("wrap", f"is {spec['wrap']!r}, neither true nor false")
    elif spec.get("wrap") and "reference" not in spec:
        problem("wrap", "is for differences; give a reference")
    elif spec.get("wrap") and units.get(str(spec.get("signal")), "rad") and not _turn(units.get(spec["signal"], "rad")):
        problem("wrap", f"{spec['signal']} is in {units[spec['signal']]!r}, which is no unit of angles")
    after, before = spec.get("after", 0.0), spec.get("before", math.inf)
    if all(isinstance(v, (int, float)) for v in (after, before)) and not 0 <= after < before:
        problem("after", f"the window from {after} to {before} s is empty")
    if "reference" in spec and "signal" in spec:
        for one, two in zip(*(_signals(spec[end], metric, units) for end in ("signal", "reference")), strict=False):
            if not _fits(units.get(two, ""), units.get(one, "")):
                problem("reference", f"{two} is in {units[two]!r}, {one} in {units[one]!r}")
                break
    if metric.axes and "signal" in spec:
        expected = POWER_UNIT if metric.axes == ("*",) else metric.unit.replace("deg", "rad")
        for name in _signals(spec["signal"], metric, units):
            if not _fits(units.get(name, ""), expected):
                problem("signal", f"{name} is in {units[name]!r}; {of} takes {WHAT[expected]}")
                break
    if spec.get("stat", "mean") not in STATISTICS:
        problem("stat", f"no {spec['stat']!r}{did_you_mean(str(spec['stat']), STATISTICS)}")
    if "unit" in spec and spec.get("signal") in units and not _factor(spec["unit"], units[spec["signal"]]):
        own = units[spec["signal"]]
        near = did_you_mean(spec["unit"], alternatives(own or "1"))
        problem("unit", f"{own!r} does not convert to {spec['unit']!r}{near}")
    return result


def _signals(signal: str, metric: Metric, recorded: Iterable[str]) -> list[str]:
    """The scalar signals that a metric's `signal` names."""
    if metric.axes == ("*",):
        return [s for s in recorded if s.rpartition(".")[0] == signal] or [signal]
    return [f"{signal}.{axis}" for axis in metric.axes] if metric.axes else [signal]


def _factor(asked: str, unit: str) -> float:
    """Factor from the signal's unit to the one asked for; 0 where a factor alone does not convert it."""
    if asked == unit:
        return 1.0
    try:
        factor, offset = conversion(unit or "1", {}, asked or "1", {})
    except ValueError:
        return 0.0
    return 0.0 if offset else factor


def _fits(unit: str, other: str) -> bool:
    """Whether one unit converts to the other; a signal without a unit fits anything."""
    try:
        return not unit or not other or bool(conversion(unit, {}, other, {}))
    except ValueError:
        return unit == other


def _converted(values: Table, unit: str, wanted: str) -> Reals:
    """The values in the unit that is wanted; as they stand where they have none, which a record calls "1"."""
    factor, offset = conversion(unit, {}, wanted, {}) if "1" not in (unit, wanted) or unit == "%" else (1.0, 0.0)
    return values.astype(float) if (factor, offset) == (1.0, 0.0) else values * factor + offset


def _turn(unit: str) -> float:
    """A full turn in a unit of angles; 0 of any other."""
    return 2 * math.pi * _factor(unit, "rad") if _factor(unit, "rad") else 0.0


def _evaluate(run: Signals, spec: Mapping[str, Any]) -> float:
    import numpy as np

    time = run.time
    window = (time >= spec.get("after", 0.0)) & (time <= spec.get("before", math.inf))
    if not window.any():
        return math.nan
    metric = METRICS[spec["of"]]
    numbers = {name: spec[name] for name in NUMBERS if name in spec}
    if not metric.axes:
        error, unit = run[spec["signal"]][window].astype(float), run.units(spec["signal"])
        if "reference" in spec:
            error = error - _converted(run[spec["reference"]][window], run.units(spec["reference"]), unit)
            turn = _turn(unit)
            if turn and spec.get("wrap", any(run.is_angle(spec[end]) for end in ("signal", "reference"))):
                error = on_circle(error, turn)
        return float(metric.function(time[window], error * _factor(spec.get("unit", unit), unit), **numbers))
    wanted = POWER_UNIT if metric.axes == ("*",) else metric.unit.replace("deg", "rad")
    vectors = [
        np.column_stack(
            [_converted(run[s][window], run.units(s), wanted) for s in _signals(spec[end], metric, run.signals)]
        )
        for end in ("signal", "reference")
        if end in spec
    ]
    value = metric.function(time[window], *vectors, **numbers)
    return float(STATISTICS[spec.get("stat", "mean")](value)) if "stat" in metric.takes else float(value)
