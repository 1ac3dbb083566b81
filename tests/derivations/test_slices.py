"""Tuned constants of the slices are near the best of their objectives."""

import pytest
from mi_ellipse.sampling import projected_solid_angle as psa

from derivations import slices
from derivations.latitude import mean_variance
from derivations.lights import random_lights


@pytest.mark.parametrize(("name", "away"), [("END_NODE", 0.06), ("OUTER_NODE", 0.1)])
def test_nodes(llvm_ad_rgb, name, away):
    lights = random_lights(60)
    divided = lights.divided  # Lights that use END_NODE; the others use OUTER_NODE
    lights = lights[divided if name == "END_NODE" else ~divided]
    committed = getattr(psa, name)
    found = slices.sweep(lights, name, slices.TUNED[name])
    # Between neighbouring values the variance differs by up to 5 %
    assert found[committed] < 1.05 * min(found.values())
    for value in (committed - away, committed + away):
        assert mean_variance(lights, **{name: value}) > 1.1 * found[committed]


def test_density_at_the_horizon(llvm_ad_rgb):
    lights = random_lights(60)
    densities = [slices.least_density(lights, value) for value in (0.0625, psa.AT_HORIZON, 0.5)]
    assert densities[1] > 0.08
    assert densities[1] / densities[0] > 1.7  # Twice as much, for a random sample of lights
    assert densities[2] / densities[1] < 1.5  # Doubling it again gains less
    variances = [mean_variance(lights, AT_HORIZON=v) for v in (0.0625, psa.AT_HORIZON, 0.5)]
    assert variances == sorted(variances)


def test_uniform_where_the_cosine_hardly_varies(llvm_ad_rgb):
    variance = slices.uniform_variance(random_lights(60), psa.LEAST_CHANGE)
    # The variance of a linear cosine over a disk; the cone of 5 % is a disk to 1 %
    assert variance == pytest.approx(psa.LEAST_CHANGE**2 / 4, rel=0.01)


def test_highest_peak(llvm_ad_rgb):
    needles = slices.needles(psa.HIGHEST_PEAK / 4)
    assert (slices.peaks(needles) < psa.HIGHEST_PEAK).all()
    found = slices.sweep(needles, "HIGHEST_PEAK", (10, psa.HIGHEST_PEAK, 1e5))
    assert found[10] > 5 * found[psa.HIGHEST_PEAK]
    assert found[1e5] == found[psa.HIGHEST_PEAK]  # It limits nothing below
    assert slices.rounding_of_eta(psa.HIGHEST_PEAK) == pytest.approx(6e-4, rel=0.01)


def test_thinnest_side():
    assert slices.rounding_of_side(psa.THINNEST_SIDE) < 0.01
    assert slices.rounding_of_side(psa.THINNEST_SIDE / 100) > 0.5
