"""Floors and limits of single precision: why a value is safe, and what happens away from it.

Each floor has a window: below its lower end or above its upper end something is lost. The windows
follow from the range (1.2e-38 to 3.4e38) and the spacing (2⁻²⁴) of single precision, and a
committed value must lie in its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from mi_ellipse.geometry.cone import FAR, ON_AXIS, SMALLEST
from mi_ellipse.geometry.ellipse import FARTHEST, PLANE_FLOOR
from mi_ellipse.geometry.tracing import TINY
from mi_ellipse.lamps.lamp import RESOLUTION
from mi_ellipse.lamps.textured import MINIMUM_SHARE
from mi_ellipse.sampling import projected_solid_angle as psa
from mi_ellipse.sampling.tangent_disk import MINIMUM_COSINE

RANGE = np.finfo(np.float32)
ROUNDING = 2.0**-24  # Largest relative error of rounding
LONGEST_NEEDLE = 1 / ROUNDING  # Longer ones are thinner than the rounding of their length
FARTHEST_CONE = 1e18  # Distance in semi-axes up to which squared tangents are normal numbers


class Window(NamedTuple):
    """Values between which a constant is safe, and why."""

    name: str
    value: float
    low: float
    high: float
    below: str  # What happens below `low`
    above: str

    @property
    def safe(self) -> bool:
        """Whether the committed value lies in the window."""
        return self.low <= self.value <= self.high


LARGEST, LEAST = float(RANGE.max), float(RANGE.tiny)

WINDOWS = (
    Window("TINY", TINY, LEAST, LEAST * (1 + 1e-7), "may be flushed to 0", "not a floor"),
    Window(
        "SMALLEST",
        SMALLEST,
        LEAST * LONGEST_NEEDLE**2,
        ROUNDING**2,
        "its product with the squared ratio of a needle is not normal",
        "it replaces a difference of eigenvalues that counts",
    ),
    Window(
        "ON_AXIS",
        ON_AXIS,
        LEAST,
        ROUNDING**2,
        "its square root is no number of single precision",
        "it moves a point by more than the rounding of its coordinates",
    ),
    # The error is b / a² with |b| ≤ a (1 + e²); the discriminant has terms up to 12 a⁴.
    Window(
        "FAR",
        FAR,
        2 / ROUNDING,
        (LARGEST / 12) ** 0.25,
        "the first coefficient is not yet the root",
        "the discriminant overflows",
    ),
    Window(
        "PLANE_FLOOR",
        PLANE_FLOOR,
        LEAST**0.5,
        ROUNDING,
        "its square is not normal",
        "it moves a point by more than the rounding of its coordinates",
    ),
    Window(
        "FARTHEST",
        FARTHEST,
        FARTHEST_CONE,
        LARGEST / LONGEST_NEEDLE,
        "within the range of the cone",
        "its product with the aspect ratio overflows",
    ),
    # Two points, three coordinates each, rounded to half a unit, and transformed once
    Window(
        "RESOLUTION",
        RESOLUTION,
        2 * 3**0.5 * ROUNDING,
        16 * ROUNDING,
        "differences of rounding count as distances",
        "real distances are lost",
    ),
    # The solid angle has an error of 6e-7 (see `quadrature`).
    Window(
        "MINIMUM_COSINE",
        MINIMUM_COSINE,
        6e-7,
        1e-5,
        "the error of a solid angle near 2π makes it negative",
        "caps get smaller by more than the errors of the solid angle",
    ),
    Window(
        "LEAST_LEFT",
        psa.LEAST_LEFT,
        LEAST,
        ROUNDING ** (2 / 3),
        "the density falls to 0 at a rim",
        "it acts on quantiles that are drawn",
    ),
    Window("LEAST_Q", psa.LEAST_Q, LEAST, 4 * ROUNDING, "the density falls to 0", "it is drawn"),
    Window(
        "LEAST_QUANTILE",
        psa.LEAST_QUANTILE,
        0,
        ROUNDING / 2,
        "a rounded quantile may be negative",
        "it is a number beside 1 in single precision",
    ),
    Window(
        "1 - LARGEST_QUANTILE",
        1 - psa.LARGEST_QUANTILE,
        ROUNDING / 2,
        1.5 * ROUNDING,
        "it rounds to 1 in single precision: no slice is left there",
        "more than one number is left out",
    ),
    Window(
        "INWARDS",
        psa.INWARDS,
        2 * ROUNDING,
        ROUNDING ** (2 / 3) / 2,
        "1 less this is a rim after two roundings",
        "it acts on slices that are drawn",
    ),
    # Products of both squared tangents occur, times 4.
    Window(
        "LARGEST_TANGENT2",
        psa.LARGEST_TANGENT2,
        ROUNDING**-2,
        (LARGEST / 4) ** 0.5,
        "the half-angle is not yet 90° in single precision",
        "products overflow",
    ),
    Window(
        "LEAST_TILT2",
        psa.LEAST_TILT2,
        (2 * ROUNDING) ** 2,
        ROUNDING,
        "the direction of the normal about the axis is rounding",
        "a tilt that changes cosines is ignored",
    ),
    Window(
        "AT_POLE",
        psa.AT_POLE,
        1.1 / LARGEST**0.5,
        ROUNDING,
        "the squared tangent overflows",
        "directions near the pole count as the pole",
    ),
)


def growth_of_second_moment(share: float = MINIMUM_SHARE) -> float:
    """Factor by which a mixture's second moment exceeds that of the part with the other share."""
    return 1 / (1 - share)


def main() -> None:
    """Print the windows."""
    for w in WINDOWS:
        print(f"{w.name} = {w.value:.3g}, safe in [{w.low:.2g}, {w.high:.2g}]: {w.safe}")
        print(f"  below: {w.below}; above: {w.above}")
    print(f"MINIMUM_SHARE {MINIMUM_SHARE}: second moment × {growth_of_second_moment():.3f}")


if __name__ == "__main__":
    main()
