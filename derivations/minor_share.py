"""`_minor_share`: how the draws are split between the sides of a horizon that divides a light.

Sides with irradiances E and draws in the shares p have variances of about E² / p. Two aims differ:
the squared error of an image, the sum of E² / p, is least for p in proportion to E (power 1); the
mean relative variance, that of 1 / p, is least for equal shares (power 0). For small round lights
with the horizon uniformly between axis and rim:

- Power: the least one with which the squared error is at most 10 % above the least possible. It is
  0.375, the committed 3/8. An origin of it is not recorded, this condition reproduces it.
- Polynomial: ``(1 - h)(1 + c h) / 2`` equals the shares of that power on the axis and at the rim.
  c = 1/4 is within 11 % of them for h ≤ 0.95; the least largest deviation, 6 %, is at c = 0.32. Its
  objectives are the ones that count: they differ from those of the power by less than 2 %.

The irradiances are integrals over the unit disk, by quadrature in double precision.
"""

from __future__ import annotations

from typing import NamedTuple

import mitsuba as mi
import numpy as np
from mi_ellipse.sampling.projected_solid_angle import _minor_share
from scipy.optimize import brentq

POWER = 3 / 8
MORE_ERROR = 1.1
HORIZONS = (np.arange(400) + 0.5) / 400


def ratio(h: np.ndarray) -> np.ndarray:
    """Irradiance of the smaller side over that of the larger, the horizon at h of the radius.

    The integrals of |x - h| over the parts of the unit disk beyond h and before it.
    """
    angle = np.arccos(h)
    minor = (2 / 3) * np.sin(angle) ** 3 - h * (angle - h * np.sin(angle))
    return minor / (minor + np.pi * h)


def power_share(h: np.ndarray, power: float) -> np.ndarray:
    """Share of the smaller side in proportion to a power of the irradiances."""
    weight = ratio(h) ** power
    return weight / (1 + weight)


class Objectives(NamedTuple):
    """Of a split, over the least possible."""

    squared_error: float
    relative_variance: float


def objectives(share: np.ndarray, h: np.ndarray = HORIZONS) -> Objectives:
    """Mean over horizons; that of the relative variance as far as the share does not vanish."""
    r = ratio(h)
    error = np.sum(1 / (1 - share) + r**2 / share) / np.sum((1 + r) ** 2)
    inner = h < 0.95
    relative = (1 / share + 1 / (1 - share)) / 4
    return Objectives(float(error), float(relative[inner].mean()))


def derive() -> float:
    """Least power with which the squared error stays below `MORE_ERROR` of the best."""
    return brentq(
        lambda power: objectives(power_share(HORIZONS, power)).squared_error - MORE_ERROR, 0.1, 0.9
    )


def committed(h: np.ndarray) -> np.ndarray:
    """The package's share, by its own code."""
    return np.array(_minor_share(mi.Float(h)), dtype=float)


def main() -> None:
    """Print what is derived beside what is committed."""
    mi.set_variant("llvm_ad_rgb")
    print(f"power: derived {derive():.3f}, committed {POWER}")
    inner = HORIZONS[HORIZONS <= 0.95]
    deviation = committed(inner) / power_share(inner, POWER) - 1
    print(f"polynomial: {deviation.min():+.3f} … {deviation.max():+.3f} of the power")
    for name, share in (
        ("power 3/8", power_share(HORIZONS, POWER)),
        ("polynomial", committed(HORIZONS)),
    ):
        print(f"  {name}:", *(f"{k} {v:.3f}" for k, v in objectives(share)._asdict().items()))


if __name__ == "__main__":
    main()
