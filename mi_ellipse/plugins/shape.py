"""Plugins `ellipse`, which is Mitsuba's `disk` under an affine map, and `ellipsoid`."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry import mesh
from ..geometry.sphere import is_sphere
from ..geometry.tracing import cross
from .attachment import MESH_ERROR, attach
from .names import DISK, ELLIPSE, ELLIPSOID, SPHERE

# Volume of the image of the unit cube over the product of its edges: below, double precision cannot
# tell a transform from a singular one.
SMALLEST_VOLUME = 1e-14

# Edges around the mesh of an ellipsoid. Its 20 480 triangles are inside it by at most 0.03 %.
SEGMENTS = 160
MOST_SEGMENTS = 640  # 327 680 triangles


def create_ellipse(props: mi.Properties) -> mi.Shape:
    """Build the shape `ellipse`: the `disk` with the semi-axes composed into its transform.

    Parameters
    ----------
    props
        ``semi_axis_x``, ``semi_axis_y`` (positive, default 1), ``to_world`` (any invertible affine
        map), ``flip_normals``, and whatever a Mitsuba shape takes: BSDF, emitter, media. The
        ellipse lies in the object-space XY plane, with normal +Z.

    Raises
    ------
    ValueError
        If a semi-axis is not positive and finite, or the transform is not invertible.
    """
    disk_props = as_disk(props)
    disk = mi.PluginManager.instance().create_object(disk_props)
    _mark_queried(props, disk_props)
    attach(disk)
    return disk


def as_disk(props: mi.Properties) -> mi.Properties:
    """Return the properties of the `disk` that an `ellipse` is; errors as `create_ellipse`."""
    to_world = _composed(props, ELLIPSE, "xy")
    disk_props = _without(props, "semi_axis_x", "semi_axis_y")
    disk_props.set_plugin_name(DISK)
    disk_props["to_world"] = to_world
    return disk_props


def create_ellipsoid(props: mi.Properties) -> mi.Shape:
    """Build the shape `ellipsoid`: a `sphere` if it is one, else a mesh.

    Mitsuba has no exact ellipsoid: `sphere` ignores different scales, and the rays of `ellipsoids`
    miss it unless its semi-axes are near 1. The corners of the mesh are on the ellipsoid, so that
    no part of it hides a point of the ellipsoid from outside.

    Parameters
    ----------
    props
        ``semi_axis_x``, ``semi_axis_y``, ``semi_axis_z`` (positive, default 1), ``to_world`` (any
        invertible affine map), ``segments`` (edges around the mesh, default 160), and whatever a
        Mitsuba shape takes.

    Raises
    ------
    ValueError
        If a semi-axis is not positive and finite, the transform is not invertible, the segments are
        too few or too many, or the ellipsoid is too thin for coordinates of single precision.
    """
    to_world = _composed(props, ELLIPSOID, "xyz")
    segments = _segments(props)
    rest = _without(props, "semi_axis_x", "semi_axis_y", "semi_axis_z", "segments")
    matrix = np.array(to_world.matrix, dtype=float).reshape(4, 4)
    if is_sphere(matrix[:3, :3]):
        left, lengths, right = np.linalg.svd(matrix[:3, :3])
        similar = np.eye(4)
        similar[:3, :3] = (
            lengths.mean() * left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
        )
        similar[:3, 3] = matrix[:3, 3]
        shape = _built_in(SPHERE, rest, mi.ScalarAffineTransform4d(similar))
    else:
        if "to_world" in rest:
            del rest["to_world"]
        shape = mesh.tessellate_ellipsoid(
            matrix, segments, rest, 1 - 2 * _rounding(matrix, segments)
        )
    _mark_queried(props, rest)
    attach(shape)
    return shape


def _composed(props: mi.Properties, plugin: str, axes: str) -> mi.ScalarAffineTransform4d:
    """Transform of a shape with its semi-axes."""
    lengths = [_semi_axis(props, plugin, f"semi_axis_{axis}") for axis in axes]
    scale = [*lengths, 1, 1][:3]
    return _to_world(props, plugin) @ mi.ScalarAffineTransform4d().scale(scale)


def _without(props: mi.Properties, *names: str) -> mi.Properties:
    rest = mi.Properties(props)
    for name in names:
        if name in rest:
            del rest[name]
    return rest


def _built_in(plugin: str, props: mi.Properties, to_world: mi.ScalarAffineTransform4d) -> mi.Shape:
    """Shape of Mitsuba's own with another transform."""
    props.set_plugin_name(plugin)
    props["to_world"] = to_world
    return mi.PluginManager.instance().create_object(props)


def _mark_queried(props: mi.Properties, used: mi.Properties) -> None:
    """Leave unqueried what Mitsuba did not ask for, so that it reports a misspelt parameter."""
    for name in props.keys():  # noqa: SIM118
        if name not in used or used.was_queried(name):
            props.mark_queried(name)


def _segments(props: mi.Properties) -> int:
    value = props.get("segments", SEGMENTS)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f'{ELLIPSOID}: segments="{value}" must be an integer')
    if not 5 <= value <= MOST_SEGMENTS:
        raise ValueError(f"{ELLIPSOID}: segments={value} must be from 5 to {MOST_SEGMENTS}")
    return value


def _rounding(matrix: np.ndarray, segments: int) -> float:
    """Part of an ellipsoid's size by which rounding moves the vertices of its mesh.

    Raises
    ------
    ValueError
        If that is more than `MESH_ERROR`.
    """
    sphere = mesh.unit_sphere(mesh.subdivisions(segments))
    exact = sphere.points @ matrix[:3, :3].T + matrix[:3, 3]
    difference = exact.astype(np.float32) - exact
    moved = float(np.abs(difference @ np.linalg.inv(matrix[:3, :3]).T).max())
    if not moved < MESH_ERROR / 4:
        lengths = np.linalg.svd(matrix[:3, :3], compute_uv=False)
        axes = ", ".join(f"{length:.3g}" for length in lengths)
        raise ValueError(
            f"{ELLIPSOID}: the semi-axes {axes} are too different, or too small for the place "
            f"{matrix[:3, 3]}: single-precision coordinates miss the surface by {moved:.1g} of its "
            f"size, and may by {MESH_ERROR / 4:g}; make it thicker or move it towards the origin"
        )
    return moved


def _semi_axis(props: mi.Properties, plugin: str, name: str) -> float:
    value = props.get(name, 1.0)
    if not isinstance(value, float | int):
        raise ValueError(f'{plugin}: {name}="{value}" must be a number')
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{plugin}: {name}={value:g} must be positive and finite")
    return value


def _to_world(props: mi.Properties, plugin: str) -> mi.ScalarAffineTransform4d:
    # From the matrix alone: a transform also carries an inverse, which Mitsuba's rotation about an
    # axis that is not normalised leaves inconsistent.
    given = props.get("to_world", mi.ScalarAffineTransform4d())
    matrix = given.matrix
    entries = [float(matrix[i, j]) for i in range(4) for j in range(4)]
    if not all(map(math.isfinite, entries)):
        raise ValueError(f"{plugin}: to_world has entries that are not finite:\n{matrix}")

    columns = [mi.ScalarVector3d(matrix[0, j], matrix[1, j], matrix[2, j]) for j in range(3)]
    volume = abs(dr.dot(cross(columns[0], columns[1]), columns[2]))
    if volume <= SMALLEST_VOLUME * math.prod(map(dr.norm, columns)):
        raise ValueError(f"{plugin}: to_world is singular, it must be invertible:\n{matrix}")
    return mi.ScalarAffineTransform4d(matrix)
