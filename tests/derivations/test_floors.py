"""Floors lie in their windows; steps and nodes have the errors that are claimed."""

import numpy as np
import pytest
from mi_ellipse.geometry.cone import CEL_STEPS
from mi_ellipse.geometry.irradiance import NODES
from mi_ellipse.sampling import projected_solid_angle as psa
from mi_ellipse.sampling.concentric import NEWTON_STEPS
from mi_ellipse.sampling.concentric import NODES as CONCENTRIC_NODES

from derivations import floors, quadrature


@pytest.mark.parametrize("window", floors.WINDOWS, ids=lambda window: window.name)
def test_floor(window):
    assert window.low < window.high
    # TINY's own window is a single number of double precision, which it rounds
    assert window.safe


def test_quantiles_in_single_precision():
    one = np.float32(1)
    assert np.float32(psa.LARGEST_QUANTILE) == np.nextafter(one, np.float32(0))
    assert one - np.float32(psa.LEAST_QUANTILE) == one
    assert np.float32(1 - psa.INWARDS) < one


def test_squares_in_single_precision():
    assert np.isfinite(np.float32(psa.AT_POLE) ** -2)
    with np.errstate(over="ignore"):
        assert np.isinf(np.float32(psa.AT_POLE / 100) ** -2)
        assert np.isfinite(np.float32(psa.LARGEST_TANGENT2) ** 2)
        assert np.isinf(np.float32(psa.LARGEST_TANGENT2 * 1e4) ** 2)


def test_share_of_textures():
    assert floors.growth_of_second_moment() < 1.06


def test_steps_of_the_solid_angle():
    assert quadrature.solid_angle_error(CEL_STEPS) < floors.ROUNDING
    assert quadrature.solid_angle_error(CEL_STEPS - 1) > floors.ROUNDING


def test_nodes_of_the_irradiance(llvm_ad_rgb):
    errors = quadrature.irradiance_errors(len(NODES), 10, 0.01, count=2000)
    assert errors.max() < 2e-6  # 'Some 1e-6', over fewer lights than in the derivation
    assert quadrature.irradiance_errors(len(NODES) // 2, 10, 0.01, count=2000).max() > 1e-5


def test_steps_of_the_confocal_root():
    start, first, second = quadrature.root_errors(count=50_000)
    assert start < 1  # As the docstring of `confocal_root` says
    assert first < 0.015
    assert second < floors.ROUNDING


def test_steps_of_concentric():
    errors = [quadrature.azimuth_errors(k, len(CONCENTRIC_NODES)) for k in range(NEWTON_STEPS + 1)]
    assert errors[NEWTON_STEPS] < floors.ROUNDING < errors[NEWTON_STEPS - 1]


def test_nearness_of_textures():
    # The next term of the series at infinity is 2 / T
    assert quadrature.nearness(1e5) == pytest.approx(0.125, rel=1e-4)
