"""Measure how far a picture is from its reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import flip_evaluator
import numpy as np

# A few pixels that a path hit by rare chance can outweigh all others in a mean of squares.
TRIMMED_FRACTION = 0.001

# Keeps dark pixels from dominating the relative error; relative to the picture, so that the error
# does not change with the scene's brightness.
RELATIVE_EPSILON = 0.01

# Metrics and how to call them in figures and reports.
LABELS = {
    "mse": "MSE",
    "mse_trimmed": "trimmed MSE",
    "rmse": "RMSE",
    "rmse_trimmed": "trimmed RMSE",
    "relative_mse": "relative MSE",
    "relative_mse_trimmed": "trimmed relative MSE",
    "flip": "HDR-FLIP",
}
METRICS = tuple(LABELS)
SQUARED = ("mse", "mse_trimmed", "relative_mse", "relative_mse_trimmed")


@dataclass(frozen=True)
class Estimate:
    """Mean over several seeds."""

    mean: float
    standard_error: float  # of the mean; NaN from a single seed


def errors(image: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """
    Return the errors of a picture.

    Parameters
    ----------
    image, reference
        Linear pictures of the same shape (height, width, channels).

    Returns
    -------
    dict
        ``mse`` is the mean of (image - reference)² over pixels and channels; ``relative_mse`` that
        of (image - reference)² / (reference² + ε), where ε is 0.01 times the squared mean of the
        reference; ``rmse`` the root of ``mse``. ``…_trimmed`` leaves out the worst 0.1 % of values.
    """
    return _errors(image - np.asarray(reference, dtype=np.float64), reference)


def reference_errors(half_1: np.ndarray, half_2: np.ndarray) -> dict[str, float]:
    """
    Estimate the errors of a reference from its two independent halves.

    The reference is their mean: its expected squared error is a quarter of that between them. The
    entries are those of :func:`errors`.
    """
    half_1 = np.asarray(half_1, dtype=np.float64)
    return _errors((half_1 - half_2) / 2, (half_1 + half_2) / 2)


def flip(image: np.ndarray, reference: np.ndarray) -> float:
    """
    Return the mean HDR-FLIP error, from 0 (looks the same) to 1.

    P. Andersson et al., "Visualizing errors in rendered high dynamic range images", Eurographics
    short papers 2021; at 67 pixels per degree, its exposures chosen from the reference.
    """
    # FLIP is defined for light, which is not negative; spectral noise of a wide gamut can be.
    test, truth = (
        np.ascontiguousarray(np.maximum(picture, 0), dtype=np.float32)
        for picture in (image, reference)
    )
    return float(flip_evaluator.evaluate(truth, test, "HDR", applyMagma=False)[1])


def estimate(values: Sequence[float]) -> Estimate:
    """Return the mean of independent values and its standard error."""
    spread = np.std(values, ddof=1) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return Estimate(float(np.mean(values)), float(spread))


def fit_slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Return the exponent b of the power law y ∝ x^b, fitted by least squares of logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _errors(difference: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    reference = np.asarray(reference, dtype=np.float64)
    squares = difference**2
    relative = squares / (reference**2 + RELATIVE_EPSILON * reference.mean() ** 2)
    result = {
        "mse": float(squares.mean()),
        "mse_trimmed": trimmed_mean(squares),
        "relative_mse": float(relative.mean()),
        "relative_mse_trimmed": trimmed_mean(relative),
    }
    for name in ("mse", "mse_trimmed"):
        result[f"r{name}"] = math.sqrt(result[name])
    return result


def trimmed_mean(values: np.ndarray) -> float:
    """Return the mean without the largest 0.1 % of the values, at least one of them."""
    left_out = math.ceil(TRIMMED_FRACTION * values.size)
    kept = np.partition(values.ravel(), values.size - left_out)[: values.size - left_out]
    return float(kept.mean())
