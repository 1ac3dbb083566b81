"""Least density towards a sphere close to the horizon (`LEAST_DENSITY`).

A cap that the horizon does not divide can be drawn in exact proportion to the cosine c. The density
is then the part c / mean(c) of the uniform one, and the share w of uniform draws raises the least
part l to L = w + (1 - w) l. This prints the largest relative variance that w costs, over all caps
whose rim touches the horizon (l = 0, w = L). There it is the largest, because w is.
"""

from __future__ import annotations

import numpy as np
from mi_ellipse.sampling.projected_solid_angle import LEAST_DENSITY

NODES = 400


def variance(half_angle: float, share: float) -> float:
    """Relative variance of the irradiance from a cap whose rim touches the horizon.

    By the midpoint rule over a uniform map of the unit square to the cap.
    """
    grid = (np.arange(NODES) + 0.5) / NODES
    height, azimuth = np.meshgrid(grid * (1 - np.cos(half_angle)), 2 * np.pi * grid)
    sine = np.sqrt(height * (2 - height))
    # The normal is perpendicular to the rim's lowest direction.
    cosine = np.sin(half_angle) * (1 - height) + np.cos(half_angle) * sine * np.cos(azimuth)
    part = cosine / cosine.mean()
    return float(np.mean(part**2 / ((1 - share) * part + share)) - 1)


def largest_variance(share: float) -> float:
    """The largest over half-angles."""
    return max(variance(half_angle, share) for half_angle in np.radians(np.arange(1, 91)))


if __name__ == "__main__":
    for share in (LEAST_DENSITY / 2, LEAST_DENSITY, 2 * LEAST_DENSITY):
        print(f"least density {share:.3f}: relative variance {largest_variance(share):.4f}")
