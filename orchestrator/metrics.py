"""Numbers that sum a run up.  Each metric is a pure function; the table METRICS names them for [metrics].

Windows: samples with after <= t <= before; integrals over time are trapezoidal over these samples, and t in ITAE counts
from the first of them.  Errors are signal - reference, or the signal itself without one.  Angles are not wrapped: the
vehicle's Euler angles and the references are continuous.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .errors import Problem, did_you_mean

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .records.file.run import Run

    Array = NDArray[np.float64]

UNITS = {  # {unit asked for: {unit of the signal: factor}}
    "deg": {"rad": 180 / math.pi},
    "deg/s": {"rad/s": 180 / math.pi},
    "mm": {"m": 1e3},
    "cm": {"m": 1e2},
    "m": {"m": 1.0},
    "rad": {"rad": 1.0},
}


def rms(time: Array, error: Array) -> float:
    """Root mean square over the samples (thesis Eq. 4.51).  time, error: (N,).  In the signal's unit."""
    return math.sqrt(float((error * error).mean()))


def max_abs(time: Array, error: Array) -> float:
    """Largest magnitude.  In the signal's unit."""
    return float(abs(error).max())


def final(time: Array, error: Array) -> float:
    """The last sample.  In the signal's unit."""
    return float(error[-1])


def settling_time(time: Array, error: Array, band: float) -> float:
    """When the error enters |error| <= band for good [s]; inf where it never does.  band: in the signal's unit."""
    outside = abs(error) > band
    if not outside.any():
        return float(time[0])
    last = int(outside.nonzero()[0][-1])
    return float(time[last + 1]) if last + 1 < len(time) else math.inf


def iae(time: Array, error: Array) -> float:
    """Integral of |error| over time.  In the signal's unit times s."""
    return _integral(time, abs(error))


def ise(time: Array, error: Array) -> float:
    """Integral of error^2 over time.  In the signal's unit squared times s."""
    return _integral(time, error * error)


def itae(time: Array, error: Array) -> float:
    """Integral of t |error| over time, t from the first sample.  In the signal's unit times s^2."""
    return _integral(time, (time - time[0]) * abs(error))


def convergence_time(time: Array, error: Array, band: float) -> float:
    """When |error| <= band for the first time [s]; inf where it never is.  band: in the signal's unit."""
    inside = (abs(error) <= band).nonzero()[0]
    return float(time[inside[0]]) if len(inside) else math.inf


def overshoot(time: Array, error: Array) -> float:
    """How far the error goes beyond zero, in percent of the first sample; 0 where it stays on its side."""
    if error[0] == 0.0:
        return math.nan
    return max(0.0, float((-error / error[0]).max()) * 100.0)


def total_variation(time: Array, signal: Array) -> float:
    """Sum of |change| from recorded row to row: chattering.  In the signal's unit; it grows with finer rows."""
    return float(abs(signal[1:] - signal[:-1]).sum())


def power(u: Array, max_power: float) -> Array:
    """Power that thrusters take: max_power |u|^(3/2) each, for a propeller's thrust grows with the 2/3 power of it.

    u: (N, thrusters), normalized thrust.  max_power: of one thruster at full thrust [W].  Returns (N,) [W].
    """
    total: Array = (abs(u) ** 1.5).sum(axis=1) * max_power
    return total


def energy(time: Array, u: Array, max_power: float) -> float:
    """What the thrusters take over the window [J]; see `power`."""
    return _integral(time, power(u, max_power))


def mean_power(time: Array, u: Array, max_power: float) -> float:
    """Energy by duration [W]; see `power`."""
    return energy(time, u, max_power) / float(time[-1] - time[0]) if len(time) > 1 else math.nan


def distance(time: Array, position: Array, other: Array) -> Array:
    """Euclidean distance of two points.  position, other: (N, 3) in NED [m].  Returns (N,) [m]."""
    difference = position - other
    result: Array = (difference * difference).sum(axis=1) ** 0.5
    return result


def heading_difference(time: Array, heading: Array, other: Array) -> Array:
    """heading - other.  heading, other: (N, 1) [rad].  Returns (N,) in [0, 360) degrees."""
    result: Array = (heading - other)[:, 0] * (180 / math.pi) % 360.0
    result[result == 360.0] = 0.0  # what remains of a difference just below zero, rounded
    return result


def _integral(time: Array, values: Array) -> float:
    return float(((values[1:] + values[:-1]) / 2 * (time[1:] - time[:-1])).sum())


STATISTICS: dict[str, Callable[[Array], Any]] = {
    "mean": lambda values: values.mean(),
    "min": lambda values: values.min(),
    "max": lambda values: values.max(),
}


@dataclass(frozen=True)
class Metric:
    """A function and how [metrics] asks for it: its keys beside `of`, `signal`, `after`, `before`."""

    function: Callable[..., Any]
    unit: str = "{}"  # of the number; {} is the signal's, or the one asked for
    needs: tuple[str, ...] = ()
    takes: tuple[str, ...] = ("reference", "unit")
    axes: tuple[str, ...] = ()  # of the vectors that `signal` and `reference` name; ("*",): all that there are
    ranks: str = "always"  # whether a smaller magnitude is better: "always", "never", "of an error" (with a reference)


NUMBERS = ("band", "max_power")  # keys that are handed to the function

