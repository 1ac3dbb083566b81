"""Fitted polynomials, scales and powers come out of their derivations."""

import numpy as np
import pytest
from mi_ellipse.sampling import projected_solid_angle as psa
from mi_ellipse.sampling import solid_angle

from derivations import angular_warp, azimuth, latitude, minor_share
from derivations.lights import random_lights


@pytest.mark.parametrize(
    ("function", "committed"),
    [
        (azimuth.sine_over_fraction, solid_angle.QUARTER_SINE),
        (azimuth.cosine, solid_angle.QUARTER_COSINE),
    ],
)
def test_quarter_angle(function, committed):
    # The committed digits: nine significant ones
    np.testing.assert_allclose(azimuth.chebyshev(function), committed, rtol=5e-9)
    error = azimuth.largest_error(function, committed)
    assert error < 3e-8  # As the docstring of `_azimuth` says
    assert azimuth.remez(function) <= error < 1.03 * azimuth.remez(function)


def test_angular_warp_is_within_two_percent_of_the_best_found():
    committed = angular_warp.largest(angular_warp.COMMITTED)
    best = angular_warp.largest(angular_warp.derive(steps=200, count=30))
    assert best <= committed < 1.02 * best
    # A tenth more or less of what acts at all angles is worse
    for k in (1, 4, 5):
        for factor in (0.9, 1.1):
            other = angular_warp.COMMITTED.copy()
            other[k] *= factor
            assert angular_warp.largest(other) > committed


@pytest.mark.parametrize(("limit", "deviation"), [(45, 3e-4), (63, 8e-4), (89.99, 1.8e-2)])
def test_deviation_from_uniform_as_claimed(limit, deviation):
    found = angular_warp.largest(angular_warp.COMMITTED, limit)
    # Not a much weaker claim than what holds either
    assert 0.75 * deviation < found < deviation


def test_latitude_scale_of_short_slices():
    # The slope of the logarithm is exactly 2 - 3/2 c²; the next term of its series is 1e-6 here
    assert abs(latitude.slope_at_equator(psa.LATITUDE_SCALE2)) < 1e-6
    assert latitude.best_scale2(0.02) == pytest.approx(psa.LATITUDE_SCALE2, abs=1e-3)


def test_latitude_scale_from_pole_to_pole():
    assert latitude.best_scale2(1e4) == pytest.approx(1.82, abs=0.005)
    # As the comment beside the constant says
    assert 1.7 <= psa.LATITUDE_SCALE2 + psa.LONG_SLICES <= 2


def test_long_slices(llvm_ad_rgb):
    lights = random_lights(60)
    values = (0.2, 0.3, 0.35, psa.LONG_SLICES, 0.45, 0.5, 0.6)
    found = {v: latitude.mean_variance(lights, LONG_SLICES=v) for v in values}
    # The valley is flat: 1 % between 0.35 and 0.45
    assert found[psa.LONG_SLICES] < 1.01 * min(found.values())
    assert min(found[0.2], found[0.6]) > 1.04 * found[psa.LONG_SLICES]


def test_power_of_the_minor_share():
    assert minor_share.derive() == pytest.approx(minor_share.POWER, abs=0.002)


def test_ratio_of_irradiances_against_quadrature():
    x, step = np.linspace(-1, 1, 200_001, retstep=True)
    chord = np.sqrt(1 - x**2)
    for h in (0.1, 0.5, 0.9):
        minor, major = (np.sum(chord * np.maximum(s * (x - h), 0)) * step for s in (1, -1))
        # The trapezoid of a root's end: step^1.5 in the smaller integral, which is 1e-2 at least
        assert minor_share.ratio(np.array([h]))[0] == pytest.approx(minor / major, rel=1e-5)


def test_polynomial_of_the_minor_share(llvm_ad_rgb):
    inner = minor_share.HORIZONS[minor_share.HORIZONS <= 0.95]
    share = minor_share.committed(inner)
    deviation = share / minor_share.power_share(inner, minor_share.POWER) - 1
    assert np.abs(deviation).max() < 0.11  # As `_minor_share` says
    polynomial = minor_share.objectives(minor_share.committed(minor_share.HORIZONS))
    power = minor_share.objectives(minor_share.power_share(minor_share.HORIZONS, minor_share.POWER))
    np.testing.assert_allclose(polynomial, power, rtol=0.02)
