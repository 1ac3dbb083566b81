"""Solid angle, tangent ellipse and irradiance of a light: the numbers, not a picture.

Every function takes a light, and points. A transform alone stands for an ellipse: the image of the
unit disk under the transform (see `ellipse.from_transform`). It counts from both of its sides. An
`Ellipsoid` is the image of the unit ball. It counts from outside.

Transform and points are Mitsuba types of the current variant, or NumPy arrays of the shapes (4, 4)
and (…, 3). The result for NumPy arrays is a NumPy array.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import wraps
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from .geometry import cone, ellipse, ellipsoid
from .geometry.irradiance import clipped
from .geometry.light import View
from .geometry.mesh import tessellate_ellipse, tessellate_ellipsoid

__all__ = [
    "Ellipsoid",
    "TangentEllipse",
    "irradiance",
    "solid_angle",
    "tangent_ellipse",
    "tessellate",
    "vector_irradiance",
]


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid, as the functions of this module take it instead of a transform.

    ``mi_ellipse.solid_angle(mi_ellipse.Ellipsoid(to_world), point)``

    Parameters
    ----------
    to_world
        Transform of the ellipsoid, or its matrix: the image of the unit ball. Semi-axes are scales.
    """

    to_world: Any


class TangentEllipse(NamedTuple):
    """Projection of a light onto a tangent plane of the unit sphere: an ellipse."""

    x: mi.Vector3f  # World-space direction of the major axis
    y: mi.Vector3f  # World-space direction of the minor axis
    z: mi.Vector3f  # World-space axis of the cone; the plane touches the sphere at this point
    ta: mi.Float  # Semi-axes: the tangents of the larger and the smaller half-angle
    tb: mi.Float


def _accepts_numpy(function):
    """Let a function of Mitsuba types take NumPy points and normals of any leading shape."""

    @wraps(function)
    def wrapped(to_world, *vectors):
        to_world = _from_numpy(to_world)
        if not any(isinstance(v, np.ndarray) for v in vectors):
            return function(to_world, *map(mi.Vector3f, vectors))

        vectors = np.broadcast_arrays(*vectors)
        if vectors[0].shape[-1:] != (3,):
            raise ValueError(
                f"{function.__name__}: points and normals are arrays of shape (…, 3), and these"
                f" have the shape {vectors[0].shape}"
            )
        shape = vectors[0].shape[:-1]
        rows = [np.asarray(v, dtype=np.float32).reshape(-1, 3) for v in vectors]
        if dr.is_jit_v(mi.Float):
            result = function(to_world, *(mi.Vector3f(np.ascontiguousarray(r.T)) for r in rows))
            return _to_numpy(result, shape)
        results = [function(to_world, *map(mi.Vector3f, row)) for row in zip(*rows, strict=True)]
        if isinstance(results[0], TangentEllipse):
            columns = zip(*results, strict=True)
            return TangentEllipse(*(_stack(column, shape) for column in columns))
        return _stack(results, shape)

    return wrapped


def _from_numpy(to_world):
    if isinstance(to_world, Ellipsoid):
        return Ellipsoid(_from_numpy(to_world.to_world))
    if isinstance(to_world, np.ndarray):
        if to_world.shape != (4, 4):
            raise ValueError(f"to_world: a matrix has the shape (4, 4), not {to_world.shape}")
        return mi.ScalarAffineTransform4d(np.asarray(to_world, dtype=float))
    return to_world


def _to_numpy(result, shape: tuple[int, ...]):
    if isinstance(result, TangentEllipse):
        return TangentEllipse(*(_to_numpy(field, shape) for field in result))
    array = np.array(result)
    return array.T.reshape((*shape, 3)) if array.ndim == 2 else array.reshape(shape)


def _stack(values, shape: tuple[int, ...]) -> np.ndarray:
    array = np.array([np.array(value) for value in values])
    return array.reshape((*shape, *array.shape[1:]))


def _or_zero(view: View, value):
    """Nothing inside a solid, nor beyond some 1e18 sizes, where single precision has no cone."""
    return dr.select(view.outside & dr.isfinite(value), value, 0)


@_accepts_numpy
def solid_angle(to_world, point):
    """Solid angle of a light seen from points.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix; or an `Ellipsoid`.
    point
        World-space points.

    Returns
    -------
    mi.Float or numpy.ndarray
        Steradians, between 0 and 2π; 0 where the solid angle is below 1e-38. The relative error is
        1e-6, or ten times the error of rounding the input to single precision if that is larger.

    Raises
    ------
    ValueError
        If a NumPy array has another shape.

    Notes
    -----
    The cone of the light is that of E. Heitz, *Analytical Calculation of the Solid Angle Subtended
    by an Arbitrarily Positioned Ellipsoid to a Point Source* (2017). Its solid angle is Carlson's
    ``(4/3) ta tb R_J(0, 1 + ta², 1 + tb², 1)``, computed in the form of R. Bulirsch (*Numerical
    Calculation of Elliptic Integrals and Elliptic Functions III*, 1969).
    """
    view = _view(to_world, point)
    return _or_zero(view, cone.solid_angle(view.cone))


