"""Metrics against closed forms."""

import csv
import math
import os
import re

import h5py
import numpy as np
import pytest

import orchestrator
from experiments import merged, single
from orchestrator import metrics
from orchestrator.metrics import thrusters

T = np.linspace(0.0, 1.0, 1001)
SINE = np.sin(2 * np.pi * 5 * T)  # five periods: the sum over all samples but the last is that over whole periods
DECAY = np.exp(-T / 0.1)
TRAPEZOID = 1e-5  # relative: h^2 / 12 of the second derivative, at 1 ms

# --- The definitions --------------------------------------------------------------------------------------------------


def taken(of, time, *values, **arguments):
    """A metric of samples that come in three blocks."""
    metric = metrics.METRICS[of].accumulator(**arguments)
    for block in np.array_split(np.arange(len(time)), min(3, len(time))):
        metric.update(time[block], *(array[..., block] for array in values))
    return metric.result()


def test_rms_of_a_sine_is_its_amplitude_by_root_two():
    assert taken("rms", T[:-1], 3 * SINE[:-1]) == pytest.approx(3 / math.sqrt(2), rel=1e-12)  # rounding
    assert taken("rms", T, np.full(1001, -2.0)) == 2.0


def test_max_abs_and_final():
    assert taken("max_abs", T, -4 * T) == 4.0
    assert taken("final", T, -4 * T) == -4.0


def test_integrals_of_an_exponential():
    rest = 1 - math.exp(-10)
    assert taken("iae", T, -DECAY) == pytest.approx(0.1 * rest, rel=TRAPEZOID)
    assert taken("ise", T, DECAY) == pytest.approx(0.05 * (1 - math.exp(-20)), rel=4 * TRAPEZOID)  # twice as steep
    assert taken("itae", T, DECAY) == pytest.approx(0.01 * (1 - 11 * math.exp(-10)), rel=TRAPEZOID)
    assert taken("itae", T + 5.0, DECAY) == pytest.approx(taken("itae", T, DECAY), rel=1e-12)  # t from the first sample


def test_settling_time_is_when_the_error_enters_the_band_for_good():
    assert taken("settling_time", T, DECAY, band=0.05) == T[int(np.ceil(0.1 * math.log(20) * 1000))]
    swing = np.where(T < 0.5, 0.0, np.where(T < 0.6, 1.0, 0.0))  # in, out again, in
    assert taken("settling_time", T, swing, band=0.1) == 0.6
    assert taken("convergence_time", T, swing, band=0.1) == 0.0


def test_settling_time_at_its_edges():
    ramp = T.copy()
    assert taken("settling_time", T, 0 * T, band=0.1) == 0.0  # never outside
    assert taken("settling_time", T + 3.0, 0 * T, band=0.1) == 3.0  # of a window: from its start
    assert taken("settling_time", T, ramp, band=0.1) == math.inf  # outside at the end
    assert taken("settling_time", T, 1 - ramp, band=1.0) == 0.0  # on the edge of the band is inside
    assert taken("settling_time", T[:1], np.array([2.0]), band=1.0) == math.inf
    last = np.r_[np.ones(1000), 0.0]
    assert taken("settling_time", T, last, band=0.5) == math.inf  # inside in the last sample only
    assert taken("convergence_time", T, 1 + ramp, band=0.1) == math.inf


@pytest.mark.parametrize("end", [11.97, 12.0, 12.22, 12.5, 13.0])
def test_an_everlasting_oscillation_never_settles_wherever_the_record_ends(end):
    """Inside for less than a tenth of the window is passing through."""
    time = np.arange(0.0, end, 1e-3)
    assert taken("settling_time", time, np.sin(2 * np.pi * time), band=0.2) == math.inf


@pytest.mark.parametrize(("inside", "expected"), [(99, math.inf), (102, 0.899)])
def test_a_signal_has_settled_when_it_has_been_inside_for_a_tenth_of_the_window(inside, expected):
    error = np.r_[np.ones(1001 - inside), np.zeros(inside)]
    assert taken("settling_time", T, error, band=0.5) == expected


