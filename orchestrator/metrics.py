"""Numbers that sum a run up.  Each metric is a pure function; the table at the end names them for [metrics].

Windows: samples with after <= t <= before.  Errors are signal - reference.  Angles are not wrapped: the vehicle's
Euler angles and the references are continuous.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .errors import Problem, did_you_mean

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .store import Run

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


def distance(time: Array, position: Array, other: Array) -> Array:
    """Euclidean distance of two points.  position, other: (N, 3) in NED [m].  Returns (N,) [m]."""
    difference = position - other
    result: Array = (difference * difference).sum(axis=1) ** 0.5
    return result


def heading_difference(time: Array, heading: Array, other: Array) -> Array:
    """heading - other.  heading, other: (N,) [rad].  Returns (N,) in [0, 360) degrees."""
    result: Array = (heading - other) * (180 / math.pi) % 360.0
    return result


STATISTICS: dict[str, Callable[[Array], Any]] = {
    "mean": lambda values: values.mean(),
    "min": lambda values: values.min(),
    "max": lambda values: values.max(),
}


@dataclass(frozen=True)
class _Form:
    """How a metric is asked for: its keys beside `of`, `signal`, `after`, `before`."""

    needs: tuple[str, ...] = ()
    takes: tuple[str, ...] = ("reference", "unit")
    axes: tuple[str, ...] = ()  # of the vectors that `signal` and `reference` name


SCALAR: dict[str, Callable[..., float]] = {
    "rmse": rms, "rms": rms, "max_abs": max_abs, "final": final, "settling_time": settling_time,
}  # fmt: skip
FORMS = {
    "rmse": _Form(needs=("reference",), takes=("unit",)),
    "rms": _Form(),
    "max_abs": _Form(),
    "final": _Form(),
    "settling_time": _Form(needs=("band",), takes=("reference", "unit")),
    "distance": _Form(needs=("reference",), takes=("stat",), axes=("x", "y", "z")),
    "heading_difference": _Form(needs=("reference",), takes=("stat",), axes=("psi",)),
}


def evaluate(run: Run, specs: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Every metric of [metrics], checked by `problems` before.

    nan where no sample falls into the window: a run cut short by --set master.stop_time keeps its other metrics.
    """
    return {name: _evaluate(run, spec) for name, spec in specs.items()}


def unit_of(spec: Mapping[str, Any], units: Mapping[str, str]) -> str:
    """The unit of a metric's number.  units: {signal: unit}."""
    fixed = {"distance": "m", "heading_difference": "deg", "settling_time": "s"}
    return fixed.get(spec["of"]) or spec.get("unit") or units.get(spec["signal"], "")


def problems(key: str, spec: Mapping[str, Any], units: Mapping[str, str]) -> list[Problem]:
    """What is wrong with one entry of [metrics].  units: {recorded signal: unit}."""
    found: list[Problem] = []

    def problem(name: str, sentence: str) -> None:
        found.append(Problem(f"{key}.{name}", sentence))

    of = spec.get("of")
    if of not in FORMS:
        problem("of", ("is missing" if of is None else f"no metric {of!r}") + did_you_mean(str(of), FORMS))
        return found
    form = FORMS[of]
    keys = ("of", "signal", "after", "before", *form.needs, *form.takes)
    for name in spec:
        if name not in keys:
            problem(name, f"{of} takes no {name!r}{did_you_mean(name, keys)}")
    for name in ("signal", *form.needs):
        if name not in spec:
            problem(name, "is missing")
    for name in ("signal", "reference"):
        if name in spec:
            _check_signal(name, spec[name], form, units, problem)
    for name in ("after", "before", "band"):
        value = spec.get(name, 0.0)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            problem(name, f"is {value!r}, not a number")
    after, before = spec.get("after", 0.0), spec.get("before", math.inf)
    if all(isinstance(v, (int, float)) for v in (after, before)) and not 0 <= after < before:
        problem("after", f"the window from {after} to {before} s is empty")
    if spec.get("stat", "mean") not in STATISTICS:
        problem("stat", f"no {spec['stat']!r}{did_you_mean(str(spec['stat']), STATISTICS)}")
    if "unit" in spec and spec.get("signal") in units and not _factor(spec, units[spec["signal"]]):
        possible = [u for u, factors in UNITS.items() if units[spec["signal"]] in factors]
        problem("unit", f"{units[spec['signal']]!r} does not convert to {spec['unit']!r}{did_you_mean('', possible)}")
    return found


def _check_signal(
    name: str, signal: Any, form: _Form, units: Mapping[str, str], problem: Callable[[str, str], None]
) -> None:
    missing = [s for s in _signals(str(signal), form) if s not in units]
    if missing:
        choices = {s.rpartition(".")[0] for s in units} if form.axes else units
        problem(name, f"no recorded signal {signal!r}{did_you_mean(str(signal), sorted(choices), 'recorded')}")


def _signals(signal: str, form: _Form) -> list[str]:
    return [f"{signal}.{axis}" for axis in form.axes] if form.axes else [signal]


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
    form = FORMS[spec["of"]]
    if form.axes:
        vectors = [
            np.column_stack([run[s][window] for s in _signals(spec[end], form)]) for end in ("signal", "reference")
        ]
        if spec["of"] == "distance":
            values = distance(time[window], vectors[0], vectors[1])
        else:
            values = heading_difference(time[window], vectors[0][:, 0], vectors[1][:, 0])
        return float(STATISTICS[spec.get("stat", "mean")](values))
    error = run[spec["signal"]][window].astype(float)
    if "reference" in spec:
        error = error - run[spec["reference"]][window]
    error = error * _factor(spec, run.units(spec["signal"]))
    extra = {"band": spec["band"]} if spec["of"] == "settling_time" else {}
    return SCALAR[spec["of"]](time[window], error, **extra)
