"""Exact elliptical lights and ellipsoids for Mitsuba 3, sampled by solid angle.

Importing this package makes the shapes `ellipse` and `ellipsoid` and the emitter `ellipticalarea`
known to every Mitsuba variant, whichever is set, before or after. Import it before `mitsuba`:
Dr.Jit looks for its LLVM library when it is imported.
"""

from .system import llvm

llvm.install()

from .lighting.irradiance import direct_irradiance  # noqa: E402
from .measures import (  # noqa: E402
    Ellipsoid,
    irradiance,
    solid_angle,
    tangent_ellipse,
    tessellate,
    vector_irradiance,
)
from .plugins import registration  # noqa: E402
from .plugins.grouping import group_lamps  # noqa: E402

registration.install()

__all__ = [
    "Ellipsoid",
    "direct_irradiance",
    "group_lamps",
    "irradiance",
    "solid_angle",
    "tangent_ellipse",
    "tessellate",
    "vector_irradiance",
]

__version__ = "0.1.0"
