"""Solid angle, tangent ellipse and irradiance of an elliptical light: the numbers, not a picture.

Every function takes the transform of a light (the image of the unit disk under it, see
`ellipse.from_transform`) and points, and counts the light from both of its sides. Transform and
points are Mitsuba types of the current variant, or NumPy arrays of the shapes (4, 4) and (…, 3);
NumPy in gives NumPy out.
"""

from __future__ import annotations

from functools import wraps
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from .geometry import cone, ellipse
from .geometry.irradiance import clipped
from .geometry.mesh import tessellate

__all__ = [
    "TangentEllipse",
    "irradiance",
    "solid_angle",
    "tangent_ellipse",
    "tessellate",
    "vector_irradiance",
]


class TangentEllipse(NamedTuple):
    """The ellipse in the tangent plane of the unit sphere to which a light projects."""

    x: mi.Vector3f  # World-space direction of the major axis
    y: mi.Vector3f  # World-space direction of the minor axis
    z: mi.Vector3f  # World-space axis of the cone: the point where the plane touches the sphere
    ta: mi.Float  # Semi-axes: the tangents of the larger and the smaller half-angle
    tb: mi.Float


def _accepts_numpy(function):
    """Let a function of Mitsuba types take NumPy points, and normals, of any leading shape."""

    @wraps(function)
    def wrapped(to_world, *vectors):
        if isinstance(to_world, np.ndarray):
            to_world = mi.ScalarAffineTransform4d(np.asarray(to_world, dtype=float))
        if not any(isinstance(v, np.ndarray) for v in vectors):
            return function(to_world, *map(mi.Vector3f, vectors))

        vectors = np.broadcast_arrays(*vectors)
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


def _to_numpy(result, shape: tuple[int, ...]):
    if isinstance(result, TangentEllipse):
        return TangentEllipse(*(_to_numpy(field, shape) for field in result))
    array = np.array(result)
    return array.T.reshape(*shape, 3) if array.ndim == 2 else array.reshape(shape)


def _stack(values, shape: tuple[int, ...]) -> np.ndarray:
    array = np.array([np.array(value) for value in values])
    return array.reshape(*shape, *array.shape[1:])


def _or_zero(value):
    """Nothing beyond some 1e18 sizes, where the cone leaves the range of single precision."""
    return dr.select(dr.isfinite(value), value, 0)


@_accepts_numpy
def solid_angle(to_world, point):
    """Solid angle of a light seen from points.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix.
    point
        World-space points.

    Returns
    -------
    mi.Float or numpy.ndarray
        Steradians, with a relative error of 1e-6 or ten times that of rounding the input to single
        precision, whichever is larger. Between 0 and 2π; 0 where it is below 1e-38.
    """
    return _or_zero(cone.solid_angle(_view(to_world, point).cone))


@_accepts_numpy
def tangent_ellipse(to_world, point) -> TangentEllipse:
    """Frame and tangent semi-axes of the cone of directions from points to a light.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix.
    point
        World-space points. Beyond some 1e18 sizes of the light the result is not finite.
    """
    view = _view(to_world, point)
    seen = view.cone
    frame = (view.light.to_world(axis) for axis in (seen.x, seen.y, seen.z))
    return TangentEllipse(*frame, seen.ta, seen.tb)


@_accepts_numpy
def vector_irradiance(to_world, point):
    """Integral of the direction over the solid angle of a light of unit radiance.

    See `geometry.cone.vector_irradiance`. Its product with a normal is the irradiance, if the light
    is above the horizon.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix.
    point
        World-space points.
    """
    view = _view(to_world, point)
    return _or_zero(view.light.to_world(cone.vector_irradiance(view.cone)))


@_accepts_numpy
def irradiance(to_world, point, normal):
    """Irradiance at points from a light of unit radiance, clipped at the horizon.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix.
    point
        World-space points.
    normal
        World-space unit normals.

    Returns
    -------
    mi.Float or numpy.ndarray
        Irradiance over radiance, in [0, π], exact to some 1e-6 of what it would be without the
        horizon.
    """
    view = _view(to_world, point)
    seen = view.cone
    frame = [view.light.to_world(axis) for axis in (seen.x, seen.y, seen.z)]
    local = mi.Vector3f(*(dr.dot(mi.Vector3f(normal), axis) for axis in frame))
    return _or_zero(clipped(seen.ta, seen.tb, local))


def _view(to_world, point) -> ellipse.View:
    return ellipse.from_transform(to_world).seen_from(mi.Point3f(point))
