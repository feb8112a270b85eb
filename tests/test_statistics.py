"""The statistics of sweeps by what they promise: how often intervals hold the mean, and how often tests err.

Coverage is simulated, and judged by its binomial error; p-values and shares are compared with scipy's other ways to
them.
"""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from orchestrator.metrics import METRICS
from orchestrator.metrics.specs import turn_of
from orchestrator.studies.sweep.results.statistics import holm, interval, mean, share, wilcoxon, with_never

DRAWN = {  # {distribution: how it is drawn, and its mean}
    "normal": (lambda rng, n: rng.normal(1.0, 1.0, n), 1.0),
    "lognormal": (lambda rng, n: rng.lognormal(0.0, 1.0, n), math.exp(0.5)),
}


def coverage(draw, expected, n, times=1000):
    rng = np.random.default_rng(15)
    held = (interval(draw(rng, n)) for _ in range(times))
    return sum(low <= expected <= high for low, high in held) / times


@pytest.mark.slow
@pytest.mark.parametrize(
    ("distribution", "n", "expected"),
    [("normal", 3, 0.71), ("lognormal", 3, 0.60), ("normal", 10, 0.89), ("lognormal", 10, 0.84), ("normal", 40, 0.94)],
)
def test_an_interval_holds_the_mean_as_often_as_the_docs_say(distribution, n, expected):
    # 1 000 sweeps: the share has a standard error of 0.016 at most; four of them.
    assert coverage(*DRAWN[distribution], n) == pytest.approx(expected, abs=0.06)


@pytest.mark.slow
def test_an_interval_on_the_circle_covers_as_one_on_a_line():
    """Headings around south, with a deviation of 20 degrees: numbers jump between 180 and -180."""

    def held(n, rng):
        x = (180.0 + rng.normal(0.0, 20.0, n) + 180.0) % 360.0 - 180.0
        low, high = interval(x, 360.0)
        return any(low <= expected <= high for expected in (-180.0, 180.0))

    rng = np.random.default_rng(4)
    assert sum(held(20, rng) for _ in range(600)) / 600 == pytest.approx(0.93, abs=0.04)


@pytest.mark.parametrize("n", [5, 20, 200])
def test_wilsons_interval_covers_what_it_says_on_average(n):
    """Exactly, over all outcomes; on average over the share, as a single share may lie at an edge."""
    bounds = [share(k, n) for k in range(n + 1)]
    shares = np.linspace(0.02, 0.98, 97)
    held = [sum(stats.binom.pmf(k, n, p) for k, (low, high) in enumerate(bounds) if low <= p <= high) for p in shares]
    assert np.mean(held) == pytest.approx(0.95, abs=0.02)
    assert share(0, n)[0] == 0.0
    assert share(n, n)[1] == 1.0
    assert all(math.isnan(bound) for bound in share(0, 0))


def test_the_test_of_pairs_is_the_one_that_all_signs_give():
    """Against the permutation test of the same statistic: every sign of every difference, as `never` has them, too."""
    a = np.array([3.0, math.inf, 5.0, 7.0, 2.5, math.inf, 4.0, 9.0])
    b = np.array([2.0, 4.0, 5.5, 3.0, 2.0, 6.0, 4.25, 3.5])
    d = with_never(a, b, np.isfinite(a) & np.isfinite(b), (a - b)[np.isfinite(a)])
    ranks = stats.rankdata(abs(d))
    sums = [sum(r for r, s in zip(ranks, signs, strict=True) if s) for signs in itertools.product((0, 1), repeat=8)]
    least = min(ranks[d > 0].sum(), ranks[d < 0].sum())
    exact = 2 * sum(one <= least for one in sums) / len(sums)
    p, effect = wilcoxon(d)
    assert p == pytest.approx(exact, abs=0.02)  # scipy takes the normal approximation where ranks are tied
    assert effect == pytest.approx((ranks[d > 0].sum() - ranks[d < 0].sum()) / 36)
    assert set(ranks[np.isinf(a)]) == {7.5}  # both are never: later than any number, and equal


def test_two_that_never_are_equal_and_one_that_never_is_last_whatever_the_numbers():
    a, b = np.array([math.inf, math.inf, 1e9]), np.array([math.inf, 1.0, 1.0])
    both = np.isfinite(a) & np.isfinite(b)
    d = with_never(a, b, both, a[both] - b[both])
    assert d[0] == 0.0
    assert d[1] > d[2] > 0


@pytest.mark.slow
@pytest.mark.parametrize("n", [6, 12, 30])
def test_the_table_finds_a_difference_where_there_is_none_in_no_more_than_5_percent(n):
    """Three contenders that are alike, one of two draws skewed: the error of the whole table, after Holm."""
    rng = np.random.default_rng(n)
    wrong = 0
    for _ in range(1500):
        x = rng.lognormal(0.0, 1.0, n) + rng.normal(0.0, 0.5, (3, n))
        p = [wilcoxon(x[i] - x[j])[0] for i, j in ((0, 1), (0, 2), (1, 2))]
        wrong += min(holm(p)) < 0.05
    assert wrong / 1500 <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 1500)


def test_holm_is_never_below_the_raw_and_keeps_the_order():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, math.nan, 0.9])[0] == 1.0


def test_a_mean_of_angles_is_that_of_scipy():
    x = np.random.default_rng(3).uniform(150.0, 260.0, 50)
    assert mean(x, 360.0) % 360.0 == pytest.approx(stats.circmean(x, high=360.0), rel=1e-12)


def test_which_metrics_are_angles():
    """What docs/sweeps.md says: no metric but these is itself an angle."""
    angles, units = {"v.eta.psi"}, {"v.eta.psi": "rad", "v.eta": "rad", "w.eta.psi": "rad"}

    def turn(name, **more):
        signal = "v.eta" if METRICS[name].axes else "v.eta.psi"
        return turn_of({"of": name, "signal": signal, **more}, units, angles)

    assert {name for name in METRICS if turn(name)} == {"final", "heading_difference"}
    assert turn("final") == pytest.approx(2 * math.pi)
    assert turn("final", unit="deg") == pytest.approx(360.0)
    assert {name for name in METRICS if turn(name, reference="w.eta.psi")} == {"heading_difference"}
