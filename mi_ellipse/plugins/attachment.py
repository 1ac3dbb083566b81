"""How a lamp gets its geometry from the shape around its emitter."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry import ellipse, ellipsoid, limits, mesh, sphere
from ..geometry.light import Light
from ..lamps.lamp import Lamp
from .names import DISK, ELLIPSE, ELLIPSOID, ELLIPTICAL_AREA, SPHERE

# Part of a solid's size by which the vertices of its mesh may miss it, in its own unit sphere. The
# shape `ellipsoid` makes no mesh that misses it by more.
MESH_ERROR = 1e-3


class Attachment:
    """The tie of a lamp to a shape.

    The shapes `ellipse` and `ellipsoid` attach their emitter when they are built. A plain `disk` or
    `sphere` cannot, so the emitter asks for its shape when it is first used, and again when the
    shape changes. The lamp keeps values and nothing that refers to the shape: a scene with such a
    reference is never freed.
    """

    def __init__(self, lamp: Lamp):
        self.lamp = lamp
        self._error: str | None = None  # Of an attachment that failed

    def attach(self, shape: mi.Shape | None) -> None:
        """Take the geometry from a shape.

        Raises
        ------
        ValueError
            Without a shape, if the shape is no light of this package, if its size is beyond single
            precision, or if the strategy cannot sample one like it.
        """
        try:
            light = _light(shape)
            self.lamp.place(light, _area(shape, light) if self.lamp.is_power else None)
            self._error = None
        except ValueError as error:
            self._error = f"{ELLIPTICAL_AREA}: {error}"
        if self._error:
            raise ValueError(self._error)

    def ready(self, shape_of: Callable[[], mi.Shape | None]) -> bool:
        """Tell whether the lamp has its geometry, and attach it if it can be done now.

        Dr.Jit traces every living emitter. One of them can have no shape yet; another one can
        belong to a scene that is kept alive by the traceback of its error. These must not fail the
        renders of other scenes, nor touch a shape that may be gone: they give no light and a
        warning.
        """
        if self.lamp.stored is not None:
            return True
        if dr.is_jit_v(mi.Float) and (self._error or shape_of() is None):
            error = self._error or f"{ELLIPTICAL_AREA}: {_misplaced('no shape')}"
            mi.Log(mi.LogLevel.Warn, error)
            return False
        self.attach(shape_of())
        return True


def attach(shape: mi.Shape) -> None:
    """Attach the emitter of a shape that has just been built, if it is one of this package."""
    emitter = shape.emitter()
    if isinstance(getattr(emitter, "attachment", None), Attachment):
        emitter.attachment.attach(shape)


def attach_all(scene: mi.Scene) -> None:
    """Attach the emitters of a scene that would wait for their first use, as on a plain `disk`.

    Errors are those of `Attachment.attach`.
    """
    for emitter in scene.emitters():
        attachment = getattr(emitter, "attachment", None)
        if isinstance(attachment, Attachment) and attachment.lamp.stored is None:
            attachment.attach(emitter.get_shape())


def _misplaced(what: str) -> str:
    return (
        f"the emitter is attached to {what} and gives no light; put it into a shape of type "
        f'"{ELLIPSE}", "{ELLIPSOID}", "{DISK}" or "{SPHERE}"'
    )


def _inwards(shape: str, what: str) -> str:
    return f"the {shape} around the emitter shines inwards; leave out its {what}"


def _light(shape: mi.Shape | None) -> Light:
    """Geometry of a shape.

    Raises
    ------
    ValueError
        If the shape is no light of this package.
    """
    if shape is None:
        raise ValueError(_misplaced("no shape"))
    reader = READERS.get(shape.class_name())
    if reader is None:
        raise ValueError(_misplaced(f"a {shape.class_name()}"))
    return reader(shape)


def _area(shape: mi.Shape, light: Light) -> mi.Float:
    """Surface area of a light: its value as exact as the light, its gradient that of the shape."""
    area, followed = light.area, shape.surface_area()
    return dr.replace_grad(area, followed) if dr.grad_enabled(followed) else area


def _of_disk(shape: mi.Shape) -> Light:
    to_world = dr.detach(_parameter(shape, "to_world"))
    limits.check_ellipse(_entries(to_world))
    return ellipse.from_transform(to_world)


def _of_sphere(shape: mi.Shape) -> Light:
    """Sphere; Mitsuba has made the transform a similarity."""
    matrix = _entries(dr.detach(_parameter(shape, "to_world")))
    limits.check_solid(matrix)
    light = sphere.from_transform(mi.ScalarAffineTransform4d(matrix))
    # The transform does not tell what `flip_normals` and mirrors do to the normals.
    it = mi.Interaction3f()
    it.p = mi.Point3f(light.centre) + 2 * light.lx
    ds = shape.sample_direction(it, mi.Point2f(0.5))
    if not np.all(dr.dot(ds.d, ds.n) < 0):
        raise ValueError(_inwards("sphere", "flip_normals, or the mirror in its to_world"))
    return light


def _of_mesh(shape: mi.Mesh) -> Light:
    """Ellipsoid of which the mesh is a tessellation of this package.

    Mitsuba's meshes have no transform. The affine map from the vertices of the unit sphere to those
    of the mesh is a least-squares fit, so that a lamp follows when its vertices are moved.
    """
    if shape.has_flipped_normals():
        raise ValueError(_inwards("ellipsoid", "flip_normals"))
    points = np.array(dr.detach(shape.vertex_positions_buffer()), dtype=float).reshape(-1, 3)
    unit = mesh.unit_sphere_of(len(points))
    if unit is None:
        raise ValueError(_misplaced("a mesh that is no ellipsoid of this package"))
    matrix, missed = _affine_map(unit.points, points)
    if not missed < MESH_ERROR:
        raise ValueError(
            "the vertex_positions of the mesh around the emitter are no affine image of those of "
            f"a sphere: they miss the nearest ellipsoid by {missed:.1g} of its size, and may by "
            f"{MESH_ERROR:g}"
        )
    limits.check_solid(matrix)
    kind = sphere if sphere.is_sphere(matrix[:3, :3]) else ellipsoid
    return kind.from_transform(mi.ScalarAffineTransform4d(matrix))


def _entries(to_world: Any) -> np.ndarray:
    """4×4 matrix of a transform that is known, also while Dr.Jit traces or records.

    Entry by entry: in one piece, Dr.Jit would have to run a kernel, which it cannot do then.
    """
    entries = [to_world.matrix[i, j] for i in range(4) for j in range(4)]
    return np.array([np.array(entry).item() for entry in entries], dtype=float).reshape(4, 4)


def _affine_map(known: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, float]:
    """4×4 matrix of the affine map between rows, and what it misses by, mapped back."""
    matrix = np.eye(4)
    if not np.isfinite(points).all():
        return matrix, np.inf
    known = np.concatenate([known, np.ones((len(known), 1))], axis=1)
    matrix[:3] = np.linalg.lstsq(known, points, rcond=None)[0].T
    lengths = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    if not lengths[2] > 1e-12 * lengths[0]:
        return matrix, np.inf
    back = np.linalg.inv(matrix[:3, :3])
    return matrix, np.abs((points - known @ matrix[:3].T) @ back.T).max()


# How to read a shape, by what its `class_name` says
READERS: dict[str, Callable[[Any], Light]] = {
    "Disk": _of_disk,
    "Sphere": _of_sphere,
    "Mesh": _of_mesh,
}


def _parameter(shape: mi.Shape, name: str) -> Any:
    """Parameter of a shape, without a look at its BSDF, emitter and media."""
    finder = _finder(mi.variant())(name)
    shape.traverse(finder)
    return mi.get_property(*finder.found, shape)


@cache
def _finder(variant: str) -> type:
    """Class of a callback that finds a parameter; each variant has another base for it."""

    class Finder(mi.TraversalCallback):
        def __init__(self, wanted):
            super().__init__()
            self.wanted = wanted

        def put(self, name, value, flags, cpptype=None):
            if name == self.wanted:
                self.found = value, cpptype

    return Finder
