"""Plugin `ellipse`: an exact ellipse, which is Mitsuba's `disk` under an affine map."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from ..geometry.tracing import cross
from .attachment import attach
from .names import DISK, ELLIPSE

# Volume of the image of the unit cube over the product of its edges: below, double precision cannot
# tell a transform from a singular one.
SMALLEST_VOLUME = 1e-14


def create(props: mi.Properties) -> mi.Shape:
    """Build the shape: the `disk` with the semi-axes composed into its transform.

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
    semi_axes = [_semi_axis(props, name) for name in ("semi_axis_x", "semi_axis_y")]
    to_world = _to_world(props)

    disk_props = mi.Properties(props)
    disk_props.set_plugin_name(DISK)
    for name in ("semi_axis_x", "semi_axis_y"):
        if name in disk_props:
            del disk_props[name]
    disk_props["to_world"] = to_world @ mi.ScalarAffineTransform4d().scale([*semi_axes, 1])
    disk = mi.PluginManager.instance().create_object(disk_props)

    # What `disk` did not ask for stays unqueried, so that Mitsuba reports a misspelt parameter.
    for name in props.keys():  # noqa: SIM118
        if name not in disk_props or disk_props.was_queried(name):
            props.mark_queried(name)

    attach(disk)
    return disk


def _semi_axis(props: mi.Properties, name: str) -> float:
    value = props.get(name, 1.0)
    if not isinstance(value, float | int):
        raise ValueError(f'{ELLIPSE}: {name}="{value}" must be a number')
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{ELLIPSE}: {name}={value:g} must be positive and finite")
    return value


def _to_world(props: mi.Properties) -> mi.ScalarAffineTransform4d:
    # From the matrix alone: a transform also carries an inverse, which Mitsuba's rotation about an
    # axis that is not normalised leaves inconsistent.
    given = props.get("to_world", mi.ScalarAffineTransform4d())
    matrix = given.matrix
    entries = [float(matrix[i, j]) for i in range(4) for j in range(4)]
    if not all(map(math.isfinite, entries)):
        raise ValueError(f"{ELLIPSE}: to_world has entries that are not finite:\n{matrix}")

    columns = [mi.ScalarVector3d(matrix[0, j], matrix[1, j], matrix[2, j]) for j in range(3)]
    volume = abs(dr.dot(cross(columns[0], columns[1]), columns[2]))
    if volume <= SMALLEST_VOLUME * math.prod(map(dr.norm, columns)):
        raise ValueError(f"{ELLIPSE}: to_world is singular, it must be invertible:\n{matrix}")
    return mi.ScalarAffineTransform4d(matrix)
