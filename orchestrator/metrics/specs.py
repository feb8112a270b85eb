"""The entries of [metrics]: which metrics exist, what is wrong with an entry, and how one is taken of a run.

A window holds the samples with after <= t <= before: every communication step, or with `every` its multiples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import Problem, did_you_mean
from ..fmu.units import alternatives, conversion
from . import accumulators, thrusters
from .accumulators import Accumulator, on_circle

if TYPE_CHECKING:
    from ..arrays import Reals

STATISTICS = ("mean", "min", "max")


@dataclass(frozen=True)
class Metric:
    """What takes a metric, and its entry in [metrics]: the keys it needs and takes beside `of`, `signal`, `after`,
    `before`, `every`."""

    accumulator: Callable[..., Accumulator]
    unit: str = "{}"  # of the result; {} is the signal's, or the one that the key `unit` names
    needs: tuple[str, ...] = ()
    takes: tuple[str, ...] = ("reference", "unit", "wrap")
    axes: tuple[str, ...] = ()  # of the vectors that `signal` and `reference` name; ("*",): every axis
    ranks: str = "always"  # whether a smaller magnitude is better: "always", "never", "of an error" (with a reference)
    counts: bool = False  # what happens from step to step: no power law of the step
    angle: str = "never"  # whether the number is itself an angle: "always", "never", "of an angle" (without reference)

    @property
    def meaning(self) -> str:
        """In a line."""
        return (self.accumulator.__doc__ or "").partition("\n")[0]


POWER_UNIT = "1"  # of commands, which energy and mean_power take
WHAT = {"1": "commands, which have the unit 1", "m": "positions, in a unit of length", "rad": "an angle"}
TABLE_KEYS = ("thruster", "voltage", "max_thrust")  # of power by a vendor's table
POWER = ("max_power", *TABLE_KEYS)
NUMBERS = ("band", "max_power", "voltage", "max_thrust", "every")
TEXTS = ("of", "signal", "reference", "unit", "stat", "thruster")
ARGUMENTS = ("band", "stat", *POWER)  # keys that are arguments of the accumulator

METRICS = {
    "rmse": Metric(accumulators.Rms, needs=("reference",), takes=("unit", "wrap")),
    "rms": Metric(accumulators.Rms),
    "iae": Metric(accumulators.Iae, "{}.s"),
    "ise": Metric(accumulators.Ise, "({})2.s"),
    "itae": Metric(accumulators.Itae, "{}.s2"),
    "max_abs": Metric(accumulators.MaxAbs),
    "final": Metric(accumulators.Final, ranks="of an error", angle="of an angle"),
    "settling_time": Metric(accumulators.SettlingTime, "s", needs=("band",)),
    "convergence_time": Metric(accumulators.ConvergenceTime, "s", needs=("band",)),
    "overshoot": Metric(accumulators.Overshoot, "%", needs=("reference",), takes=("wrap",)),
    "total_variation": Metric(accumulators.TotalVariation, takes=("unit",), counts=True),
    "energy": Metric(accumulators.Energy, "J", takes=POWER, axes=("*",)),
    "mean_power": Metric(accumulators.MeanPower, "W", takes=POWER, axes=("*",)),
    "distance": Metric(
        accumulators.Distance, "m", needs=("reference",), takes=("stat",), axes=("x", "y", "z"), ranks="never"
    ),
    "heading_difference": Metric(
        accumulators.HeadingDifference,
        "deg",
        needs=("reference",),
        takes=("stat",),
        axes=("psi",),
        ranks="never",
        angle="always",
    ),
}


class Meter:
    """Takes one metric of a run that goes on, from blocks of samples.

    spec: its entry in [metrics], which `problems` has accepted; units: {signal: unit} of all that is readable; angles:
    signals whose differences are differences on the circle; every: ticks from sample to sample.
    """

    def __init__(self, spec: Mapping[str, Any], units: Mapping[str, str], angles: Container[str] = (), every: int = 1):
        self._metric, self._every = METRICS[spec["of"]], every
        self._after, self._before = spec.get("after", 0.0), spec.get("before", math.inf)
        self._ends = [_signals(spec[end], self._metric, units) for end in ("signal", "reference") if end in spec]
        unit = wanted = units[self._ends[0][0]]
        if self._metric.axes:
            wanted = POWER_UNIT if self._metric.axes == ("*",) else self._metric.unit.replace("deg", "rad")
        self._conversions = {name: _conversion(units[name], wanted) for names in self._ends for name in names}
        wraps = spec.get("wrap", any(name in angles for names in self._ends for name in names))
        self._turn = _turn(unit) if wraps and len(self._ends) > 1 and not self._metric.axes else 0.0
        self._factor = 1.0 if self._metric.axes else _factor(spec.get("unit", unit), unit)
        self._accumulator = self._metric.accumulator(**{name: spec[name] for name in ARGUMENTS if name in spec})
        self._samples = 0

    def update(self, tick: int, time: Reals, samples: Mapping[str, Reals]) -> None:
        """The values at consecutive ticks from `tick`.  time: (n,) [s]; samples: {signal: (n,)}."""
        first, last = 0, len(time)
        if not self._after <= time[0] <= time[-1] <= self._before:
            first, last = (
                int(np.searchsorted(time, self._after, "left")),
                int(np.searchsorted(time, self._before, "right")),
            )
        first += -(tick + first) % self._every
        if first >= last:
            return
        window = slice(first, last, self._every)
        time = time[window]
        self._samples += len(time)
        if self._metric.axes:
            vectors = [np.array([self._of(name, samples[name][window]) for name in names]) for names in self._ends]
            self._accumulator.update(time, *vectors)
            return
        error, *reference = (self._of(names[0], samples[names[0]][window]) for names in self._ends)
        if reference:
            error = error - reference[0]
        if self._turn:
            error = on_circle(error, self._turn)
        self._accumulator.update(time, error if self._factor == 1.0 else error * self._factor)

    def _of(self, name: str, values: Reals) -> Reals:
        """Values of a signal in the unit that the metric takes."""
        factor, offset = self._conversions[name]
        return values if (factor, offset) == (1.0, 0.0) else values * factor + offset

    def result(self) -> float:
        """The metric of the samples so far; nan where none fell into the window: a run shortened by --set
        master.stop_time keeps its other metrics."""
        return math.nan if not self._samples else float(self._accumulator.result())

    def warning(self) -> str:
        """What makes the result doubtful, or ""."""
        if self._samples == 1 and self._metric.accumulator is not accumulators.Final:
            return "is of a single sample: no more fall into its window"
        return self._accumulator.warning()


def signals_of(spec: Mapping[str, Any], names: Iterable[str]) -> list[str]:
    """The scalar signals that an entry of [metrics] needs.  names: of all that is readable."""
    return [
        name
        for end in ("signal", "reference")
        if end in spec
        for name in _signals(spec[end], METRICS[spec["of"]], names)
    ]


def finite(metrics: Mapping[str, float]) -> dict[str, float | None]:
    """The metrics as JSON can hold them: None for nan and inf."""
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}


def text(value: float) -> str:
    """A metric that has a sample, for a person: "never" where what it is the time of does not happen."""
    if math.isfinite(value):
        return f"{value:.6g}"
    return "no value" if math.isnan(value) else "never"


def unit_of(spec: Mapping[str, Any], units: Mapping[str, str]) -> str:
    """The unit of a metric.  units: {signal: unit}."""
    unit = spec.get("unit") or units.get(spec["signal"], "")
    shown = METRICS[spec["of"]].unit.format(unit)
    return shown.replace("1.s", "s").replace("(1)2.s", "s") if unit == "1" else shown


def turn_of(spec: Mapping[str, Any], units: Mapping[str, str], angles: Container[str]) -> float:
    """A full turn in the unit of a metric that is itself an angle, whose means are taken on the circle; else 0.

    units: {signal: unit}; angles: signals whose differences are differences on the circle.
    """
    metric = METRICS[spec["of"]]
    is_angle = metric.angle == "always" or (
        metric.angle == "of an angle" and "reference" not in spec and spec["signal"] in angles
    )
    return _turn(unit_of(spec, units)) if is_angle else 0.0


def smaller_is_better(spec: Mapping[str, Any]) -> bool:
    """Whether the smaller magnitude of this metric is the better one; otherwise the metric ranks nothing."""
    ranks = METRICS[spec["of"]].ranks
    return ranks == "always" or (ranks == "of an error" and "reference" in spec)


def problems(key: str, spec: Mapping[str, Any], units: Mapping[str, str]) -> list[Problem]:
    """Check one entry of [metrics].  key: its dotted key; units: {readable signal: unit}.  Returns its problems."""
    result: list[Problem] = []

    def problem(name: str, sentence: str) -> None:
        result.append(Problem(f"{key}.{name}", sentence))

    no_texts = [n for n in TEXTS if not isinstance(spec.get(n, ""), str)]
    for name in no_texts:
        problem(name, f"is {spec[name]!r}, not a text")
    if no_texts:
        return result
    of = spec.get("of")
    if of not in METRICS:
        problem("of", ("is missing" if of is None else f"no metric {of!r}") + did_you_mean(str(of), METRICS))
        return result
    metric = METRICS[of]
    keys = ("of", "signal", "after", "before", "every", *metric.needs, *metric.takes)
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
                near = did_you_mean(str(spec[name]), sorted(choices), "there are")
                problem(name, f"no signal {spec[name]!r}{near}")
    for name in ("after", "before", *NUMBERS):
        value = spec.get(name, 0.0)
        if not _is_number(value):
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
    if sentence := _power_problem(spec):
        problem(*sentence)
    if "unit" in spec and spec.get("signal") in units and not _factor(spec["unit"], units[spec["signal"]]):
        own = units[spec["signal"]]
        near = did_you_mean(spec["unit"], alternatives(own or "1"))
        problem("unit", f"{own!r} does not convert to {spec['unit']!r}{near}")
    return result


def _power_problem(spec: Mapping[str, Any]) -> tuple[str, str] | None:
    """What is wrong with how a metric of power says which power: the key, and a sentence."""
    if not set(POWER) & set(METRICS[spec["of"]].takes):
        return None
    given = [name for name in TABLE_KEYS if name in spec]
    if "max_power" in spec or not given:
        if "max_power" in spec and given:
            return given[0], "does not go with max_power: power is by the vendor's table, or by the law of a propeller"
        missing = "is missing, or thruster, voltage and max_thrust for the power by a vendor's table"
        return None if "max_power" in spec else ("max_power", missing)
    for name in TABLE_KEYS:
        if name not in spec:
            return name, f"is missing beside {given[0]}"
    thruster, voltage, thrust = (spec[name] for name in TABLE_KEYS)
    if thruster not in thrusters.TABLES:
        return "thruster", f"no table of {thruster!r}{did_you_mean(str(thruster), thrusters.TABLES)}"
    if not all(_is_number(value) and value > 0 for value in (voltage, thrust)):
        return None  # reported with the other numbers
    least, largest = thrusters.voltages(thruster)
    if not least <= voltage <= largest:
        return "voltage", f"is {voltage:g} V; the table of the {thruster} goes from {least:g} to {largest:g} V"
    curve = thrusters.PowerCurve(thruster, voltage)
    if not curve.gives(np.array([-thrust, thrust])).all():
        return "max_thrust", f"is {thrust:g} N, and {curve}"
    return None


def _is_number(value: Any) -> bool:
    return not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value)


def _signals(signal: str, metric: Metric, names: Iterable[str]) -> list[str]:
    """The scalar signals that a metric's `signal` names.  names: of all that is readable."""
    if metric.axes == ("*",):
        return [s for s in names if s.rpartition(".")[0] == signal] or [signal]
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


def _conversion(unit: str, wanted: str) -> tuple[float, float]:
    """Factor and offset; none where a signal has no unit, which a record calls "1"."""
    return conversion(unit, {}, wanted, {}) if "1" not in (unit, wanted) or unit == "%" else (1.0, 0.0)


def _turn(unit: str) -> float:
    """A full turn in a unit of angles; 0 of any other."""
    return 2 * math.pi * _factor(unit, "rad") if _factor(unit, "rad") else 0.0
