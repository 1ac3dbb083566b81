"""Strategy `rejection`: directions uniform in the solid angle of the bounding rectangle."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from ..geometry.light import View
from .strategy import register


class Record(NamedTuple):
    """What is computed once per reference point, in units of the longer semi-axis.

    A slice of the rectangle runs along one axis, the *edge* axis. Its place is a coordinate along
    the other axis, the *slice* axis.
    """

    centre: mi.Vector3d
    ratio: mi.Float64
    edge_is_x: mi.Mask
    edge0: mi.Float64  # Range along the edge axis
    edge1: mi.Float64
    height: mi.Float64  # Distance to the plane
    angle0: mi.Float64  # `_angle` at the start of the slice axis
    solid_angle: mi.Float64  # Solid angle of the rectangle


def _cross_difference(t0, t1, r0, r1, rest2):
    """``t1 r0 - t0 r1`` for ``r² = t² + rest2`` and ``t0 < t1``, without cancellation."""
    total = t1 * r0 + t0 * r1
    same_side = t0 * t1 > 0
    return dr.select(
        same_side,
        rest2 * (t1 - t0) * (t1 + t0) / dr.select(same_side, total, 1),
        t1 * r0 - t0 * r1,
    )


def _angle(s, t0, t1, h):
    """Solid angle of the rectangle ``[0, s] × [t0, t1]`` at distance h."""
    rest2 = s * s + h * h
    r0, r1 = dr.sqrt(t0 * t0 + rest2), dr.sqrt(t1 * t1 + rest2)
    difference = _cross_difference(t0, t1, r0, r1, rest2)
    return dr.atan2(s * h * difference, h * h * r0 * r1 + s * s * t0 * t1)


@register(
    "rejection",
    colour="#CC79A7",
    mark="s",
    sentence="Uniform in the solid angle of the bounding rectangle; draws beside the ellipse are"
    " dark (Gamito 2016), for comparison.",
    planar=True,
)
class Rejection:
    """One try in the solid angle of the bounding rectangle; a draw beside the ellipse is dark.

    The strategy is that of Gamito, *Solid Angle Sampling of Disk and Cylinder Lights* (EGSR 2016),
    over the rectangle of Ureña, Fajardo and King, *An Area-Preserving Parametrization for Spherical
    Rectangles* (EGSR 2013). The rectangle encloses the ellipse along its principal axes. The
    density is one over the solid angle of the rectangle.

    The computation is in double precision. Its inversion stays exact for small and distant
    rectangles, where the published inversion cancels.
    """

    def prepare(self, view: View, normal: mi.Normal3f) -> Record:
        """Compute the rectangle seen from a reference point. Its normal is not used."""
        centre, ratio = view.position, view.light.ratio
        height = dr.abs(centre.z)

        # If one axis alone straddles the reference, it is the slice axis. If neither does, the edge
        # axis is the one that lies further away. With the other choice, the angles of the slices
        # differ by less than their own rounding.
        x_straddles, y_straddles = dr.abs(centre.x) < 1, dr.abs(centre.y) < ratio
        farther = dr.abs(centre.x) >= dr.abs(centre.y)
        edge_is_x = dr.select(x_straddles, y_straddles, y_straddles | farther)

        edge, edge_size = dr.select(edge_is_x, centre.x, centre.y), dr.select(edge_is_x, 1, ratio)
        start, size = dr.select(edge_is_x, centre.y, centre.x), dr.select(edge_is_x, ratio, 1)
        t0, t1 = edge - edge_size, edge + edge_size
        angle0 = _angle(start - size, t0, t1, height)
        return Record(
            centre=centre,
            ratio=ratio,
            edge_is_x=edge_is_x,
            edge0=t0,
            edge1=t1,
            height=height,
            angle0=angle0,
            solid_angle=_angle(start + size, t0, t1, height) - angle0,
        )

    def sample(self, record: Record, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's frame, its density, and validity."""
        t0, t1, h = record.edge0, record.edge1, record.height
        u0, u1 = mi.Float64(u.x), mi.Float64(u.y)

        # Draw a slice: invert `_angle`. With half = ½(atan(t1/h) ± atan(t0/h)), the tangent of the
        # inclination of the slice is sin g / (2 √(product of the four sines below)).
        g = record.angle0 + u0 * record.solid_angle
        gap = dr.atan2(h * (t1 - t0), h * h + t0 * t1)
        both = dr.atan2(h * (t1 + t0), t0 * t1 - h * h)  # π minus the sum of the two angles
        product = (
            dr.sin(0.5 * (gap + g))
            * dr.sin(0.5 * (gap - g))
            * dr.sin(0.5 * (both + g))
            * dr.sin(0.5 * (both - g))
        )
        s = h * dr.sin(g) * 0.5 * dr.rsqrt(dr.abs(product))

        # Draw along the slice: the sine of the latitude is uniform between those of the edges.
        d2 = s * s + h * h
        r0, r1 = dr.sqrt(t0 * t0 + d2), dr.sqrt(t1 * t1 + d2)
        span = _cross_difference(t0, t1, r0, r1, d2) / (r0 * r1)
        below = dr.select(t0 < 0, d2 / (r0 + dr.abs(t0)), r0 + t0) / r0 + u1 * span  # 1 + sine
        above = (
            dr.select(t1 > 0, d2 / (r1 + dr.abs(t1)), r1 - t1) / r1 + (1 - u1) * span
        )  # 1 - sine
        t = dr.sqrt(d2) * 0.5 * (below - above) * dr.rsqrt(below * above)

        x, y = dr.select(record.edge_is_x, t, s), dr.select(record.edge_is_x, s, t)
        a, b = x - record.centre.x, (y - record.centre.y) / record.ratio
        d = dr.normalize(mi.Vector3d(x, y, record.centre.z))
        return mi.Vector3f(d), mi.Float(dr.rcp(record.solid_angle)), a * a + b * b <= 1

    def pdf(self, record: Record, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the rectangle."""
        return mi.Float(dr.rcp(record.solid_angle))
