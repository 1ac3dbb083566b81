"""Choose the regions of the pictures that are enlarged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...files.images import Image
from ..results import Comparison

DIFFERENCE_GAIN = 5  # of the false-colour pictures
INSET_COLOURS = ("#00E5FF", "#FFE600", "#FF4FD8", "#7CFF4F")
INSET_SIZE = 0.16  # of the smaller side of the picture

# Left, top, width and height in pixels
Inset = tuple[int, int, int, int]

# One value a pixel, (height, width)
Map = NDArray[np.float64]


def choose_insets(comparison: Comparison, count: int = 2) -> list[Inset]:
    """
    Return the square regions of a picture where the strategies differ most.

    What counts is the mean of the false-colour differences as they are shown, clipped at white, so
    that single bright pixels do not draw attention: the largest of all strategies minus the
    smallest, over all numbers of samples.
    """
    reference = comparison.reference_image()
    scale = 2.0**comparison.exposure
    shown = [
        np.mean(
            [magnitude(comparison.image(one), reference, scale) for one in comparison.series(name)],
            axis=0,
        )
        for name in comparison.strategies
    ]
    height, width = reference.shape[:2]
    size = min(height, width, max(4, round(INSET_SIZE * min(height, width))))
    means = np.array([_box_means(one, size) for one in shown])
    # With a single strategy, the places where it errs most.
    interest = means.max(axis=0) - (means.min(axis=0) if len(means) > 1 else 0)

    insets: list[Inset] = []
    for _ in range(count):
        y, x = np.unravel_index(np.argmax(interest), interest.shape)
        insets.append((int(x), int(y), size, size))
        # The next one shall show something else.
        interest[max(y - 2 * size, 0) : y + 2 * size, max(x - 2 * size, 0) : x + 2 * size] = -1
    return sorted(insets)


def check_inside(insets: Sequence[Inset], shape: tuple[int, ...]) -> None:
    """Raise a ValueError if a region is not inside the picture, or there are too many."""
    height, width = shape[:2]
    if len(insets) > len(INSET_COLOURS):
        raise ValueError(f"{len(insets)} insets are more than the {len(INSET_COLOURS)} that fit")
    for x, y, w, h in insets:
        if w < 1 or h < 1 or x + w > width or y + h > height:
            raise ValueError(
                f"the inset {x},{y},{w},{h} is not inside the picture of {width} × {height} pixels"
            )


def magnitude(image: Image, reference: Image, scale: float) -> Map:
    """Return the mean absolute difference of the channels × 5, clipped at the picture's white."""
    difference = np.abs(image.astype(np.float64) - reference).mean(axis=2)
    clipped: Map = np.minimum(DIFFERENCE_GAIN * scale * difference, 1)
    return clipped


def _box_means(values: Map, size: int) -> Map:
    """Return the mean of every square of `size` pixels, by its top left corner."""
    sums = np.pad(values, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    squares = sums[size:, size:] - sums[:-size, size:] - sums[size:, :-size] + sums[:-size, :-size]
    means: Map = squares / size**2
    return means