@_accepts_numpy
def tangent_ellipse(to_world, point) -> TangentEllipse:
    """Frame and tangent semi-axes of the cone of directions from points to a light.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix; or an `Ellipsoid`.
    point
        World-space points. Inside an ellipsoid, and beyond some 1e18 sizes of a light, the result
        says nothing, or is not finite.

    Returns
    -------
    TangentEllipse
        Fields of Mitsuba's types, or arrays of the shapes (…, 3) for axes and (…) for tangents. The
        directions with ``(X/ta)² + (Y/tb)² ≤ 1`` meet the light, for ``X = d·x / d·z``,
        ``Y = d·y / d·z`` and ``d·z > 0``.

    Raises
    ------
    ValueError
        If a NumPy array has another shape.

    Notes
    -----
    Principal axes of the cone after E. Heitz (2017), see `solid_angle`.
    """
    view = _view(to_world, point)
    seen = view.cone
    frame = (view.light.to_world(axis) for axis in (seen.x, seen.y, seen.z))
    return TangentEllipse(*frame, seen.ta, seen.tb)


@_accepts_numpy
def vector_irradiance(to_world, point):
    """Integral of the direction over the solid angle of a light of unit radiance.

    Its dot product with a normal is the irradiance, if the light is above the horizon.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix; or an `Ellipsoid`.
    point
        World-space points.

    Returns
    -------
    mi.Vector3f or numpy.ndarray
        World-space vectors, of the shape (…, 3), of lengths from 0 to π: irradiance over radiance.

    Raises
    ------
    ValueError
        If a NumPy array has another shape.

    Notes
    -----
    It is ``π sin α sin β z`` with the half-angles α and β and the axis z of the cone: E. Heitz and
    S. Hill, *Real-Time Line- and Disk-Light Shading with Linearly Transformed Cosines* (SIGGRAPH
    course, 2017).
    """
    view = _view(to_world, point)
    return _or_zero(view, view.light.to_world(cone.vector_irradiance(view.cone)))


@_accepts_numpy
def irradiance(to_world, point, normal):
    """Irradiance at points from a light of unit radiance, clipped at the horizon.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix; or an `Ellipsoid`.
    point
        World-space points.
    normal
        World-space unit normals.

    Returns
    -------
    mi.Float or numpy.ndarray
        Irradiance over radiance, in [0, π]: lx for a light of 1 cd/m², W/m² for one of
        1 W/(m² sr). The error is some 1e-6 of the irradiance without the horizon.

    Raises
    ------
    ValueError
        If a NumPy array has another shape.

    Notes
    -----
    The closed form of E. Heitz and S. Hill (2017), see `vector_irradiance`. Where the horizon
    divides the light, what it counts as negative is added again: an integral over the azimuth, by
    a Gauss-Legendre rule of 32 nodes.
    """
    view = _view(to_world, point)
    seen = view.cone
    frame = [view.light.to_world(axis) for axis in (seen.x, seen.y, seen.z)]
    local = mi.Vector3f(*(dr.dot(mi.Vector3f(normal), axis) for axis in frame))
    # Scalar variants fail at a division by zero, and a solid has no cone from inside.
    ta, tb = (dr.select(view.outside, tangent, 1) for tangent in (seen.ta, seen.tb))
    local = dr.select(view.outside, local, mi.Vector3f(0, 0, 1))
    return _or_zero(view, clipped(ta, tb, local))


def tessellate(to_world, segments: int = 64, props: mi.Properties | None = None) -> mi.Mesh:
    """Triangle mesh of a light, for previews and for comparing with mesh lights.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix; or an `Ellipsoid`.
    segments
        Number of triangles of an ellipse, at least 3; number of edges around an ellipsoid, at least
        5. The errors of both are those of `geometry.mesh`.
    props
        Properties of the mesh, such as a BSDF or an emitter.

    Returns
    -------
    mi.Mesh
        With normals, and the texture coordinates of Mitsuba's `disk` or `sphere`.

    Raises
    ------
    ValueError
        If `segments` is too small.

    Notes
    -----
    A fan for an ellipse, which has its area; a geodesic sphere for an ellipsoid.
    """
    if isinstance(to_world, Ellipsoid):
        return tessellate_ellipsoid(to_world.to_world, segments, props)
    return tessellate_ellipse(to_world, segments, props)


def _view(to_world, point) -> View:
    solid = isinstance(to_world, Ellipsoid)
    light = (ellipsoid if solid else ellipse).from_transform(
        to_world.to_world if solid else to_world
    )
    return light.seen_from(mi.Point3f(point))