METRICS = {
    "rmse": Metric(rms, needs=("reference",), takes=("unit",)),
    "rms": Metric(rms),
    "iae": Metric(iae, "{}.s"),
    "ise": Metric(ise, "({})2.s"),
    "itae": Metric(itae, "{}.s2"),
    "max_abs": Metric(max_abs),
    "final": Metric(final, ranks="of an error"),
    "settling_time": Metric(settling_time, "s", needs=("band",)),
    "convergence_time": Metric(convergence_time, "s", needs=("band",)),
    "overshoot": Metric(overshoot, "%", needs=("reference",), takes=()),
    "total_variation": Metric(total_variation, takes=("unit",)),
    "energy": Metric(energy, "J", needs=("max_power",), takes=(), axes=("*",)),
    "mean_power": Metric(mean_power, "W", needs=("max_power",), takes=(), axes=("*",)),
    "distance": Metric(distance, "m", needs=("reference",), takes=("stat",), axes=("x", "y", "z"), ranks="never"),
    "heading_difference": Metric(
        heading_difference, "deg", needs=("reference",), takes=("stat",), axes=("psi",), ranks="never"
    ),
}


def evaluate(run: Run, specs: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Every metric of [metrics], checked by `problems` before.

    nan where no sample falls into the window: a run cut short by --set master.stop_time keeps its other metrics.
    """
    return {name: _evaluate(run, spec) for name, spec in specs.items()}


def finite(metrics: Mapping[str, float]) -> dict[str, float | None]:
    """The metrics as JSON can hold them: null for what is no number."""
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}


def unit_of(spec: Mapping[str, Any], units: Mapping[str, str]) -> str:
    """The unit of a metric's number.  units: {signal: unit}."""
    unit = spec.get("unit") or units.get(spec["signal"], "")
    shown = METRICS[spec["of"]].unit.format(unit)
    return shown.replace("1.s", "s").replace("(1)2.s", "s") if unit == "1" else shown


def smaller_is_better(spec: Mapping[str, Any]) -> bool:
    """Whether of two numbers of this metric the one nearer to zero is the better; else neither is."""
    ranks = METRICS[spec["of"]].ranks
    return ranks == "always" or (ranks == "of an error" and "reference" in spec)


def problems(key: str, spec: Mapping[str, Any], units: Mapping[str, str]) -> list[Problem]:
    """What is wrong with one entry of [metrics].  units: {recorded signal: unit}."""
    found: list[Problem] = []

    def problem(name: str, sentence: str) -> None:
        found.append(Problem(f"{key}.{name}", sentence))

    no_texts = [n for n in ("of", "signal", "reference", "unit", "stat") if not isinstance(spec.get(n, ""), str)]
    for name in no_texts:
        problem(name, f"is {spec[name]!r}, not a text")
    if no_texts:
        return found
    of = spec.get("of")
    if of not in METRICS:
        problem("of", ("is missing" if of is None else f"no metric {of!r}") + did_you_mean(str(of), METRICS))
        return found
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
    after, before = spec.get("after", 0.0), spec.get("before", math.inf)
    if all(isinstance(v, (int, float)) for v in (after, before)) and not 0 <= after < before:
        problem("after", f"the window from {after} to {before} s is empty")
    unit, other = (units.get(spec.get(end, ""), "") for end in ("signal", "reference"))
    if unit and other and unit != other:
        problem("reference", f"{spec['reference']} is in {other!r}, {spec['signal']} in {unit!r}")
    if spec.get("stat", "mean") not in STATISTICS:
        problem("stat", f"no {spec['stat']!r}{did_you_mean(str(spec['stat']), STATISTICS)}")
    if "unit" in spec and spec.get("signal") in units and not _factor(spec, units[spec["signal"]]):
        possible = [u for u, factors in UNITS.items() if units[spec["signal"]] in factors]
        problem("unit", f"{units[spec['signal']]!r} does not convert to {spec['unit']!r}{did_you_mean('', possible)}")
    return found


def _signals(signal: str, metric: Metric, recorded: Iterable[str]) -> list[str]:
    """The scalar signals that a metric's `signal` names."""
    if metric.axes == ("*",):
        return [s for s in recorded if s.rpartition(".")[0] == signal] or [signal]
    return [f"{signal}.{axis}" for axis in metric.axes] if metric.axes else [signal]


def _factor(spec: Mapping[str, Any], unit: str) -> float:
    """From the signal's unit to the one asked for; 0 where there is no way."""
    asked = spec.get("unit", unit)
    return 1.0 if asked == unit else UNITS.get(asked, {}).get(unit, 0.0)


def _evaluate(run: Run, spec: Mapping[str, Any]) -> float:
    import numpy as np

    time = run.time
    window = (time >= spec.get("after", 0.0)) & (time <= spec.get("before", math.inf))
    if not window.any():
        return math.nan
    metric = METRICS[spec["of"]]
    numbers = {name: spec[name] for name in NUMBERS if name in spec}
    if not metric.axes:
        error = run[spec["signal"]][window].astype(float)
        if "reference" in spec:
            error = error - run[spec["reference"]][window]
        return float(metric.function(time[window], error * _factor(spec, run.units(spec["signal"])), **numbers))
    vectors = [
        np.column_stack([run[s][window] for s in _signals(spec[end], metric, run.signals)])
        for end in ("signal", "reference")
        if end in spec
    ]
    value = metric.function(time[window], *vectors, **numbers)
    return float(STATISTICS[spec.get("stat", "mean")](value)) if "stat" in metric.takes else float(value)
