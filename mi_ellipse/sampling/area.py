"""Strategy `area`: points uniform on the surface, the baseline of every renderer."""

from __future__ import annotations

import mitsuba as mi

from ..geometry.light import View
from .strategy import register


@register(
    "area",
    colour="#E69F00",
    mark="o",
    sentence="Points uniform on the surface: the baseline of every renderer. Its variance has no"
    " bound near the lamp.",
)
class Area:
    """Points uniform on the surface; on an ellipsoid, images of uniform points of the unit sphere.

    The variance of the irradiance has no bound near the light. Points of a solid that face away are
    drawn and dark.
    """

    def prepare(self, view: View, normal: mi.Normal3f) -> View:
        """Return the view, which is all that is needed. The normal is not used."""
        return view

    def sample(self, view: View, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's frame, its density, and validity."""
        return view.light.surface_direction(view, u)

    def pdf(self, view: View, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the light."""
        return view.light.surface_density(view, direction)
