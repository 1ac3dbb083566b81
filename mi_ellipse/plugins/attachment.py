"""How a lamp gets its geometry from the shape around its emitter."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import drjit as dr
import mitsuba as mi

from ..lamps.lamp import Lamp
from .names import DISK, ELLIPSE, ELLIPTICAL_AREA

# What `class_name` says of the shapes that a lamp can have.
SHAPES = ("Disk",)


class Attachment:
    """The tie of a lamp to a shape.

    The shape `ellipse` attaches its emitter when it is built. A plain `disk` cannot, so the emitter
    asks for its shape when it is first used, and again when the shape changes. The lamp keeps
    values and nothing that refers to the shape: a scene with such a reference is never freed.
    """

    def __init__(self, lamp: Lamp):
        self.lamp = lamp
        self._error: str | None = None  # Of an attachment that failed

    def attach(self, shape: mi.Shape | None) -> None:
        """Take the geometry from a shape.

        Raises
        ------
        ValueError
            Without a shape, or if the shape is no ellipse.
        """
        if shape is None or shape.class_name() not in SHAPES:
            self._error = _misplaced("no shape" if shape is None else f"a {shape.class_name()}")
            raise ValueError(self._error)
        self.lamp.place(_transform(shape))

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
            mi.Log(mi.LogLevel.Warn, self._error or _misplaced("no shape"))
            return False
        self.attach(shape_of())
        return True


def attach(shape: mi.Shape) -> None:
    """Attach the emitter of a shape that has just been built, if it is one of this package."""
    emitter = shape.emitter()
    if isinstance(getattr(emitter, "attachment", None), Attachment):
        emitter.attachment.attach(shape)


def _misplaced(what: str) -> str:
    return (
        f"{ELLIPTICAL_AREA}: the emitter is attached to {what} and gives no light; put it into a "
        f'shape of type "{ELLIPSE}" or "{DISK}"'
    )


def _transform(shape: mi.Shape) -> mi.AffineTransform4f:
    """Transform of a shape, without a look at its BSDF, emitter and media."""
    finder = _finder(mi.variant())()
    shape.traverse(finder)
    return mi.get_property(*finder.found, shape)


@cache
def _finder(variant: str) -> type:
    """Class of a callback that finds `to_world`; each variant has another base for it."""

    class Finder(mi.TraversalCallback):
        def put(self, name, value, flags, cpptype=None):
            if name == "to_world":
                self.found = value, cpptype

    return Finder