def test_a_signal_has_converged_when_it_stays_inside_for_a_tenth_of_the_window():
    """Passing through is none: a sample of it would be seen at one step and not at another."""
    through = 1 - 4 * T  # inside from 0.225 to 0.275
    assert taken("convergence_time", T, through, band=0.1) == math.inf
    assert taken("convergence_time", T, through, band=0.24) == 0.19
    once = np.r_[np.ones(500), 0.0, np.ones(500)]
    assert taken("convergence_time", T, once, band=0.5) == math.inf
    assert taken("convergence_time", T, SINE, band=0.3) == math.inf  # 0.0194 s each time
    twice = np.where((T > 0.1) & (T < 0.15) | (T > 0.3) & (T < 0.45), 0.0, 1.0)  # the second time for long enough
    assert taken("convergence_time", T, twice, band=0.5) == 0.301
    assert taken("convergence_time", T, np.where(T < 0.89, 1.0, 0.0), band=0.5) == 0.89  # at the end
    assert taken("convergence_time", T, np.where(T < 0.95, 1.0, 0.0), band=0.5) == math.inf
    assert taken("convergence_time", T[:1], np.array([0.5]), band=1.0) == 0.0
    assert taken("convergence_time", T[:1], np.array([2.0]), band=1.0) == math.inf


def test_overshoot_and_total_variation():
    assert taken("overshoot", T, DECAY) == 0.0
    assert taken("overshoot", T, -2 * np.cos(2 * np.pi * T)) == pytest.approx(100.0)
    assert math.isnan(taken("overshoot", T, T))
    assert math.isnan(taken("overshoot", T, T - 1e-16))  # begins at zero, but for rounding: no 1e18 %
    assert taken("total_variation", T, SINE) == pytest.approx(20.0, rel=TRAPEZOID)  # 4 per period


def test_energy_is_power_over_time():
    u = np.vstack([np.full(1001, 0.25), np.full(1001, -1.0)])  # 0.25^(3/2) = 1/8
    assert taken("energy", 2 * T, u, max_power=100.0) == pytest.approx(225.0)
    assert taken("mean_power", 2 * T, u, max_power=100.0) == pytest.approx(112.5)
    assert math.isnan(taken("mean_power", T[:1], u[:, :1], max_power=100.0))


@pytest.mark.parametrize(
    ("thrust", "watts"),
    # The lines of the vendor's table at 16 V around each thrust, as they stand in it: kgf and W.
    [(51.485, 381.3), (-39.913, 388.8), (40.0, 248.0), (20.0, 86.0), (10.0, 28.0), (0.0, 0.0)],
)
def test_power_of_a_t200_is_that_of_the_vendors_table(thrust, watts):
    u = np.full((1, 11), thrust / 51.485)
    power = taken("mean_power", T[:11], u, thruster="t200", voltage=16.0, max_thrust=51.485)
    assert power == pytest.approx(watts, abs=2.0)  # the table's thrusts are 0.1 N apart, or 1 W at full thrust


def test_the_vendors_table_is_met_by_its_other_lines_and_voltages_as_documented(monkeypatch):
    """docs/experiment.md: what interpolation is wrong by, of what was measured and left out."""
    pulses, voltages, thrusts, watts = thrusters._table("t200")

    def errors(table, voltage, thrust, power):
        """Of a curve made of another table at these thrusts [N], as far as it goes."""
        monkeypatch.setattr(thrusters, "_table", lambda thruster: table)
        curve = thrusters.PowerCurve("t200", float(voltage))
        within = (thrust >= curve.reverse) & (thrust <= curve.forward)
        return (curve.power(thrust) - power)[within]

    full = watts.max(axis=0)
    lines = [
        np.concatenate(
            [
                errors(
                    (
                        np.delete(pulses, i),
                        voltages[[j]],
                        np.delete(thrusts[:, [j]], i, 0),
                        np.delete(watts[:, [j]], i, 0),
                    ),
                    voltages[j],
                    thrusts[[i], j] * thrusters.GRAVITY,
                    watts[[i], j],
                )
                for i in range(len(thrusts))
            ]
        )
        for j in range(len(voltages))
    ]
    assert max(np.sqrt((error**2).mean()) for error in lines) < 2.4
    assert 10.0 < max(abs(error).max() for error in lines) < 11.0
    assert max(abs(error).max() / of for error, of in zip(lines, full, strict=True)) < 0.023
    between = [
        errors(
            (pulses, np.delete(voltages, j), np.delete(thrusts, j, 1), np.delete(watts, j, 1)),
            voltages[j],
            thrusts[:, j] * thrusters.GRAVITY,
            watts[:, j],
        )
        for j in range(1, len(voltages) - 1)
    ]
    assert max(np.sqrt((error**2).mean()) for error in between) < 7.3
    assert 26.0 < max(abs(error).max() for error in between) < 27.0
    assert max(abs(error).max() / full[j + 1] for j, error in enumerate(between)) < 0.062


