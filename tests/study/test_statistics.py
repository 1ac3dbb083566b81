"""Intervals over seeds: against simulations in which the truth is known."""

import math

import numpy as np
import pytest
from mi_ellipse.study import statistics
from mi_ellipse.study.statistics import Estimate, efficiency, estimate, is_best

TRIALS = 4000


def test_estimate():
    result = estimate([1.0, 2.0, 3.0, 6.0])
    assert result.mean == 3
    assert result.standard_error == pytest.approx(math.sqrt((4 + 1 + 0 + 9) / 3 / 4))
    assert math.isnan(estimate([1.0]).standard_error)


def test_slope():
    x = np.array([8, 16, 32, 256])
    assert statistics.fit_slope(x, 3 / x) == pytest.approx(-1)
    assert statistics.fit_slope(x, 0.1 * np.sqrt(x)) == pytest.approx(0.5)


def test_interval_of_a_mean():
    """0.975 quantiles of Student's t, from a printed table."""
    for seeds, quantile in ((2, 12.706), (4, 3.182), (11, 2.228)):
        low, high = Estimate(5.0, 0.1).interval(seeds)
        assert (5 - low, high - 5) == pytest.approx((0.1 * quantile,) * 2, rel=2e-4)  # 4 digits
    assert all(map(math.isnan, estimate([5.0]).interval(1)))


# ---- Efficiencies ----


def test_efficiency_is_that_of_mean_errors_and_median_ratios():
    result = efficiency([2.0, 4.0, 3.0], [5.0, 1.0, 2.0], [1.0, 1.0, 4.0], [4.0, 3.0, 9.0])
    assert result.value == pytest.approx(3 / 2 * 1 / 3)  # of 5 / 4, 1 / 3 and 2 / 9
    assert result.low * result.high == pytest.approx(result.value**2)
    assert result.low < result.value < result.high


def test_efficiency_of_a_strategy_beside_itself_has_the_spread_of_its_times():
    errors = [2.0, 4.0, 3.0]
    seconds, again = [5.0, 1.0, 2.0], [5.5, 0.9, 2.0]
    result = efficiency(errors, seconds, errors, again)
    assert result.value == 1  # of 1 / 1.1, 1 / 0.9 and 1
    assert result.low < 0.9
    assert result.high > 1.1
    same = efficiency(errors, seconds, errors, seconds)
    assert (same.value, same.low, same.high) == (1, 1, 1)


def test_what_slows_a_turn_of_both_strategies_does_not_count():
    load = np.array([1.0, 1.5, 1.0, 0.9])  # of the machine
    result = efficiency([1.0] * 4, 2 * load, [1.0] * 4, 3 * load)
    assert (result.value, result.low, result.high) == pytest.approx((1.5**-1,) * 3)


def test_a_single_seed_has_no_interval():
    result = efficiency([2.0], [1.0], [1.0], [1.0])
    assert result.value == 2
    assert math.isnan(result.low)
    assert math.isnan(result.high)


def test_one_very_slow_render_leaves_finite_ends():
    result = efficiency([1.0] * 3, [1.0] * 3, [1.0] * 3, [1.0, 1.0, 1e6])
    assert result.value == 1
    assert 0 < result.low < 1e-9
    assert 1e9 < result.high < math.inf


def coverage(seeds, error_spread, time_spread, drift=0.0):
    """Share of the intervals, in simulated comparisons, that hold the true efficiency of 1.6."""
    random = np.random.default_rng([seeds, int(1e6 * error_spread), int(1e6 * time_spread)])
    hits = 0
    for _ in range(TRIALS):
        first, other = 1 + error_spread * random.standard_normal((2, seeds))
        load = np.exp(drift * random.standard_normal(seeds))  # the same for both
        # As medians are taken, deviations are drawn whose median is the true time.
        first_seconds, seconds = load * np.exp(time_spread * random.standard_normal((2, seeds)))
        result = efficiency(2 * first, 4 * first_seconds, 1 * other, 5 * seconds)
        hits += result.low <= 1.6 <= result.high
    return hits / TRIALS


@pytest.mark.parametrize("seeds", [2, 3, 4, 8, 30])
@pytest.mark.parametrize(
    ("error_spread", "time_spread"), [(0.05, 0.0), (0.05, 0.02), (0.02, 0.05), (0.0, 0.05)]
)
def test_intervals_hold_the_truth_as_often_as_they_say(seeds, error_spread, time_spread):
    found = coverage(seeds, error_spread, time_spread)
    # A share of 0.95 over the trials scatters by 0.0034; five times that is a chance of 6e-7.
    scatter = 5 * math.sqrt(0.95 * 0.05 / TRIALS)
    assert found > 0.95 - scatter
    if time_spread == 0:  # Of medians, the intervals of few seeds are too wide on purpose.
        assert found < 0.95 + scatter


def test_a_drift_of_the_machine_does_not_narrow_the_intervals():
    assert coverage(4, 0.03, 0.02, drift=0.1) > 0.95 - 5 * math.sqrt(0.95 * 0.05 / TRIALS)


# ---- The best one ----


@pytest.mark.parametrize(
    ("interval", "others", "expected"),
    [
        ((2, 3), [(0, 1), (1, 1.9)], True),
        ((2, 3), [(0, 1), (1, 2)], False),
        ((2, 3), [(4, 5)], False),
        ((2, 3), [], False),
        ((math.nan, math.nan), [(0, 1)], False),
        ((2, 3), [(math.nan, math.nan)], False),
    ],
)
def test_only_a_value_above_all_others_is_the_best(interval, others, expected):
    assert is_best(interval, others) is expected
