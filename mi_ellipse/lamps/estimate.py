"""Estimate of the light that a lamp gives to a point, for the choice among lamps."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..geometry.ellipse import View
from ..geometry.tracing import TINY

# Weight of the light that arrives on the far side of the geometric normal.
FAR_SIDE = 0.25


def irradiance(view: View, normal: mi.Normal3f) -> mi.Float:
    """About the irradiance from a light of unit radiance, over π, on either side of a surface.

    Exact for a light that the horizon does not divide: ``sin α sin β |n·z|``, with the half-angles
    α and β and the axis z of the cone. Where the horizon divides it, a quadratic in the distance
    of the horizon from the axis. In media, where the normal is zero, ``sin α sin β``.

    The far side of the geometric normal counts with `FAR_SIDE`. Points behind the light get zero.
    """
    light, root = view.light, view.root
    x, y, z = view.centre
    one = mi.Float(1)
    e2 = dr.square(light.ratio32)
    inv_root, inv_y = dr.rcp(root), dr.rcp(e2 + root)

    # sin² α sin² β from the eigenvalues' product and sum
    det2 = z * z * e2
    trace = dr.fma(z * z, inv_root, dr.fma(y * y * light.eccentricity2, inv_y, e2))
    sines2 = det2 / dr.fma(root * root, root + trace, det2)

    n = light.to_light_single(normal)
    axis = mi.Vector3f(x * root * dr.rcp(one + root), y * root * inv_y, z)
    nz = dr.dot(n, axis) * dr.rsqrt(dr.squared_norm(axis))
    # The horizon meets the cone where |nz| is below the reach of the cone along the normal.
    along = dr.dot(n, view.centre)
    reach2 = dr.fma(dr.fma(n.x, n.x, e2 * n.y * n.y) - along * along, inv_root, nz * nz)
    reach = dr.sqrt(dr.maximum(reach2, TINY))
    height = dr.abs(nz)
    below = dr.maximum(reach - height, 0)
    both = below * below / (4 * reach)
    near, far = dr.select(nz > 0, one, FAR_SIDE), dr.select(nz > 0, FAR_SIDE, one)
    cosine = dr.fma(height + both, near, both * far)
    cosine = dr.select(dr.squared_norm(normal) > 0, cosine, one)
    return dr.select(view.lit, dr.sqrt(sines2) * cosine, 0)