def test_power_between_two_voltages_lies_between_theirs():
    u = np.full((1, 11), 1.0)
    low, middle, high = (
        taken("mean_power", T[:11], u, thruster="t200", voltage=v, max_thrust=30.0) for v in (14.0, 15.0, 16.0)
    )
    assert min(low, high) - 3.0 < middle < max(low, high) + 3.0


def test_distance_is_euclidean():
    points = np.zeros((3, 3))
    assert taken("distance", T[:3], points, points + np.array([[1.0], [2.0], [-2.0]])) == 3.0


@pytest.mark.parametrize(
    ("heading", "other", "degrees"),
    [
        (math.pi, 0.0, 180.0),
        (0.0, math.pi / 2, -90.0),
        (5 * math.pi, 0.0, 180.0),
        (-3 * math.pi, math.pi / 2, 90.0),
        (0.1, 0.1, 0.0),
    ],
)
def test_heading_difference_lies_within_half_a_turn(heading, other, degrees):
    result = taken("heading_difference", T[:1], np.array([[heading]]), np.array([[other]]))
    assert result == pytest.approx(degrees, abs=1e-9)  # rounding of multiples of pi


@pytest.mark.parametrize("stat", ["min", "max"])
def test_heading_difference_just_below_zero_is_no_turn(stat):
    tiny = np.array([[-1e-20, -1e-16, 0.0, 1e-20]])
    assert taken("heading_difference", T[:4], tiny, np.zeros((1, 4)), stat=stat) == pytest.approx(0.0, abs=1e-13)


# --- In an experiment -------------------------------------------------------------------------------------------------

SPECS = {
    "rms_sine": ({"of": "rms", "signal": "one.sine.a", "before": 0.0999}, 1 / math.sqrt(2)),
    "rms_angle": ({"of": "rms", "signal": "one.sine.b", "before": 0.0999, "unit": "deg"}, 180 / math.pi / math.sqrt(2)),
    "rmse": ({"of": "rmse", "signal": "one.ramp", "reference": "two.ramp"}, 0.0),
    "max": ({"of": "max_abs", "signal": "one.ramp", "after": 0.01, "before": 0.04, "unit": "mm"}, 80.0),
    "final": ({"of": "final", "signal": "one.ramp"}, 0.2),
    "until": ({"of": "final", "signal": "one.ramp", "before": 0.05, "unit": "cm"}, 10.0),
    "final_km": ({"of": "final", "signal": "one.ramp", "unit": "km"}, 2e-4),
    "settling": ({"of": "settling_time", "signal": "one.decay", "band": 0.5}, 0.014),  # 0.02 ln 2 = 0.01386
    "settling_mm": ({"of": "settling_time", "signal": "one.decay", "band": 500, "unit": "mm"}, 0.014),
    "settling_after": ({"of": "settling_time", "signal": "one.decay", "band": 0.5, "after": 0.03}, 0.03),
    "never": ({"of": "settling_time", "signal": "one.ramp", "band": 0.01}, None),
    "nowhere": ({"of": "rms", "signal": "one.ramp", "after": 7.0}, None),
    "near": ({"of": "distance", "signal": "one.eta", "reference": "two.eta"}, 5.0),
    "nearest": ({"of": "distance", "signal": "one.eta", "reference": "two.eta", "stat": "min"}, 5.0),
    "heading": ({"of": "heading_difference", "signal": "one.eta", "reference": "two.eta", "stat": "max"}, -90.0),
    "variation": ({"of": "total_variation", "signal": "one.ramp"}, 0.2),
}


