"""The errors of a picture, against values worked out by hand."""

import math

import numpy as np
import pytest
from mi_ellipse.study import metrics

SHAPE = (20, 50, 3)  # 3000 values, of which the worst 3 are left out when trimmed


@pytest.fixture
def reference():
    return np.random.default_rng(1).uniform(0.5, 1.5, SHAPE)


def test_errors_of_a_constant_offset(reference):
    errors = metrics.errors(reference + 0.1, reference)
    assert errors["mse"] == pytest.approx(0.01)
    assert errors["rmse"] == pytest.approx(0.1)
    assert errors["mse_trimmed"] == pytest.approx(0.01)
    relative = [0.01 / (r**2 + 0.01 * reference.mean() ** 2) for r in reference.ravel()]
    assert errors["relative_mse"] == pytest.approx(sum(relative) / 3000)
    assert errors["relative_mse_trimmed"] == pytest.approx(sum(sorted(relative)[:-3]) / 2997)


def test_trimming_leaves_out_the_worst_values_only(reference):
    image = reference + 0.1
    image[3, 4] += 100.0  # three values
    errors = metrics.errors(image, reference)
    assert errors["mse"] > 9
    assert errors["mse_trimmed"] == pytest.approx(0.01)
    assert errors["rmse_trimmed"] == pytest.approx(0.1)
    image[7, 8, 0] += 100.0  # the fourth
    assert metrics.errors(image, reference)["mse_trimmed"] > 3


def test_relative_error_does_not_change_with_brightness(reference):
    reference[:5] = 0  # where only ε keeps it finite
    image = reference + 0.01
    dark = metrics.errors(1e-3 * image, 1e-3 * reference)
    bright = metrics.errors(image, reference)
    assert dark["relative_mse"] == pytest.approx(bright["relative_mse"])
    assert dark["mse"] == pytest.approx(1e-6 * bright["mse"])


def test_single_precision_pictures_are_compared_in_double():
    reference = np.full(SHAPE, 1e-30, dtype=np.float32)
    assert metrics.errors(2 * reference, reference)["mse"] == pytest.approx(1e-60)


def test_reference_errors_are_those_of_the_mean_of_the_halves():
    truth = np.ones((200, 200, 3))
    first, second = truth + 0.02 * np.random.default_rng(2).normal(size=(2, *truth.shape))
    estimated = metrics.reference_errors(first, second)
    actual = metrics.errors((first + second) / 2, truth)
    for name in metrics.SQUARED:
        assert estimated[name] == pytest.approx(actual[name], rel=0.03)
    assert estimated["mse"] == pytest.approx(0.0002, rel=0.03)


def test_flip(reference):
    assert metrics.flip(reference, reference) == 0
    small, large = (metrics.flip(reference * (1 + x), reference) for x in (0.05, 0.5))
    assert 0 < small < large < 1
    assert metrics.flip(-reference, reference) == metrics.flip(0 * reference, reference)


def test_estimate():
    estimate = metrics.estimate([1.0, 2.0, 3.0, 6.0])
    assert estimate.mean == 3
    assert estimate.standard_error == pytest.approx(math.sqrt((4 + 1 + 0 + 9) / 3 / 4))
    assert math.isnan(metrics.estimate([1.0]).standard_error)


def test_slope():
    x = np.array([8, 16, 32, 256])
    assert metrics.fit_slope(x, 3 / x) == pytest.approx(-1)
    assert metrics.fit_slope(x, 0.1 * np.sqrt(x)) == pytest.approx(0.5)
