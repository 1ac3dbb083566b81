"""What a light offers to strategies and lamps, whatever its shape."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import fields
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol

import mitsuba as mi

from .cone import Cone, RoundCone


class Hit(NamedTuple):
    """The point of a light that a direction meets."""

    p: mi.Point3f  # World-space point
    n: mi.Normal3f  # World-space normal there
    uv: mi.Point2f  # Parameterisation of Mitsuba's shape there
    distance: mi.Float  # From the reference point, in world units


class View(ABC):
    """A light as it is seen from a point, along the light's own axes.

    Parameters
    ----------
    light
        The light.
    position
        Vector from the point to the centre, as `Light.light_coordinates` returns it.
    """

    def __init__(self, light: Any, position: mi.Vector3d):
        self.light = light
        self.position = position

    @property
    @abstractmethod
    def root(self) -> mi.Float:
        """The confocal root, on which the whole cone rests."""

    @cached_property
    def centre(self) -> mi.Vector3f:
        """The position in single precision."""
        return mi.Vector3f(self.position)

    @property
    @abstractmethod
    def cone(self) -> Cone | RoundCone:
        """The cone of directions that meet the light."""

    @property
    @abstractmethod
    def lit(self) -> mi.Mask:
        """True where the light shines. Draw and density both ask here, so they agree."""

    @property
    def outside(self) -> mi.Mask:
        """True where the directions that meet the light are a cone, lit or not."""
        return mi.Mask(True)


class StoredLight(Protocol):
    """A light as a lamp keeps it between traces: a dataclass of evaluated numbers."""

    def light(self) -> Light:
        """Return the light for one trace."""


class Light(Protocol):
    """A light in world space, for one trace.

    Directions are given along the light's own axes, lengths in units of its longest semi-axis lx
    where nothing else is said.
    """

    planar: ClassVar[bool]  # An ellipse, with principal coordinates; else a solid

    @property
    def area(self) -> mi.Float:
        """Surface area in world units: one side of an ellipse, the outside of a solid."""

    def stored(self) -> StoredLight:
        """Return what a lamp keeps."""

    def seen_from(self, point: mi.Point3f) -> View:
        """Return the view of the light from a world-space point."""

    def light_coordinates(self, reference: mi.Point3f) -> mi.Vector3d:
        """Vector from a world-space point to the centre."""

    def to_light(self, v: mi.Vector3f) -> mi.Vector3f:
        """Components of a world-space vector along the axes of the light."""

    def to_world(self, v: mi.Vector3f) -> mi.Vector3f:
        """World-space vector from its components along the axes of the light."""

    def hit(self, view: View, direction: mi.Vector3f) -> Hit:
        """Return the point where a drawn direction meets the light."""

    def surface_direction(self, view: View, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction to a random point of the surface, its density, whether the point is seen."""

    def surface_density(self, view: View, direction: mi.Vector3f) -> mi.Float:
        """Density per solid angle of a direction from `surface_direction`."""

    def sample_surface(self, u: mi.Point2f) -> tuple[mi.Point3f, mi.Normal3f, mi.Point2f]:
        """World-space point of the surface, normal and uv, as `surface_direction` draws it."""

    def surface_pdf(self, p: mi.Point3f) -> mi.Float:
        """Density per area, in world units, of `sample_surface` at a world-space point."""


def field_values(record: Any) -> dict[str, Any]:
    """Return the fields of a dataclass without copying their values."""
    return {field.name: getattr(record, field.name) for field in fields(record)}