@pytest.fixture
def waves(models):
    table = single("waves", stop_time=0.1, step=1e-3)
    table["components"]["two"] = {
        "fmu": "waves",
        "parameters": {"place": [3.0, 0.0, -4.0], "heading": math.pi / 2},
    }
    return table


def test_metrics_of_a_run_are_those_of_the_signals(orch, write, waves, tmp_path):
    path = write(merged(waves, {"metrics": {name: spec for name, (spec, _) in SPECS.items()}}))
    answer = orch("run", path, "--json")
    assert answer.code == 0, answer.err
    for name, (_, expected) in SPECS.items():
        # rounding of t and of sums over a hundred samples
        assert answer.json["metrics"][name] == (None if expected is None else pytest.approx(expected, abs=1e-12)), name
    assert "never" in answer.json["metrics_never"]
    assert "nowhere" not in answer.json["metrics_never"]
    with orchestrator.open_run(tmp_path / answer.json["file"]) as run:
        assert run.metrics["final"] == answer.json["metrics"]["final"]
        assert run.metrics["never"] == math.inf
    text = orch("run", path).out
    lines = {words[0]: words[1:] for words in map(str.split, text.splitlines()) if words}
    assert lines["max"] == ["80", "mm"]
    assert lines["heading"] == ["-90", "deg"]
    assert lines["settling_mm"] == ["0.014", "s"]
    assert lines["never"] == ["never", "s"]
    assert lines["nowhere"][:4] == ["no", "sample", "in", "its"]


def test_a_metric_of_a_single_sample_is_a_warning(orch, write, waves):
    """A run shortened by --set: the window begins where it ends.  `final` is of one sample by definition."""
    window = {"signal": "one.ramp", "after": 0.1}
    path = write(merged(waves, {"metrics": {of: {"of": of, **window} for of in ("rms", "final")}}))
    answer = orch("run", path, "--json").json
    assert answer["warnings"] == ["metrics.rms is of a single sample: no more fall into its window"]
    assert answer["metrics"]["rms"] == answer["metrics"]["final"]


def test_check_notes_a_window_that_no_sample_falls_into(orch, write, waves):
    window = {"of": "rms", "signal": "one.ramp"}
    path = write(merged(waves, {"metrics": {"late": {**window, "after": 0.2}, "last": {**window, "after": 0.1}}}))
    answer = orch("check", path, "--json")
    assert answer.json["notes"] == ["no sample falls into the window of late: the run goes from 0 to 0.1 s"]


@pytest.mark.parametrize(
    ("signal", "unit", "factor"),
    [("ramp", "mm", 1e3), ("ramp", "km", 1e-3), ("sine.b", "deg", 180 / math.pi), ("rate", "rpm", 30 / math.pi)],
)
def test_a_metric_converts_to_any_unit_of_the_same_quantity(orch, write, waves, signal, unit, factor):
    spec = {"of": "max_abs", "signal": f"one.{signal}"}
    table = merged(waves, {"metrics": {"own": spec, "other": {**spec, "unit": unit}}})
    values = orch("run", write(table), "--json").json["metrics"]
    assert values["other"] == pytest.approx(values["own"] * factor, rel=1e-15)  # one rounding
    assert values["own"] > 0


