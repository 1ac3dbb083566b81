"""Say how certain a number is that was measured with a few seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

CONFIDENCE = 0.95  # of every interval

# The standard error of a median of normally distributed values, over that of their mean. It is
# reached with many values (1.25); with four it is 1.09, so that intervals are a little too wide.
MEDIAN_OVER_MEAN = math.sqrt(math.pi / 2)

# Of an interval, as a logarithm: beyond, nothing is known, and the ends shall stay finite numbers.
LONGEST_REACH = 100.0


@dataclass(frozen=True)
class Estimate:
    """Mean over several seeds."""

    mean: float
    standard_error: float  # of the mean; NaN from a single seed

    def interval(self, seeds: int) -> tuple[float, float]:
        """Return the ends of the 95 % interval by Student's t; NaN from a single seed."""
        reach = _quantile(seeds) * self.standard_error
        return self.mean - reach, self.mean + reach


@dataclass(frozen=True)
class Spread:
    """Median, smallest and largest of several values."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Return that of values."""
        return cls(float(np.median(values)), min(values), max(values))


@dataclass(frozen=True)
class Efficiency:
    """Error times time of the first strategy over that of another one."""

    value: float
    low: float  # ends of the 95 % interval; NaN from a single seed
    high: float


def estimate(values: Sequence[float]) -> Estimate:
    """Return the mean of independent values and its standard error."""
    spread = np.std(values, ddof=1) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return Estimate(float(np.mean(values)), float(spread))


def efficiency(
    first_errors: Sequence[float],
    first_seconds: Sequence[float],
    errors: Sequence[float],
    seconds: Sequence[float],
) -> Efficiency:
    """
    Return the efficiency of a strategy relative to the first one.

    The value is made of mean errors and of the median of the ratios of times. Its interval is
    symmetric in the logarithm (delta method): each seed gives the sum of the relative deviations of
    its errors and of its ratio. The spread of the sums over the seeds, with Student's t for that
    number of seeds, gives the width. It is exact for small normal deviations. It is too narrow
    where a few pixels make the error, as those of the plain MSE near a lamp can.

    Parameters
    ----------
    first_errors, errors
        Of the first strategy and of the other one, for the same seeds.
    first_seconds, seconds
        Of the two in the same turn, one turn a seed: what slows both has no part in their ratio.
    """
    mean, first_mean = float(np.mean(errors)), float(np.mean(first_errors))
    gains = np.divide(first_seconds, seconds)
    value = first_mean / mean * float(np.median(gains))

    count = len(errors)
    if count == 1:
        return Efficiency(value, math.nan, math.nan)
    of_errors = np.divide(first_errors, first_mean) - np.divide(errors, mean)
    of_seconds = np.log(gains)
    deviations = of_errors + MEDIAN_OVER_MEAN * of_seconds
    reach = _quantile(count) * float(np.std(deviations, ddof=1)) / math.sqrt(count)
    reach = min(reach, LONGEST_REACH)
    return Efficiency(value, value * math.exp(-reach), value * math.exp(reach))


def is_best(interval: tuple[float, float], others: Sequence[tuple[float, float]]) -> bool:
    """
    Tell whether an interval lies wholly above all `others`: the best value is known to be that.

    False where one of them is NaN, and where there are no others.
    """
    return bool(others) and all(interval[0] > high for _, high in others)


def fit_slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Return the exponent b of the power law y ∝ x^b, fitted by least squares of logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _quantile(count: int) -> float:
    """Return how many standard errors the interval reaches to either side."""
    return float(stdtrit(count - 1, (1 + CONFIDENCE) / 2)) if count > 1 else math.nan
