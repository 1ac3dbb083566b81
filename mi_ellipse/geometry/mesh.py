"""Triangle meshes of elliptical lights and ellipsoids."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import mitsuba as mi
import numpy as np


class UnitSphere(NamedTuple):
    """A geodesic sphere: an icosahedron with its triangles divided into four, and again.

    Its vertices are on the unit sphere. Those on the seam and at the poles of the parameterisation
    are there more than once.
    """

    points: np.ndarray  # (count, 3)
    uv: np.ndarray  # (count, 2): longitude over 2π and colatitude over π, as Mitsuba's `sphere`
    faces: np.ndarray  # (triangles, 3), counter-clockwise from outside


def tessellate_ellipse(to_world, segments: int = 64, props: mi.Properties | None = None) -> mi.Mesh:
    """Triangle mesh of an ellipse, for previews and for comparing with mesh lights.

    The mesh is a fan of triangles around the centre. It has the area of the ellipse. So its corners
    lie outside the ellipse, by ``(2π / segments)² / 12`` of the radius. The middles of its edges
    lie inside, by half as much. With 64 segments these are 0.08 % and 0.04 %.

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
        The mesh has normals and the texture coordinates of `disk`: radius, and angle over 2π.
    """
    if segments < 3:
        raise ValueError(f"tessellate: segments={segments} must be at least 3")
    matrix = np.array(getattr(to_world, "matrix", to_world), dtype=float).reshape(4, 4)
    points, normals, uv, faces = _fan(matrix, segments)

    return _mesh("ellipse", points.T, normals.T, uv.T, faces.T, props)


def tessellate_ellipsoid(
    to_world, segments: int = 64, props: mi.Properties | None = None, scale: float = 1
) -> mi.Mesh:
    """Triangle mesh of an ellipsoid.

    The image of a geodesic sphere. Its corners are on the ellipsoid. Its triangles are inside by at
    most ``7.3 / segments²`` of its radius in any direction (0.12 % with 80 segments, 0.03 % with
    160), and its area, and its mean solid angle from afar, are smaller by ``7.7 / segments²``.

    Parameters
    ----------
    to_world
        Transform of the ellipsoid, or its matrix: the unit ball is mapped to it.
    segments
        Edges of a great circle, at least 5; the next of 5, 10, 20, 40, 80… is taken. 80 segments
        are 5 120 triangles, 160 are 20 480.
    props
        Properties of the mesh, such as a BSDF or an emitter.
    scale
        Size of the mesh over that of the ellipsoid.

    Returns
    -------
    mi.Mesh
        With the normals of the ellipsoid, and the texture coordinates of Mitsuba's `sphere`.
    """
    if segments < 5:
        raise ValueError(f"tessellate: segments={segments} must be at least 5 for an ellipsoid")
    matrix = np.array(getattr(to_world, "matrix", to_world), dtype=float).reshape(4, 4)
    linear, centre = matrix[:3, :3], matrix[:3, 3]
    sphere = unit_sphere(subdivisions(segments))
    normals = sphere.points @ np.linalg.inv(linear)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = sphere.faces if np.linalg.det(linear) > 0 else sphere.faces[:, [0, 2, 1]]
    points = scale * sphere.points @ linear.T + centre
    return _mesh("ellipsoid", points, normals, sphere.uv, faces, props)


def subdivisions(segments: int) -> int:
    """How often an icosahedron is divided until a great circle has this many edges."""
    return max(math.ceil(math.log2(segments / 5)), 0)


@cache
def unit_sphere(times: int) -> UnitSphere:
    """Geodesic sphere from an icosahedron that is divided so many times."""
    points, faces = _icosahedron()
    for _ in range(times):
        points, faces = _divide(points, faces)
    return UnitSphere(*_unfold(points, faces))


def unit_sphere_of(vertex_count: int) -> UnitSphere | None:
    """Return the geodesic sphere with this number of vertices, if there is one."""
    times = 0
    while vertices(times) < vertex_count:
        times += 1
    return unit_sphere(times) if vertices(times) == vertex_count else None


def vertices(times: int) -> int:
    """Number of vertices of `unit_sphere`: its points, and copies at the seam and the poles."""
    return 10 * 4**times + 2 + (3 * 2**times + 8)


def _icosahedron() -> tuple[np.ndarray, np.ndarray]:
    """Vertices with one at either pole, and triangles."""
    height, radius = 1 / np.sqrt(5), 2 / np.sqrt(5)
    turn = 2 * np.pi * np.arange(5) / 5
    upper = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(5, height)], 1)
    points = np.concatenate([[[0, 0, 1]], upper, -upper, [[0, 0, -1]]])
    # A vertex below is opposite to one above, so that it is between the third and the fourth on.
    k = np.arange(5)
    above, next_above = 1 + k, 1 + (k + 1) % 5
    below, next_below = 6 + (k + 3) % 5, 6 + (k + 4) % 5
    top, bottom = np.full(5, 0), np.full(5, 11)
    faces = [
        (top, above, next_above),
        (above, below, next_above),
        (next_above, below, next_below),
        (bottom, next_below, below),
    ]
    return points, np.concatenate([np.stack(face, 1) for face in faces])


def _divide(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Divide each triangle into four; the new vertices are pushed out to the unit sphere."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends, index = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    middles = points[ends].sum(1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    ab, bc, ca = (len(points) + index).reshape(3, -1)
    a, b, c = faces.T
    quarters = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
    faces = np.concatenate([np.stack(quarter, 1) for quarter in quarters])
    return np.concatenate([points, middles]), faces


def _unfold(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, uv and triangles, with as many copies of a point as it has longitudes."""
    u = (np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) % 1)[faces]
    # Across the seam the longitude goes on beyond 1.
    u += (u < 0.5) & (u.max(1) - u.min(1) > 0.5)[:, None]
    pole = np.hypot(points[:, 0], points[:, 1])[faces] < 1e-9
    others = np.where(pole, 0, u).sum(1, keepdims=True) / 2
    u = np.where(pole, others, u)
    corners = np.stack([faces.ravel(), np.round(u.ravel(), 12)], 1)
    copies, faces = np.unique(corners, axis=0, return_inverse=True)
    points = points[copies[:, 0].astype(int)]
    colatitude = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2]) / np.pi
    return points, np.stack([copies[:, 1], colatitude], 1), faces.reshape(-1, 3)


def _mesh(
    name: str,
    points: np.ndarray,
    normals: np.ndarray,
    uv: np.ndarray,
    faces: np.ndarray,
    props: mi.Properties | None,
) -> mi.Mesh:
    """Mesh from arrays with a row for each vertex or triangle."""
    mesh = mi.Mesh(
        name,
        vertex_count=len(points),
        face_count=len(faces),
        props=props or mi.Properties(),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
    )
    params = mi.traverse(mesh)
    for key, values in (
        ("vertex_positions", points),
        ("vertex_normals", normals),
        ("vertex_texcoords", uv),
    ):
        params[key] = values.ravel().astype(np.float32)
    params["faces"] = faces.ravel().astype(np.uint32)
    params.update()
    return mesh


def _fan(
    matrix: np.ndarray, segments: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, normals and uv of the vertices, and indices of the triangles, one a column."""
    step = 2 * np.pi / segments
    radius = np.sqrt(step / np.sin(step))
    turns = np.arange(segments + 1) / segments
    rim = radius * np.stack([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)])
    # Every triangle has a centre of its own, because uv there has the angle of its middle.
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
    return points, normals, uv, faces
