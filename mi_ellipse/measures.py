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

from . import cone, ellipse

NODES, WEIGHTS = np.polynomial.legendre.leggauss(32)


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
    light = ellipse.from_transform(to_world)
    return _or_zero(cone.solid_angle(cone.from_point(light, mi.Point3f(point))))


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
    light = ellipse.from_transform(to_world)
    seen = cone.from_point(light, mi.Point3f(point))
    frame = (light.to_world(axis) for axis in (seen.x, seen.y, seen.z))
    return TangentEllipse(*frame, seen.ta, seen.tb)


@_accepts_numpy
def vector_irradiance(to_world, point):
    """Integral of the direction over the solid angle of a light of unit radiance.

    ``π sin α sin β z``, with the half-angles α and β and the axis z of the cone: Heitz and Hill,
    *Real-Time Line- and Disk-Light Shading with Linearly Transformed Cosines* (SIGGRAPH course,
    2017). Its product with a normal is the irradiance, if the light is above the horizon.

    Parameters
    ----------
    to_world
        Transform of the light, or its matrix.
    point
        World-space points.
    """
    seen = tangent_ellipse(to_world, point)
    sines = seen.ta * seen.tb / dr.sqrt((1 + dr.square(seen.ta)) * (1 + dr.square(seen.tb)))
    return _or_zero(seen.z * (dr.pi * sines))


@_accepts_numpy
def irradiance(to_world, point, normal):
    """Irradiance at points from a light of unit radiance, clipped at the horizon.

    The product of `vector_irradiance` with the normal; where the horizon divides the light, the
    part below it is added again. That part is a smooth integral over the azimuth about the cone's
    axis, in closed form along the radius.

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
    seen = tangent_ellipse(to_world, point)
    ta, tb = mi.Float64(seen.ta), mi.Float64(seen.tb)
    n = mi.Vector3d(*(mi.Float64(dr.dot(mi.Vector3f(normal), axis)) for axis in seen[:3]))
    sign = dr.mulsign(mi.Float64(1), n.z)
    n *= sign
    sines = ta * tb / dr.sqrt((1 + ta * ta) * (1 + tb * tb))
    whole = dr.pi * sines * n.z

    # The horizon is the line n.x X + n.y Y + n.z = 0 of the tangent plane. It cuts the ellipse at
    # the eccentric angles `middle` ± `half`, between which the ellipse is below.
    reach = dr.sqrt(dr.square(n.x * ta) + dr.square(n.y * tb))
    below = reach > n.z
    half = dr.acos(dr.select(below, n.z / reach, 1))
    middle = dr.atan2(-n.y * tb, -n.x * ta)

    # Azimuths as the eccentric angles of sin(θ/2), which do not crowd where the light is large
    a1, b1 = (t / dr.sqrt(2 * (q + dr.sqrt(q))) for t, q in ((ta, 1 + ta * ta), (tb, 1 + tb * tb)))

    def half_angle(t):
        s, c = dr.sincos(t)
        return dr.atan2(a1 * tb * s, b1 * ta * c)

    centre = half_angle(middle)
    start = _within_half_turn(half_angle(middle - half) - centre)
    end = _within_half_turn(half_angle(middle + half) - centre)
    missing = mi.Float64(0)
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        s, c = dr.sincos(centre + start + (end - start) * float(0.5 + 0.5 * node))
        x, y = a1 * c, b1 * s
        rho2 = x * x + y * y
        towards = (n.x * x + n.y * y) / dr.sqrt(rho2)
        # Angles from the axis to the horizon and to the rim
        horizon = dr.atan2(n.z, -towards)
        rim = dr.atan(dr.sqrt((x * x + y * y) / (dr.square(x / ta) + dr.square(y / tb))))
        band = _radial(n.z, towards, rim) - _radial(n.z, towards, horizon)
        missing -= float(weight) * 0.5 * (end - start) * a1 * b1 / rho2 * band
    missing = dr.select(below, dr.maximum(missing, 0), 0)
    return _or_zero(mi.Float(dr.select(sign > 0, whole + missing, missing)))


def _within_half_turn(angle):
    return dr.select(
        angle > dr.pi, angle - 2 * dr.pi, dr.select(angle < -dr.pi, angle + 2 * dr.pi, angle)
    )


def _radial(upwards, sideways, theta):
    """Integral of ``(upwards cos θ + sideways sin θ) sin θ`` from 0 to θ."""
    s, c = dr.sincos(theta)
    return 0.5 * (upwards * s * s + sideways * (theta - s * c))


def tessellate(to_world, segments: int = 64, props: mi.Properties | None = None) -> mi.Mesh:
    """Triangle mesh of an ellipse, for previews and for comparing with mesh lights.

    A fan of triangles around the centre with the area of the ellipse: its corners lie outside the
    ellipse by ``(2π / segments)² / 12`` of the radius and the middles of its edges inside by half
    as much (0.08 % and 0.04 % with 64 segments).

    Parameters
    ----------
    to_world
        Transform of the ellipse, or its matrix.
    segments
        Number of triangles, at least 3.
    props
        Properties of the mesh, such as a BSDF or an emitter.

    Returns
    -------
    mi.Mesh
        With normals, and the texture coordinates of `disk`: radius and angle over 2π.
    """
    if segments < 3:
        raise ValueError(f"tessellate: segments={segments} must be at least 3")
    matrix = np.array(getattr(to_world, "matrix", to_world), dtype=float).reshape(4, 4)

    step = 2 * np.pi / segments
    radius = np.sqrt(step / np.sin(step))
    turns = np.arange(segments + 1) / segments
    rim = radius * np.stack([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)])
    # A centre of its own for every triangle, for the angle there is that of the triangle's middle
    local = np.concatenate([np.zeros((2, segments)), rim], axis=1)
    points = matrix[:3, :2] @ local + matrix[:3, 3:]
    uv = np.stack(
        [np.repeat([0, 1], [segments, segments + 1]), [*(turns[:-1] + 0.5 / segments), *turns]]
    )
    normal = np.linalg.inv(matrix[:3, :3]).T[:, 2]
    normals = np.repeat(normal[:, None] / np.linalg.norm(normal), points.shape[1], axis=1)
    first = np.arange(segments)
    faces = np.stack([first, first + segments, first + segments + 1])
    if np.linalg.det(matrix[:3, :3]) < 0:
        faces = faces[[0, 2, 1]]

    mesh = mi.Mesh(
        "ellipse",
        vertex_count=points.shape[1],
        face_count=segments,
        props=props or mi.Properties(),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
    )
    params = mi.traverse(mesh)
    for name, values in (
        ("vertex_positions", points),
        ("vertex_normals", normals),
        ("vertex_texcoords", uv),
    ):
        params[name] = values.T.ravel().astype(np.float32)
    params["faces"] = faces.T.ravel().astype(np.uint32)
    params.update()
    return mesh
