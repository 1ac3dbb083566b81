"""Directions to a sphere, which is seen as a spherical cap: uniform, or following a cosine."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..geometry.cone import RoundCone
from ..geometry.tracing import TINY


def uniform(cone: RoundCone, p: mi.Point2f) -> mi.Vector3f:
    """Area-preserving map of the unit disk to the cap: J. H. Lambert's, along radii.

    Returns
    -------
    mi.Vector3f
        Unit vector in the light's frame.
    """
    height, r2 = cone.height, dr.squared_norm(p)
    scale = dr.sqrt(height * dr.fma(-height, r2, 2))
    return cone.from_local(mi.Vector3f(p.x * scale, p.y * scale, dr.fma(-height, r2, 1)))


def uniform_density(cone: RoundCone) -> mi.Float:
    """Density per solid angle of `uniform`, over the whole cap."""
    return dr.inv_two_pi / cone.height


def projected(cone: RoundCone, normal: mi.Vector3f, p: mi.Point2f) -> mi.Vector3f:
    """Direction in proportion to the cosine at a surface, for a cap on one side of its horizon.

    The projection of such a cap onto the surface is an ellipse (C. Ureña and I. Georgiev,
    *Stratified Sampling of Projected Spherical Caps*, EGSR 2018). The flat disk in the rim of the
    cap has the same projection. So a uniform point of that disk is moved along the normal to the
    unit sphere.

    Parameters
    ----------
    normal
        Unit normal of the surface, on either side, in the light's frame.
    p
        Uniform point of the unit disk.

    Returns
    -------
    mi.Vector3f
        Unit vector in the light's frame.
    """
    sine = dr.sqrt(cone.sine2)
    flat = cone.from_local(mi.Vector3f(p.x * sine, p.y * sine, dr.sqrt(cone.cosine2)))
    cosine = dr.dot(flat, normal)
    # Squared distance of the point from the unit sphere, along both ways of a chord: no cancelling
    power = cone.sine2 * dr.maximum(dr.fma(-p.x, p.x, dr.fma(-p.y, p.y, 1)), 0)
    way = dr.abs(cosine) + dr.sqrt(dr.fma(cosine, cosine, power))
    return dr.fma(normal, dr.mulsign(power / dr.maximum(way, TINY), cosine), flat)


def projected_density(cone: RoundCone, normal: mi.Vector3f, direction: mi.Vector3f) -> mi.Float:
    """Density per solid angle of `projected` at a direction in the light's frame."""
    area = dr.pi * cone.sine2 * dr.abs(dr.dot(cone.z, normal))
    return dr.abs(dr.dot(direction, normal)) / dr.maximum(area, TINY)


def least_cosine(cone: RoundCone, normal: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
    """Least cosine at a surface over the cap, negative where the horizon divides it, and the mean.

    In media, where the normal is zero, both are zero.
    """
    nz, cosine = dr.abs(dr.dot(cone.z, normal)), dr.sqrt(cone.cosine2)
    across2 = dr.maximum(dr.fma(-nz, nz, dr.squared_norm(normal)), 0)
    least = dr.fma(nz, cosine, -dr.sqrt(across2 * cone.sine2))
    return least, 0.5 * nz * (mi.Float(1) + cosine)