@pytest.mark.parametrize(
    ("spec", "key", "words"),
    [
        ({"signal": "one.ramp"}, "of", "is missing; known: rmse"),
        ({"of": "rsm", "signal": "one.ramp"}, "of", "no metric 'rsm'; did you mean 'rms'"),
        ({"of": ["rms"], "signal": "one.ramp"}, "of", "not a text"),
        ({"of": "rms"}, "signal", "is missing"),
        ({"of": "rms", "signal": 3}, "signal", "is 3, not a text"),
        ({"of": "rms", "signal": "one.rmap"}, "signal", "did you mean 'one.ramp'"),
        ({"of": "rms", "signal": "one.eta"}, "signal", "no signal 'one.eta'"),
        ({"of": "rmse", "signal": "one.ramp"}, "reference", "is missing"),
        ({"of": "rmse", "signal": "one.ramp", "reference": "two.sine.b"}, "reference", "is in 'rad', one.ramp in 'm'"),
        ({"of": "rms", "signal": "one.ramp", "unit": "deg"}, "unit", "'m' does not convert to 'deg'"),
        ({"of": "rms", "signal": "one.ramp", "unit": "mn"}, "unit", "did you mean 'm'? known: m, mm, cm, km"),
        ({"of": "rms", "signal": "one.rate", "unit": "deg/m"}, "unit", "did you mean 'deg/s'?"),
        ({"of": "rms", "signal": "one.ramp", "unit": ["mm"]}, "unit", "not a text"),
        ({"of": "rms", "signal": "one.ramp", "affter": 1.0}, "affter", "did you mean 'after'"),
        ({"of": "rms", "signal": "one.ramp", "after": "1"}, "after", "'1', not a number"),
        ({"of": "rms", "signal": "one.ramp", "after": 2.0, "before": 1.0}, "after", "is empty"),
        ({"of": "settling_time", "signal": "one.ramp"}, "band", "is missing"),
        ({"of": "settling_time", "signal": "one.ramp", "band": -0.1}, "band", "positive"),
        ({"of": "settling_time", "signal": "one.ramp", "band": True}, "band", "not a number"),
        (
            {"of": "distance", "signal": "one.eta", "reference": "two.sine"},
            "reference",
            "no signal 'two.sine'",
        ),
        ({"of": "distance", "signal": "one.eta", "reference": "two.eta", "stat": "median"}, "stat", "mean, min, max"),
        ({"of": "distance", "signal": "one.eta", "reference": "two.eta", "stat": ["min"]}, "stat", "not a text"),
        ({"of": "distance", "signal": "one.eta", "reference": "two.eta", "unit": "mm"}, "unit", "takes no 'unit'"),
    ],
)
def test_a_metric_that_makes_no_sense_says_why(problems, waves, spec, key, words):
    found = problems(merged(waves, {"metrics": {"it": spec}}))
    assert any(k == f"metrics.it.{key}" and words in sentence for k, sentence in found), found


def test_a_text_has_no_metric(problems, probe):
    ((key, sentence),) = problems(merged(single(probe), {"metrics": {"it": {"of": "final", "signal": "one.words"}}}))
    assert key == "metrics.it.signal"
    assert "no signal 'one.words'" in sentence


EVERY = {  # {metric: its definition over whole arrays}
    "rms": lambda t, e: np.sqrt((e * e).mean()),
    "max_abs": lambda t, e: abs(e).max(),
    "final": lambda t, e: e[-1],
    "iae": lambda t, e: np.trapezoid(abs(e), t),
    "ise": lambda t, e: np.trapezoid(e * e, t),
    "itae": lambda t, e: np.trapezoid((t - t[0]) * abs(e), t),
    "total_variation": lambda t, e: abs(np.diff(e)).sum(),
}


