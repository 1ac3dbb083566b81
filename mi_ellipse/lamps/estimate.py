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
    divides the light, each side gets `_minor` more. In media, where the normal is zero, it is
    ``sin α sin β``.

    The far side of the normal counts with `FAR_SIDE`. Where the light does not shine, it is zero.
    """
    sines2, nz, reach2 = view.outlook(normal)
    sines, height = dr.sqrt(sines2), dr.abs(nz)
    divided = _minor(sines, height, reach2)
    one, up = mi.Float(1), nz > 0
    side, other = dr.select(up, one, FAR_SIDE), dr.select(up, FAR_SIDE, one)
    cosine = dr.fma(height + divided, side, divided * other)
    cosine = dr.select(dr.squared_norm(normal) > 0, cosine, one)
    gain = sines * cosine
    return dr.select(view.lit & dr.isfinite(gain), gain, 0)


def _minor(sines: mi.Float, height: mi.Float, reach2: mi.Float) -> mi.Float:
    """Irradiance from the smaller side of a light that the horizon divides, over π sin α sin β.

    With s and c the sine and cosine of the angle from axis to rim along the normal, it is
    ``(s - h)² / (s A + h B)`` for an axis at the height h, and zero for ``h ≥ s``. Its limits for
    ``h = 0`` are exact: ``A = 3π/2`` for small lights (4.71; here 4.71), 2 for circles that fill
    the hemisphere and π for needles that do (here 3.14).

    Error of both sides together, where the horizon divides the light, root mean square: 1 % for
    small lights, 5 % for half-angles up to 70°, 11 % up to 89°, 2 % beyond, and 24 % for needles
    that are tilted against the horizon.
    """
    one = mi.Float(1)
    across2 = dr.maximum(dr.fma(-height, height, one), 0)
    inv = dr.rsqrt(dr.maximum(reach2 + across2, TINY))
    s, c = dr.sqrt(dr.maximum(reach2, 0)) * inv, dr.sqrt(across2) * inv
    needle = dr.fma(-1.14, c, 1.14)
    slope = dr.fma(s, dr.fma(2.71, c, 2) + needle, -needle * dr.minimum(sines, s))
    below = dr.maximum(s - height, 0)
    return dr.square(below) / dr.maximum(dr.fma(height, dr.fma(5, c, -2), slope), TINY)
