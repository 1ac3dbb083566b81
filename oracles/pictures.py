"""Pictures, and what may be said about the difference of two."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import scipy.stats

# Of wrongly rejecting a pair of pictures of equal expectation. There are some two hundred pairs.
SIGNIFICANCE = 1e-5


def render(scene, spp: int, count: int = 8, **options) -> np.ndarray:
    """Independent pictures of a scene, as an array (count, height, width, channels)."""
    return np.array([np.array(mi.render(scene, spp=spp, seed=s, **options)) for s in range(count)])


def blocks(pictures: np.ndarray, side: int = 4) -> np.ndarray:
    """Means over `side` × `side` blocks of each picture and channel: (count, blocks, channels)."""
    n, height, width, channels = pictures.shape
    split = pictures.reshape(n, side, height // side, side, width // side, channels)
    return split.mean((2, 4)).reshape(n, side * side, channels)


def assert_same_picture(got: np.ndarray, expected: np.ndarray, rtol: float) -> None:
    """Pictures of one seed: the same numbers, up to the rounding of a transform."""
    assert expected.max() > 0
    np.testing.assert_allclose(got, expected, rtol=rtol, atol=1e-5)


def assert_same_expectation(got: np.ndarray, expected: np.ndarray, within: float) -> None:
    """Welch's test of each block and channel, corrected for their number (Bonferroni).

    Parameters
    ----------
    got, expected
        Independent pictures, as from `render`.
    within
        A relative error of the mean that the test must be able to see in a typical block: its
        threshold is asserted to be smaller.
    """
    assert np.isfinite(got).all()
    assert np.isfinite(expected).all()
    degrees = len(got) + len(expected) - 2
    got, expected = blocks(got.astype(float)), blocks(expected.astype(float))
    variance = got.var(0, ddof=1) / len(got) + expected.var(0, ddof=1) / len(expected)
    got, expected = got.mean(0), expected.mean(0)
    assert expected.any(), "the picture is black"

    # A few pictures tell little about the variance of one block. The relative errors of a channel
    # are similar: where their mean is larger, it is taken, and its degrees of freedom (a quarter of
    # them, as they are not equal).
    scale = np.maximum(np.abs(expected), np.sqrt(np.mean(expected**2, 0)))
    lit = np.where(scale > 0, scale, 1)
    variance = np.maximum(variance, np.mean(variance / lit**2, 0) * scale**2)
    quantile = scipy.stats.t.isf(SIGNIFICANCE / 2 / scale.size, df=degrees * len(scale) / 4)
    # Pictures of the same random numbers differ by rounding alone.
    limit = np.maximum(quantile * np.sqrt(variance), 1e-5 * scale)
    assert np.median(limit / lit) < within, f"only sees errors above {np.median(limit / lit):.3f}"
    difference = np.abs(got - expected)
    assert (difference <= limit).all(), f"off by {(difference / lit).max():.4f}"
