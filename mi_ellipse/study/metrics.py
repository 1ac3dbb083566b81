"""Measure how far a picture is from its reference; a metric is one entry of this registry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import flip_evaluator
import numpy as np
from numpy.typing import ArrayLike, NDArray

# A few pixels that a path hit by rare chance can outweigh all others in a mean of squares.
TRIMMED_FRACTION = 0.001

# Keeps dark pixels from dominating the relative error. It is relative to the picture, so that the
# error does not change with the brightness of the scene.
RELATIVE_EPSILON = 0.01


class Pair:
    """
    A picture and its reference, and what several metrics need of the two.

    Parameters
    ----------
    image, reference
        Linear pictures of the same shape (height, width, channels).
    """

    def __init__(self, image: ArrayLike, reference: ArrayLike):
        self.image, self.reference = np.asarray(image), np.asarray(reference)
        if self.image.shape != self.reference.shape:
            raise ValueError(
                f"image: its shape is {self.image.shape}, and that of the reference"
                f" {self.reference.shape}"
            )

    @cached_property
    def difference(self) -> NDArray[np.float64]:
        """Picture minus reference."""
        difference: NDArray[np.float64] = self.image - self.reference.astype(np.float64)
        return difference

    @cached_property
    def squares(self) -> NDArray[np.float64]:
        """Squared differences."""
        squares: NDArray[np.float64] = self.difference**2
        return squares

    @cached_property
    def relative_squares(self) -> NDArray[np.float64]:
        """Squared differences over reference² + ε."""
        reference = self.reference.astype(np.float64)
        floor = RELATIVE_EPSILON * reference.mean() ** 2
        relative: NDArray[np.float64] = self.squares / (reference**2 + floor)
        return relative


class _Halves(Pair):
    """
    The mean of two independent pictures, and an estimate of its difference from the truth.

    The expected square of that difference is a quarter of the expected square between the two.
    """

    def __init__(self, half_1: ArrayLike, half_2: ArrayLike):
        first, second = (np.asarray(half, dtype=np.float64) for half in (half_1, half_2))
        super().__init__((first + second) / 2, (first + second) / 2)
        self.difference = (first - second) / 2


Function = Callable[[Pair], float]


@dataclass(frozen=True)
class Metric:
    """One way to measure an error."""

    name: str  # in tables and files
    label: str  # in figures and reports
    squared: bool  # it falls like a variance, as 1 / samples, and not like its root
    note: str  # what it is, for a reader of the report
    function: Function
    by_difference: bool = True  # made of differences and the reference alone, see `_Halves`
    slow: bool = False  # takes seconds, so that its values are kept between two runs
    drawn: bool = False  # has curves of its own
    efficiency: bool = False  # efficiencies are made of it


METRICS: dict[str, Metric] = {}


def register(
    name: str, label: str, squared: bool, note: str, **options: bool
) -> Callable[[Function], Function]:
    """Enter a function of a :class:`Pair` under a name; `options` are further fields."""

    def enter(function: Function) -> Function:
        METRICS[name] = Metric(name, label, squared, note, function, **options)
        return function

    return enter


# ---- The metrics, in the order of the tables ----


@register(
    "mse", "MSE", True, "The mean of (image − reference)².", drawn=True, efficiency=True
)  # fmt: skip
def _mse(pair: Pair) -> float:
    return float(pair.squares.mean())


@register(
    "mse_trimmed",
    "trimmed MSE",
    True,
    f"The MSE without the worst {TRIMMED_FRACTION:.1%} of the values.",
    drawn=True,
    efficiency=True,
)
def _mse_trimmed(pair: Pair) -> float:
    return trimmed_mean(pair.squares)


@register("rmse", "RMSE", False, "The root of the MSE.")
def _rmse(pair: Pair) -> float:
    return math.sqrt(_mse(pair))


@register("rmse_trimmed", "trimmed RMSE", False, "The root of the trimmed MSE.")
def _rmse_trimmed(pair: Pair) -> float:
    return math.sqrt(_mse_trimmed(pair))


@register(
    "relative_mse",
    "relative MSE",
    True,
    "The mean of (image − reference)² / (reference² + ε), where ε is"
    f" {RELATIVE_EPSILON} times the squared mean of the reference.",
)
def _relative_mse(pair: Pair) -> float:
    return float(pair.relative_squares.mean())


@register(
    "relative_mse_trimmed",
    "trimmed relative MSE",
    True,
    f"The relative MSE without the worst {TRIMMED_FRACTION:.1%} of the values.",
    drawn=True,
)
def _relative_mse_trimmed(pair: Pair) -> float:
    return trimmed_mean(pair.relative_squares)


@register(
    "flip",
    "HDR-FLIP",
    False,
    "What a viewer sees of the error, from 0 (equal) to 1, at 67 pixels per degree.",
    by_difference=False,
    slow=True,
    drawn=True,
)
def _flip(pair: Pair) -> float:
    return flip(pair.image, pair.reference)


# ---- Measuring ----


def errors(image: ArrayLike, reference: ArrayLike) -> dict[str, float]:
    """
    Return the errors of a picture by the metrics that are made of differences.

    Parameters
    ----------
    image, reference
        Linear pictures of the same shape (height, width, channels).

    Returns
    -------
    dict
        The names are those of :data:`METRICS`, whose notes say what each one is.
    """
    return _measure(Pair(image, reference))


def reference_errors(half_1: ArrayLike, half_2: ArrayLike) -> dict[str, float]:
    """
    Estimate the errors of a reference from its two independent halves.

    The reference is their mean: its expected squared error is a quarter of that between them. The
    entries are those of :func:`errors`.
    """
    return _measure(_Halves(half_1, half_2))


def flip(image: ArrayLike, reference: ArrayLike) -> float:
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


def trimmed_mean(values: NDArray[np.float64]) -> float:
    """Return the mean without the largest 0.1 % of the values, at least one of them."""
    left_out = math.ceil(TRIMMED_FRACTION * values.size)
    kept = np.partition(values.ravel(), values.size - left_out)[: values.size - left_out]
    return float(kept.mean())


def _measure(pair: Pair) -> dict[str, float]:
    return {name: metric.function(pair) for name, metric in METRICS.items() if metric.by_difference}
