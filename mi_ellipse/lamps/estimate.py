"""Estimate of the light that a lamp gives to a point, for the choice among lamps."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..geometry.light import View
from ..geometry.tracing import TINY

# Weight of the light on the far side of the geometric normal. The emitter does not know which side
# of a surface is seen. A lamp that only lights the side that is not seen takes samples in vain; a
# lamp that lights the far side, which is seen, needs some. With 1/4, a surface seen from its far
# side has at most four times the variance of the choice that it would have from the near one.
FAR_SIDE = 0.25


def irradiance(view: View, normal: mi.Normal3f) -> mi.Float:
    """About the irradiance from a light of unit radiance, over π, on both sides of a surface.

    Exact for a light that the horizon does not divide: ``sin α sin β |n·z|``, with the half-angles
    α and β and the axis z of the cone (`geometry.cone.vector_irradiance`). Where the horizon
    divides the light, each side gets a quadratic in the distance of the horizon from the rim. In
    media, where the normal is zero, it is ``sin α sin β``.

    The far side of the normal counts with `FAR_SIDE`. Where the light does not shine, it is zero.
    """
    sines2, nz, reach2 = view.outlook(normal)
    height, reach = dr.abs(nz), dr.sqrt(dr.maximum(reach2, TINY))
    below = dr.maximum(reach - height, 0)
    divided = below * below / (4 * reach)
    one, up = mi.Float(1), nz > 0
    side, other = dr.select(up, one, FAR_SIDE), dr.select(up, FAR_SIDE, one)
    cosine = dr.fma(height + divided, side, divided * other)
    cosine = dr.select(dr.squared_norm(normal) > 0, cosine, one)
    gain = dr.sqrt(sines2) * cosine
    return dr.select(view.lit & dr.isfinite(gain), gain, 0)
