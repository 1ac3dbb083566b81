"""An exact elliptical light for Mitsuba 3, sampled by solid angle.

Importing this package makes the shape `ellipse` and the emitter `ellipticalarea` known to every
Mitsuba variant, whichever is set, before or after. Import it before `mitsuba`: Dr.Jit looks for its
LLVM library when it is imported.
"""

from . import llvm

llvm.install()

import mitsuba as mi  # noqa: E402

from . import emitter, shape  # noqa: E402
from .measures import (  # noqa: E402
    irradiance,
    solid_angle,
    tangent_ellipse,
    tessellate,
    vector_irradiance,
)

__all__ = ["irradiance", "solid_angle", "tangent_ellipse", "tessellate", "vector_irradiance"]

__version__ = "0.1.0"

_registered: set[str] = set()


def _register(old: str | None, new: str | None) -> None:
    """Register the plugins under the variant that has just been set, once."""
    if new is None or new in _registered:
        return
    mi.register_shape("ellipse", shape.create)
    mi.register_emitter("ellipticalarea", emitter.define())
    _registered.add(new)


mi.detail.add_variant_callback(_register)
_register(None, mi.variant())
