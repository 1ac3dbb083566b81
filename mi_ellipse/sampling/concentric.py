"""Strategy `concentric`: directions uniform in solid angle by numerical inversion."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry import cone
from ..geometry.cone import RoundCone
from ..geometry.light import View
from . import cap, solid_angle
from .strategy import register

# Steps of Newton's method after the shifted κ map, and nodes of the Gauss-Legendre rule that
# integrates the azimuthal density. With them the error of the eccentric angle is at most 4e-8, for
# half-angles near 90°. That is below the rounding of single precision (derivations/quadrature.py).
NEWTON_STEPS = 2
NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)


class Record(NamedTuple):
    """What is computed once per reference point."""

    map: solid_angle.Record
    quadrant: mi.Float  # `_cumulative` of the whole quadrant
    pdf: mi.Float  # One over the solid angle


def _cumulative(record: solid_angle.Record, t: mi.Float) -> mi.Float:
    """Solid angle between the eccentric angles 0 and t ≤ π/2, up to a constant factor."""
    total = 0
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        s, c = dr.sincos(t * float(0.5 + 0.5 * node))
        total = dr.fma(float(weight), dr.rcp(solid_angle.rim(record, c, s)), total)
    return 0.5 * t * total


def radial_map(record: Record, c: mi.Float, s: mi.Float, radius2: mi.Float) -> mi.Vector3f:
    """Area-preserving map of the unit disk to the spherical ellipse. It maps radii to radii.

    Guillén et al. 2017, section 4.1: the azimuth keeps the fraction of the quadrant's solid angle,
    and along the radius ``1 - cos θ`` is proportional to the squared radius. The inversion starts
    from the shifted κ map. It integrates a positive integrand, because the published difference of
    elliptic integrals cancels in single precision.

    Parameters
    ----------
    c, s
        Cosine and sine of the azimuth on the disk.
    radius2
        Squared radius on the disk, in [0, 1].

    Returns
    -------
    mi.Vector3f
        Direction in the frame of the cone.
    """
    seen = record.map
    angle = dr.atan2(dr.abs(s), dr.abs(c))
    target = angle * (2 / dr.pi) * record.quadrant
    start = solid_angle.warp(seen, dr.abs(c), dr.abs(s))
    t = dr.atan2(start.s, start.c)
    for _ in range(NEWTON_STEPS):
        ts, tc = dr.sincos(t)
        t -= (_cumulative(seen, t) - target) * solid_angle.rim(seen, tc, ts)
        t = dr.clip(t, 0, 0.5 * dr.pi)
    ts, tc = dr.sincos(t)
    density = solid_angle.rim(seen, tc, ts)
    return solid_angle.direction(seen, dr.mulsign(tc, c), dr.mulsign(ts, s), density, radius2)


@register(
    "concentric",
    colour="#56B4E9",
    mark="p",
    sentence="Uniform in solid angle by numerical inversion (Guillén et al. 2017), for comparison.",
)
class Concentric:
    """Directions uniform in solid angle: the concentric square-disk map, then the radial map.

    Guillén, Ureña, King, Fajardo, Georgiev, López-Moreno and Jarabo, *Area-Preserving
    Parameterizations for Spherical Ellipses* (EGSR 2017). On a sphere the radial map is Lambert's.
    """

    def prepare(self, view: View, normal: mi.Normal3f) -> Record | RoundCone:
        """Compute cone and solid angle of a reference point. Its normal is not used."""
        if isinstance(view.cone, RoundCone):
            return view.cone
        seen = solid_angle.SolidAngle().record(view.cone)
        return Record(
            map=seen,
            quadrant=_cumulative(seen, mi.Float(0.5 * dr.pi)),
            pdf=dr.rcp(cone.solid_angle(seen.cone)),
        )

    def sample(
        self, record: Record | RoundCone, u: mi.Point2f
    ) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's frame, its density, and validity."""
        p = mi.warp.square_to_uniform_disk_concentric(u)
        if isinstance(record, RoundCone):
            return cap.uniform(record, p), cap.uniform_density(record), mi.Mask(True)
        d = radial_map(record, p.x, p.y, dr.squared_norm(p))
        return record.map.cone.from_local(d), record.pdf, mi.Mask(True)

    def pdf(self, record: Record | RoundCone, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the light."""
        if isinstance(record, RoundCone):
            return cap.uniform_density(record)
        return record.pdf
