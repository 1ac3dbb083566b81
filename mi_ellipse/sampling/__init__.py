"""Sampling strategies: how two random numbers become a direction towards the light.

A strategy is a class with three methods::

    prepare(ellipse, reference, normal) -> record
    sample(record, u) -> (direction, pdf, valid)
    pdf(record, direction) -> pdf

Directions are given along the light's ``(ex, ey, normal)``. `prepare` sees the reference point and
its normal (zero in media) and never the random numbers; the record has, beside what is its own, the
`centre` of the light that `Ellipse.light_coordinates` gives, in either precision. `pdf` is exactly
the density per solid angle that `sample` draws from; it does not test whether the direction meets
the light, and in single precision it must not: the ray decides what is hit. A draw that is not
`valid` carries its density and no light.

Dr.Jit merges no equal operations while it traces a strategy (`EllipticalArea._lookup`). What is
used twice has a name, and so has a literal in the code that every path runs.
"""

from functools import partial

from .area import Area
from .concentric import Concentric
from .projected_solid_angle import ProjectedSolidAngle
from .rejection import Rejection
from .solid_angle import SolidAngle
from .tangent_disk import TangentDisk

STRATEGIES = {
    "area": Area,
    "rejection": Rejection,
    "solid_angle": SolidAngle,
    "projected_solid_angle": ProjectedSolidAngle,
    "projected_solid_angle_one_sided": partial(ProjectedSolidAngle, one_sided=True),
    "tangent_disk": TangentDisk,
    "concentric": Concentric,
}
DEFAULT = "solid_angle"
