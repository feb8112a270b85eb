"""Metrics taken while a run goes on against plain functions of all its steps, over random entries of [metrics].

The functions here are the definitions of docs/experiment.md, written anew over whole arrays.
"""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import orchestrator
from experiments import single
from fmu_files import SOURCES
from orchestrator import metrics
from orchestrator.metrics.thrusters import PowerCurve
from orchestrator.models import build

STEP = 1e-4  # s
STEPS = 9000  # more than a block of samples, which has 8192
MOST = 24  # entries of one experiment
UNITS = {"m": {"mm": 1e3, "km": 1e-3}, "rad": {"deg": 180 / math.pi}, "1": {}}
LENGTHS = [f"vehicle.{vector}.{axis}" for vector in ("one", "other") for axis in "xyz"]
ANGLES = [f"vehicle.{vector}.{axis}" for vector in ("one", "other") for axis in ("phi", "theta", "psi")]
COMMANDS = [f"vehicle.u.T{k}" for k in (1, 2, 3)]
LIMITS = {
    "band": st.floats(0.05, 20.0),
    "max_power": st.floats(1.0, 500.0),
    "stat": st.sampled_from(metrics.STATISTICS),
}


@st.composite
def entries(draw):
    """An entry of [metrics] that is right, of any kind."""
    of = draw(st.sampled_from(sorted(metrics.METRICS)))
    metric = metrics.METRICS[of]
    if metric.axes == ("*",):
        spec = {"of": of, "signal": "vehicle.u"}
        if draw(st.booleans()):
            spec |= {
                "thruster": "t200",
                "voltage": draw(st.floats(16.0, 20.0)),
                "max_thrust": draw(st.floats(5.0, 39.0)),
            }
        else:
            spec |= {"max_power": draw(LIMITS["max_power"])}
    elif metric.axes:
        spec = {"of": of, "signal": "vehicle.one", "reference": "vehicle.other"}
        spec |= {"stat": draw(LIMITS["stat"])} if draw(st.booleans()) else {}
    else:
        like = draw(st.sampled_from([LENGTHS, ANGLES, COMMANDS]))
        spec = {"of": of, "signal": draw(st.sampled_from(like))}
        keys = {*metric.needs, *metric.takes}
        if "reference" in metric.needs or ("reference" in keys and draw(st.booleans())):
            spec["reference"] = draw(st.sampled_from(like))
            if "wrap" in keys and like is ANGLES and draw(st.booleans()):
                spec["wrap"] = draw(st.booleans())
        own = "m" if like is LENGTHS else "rad" if like is ANGLES else "1"
        if "unit" in keys and UNITS[own] and draw(st.booleans()):
            spec["unit"] = draw(st.sampled_from(sorted(UNITS[own])))
        if "band" in keys:
            spec["band"] = draw(LIMITS["band"])
    end = STEPS * STEP
    if draw(st.booleans()):
        spec["after"] = draw(st.sampled_from([0.0, STEP, 0.1234, 0.81915, 0.8192, 0.8193]) | st.floats(0.0, end))
    if draw(st.booleans()):
        least = spec.get("after", 0.0)
        spec["before"] = draw(st.floats(least, end, exclude_min=True) if least < end else st.just(end + 1.0))
    if draw(st.booleans()):
        spec["every"] = round(draw(st.sampled_from([1, 2, 7, 100, 8192])) * STEP, 4)
    return spec


def plain(spec, run):
    """A metric of the rows of a run that records every step; nan where none falls into its window."""
    time = run.time
    every = round(spec.get("every", STEP) / STEP)
    chosen = (np.arange(len(time)) % every == 0) & (time >= spec.get("after", 0.0)) & (time <= spec.get("before", 9.0))
    if not chosen.any():
        return math.nan
    t = time[chosen]
    if spec["of"] in ("energy", "mean_power"):
        drawn = power(spec, run["vehicle.u"][chosen].T)
        joule = np.trapezoid(drawn, t)
        return joule if spec["of"] == "energy" else joule / (t[-1] - t[0]) if len(t) > 1 else math.nan
    if spec["of"] in ("distance", "heading_difference"):
        one, other = (run[name][chosen] for name in ("vehicle.one", "vehicle.other"))
        numbers = np.linalg.norm((one - other)[:, :3], axis=1)
        if spec["of"] == "heading_difference":
            return heading_difference(one[:, 5] - other[:, 5], spec.get("stat", "mean"))
        return getattr(numbers, spec.get("stat", "mean"))()
    error = run[spec["signal"]]
    if "reference" in spec:
        error = error - run[spec["reference"]]
        if spec.get("wrap", spec["signal"] in ANGLES):
            error = np.arctan2(np.sin(error), np.cos(error))
    if "unit" in spec:
        error = error * {"mm": 1e3, "km": 1e-3, "deg": 180 / math.pi}[spec["unit"]]
    return SCALAR[spec["of"]](t, error[chosen], spec.get("band"))


