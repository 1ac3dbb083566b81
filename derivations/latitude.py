"""`LATITUDE_SCALE2` and `LONG_SLICES`: the scale of the tangent in the density along a slice.

Along a slice the irradiance wants the density cos² λ dλ of the latitude λ. Drawn is one that is
proportional to ``(1 + c² T²)^(-3/2) dT``, ``T = tan λ``; its ratio to the wanted density is
``(1 + c² T²)^(3/2) / (1 + T²)²``.

- Short slices: the logarithm of that ratio, ``3/2 log(1 + c² T²) - 2 log(1 + T²)``, has the slope
  ``3/2 c² - 2`` in T² at T = 0. It vanishes for c² = 4/3 exactly.
- Slices from pole to pole: minimised is the relative variance of the ratio. By quadrature in double
  precision the best c² is 1.82.
- Both together: minimised is the relative variance of the irradiance over the random lights of
  `lights`, with the package's own code. 0.4 is within 1 % of the best. For lights that fill the
  view the variance is 35 % less than with 0.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from mi_ellipse.sampling.projected_solid_angle import LATITUDE_SCALE2, LONG_SLICES
from scipy.optimize import minimize_scalar

from .lights import CLASSES, draw, random_lights, relative_variances, replaced

NODES, WEIGHTS = np.polynomial.legendre.leggauss(400)


def slope_at_equator(scale2: float, step: float = 1e-6) -> float:
    """Slope, in T², of the logarithm of drawn over wanted density."""
    return (2 * np.log1p(step) - 1.5 * np.log1p(scale2 * step)) / step


def slice_variance(scale2: float, half_length: float) -> float:
    """Relative variance along a slice whose latitudes have tangents up to `half_length`."""
    limit = np.arctan(half_length)
    latitude, weights = limit * NODES, limit * WEIGHTS
    wanted = np.cos(latitude) ** 2
    cos2 = np.cos(latitude) ** 2
    drawn = np.sqrt(cos2) / (cos2 + scale2 * (1 - cos2)) ** 1.5
    drawn /= weights @ drawn
    return float(weights @ (wanted**2 / drawn) / (weights @ wanted) ** 2 - 1)


def best_scale2(half_length: float) -> float:
    """Best c² for slices of a half-length, a tangent."""
    result = minimize_scalar(slice_variance, (1, 2), args=(half_length,), bounds=(1, 3))
    return float(result.x)


def mean_variance(lights, **constants: float) -> float:
    """Mean relative variance of the irradiance with constants replaced."""
    with replaced(**constants):
        return float(np.nanmean(relative_variances(lights, draw(lights))[0]))


def main() -> None:
    """Print what is derived beside what is committed."""
    mi.set_variant("llvm_ad_rgb")
    print(f"slope at the equator for c² = {LATITUDE_SCALE2:.6f}: {slope_at_equator(4 / 3):.1e}")
    for half_length in (0.1, 0.3, 1, 3, 10, 100, 1e4):
        formula = LATITUDE_SCALE2 + LONG_SLICES * half_length**2 / (1 + half_length**2)
        print(f"  slices of ±{half_length:g}: best c² {best_scale2(half_length):.3f}", end="")
        print(f", the formula {formula:.3f}")
    lights = random_lights(120)
    fills = lights[lights.kind == list(CLASSES).index("fills the view")]
    for value in (0, 0.2, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6):
        print(f"  LONG_SLICES {value:.2f}: {mean_variance(lights, LONG_SLICES=value):.5f}", end="")
        print(f", fills the view {mean_variance(fills, LONG_SLICES=value):.5f}")


if __name__ == "__main__":
    main()
