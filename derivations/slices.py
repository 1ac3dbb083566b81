"""The tuned constants of `projected_solid_angle` that shape the density of the slices.

Each is judged with the package's own code, over the random lights of `lights`:

- END_NODE, OUTER_NODE: minimised is the mean relative variance of the irradiance, over the lights
  that the horizon divides and over the others. Both committed values are within 5 % of the best.
- AT_HORIZON: a choice between two aims, not an optimum, and an origin is not recorded. A larger
  value raises the least density, which lies at the horizon, and the variance where the shading
  normal is the surface's. At 0.25 no density is below 0.08 of the uniform one, twice what 0.06
  gives; doubling 0.25 again gains a fifth to a third.
- LEAST_CHANGE: uniform directions then have a relative variance of a quarter of its square at most,
  the variance of a linear cosine over a disk. 0.05 allows 1/1600, a deviation of 2.5 %. The factor
  of the cone's own width is (1/2)²: on the axis the cosine falls by ½ tan².
- HIGHEST_PEAK: η follows from τ with a relative rounding of ``(1 + (κ η)²) 2⁻²⁴``, 6e-4 at 100.
  Lower values raise the variance of needles whose κ η they cut off. Higher ones lower it where
  κ η > 100 (extremely long needles seen from close by), but at 1000 the rounding is 6 % already.
- THINNEST_SIDE: the thickness of a side is a difference of numbers of the size of τ_max. Its
  relative rounding is ``2⁻²⁴ / thickness``, 0.6 % at 1e-5 and 60 % at 1e-7.
"""

from __future__ import annotations

from collections.abc import Sequence

import mitsuba as mi
import numpy as np
from mi_ellipse.sampling import projected_solid_angle as psa

from .latitude import mean_variance
from .lights import Lights, draw, random_lights, relative_variances, replaced

ROUNDING = 2.0**-24
TUNED = {
    "END_NODE": (0.06, 0.09, 0.1, 0.11, 0.12, 0.13, 0.14, 0.16, 0.2),
    "OUTER_NODE": (0.6, 0.7, 0.76, 0.78, 0.8, 0.82, 0.85, 0.9),
}


def sweep(lights: Lights, name: str, values: Sequence[float]) -> dict[float, float]:
    """Mean relative variance for values of a constant."""
    return {value: mean_variance(lights, **{name: value}) for value in values}


def least_density(lights: Lights, at_horizon: float, side: int = 64) -> float:
    """Least density over that of uniform directions, over divided lights."""
    with replaced(AT_HORIZON=at_horizon):
        pdf = draw(lights[lights.divided], side=side).pdf.astype(float)
    return float((pdf.min(axis=1) * (1 / pdf).mean(axis=1)).min())


def change(lights: Lights) -> np.ndarray:
    """Change of the cosine over the light, as a part of that on the axis."""
    x, y, z = lights.normal.T
    width2 = (0.5 * lights.ta**2) ** 2
    return np.sqrt(width2 + ((x * lights.ta) ** 2 + (y * lights.tb) ** 2) / z**2)


def uniform_variance(lights: Lights, limit: float) -> float:
    """Largest relative variance of uniform directions where the cosine changes by a limit at most.

    The lights are made smaller until it does, those under grazing normals left out.
    """
    lights = lights[np.abs(lights.normal[:, 2]) > 0.05]
    tangent2, tan2 = lights.ta**2, lights.normal[:, 0] ** 2 * lights.ta**2
    tan2 = (tan2 + lights.normal[:, 1] ** 2 * lights.tb**2) / lights.normal[:, 2] ** 2
    # ¼ ta⁴ s² + tan² s = limit², s the square of the scale
    s = 2 * limit**2 / (tan2 + np.sqrt(tan2**2 + (tangent2 * limit) ** 2))
    small = lights._replace(ta=lights.ta * np.sqrt(s), tb=lights.tb * np.sqrt(s))
    assert np.allclose(change(small), limit)
    return float(np.nanmax(relative_variances(small, draw(small, sliced=False))[0]))


def needles(peak: float, count: int = 60, seed: int = 3) -> Lights:
    """Tilted needles with about a given κ η at the rim."""
    rng = np.random.default_rng(seed)
    ta = 2 * peak * 10 ** rng.uniform(0, 0.3, count)
    tb = 1e-2 / peak * 10 ** rng.uniform(-1, 0, count)
    # The normal nearly along the minor axis: the slices cross the needle at a slant
    x = 10 ** rng.uniform(-0.1, 0.1, count) / peak
    z = rng.uniform(0.1, 0.9, count)
    normal = np.stack([x * np.sqrt(1 - z**2), np.sqrt((1 - z**2) * (1 - x**2)), z], axis=1)
    return Lights(np.zeros(count, int), ta, tb, normal)


def peaks(lights: Lights) -> np.ndarray:
    """κ η at the rims, before `HIGHEST_PEAK` limits it."""
    with replaced(HIGHEST_PEAK=1e9):
        cut = psa._slices(lights.cone(), lights.normals(), False)
    return np.sqrt(np.array(cut.kappa2)) * np.array(cut.eta_max)


def rounding_of_eta(peak: float) -> float:
    """Relative rounding of η where κ η is this: that of τ, times d log η / d log τ."""
    return (1 + peak**2) * ROUNDING


def rounding_of_side(thickness: float) -> float:
    """Relative rounding of the thickness of a side, a part of τ_max."""
    return ROUNDING / thickness


def main() -> None:
    """Print what is derived beside what is committed."""
    mi.set_variant("llvm_ad_rgb")
    lights = random_lights(120)
    for name, values in TUNED.items():
        used = lights.divided == (name == "END_NODE")
        found = sweep(lights[used], name, values)
        best = min(found, key=found.get)
        excess = found[getattr(psa, name)] / found[best]
        print(f"{name}: best {best}, committed {getattr(psa, name)}, {excess:.3f} of the best")
        print("  ", *(f"{value}: {variance:.5f}" for value, variance in found.items()))

    print(f"AT_HORIZON, committed {psa.AT_HORIZON}:")
    for value in (0.0625, 0.125, 0.25, 0.5, 1):
        variance = mean_variance(lights, AT_HORIZON=value)
        print(f"  {value}: least density {least_density(lights, value):.3f}", end="")
        print(f", variance {variance:.5f}")

    for limit in (0.02, psa.LEAST_CHANGE, 0.1):
        variance = uniform_variance(lights, limit)
        share = variance / limit**2
        print(f"LEAST_CHANGE {limit}: variance {variance:.2e}, {share:.3f} of its square")

    for peak in (30, 100, 1000, 10_000):
        chosen = needles(peak)
        found = sweep(chosen, "HIGHEST_PEAK", (10, 30, 100, 300, 1000, 1e5))
        print(f"HIGHEST_PEAK, needles of κ η {np.median(peaks(chosen)):.0f}:", end=" ")
        print(*(f"{value:g}: {variance:.4f}" for value, variance in found.items()))
        print(f"  rounding of η there: {rounding_of_eta(peak):.1e}")
    for thickness in (1e-7, psa.THINNEST_SIDE, 1e-3):
        print(f"THINNEST_SIDE {thickness:g}: rounding {rounding_of_side(thickness):.1e}")


if __name__ == "__main__":
    main()