@pytest.mark.parametrize("loop", ["compiled", "python"])
@pytest.mark.parametrize("algorithm", ["gauss-seidel", "jacobi"])
def test_metrics_are_of_every_step_whatever_is_recorded(orch, write, waves, tmp_path, loop, algorithm):
    """Longer than a block of samples, so that its metrics are taken in several."""
    window = {"after": 0.0123, "before": 2.01}
    specs = {of: {"of": of, "signal": "one.sine.a", **window} for of in EVERY}
    specs["sparse"] = {"of": "rms", "signal": "one.sine.a", "every": 0.01}
    specs["far"] = {"of": "distance", "signal": "one.eta", "reference": "two.eta", "stat": "max"}
    table = merged(waves, {"master": {"stop_time": 2.1, "step": 1e-4, "algorithm": algorithm}, "metrics": specs})
    environment = {**os.environ, "ORCH_LOOP": loop}
    full = orch("run", write(table), "--json", env=environment)
    thin = merged(table, {"record": {"every": 0.1, "signals": ["!*"]}})
    answer = orch("run", write(thin), "--json", env=environment)
    assert answer.json["metrics"] == full.json["metrics"]  # bit for bit
    with orchestrator.open_run(tmp_path / full.json["file"]) as run:
        time, signal = run.time, run["one.sine.a"]
    inside = (time >= window["after"]) & (time <= window["before"])
    for of, whole in EVERY.items():
        expected = whole(time[inside], signal[inside])
        assert answer.json["metrics"][of] == pytest.approx(expected, rel=1e-12), of  # sums in another order
    assert answer.json["metrics"]["sparse"] == pytest.approx(EVERY["rms"](time[::100], signal[::100]), rel=1e-12)
    assert answer.json["metrics"]["far"] == pytest.approx(5.0)


def test_every_of_a_metric_is_a_multiple_of_the_step(problems, waves):
    table = merged(waves, {"metrics": {"it": {"of": "rms", "signal": "one.ramp", "every": 0.0015}}})
    ((key, sentence),) = problems(table)
    assert key == "metrics.it.every"
    assert "0.0015 s is not a multiple of master.step = 0.001 s; try 0.001 or 0.002" in sentence


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({}, "max_power", "is missing, or thruster, voltage and max_thrust"),
        ({"max_power": 390.0, "thruster": "t200"}, "thruster", "does not go with max_power"),
        ({"thruster": "t200", "voltage": 16.0}, "max_thrust", "is missing beside thruster"),
        ({"thruster": "t20", "voltage": 16.0, "max_thrust": 40.0}, "thruster", "did you mean 't200'"),
        ({"thruster": "t200", "voltage": 24.0, "max_thrust": 40.0}, "voltage", "from 10 to 20 V"),
        (
            {"thruster": "t200", "voltage": 16.0, "max_thrust": 45.0},
            "max_thrust",
            "51.5 N forward and 39.9 N in reverse",
        ),
    ],
)
def test_a_metric_of_power_says_which_power(problems, spiral, changes, key, words):
    table = merged(spiral, {"metrics": {"it": {"of": "mean_power", "signal": "allocation.u", **changes}}})
    result = problems(table)
    assert any(k == f"metrics.it.{key}" and words in sentence for k, sentence in result), result


def test_power_is_of_all_axes_of_the_vector_whatever_is_recorded(orch, write, spiral):
    spec = {"of": "mean_power", "signal": "allocation.u", "max_power": 100.0}
    table = merged(spiral, {"metrics": {"power": spec}})
    one = orch("run", write(merged(table, {"record": {"signals": ["allocation.u.T1"]}})), "--json").json
    assert one["metrics"] == orch("run", write(table), "--json").json["metrics"]


def test_a_command_beyond_the_thrusters_table_has_no_power():
    metric = metrics.METRICS["energy"].accumulator(thruster="t200", voltage=16.0, max_thrust=30.0)
    metric.update(T[:3], np.array([[0.5, 2.0, 0.0]]))
    assert math.isnan(metric.result())
    assert "asks for 60 N" in metric.warning()
    assert "51.5 N forward" in metric.warning()


def test_metrics_take_integers_and_booleans(orch, write, probe):
    specs = {"n": {"of": "final", "signal": "one.steps"}, "half": {"of": "rms", "signal": "one.odd"}}
    answer = orch("run", write(merged(single(probe, stop_time=0.03), {"metrics": specs})), "--json")
    assert answer.json["metrics"] == {"n": 9.0, "half": pytest.approx(math.sqrt(0.5))}


# --- Runs that end early ----------------------------------------------------------------------------------------------


