"""Strategy `area`: points uniform on the surface, the baseline of every renderer."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from ..ellipse import Ellipse


class Record(NamedTuple):
    """What is computed once per reference point."""

    centre: mi.Vector3f  # Along the light's frame, in units of the longer semi-axis
    ratio: mi.Float


def _density(record: Record, cos_theta: mi.Float) -> mi.Float:
    """Density per solid angle of a direction at this cosine to the light's normal: r² / (A cos)."""
    distance = record.centre.z / cos_theta
    return dr.square(distance) / (dr.pi * record.ratio * dr.abs(cos_theta))


class Area:
    """Points uniform on the surface, through the concentric map (Shirley and Chiu 1997).

    The variance of the irradiance has no bound near the light.
    """

    def prepare(self, ellipse: Ellipse, reference: mi.Point3f, normal: mi.Normal3f) -> Record:
        """Position of the light; the normal is not used."""
        centre = mi.Vector3f(ellipse.light_coordinates(reference))
        return Record(centre, ellipse.ratio32)

    def sample(self, record: Record, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's ``(ex, ey, normal)``, its density, and validity."""
        point = mi.warp.square_to_uniform_disk_concentric(u)
        offset = mi.Vector3f(point.x, record.ratio * point.y, 0)
        d = dr.normalize(record.centre + offset)
        return d, _density(record, d.z), mi.Mask(True)

    def pdf(self, record: Record, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the light."""
        return _density(record, direction.z)
