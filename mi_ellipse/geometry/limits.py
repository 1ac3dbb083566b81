"""Sizes of lights that single precision can hold; others are refused."""

from __future__ import annotations

import math

import numpy as np

from .ellipse import PLANE_FLOOR
from .tracing import TINY

# Mitsuba's rays meet nothing from some 3e18 on, because squares of distances overflow. A light of
# this size and place is met from ten times as far.
LARGEST = 1e17

# From a distance of 1, an ellipse with the semi-axes 1e-18 and 1e-18 is right, and so is one with 1
# and 1e-18. With 1e-19 they are dark, because squares underflow.
SMALLEST = 1e-18

# Mitsuba starts the rays of a surface this far beside it, times one plus its coordinates. No light
# that is nearer can be right in any case.
RAY_OFFSET = 1500 * 2**-24

# From this many shorter semi-axes away, an ellipse of any aspect is right: 0.5 % were wrong at 10,
# and 4e-5 at 100, for aspects from 1e10 to 1e12.
FAR = 100


def check_ellipse(to_world: np.ndarray) -> None:
    """
    Refuse an ellipse whose light would be wrong where Mitsuba could light a surface.

    Parameters
    ----------
    to_world
        4×4 matrix, which maps the unit disk of the XY plane to the ellipse.

    Raises
    ------
    ValueError
        If the ellipse is too large, too small, or too long for its width.
    """
    lengths = np.linalg.svd(to_world[:3, :2], compute_uv=False)
    # The shorter one by the area, which loses nothing on needles
    area = np.linalg.norm(np.cross(to_world[:3, 0], to_world[:3, 1]))
    lx, ly = float(lengths[0]), float(area / lengths[0])
    _check_size(lx, ly, to_world[:3, 3])
    _check_aspect(lx, ly)


def check_solid(to_world: np.ndarray) -> None:
    """
    Refuse an ellipsoid that is too large or too small, as `check_ellipse` does.

    Its thickness is no matter of this: a mesh that single precision does not hold is refused.
    """
    lengths = np.linalg.svd(to_world[:3, :3], compute_uv=False)
    _check_size(float(lengths[0]), float(lengths[2]), to_world[:3, 3])


def _check_size(longest: float, shortest: float, centre: np.ndarray) -> None:
    reach = float(np.abs(centre).max()) + longest
    if not reach <= LARGEST:
        raise ValueError(
            f"a light of the size {longest:.3g} that reaches to {reach:.3g} is too large or too far"
            f" for single precision; keep it within {LARGEST:g} from the origin"
        )
    size, ratio = math.sqrt(longest * shortest), shortest / longest if longest else 0.0
    if not (size >= SMALLEST and ratio >= SMALLEST):
        raise ValueError(
            f"a light with the semi-axes {longest:.3g} and {shortest:.3g} is too small or too"
            " narrow for single precision; make their ratio, and the root of their product, at"
            f" least {SMALLEST:g}"
        )


def _check_aspect(lx: float, ly: float) -> None:
    """
    Refuse an ellipse that is too long for its width.

    At the height h above its plane, the cubic of `cone.confocal_root` has the constant term
    ``(h ly / lx²)²``. Where single precision does not hold that, the cone is wrong for points as
    near as the width. Below the height ``PLANE_FLOOR lx``, every point counts as being there.
    """
    nearest = RAY_OFFSET * (1 + ly)
    lowest = math.sqrt(TINY) * lx * lx / ly
    wrong = max(min(lowest, FAR * ly), PLANE_FLOOR * lx)
    if wrong <= nearest:
        return
    longest = nearest / PLANE_FLOOR
    if FAR * ly > nearest:
        longest = min(longest, math.sqrt(nearest * ly / math.sqrt(TINY)))
    # A little less, so that the limit that is printed with two digits is accepted
    raise ValueError(
        f"an ellipse with the semi-axes {lx:.3g} and {ly:.3g} is too long for its width: the light"
        f" would be wrong nearer than {wrong:.2g}; make the longer one at most {0.95 * longest:.2g}"
    )