@pytest.fixture
def trouble(models):
    """trouble(kind, stop_time): y is the time.  kind: 0 to the end, 1 it fails at 0.02 s, 4 it ends the run there."""

    def make(kind, stop_time=0.05):
        table = merged(single("trouble", stop_time, kind=kind), {"components.one.start": {"u": 0.0}})
        specs = {
            "rms": {"of": "rms", "signal": "one.y"},
            "late": {"of": "rms", "signal": "one.y", "after": 0.03},
            "sparse": {"of": "iae", "signal": "one.y", "every": 0.02},
        }
        return {**table, "metrics": specs}

    return make


@pytest.mark.parametrize("loop", ["compiled", "python"])
def test_the_metrics_of_a_failed_run_are_those_of_a_run_until_it_failed(orch, write, trouble, tmp_path, loop):
    environment = {**os.environ, "ORCH_LOOP": loop}
    failed = orch("run", write(trouble(1)), "--json", env=environment)
    assert (failed.code, failed.json["status"]) == (3, "failed")
    short = orch("run", write(trouble(0, stop_time=0.02), "short.toml"), "--json", env=environment).json["metrics"]
    assert failed.json["metrics"] == short
    assert short["rms"] == pytest.approx(math.sqrt((0.01**2 + 0.02**2) / 3), rel=1e-12)
    assert short["sparse"] == pytest.approx(0.02 * 0.02 / 2, rel=1e-12)
    with orchestrator.open_run(tmp_path / failed.json["file"]) as run:
        assert run.metrics["rms"] == short["rms"]
        assert (run.ended_at, run.unsampled) == (0.02, {"late"})
    ended = orch("run", write(trouble(4)))  # by its FMU
    for answer in (orch("show", failed.json["file"]), ended, orch("show", "last")):
        assert "  metrics, of the time until 0.02 s only" in answer.out
        assert re.search(r"late +no sample in its window", answer.out)


def test_the_metrics_of_a_failed_run_win_no_comparison(orch, write, trouble, tmp_path):
    """It has the smaller rms, as it had less time for it."""
    short = orch("run", write(trouble(1)), "--json").json
    whole = orch("run", write(trouble(0)), "--json").json
    assert short["metrics"]["rms"] < whole["metrics"]["rms"]
    report = orch("compare", short["file"], whole["file"], "--json").json
    (rms,) = (metric for metric in report["metrics"] if metric["name"] == "rms")
    assert (rms["best"], rms["marked"]) == ([whole["run_id"]], [short["run_id"]])
    assert report["runs"][0]["marks"] == ["failed"]
    chosen = orch("list", "--where", "metrics.rms < 1.0", "--json").json
    assert [run["run_id"] for run in chosen] == [whole["run_id"]]
    html = orch("report", short["file"], "-o", "page.html")
    assert html.code == 0, html.err
    assert "value until 0.02 s" in (tmp_path / "page.html").read_text()


def test_a_sweep_has_no_numbers_of_runs_that_failed(orch, write, trouble, tmp_path):
    table = {**trouble(0), "sweep": {"vary": {"components.one.parameters.kind": [0, 1]}}}
    answer = orch("sweep", write(table), "--json", "--workers", "1")
    assert (answer.json["completed"], answer.json["failed"]) == (1, 1), answer.err
    (path,) = tmp_path.glob("results/*/table.csv")
    completed, failed = csv.DictReader(path.read_text().splitlines())
    assert (completed["status"], failed["status"]) == ("completed", "failed")
    assert completed["rms"]
    assert not failed["rms"]


def test_repeating_a_failed_run_of_a_record_without_metrics_finds_no_difference(orch, write, trouble, tmp_path):
    answer = orch("run", write(trouble(1)), "--json").json
    with h5py.File(tmp_path / answer["file"], "r+") as file:  # as earlier versions wrote it
        file.attrs.update(metrics="{}", metrics_never="[]")
    verified = orch("rerun", answer["file"], "--verify")
    assert "metrics" not in verified.out + verified.err
    with h5py.File(tmp_path / answer["file"], "r+") as file:
        file.attrs.update(metrics='{"rms": 1.0}')
    assert "metrics: {'rms': 1.0} then" in orch("rerun", answer["file"], "--verify").out