def heading_difference(difference, stat):
    """The circular mean, or that and the farthest deviation from it to one side.  difference: (n,) [rad]; in deg."""
    mean = np.angle(np.exp(1j * difference).mean())
    deviations = np.unwrap(difference)
    deviations = deviations - mean - 2 * math.pi * np.round((deviations.mean() - mean) / (2 * math.pi))
    if abs(deviations).max() > math.pi:
        deviations = np.array([-math.pi, math.pi])
    return math.degrees({"mean": mean, "min": mean + deviations.min(), "max": mean + deviations.max()}[stat])


def power(spec, u):
    """Of thrusters, (n,) [W].  u: (thrusters, n)."""
    if "max_power" in spec:
        return spec["max_power"] * (abs(u) ** 1.5).sum(axis=0)
    curve = PowerCurve(spec["thruster"], spec["voltage"])  # its numbers have tests of their own
    return sum(curve.power(spec["max_thrust"] * one) for one in u)


def settled(t, error, band):
    outside = np.flatnonzero(abs(error) > band)
    entered = 0 if not len(outside) else outside[-1] + 1
    lasts = entered < len(t) and t[-1] - t[entered] >= 0.1 * (t[-1] - t[0])
    return t[entered] if lasts else math.inf


def converged(t, error, band):
    inside = abs(error) <= band
    for first in np.flatnonzero(inside & ~np.r_[False, inside[:-1]]):
        last = first + int(np.argmin(np.r_[inside[first:], False])) - 1
        if t[last] - t[first] >= 0.1 * (t[-1] - t[0]):
            return t[first]
    return math.inf


def overshot(t, error, band):
    return 100.0 * max(0.0, (-error / error[0]).max()) if abs(error[0]) > 1e-12 * abs(error).max() else math.nan


SCALAR = {
    "rmse": lambda t, error, band: np.sqrt((error**2).mean()),
    "rms": lambda t, error, band: np.sqrt((error**2).mean()),
    "iae": lambda t, error, band: np.trapezoid(abs(error), t),
    "ise": lambda t, error, band: np.trapezoid(error**2, t),
    "itae": lambda t, error, band: np.trapezoid((t - t[0]) * abs(error), t),
    "max_abs": lambda t, error, band: abs(error).max(),
    "final": lambda t, error, band: error[-1],
    "settling_time": settled,
    "convergence_time": converged,
    "overshoot": overshot,
    "total_variation": lambda t, error, band: abs(np.diff(error)).sum(),
}


@pytest.fixture(scope="module")
def erratic(_build_folder):
    return build.build([str(SOURCES / "erratic.py")])["erratic"]


@pytest.mark.slow
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 1 << 20), specs=st.lists(entries(), min_size=MOST // 2, max_size=MOST))
def test_metrics_of_a_run_are_plain_functions_of_all_its_steps(erratic, write, tmp_path, monkeypatch, seed, specs):
    monkeypatch.setenv("ORCH_LOOP", "python" if seed % 4 == 0 else "")
    table = single(erratic, stop_time=STEPS * STEP, step=STEP, name="vehicle", seed=seed)
    names = [f"m{i}" for i in range(len(specs))]
    table |= {"record": {"every": STEP}, "metrics": dict(zip(names, specs, strict=True))}
    with orchestrator.run(write(table), output=tmp_path / "run.h5") as run:
        for name, spec in zip(names, specs, strict=True):
            # sums in another order; differences on the circle by another formula
            expected = pytest.approx(plain(spec, run), rel=1e-9, abs=1e-9, nan_ok=True)
            assert run.metrics[name] == expected, spec
