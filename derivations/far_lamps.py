"""From which distance on points of a lamp could be drawn by area, and what that would save.

A draw uniform on the surface costs less than one by direction. Its weight is the cosine at the lamp
over the squared distance, which hardly varies over a lamp that is far away. So `solid_angle` could
branch to a draw by area where the relative variance of that weight is below `LEAST_VARIANCE`.

- `variance` integrates over the ellipse, in double precision.
- `first_order` is its limit for far lamps. With the semi-axis vectors A and B and the vector c to
  the centre, the logarithm of the weight changes by -3 (c·q) / c² with the point q of the lamp. The
  variance of a coordinate over a unit disk is 1/4, so the weight has the relative variance
  9/4 ((c·A)² + (c·B)²) / c⁴. It is 2.25/d² for a disk d radii away in its own plane, two thirds of
  it as the mean over all directions, and 0 on the axis, where 3/16/d⁴ is left.
- `distance` is where the variance falls below the limit.
- `shares` counts the light samples of a scene that are so far away.

The branch is not built, because it would leave the fog of `scenes/spheres_fog.xml` as it is. One
light sample in a hundred is so far away that the distance alone decides, and one in seven if the
direction counts too. With ten times that variance they are more than half of the samples. A
prototype took as long as `solid_angle` all the same, within the error: a packet of 16 paths leaves
a draw out only if none of its points needs it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.optimize import brentq

LEAST_VARIANCE = 1e-3
FOG = Path(__file__).resolve().parent.parent / "scenes" / "spheres_fog.xml"
RADII, ANGLES = 24, 48  # Nodes of the quadrature; the integrand is smooth from one semi-axis on


def variance(centre: np.ndarray, ratio: float = 1.0) -> float:
    """Relative variance of the cosine over the squared distance, for uniform points of an ellipse.

    Parameters
    ----------
    centre
        Vector from the reference point to the centre, along the principal axes and the normal, in
        units of the longer semi-axis.
    ratio
        Shorter semi-axis over the longer one.
    """
    nodes, weights = np.polynomial.legendre.leggauss(RADII)
    radius = np.sqrt(0.5 * (nodes + 1))[:, None]  # Uniform in its square
    angle = 2 * np.pi * np.arange(ANGLES) / ANGLES
    x, y, z = centre
    squared = (x + radius * np.cos(angle)) ** 2 + (y + ratio * radius * np.sin(angle)) ** 2 + z**2
    weight = squared**-1.5  # The height above the plane is the same for all points
    share = 0.5 * weights[:, None] / ANGLES
    mean = np.sum(share * weight)
    return float(np.sum(share * (weight / mean - 1) ** 2))


def first_order(centre: np.ndarray, ratio: float = 1.0) -> float:
    """`variance` of a lamp that is far away."""
    x, y, z = centre
    return 2.25 * (x * x + ratio**2 * y * y) / (x * x + y * y + z * z) ** 2


def direction(polar: float) -> np.ndarray:
    """Unit vector at an angle in degrees from the lamp's axis, above the longer semi-axis."""
    return np.array([np.sin(np.radians(polar)), 0.0, np.cos(np.radians(polar))])


def distance(polar: float, limit: float = LEAST_VARIANCE) -> float:
    """Distance in radii, at an angle from the axis of a disk, where the variance is the limit."""
    return float(brentq(lambda d: variance(d * direction(polar)) - limit, 2.0, 1e4, rtol=1e-10))


def mean_variance(d: float, nodes: int = 16) -> float:
    """Mean over all directions at a distance from a disk."""
    heights, weights = np.polynomial.legendre.leggauss(nodes)
    polar = np.degrees(np.arccos(heights))
    return float(
        0.5 * sum(w * variance(d * direction(p)) for p, w in zip(polar, weights, strict=True))
    )


# ---- Light samples of a scene ----


class Shares(NamedTuple):
    """What part of the light samples of a scene would be drawn by area."""

    by_distance: float  # If the branch looks at the distance, in longer semi-axes
    by_variance: float  # If it looks at the first-order variance, so at the direction too


class Counting:
    """A strategy that counts its draws, and those where `area` has a variance below a limit."""

    def __init__(self, strategy: Any, limit: float):
        self.strategy = strategy
        self.limit = limit
        self.farthest2 = distance(90, limit) ** 2
        self.counts = dr.zeros(mi.UInt32, 3)

    def prepare(self, view: Any, normal: Any) -> tuple[Any, Any]:
        """Keep the view beside what the strategy prepares."""
        return view, self.strategy.prepare(view, normal)

    def sample(self, record: tuple[Any, Any], u: Any) -> Any:
        """Count, and draw as the strategy does."""
        view, prepared = record
        x, y, z = mi.Vector3f(view.position)
        far2 = x * x + y * y + z * z
        across2 = x * x + dr.square(mi.Float(view.light.ratio) * y)
        small = 2.25 * across2 < self.limit * far2 * far2
        for k, counted in enumerate((mi.Bool(True), far2 > self.farthest2, small)):
            dr.scatter_add(self.counts, dr.select(counted, mi.UInt32(1), 0), mi.UInt32(k))
        return self.strategy.sample(prepared, u)

    def pdf(self, record: tuple[Any, Any], d: Any) -> Any:
        """Density of the strategy."""
        return self.strategy.pdf(record[1], d)


def shares(scene: mi.Scene, limit: float = LEAST_VARIANCE, spp: int = 4, seed: int = 0) -> Shares:
    """Count the light samples of a scene with one lamp."""
    (emitter,) = scene.emitters()
    strategy = emitter.lamp.strategy
    emitter.lamp.strategy = counting = Counting(strategy, limit)
    dr.eval(mi.render(scene, spp=spp, seed=seed))
    emitter.lamp.strategy = strategy
    every, by_distance, by_variance = counting.counts.numpy().astype(float)
    return Shares(by_distance / every, by_variance / every)


def main() -> None:
    """Print the distances, and the shares of the fog."""
    from mi_ellipse.rendering.scene import load_scene

    mi.set_variant("llvm_ad_rgb")
    for polar in (0, 30, 60, 90):
        print(f"{polar:>3}° from the axis: below {LEAST_VARIANCE} from {distance(polar):.1f} radii")
    everywhere = brentq(lambda d: mean_variance(d) - LEAST_VARIANCE, 2.0, 1e3)
    print(f"mean of all directions: from {everywhere:.1f} radii")
    scene = load_scene(FOG, {"resx": "160", "resy": "120"})
    for limit in (LEAST_VARIANCE, 10 * LEAST_VARIANCE):
        by_distance, by_variance = (100 * share for share in shares(scene, limit))
        print(f"light samples of the fog below {limit}: {by_distance:.2f} % by their distance,")
        print(f"    {by_variance:.2f} % by distance and direction")


if __name__ == "__main__":
    main()
