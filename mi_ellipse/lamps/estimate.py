"""Estimate of the light that a lamp gives to a point, for the choice among lamps."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..geometry.cone import coarse_root
from ..geometry.tracing import TINY, table, take
from .records import Shapes

# Weight of the light on the far side of the geometric normal. The emitter does not know which side
# of a surface is seen. A lamp that only lights the side that is not seen takes samples in vain; a
# lamp that lights the far side, which is seen, needs some. With 1/4, a surface seen from its far
# side has at most four times the variance of the choice that it would have from the near one.
FAR_SIDE = 0.25


@dataclass
class Outlines:
    """What the estimate needs of many lights, in single precision: ellipses and ellipsoids alike.

    An ellipse is an ellipsoid whose shortest semi-axis is zero. Draws and densities use the lights
    themselves. An estimate that is a little off costs a little variance and nothing else.
    """

    centre: mi.Point3f
    x: mi.Vector3f  # Directions of the semi-axes, the longest one first, over the length lx of
    y: mi.Vector3f  # the longest one
    z: mi.Vector3f
    lx: mi.Float
    y2: mi.Float  # Squared semi-axes over lx
    z2: mi.Float

    @classmethod
    def of(cls, shapes: Shapes) -> Outlines:
        """Take what is needed of the lights."""
        return cls(
            centre=table(mi.Point3f, shapes.centre.T),
            x=table(mi.Vector3f, shapes.ex.T / shapes.lx),
            y=table(mi.Vector3f, shapes.ey.T / shapes.lx),
            z=table(mi.Vector3f, shapes.normal.T / shapes.lx),
            lx=table(mi.Float, shapes.lx),
            y2=table(mi.Float, shapes.ratio**2),
            z2=table(mi.Float, shapes.flatness**2),
        )

    def irradiance(self, slot: mi.UInt32, point: mi.Point3f, normal: mi.Normal3f) -> mi.Float:
        """`irradiance` of the light in a slot."""
        x, y, z = (take(mi.Vector3f, axis, slot) for axis in (self.x, self.y, self.z))
        lx, y2, z2 = (take(mi.Float, numbers, slot) for numbers in (self.lx, self.y2, self.z2))
        offset = take(mi.Point3f, self.centre, slot) - point
        centre = mi.Vector3f(dr.dot(offset, x), dr.dot(offset, y), dr.dot(offset, z))
        n = mi.Vector3f(dr.dot(normal, x), dr.dot(normal, y), dr.dot(normal, z)) * lx
        return irradiance(centre, y2, z2, n)


def irradiance(centre: mi.Vector3f, y2: mi.Float, z2: mi.Float, normal: mi.Vector3f) -> mi.Float:
    """About the irradiance from a light of unit radiance, over π, on both sides of a surface.

    For a light that the horizon does not divide it is ``sin α sin β |n·z|``, with the half-angles α
    and β and the axis z of the cone (`geometry.cone.vector_irradiance`). Where the horizon divides
    the light, each side gets `_minor` more. In media, where the normal is zero, it is
    ``sin α sin β``.

    The far side of the normal counts with `FAR_SIDE`. Where the light does not shine, it is zero.

    Product and sum of the eigenvalues of the dual cone matrix give the sines, and its value for the
    normal gives the reach, all from the confocal root alone. In single precision the reach of small
    lights is lost in rounding, where it hardly matters.

    Parameters
    ----------
    centre
        Vector from the point to the centre of the light, along its axes, in units of the longest.
    y2, z2
        Squared middle and shortest semi-axis in these units; 0 for the shortest one of an ellipse.
    normal
        Normal of the surface along the same axes, or zero.
    """
    one = mi.Float(1)
    cx, cy, cz = centre
    xx, yy, zz = cx * cx, cy * cy, cz * cz
    root, determinant = coarse_root(xx, yy, zz, y2, z2)
    inv_root, inv_x = dr.rcp(root), dr.rcp(one + root)
    inv_y, inv_z = dr.rcp(y2 + root), dr.rcp(z2 + root)

    trace = dr.fma(yy * (one - y2), inv_y, dr.fma(zz * (one - z2), inv_z, y2 + z2))
    sines2 = determinant * dr.rcp(dr.fma(root * root, root + trace, determinant))
    axis = mi.Vector3f(cx * inv_x, cy * inv_y, cz * inv_z)
    nz = dr.dot(normal, axis) * dr.rsqrt(dr.maximum(dr.squared_norm(axis), TINY))
    along = dr.dot(normal, centre)
    dual = dr.fma(normal.x, normal.x, dr.fma(y2 * normal.y, normal.y, -along * along))
    dual = dr.fma(z2 * normal.z, normal.z, dual)
    reach2 = dr.fma(dual, inv_root, nz * nz)

    sines, height = dr.sqrt(dr.maximum(sines2, 0)), dr.abs(nz)
    divided = _minor(sines, height, reach2)
    up = nz > 0
    side, other = dr.select(up, one, FAR_SIDE), dr.select(up, FAR_SIDE, one)
    cosine = dr.fma(height + divided, side, divided * other)
    cosine = dr.select(dr.squared_norm(normal) > 0, cosine, one)
    gain = sines * cosine
    # An ellipse shines to one side, an ellipsoid outwards.
    lit = dr.select(z2 > 0, determinant > 0, cz < 0)
    return dr.select(lit & dr.isfinite(gain), gain, 0)


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
