"""The sphere: its surface, and how it is seen, without the general root and principal axes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from .cone import LOWEST_ROOT, RoundCone
from .light import Hit, View, field_values
from .tracing import TINY, cross

# Semi-axes that differ by a smaller part are those of a sphere: ten roundings of single precision.
SPHERICITY = 1e-6

# Least squared cosine at the unit sphere, for densities of its points: that part of the draws is
# below, and rounding a direction moves it by as much.
LEAST_COSINE2 = 1e-7


class SphereView(View):
    """A sphere as it is seen from a point, along the axes of the world."""

    @cached_property
    def root(self) -> mi.Float:
        """Squared length of a tangent from the point, negative inside; in double precision."""
        return mi.Float(dr.squared_norm(self.position) - 1)

    @cached_property
    def cone(self) -> RoundCone:
        """The cone of directions that meet the light."""
        # Inside, where there is none, nothing is divided by zero.
        tangent2 = dr.maximum(self.root, LOWEST_ROOT)
        inv = dr.rsqrt(tangent2 + mi.Float(1))
        return RoundCone(self.centre * inv, dr.rcp(tangent2), tangent2, dr.square(inv))

    @property
    def lit(self) -> mi.Mask:
        """True outside: the light shines outwards."""
        return self.root > mi.Float(0)

    @property
    def outside(self) -> mi.Mask:
        """True outside: inside, every direction meets the light."""
        return self.lit


@dataclass
class Ball:
    """The numbers of a sphere that follow from its transform, without its centre."""

    inv_lx: mi.Float64  # 1 / lx
    lx: mi.Float  # Radius
    ex: mi.Vector3f  # Images of the axes before `to_world`, of length 1; for textures alone
    ey: mi.Vector3f
    ez: mi.Vector3f


@dataclass
class StoredSphere(Ball):
    """A sphere as a lamp keeps it between traces; arrays of many too."""

    centre: mi.Point3f  # Mitsuba keeps transforms in single precision

    def light(self) -> Sphere:
        """Return the light for one trace."""
        return Sphere(**(field_values(self) | {"centre": mi.Point3d(self.centre)}))


@dataclass
class Sphere(Ball):
    """A sphere in world space that shines outwards, for one trace.

    The light's own axes are those of the world, so nothing is turned. Lengths are in units of the
    radius where nothing else is said.
    """

    planar: ClassVar[bool] = False

    centre: mi.Point3d

    def stored(self) -> StoredSphere:
        """Return what a lamp keeps."""
        return StoredSphere(**(field_values(self) | {"centre": mi.Point3f(self.centre)}))

    def seen_from(self, point: mi.Point3f) -> SphereView:
        """Return the view of the light from a world-space point."""
        return SphereView(self, self.light_coordinates(point))

    @property
    def area(self) -> mi.Float:
        """Surface area in world units."""
        return 4 * dr.pi * dr.square(self.lx)

    def light_coordinates(self, reference: mi.Point3f) -> mi.Vector3d:
        """Vector from a world-space point to the centre in units of the radius."""
        return mi.Vector3d((mi.Point3d(self.centre) - mi.Point3d(reference)) * self.inv_lx)

    def to_light(self, v: mi.Vector3f) -> mi.Vector3f:
        """Return the world-space vector itself."""
        return mi.Vector3f(v)

    def to_world(self, v: mi.Vector3f) -> mi.Vector3f:
        """Return the world-space vector itself."""
        return mi.Vector3f(v)

    # ---- Points of the surface ----

    def surface_direction(
        self, view: SphereView, u: mi.Point2f
    ) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction to a point uniform on the surface, its density, whether the point is seen.

        From the point, the density loses less than `surface_density` does far away.
        """
        q = mi.Vector3f(mi.warp.square_to_uniform_sphere(u))
        offset = view.centre + q
        distance = dr.maximum(dr.norm(offset), TINY)  # The view may be at the very point
        d = offset / distance
        pdf = _surface_density(distance, dr.square(dr.dot(q, d)))
        return d, pdf, dr.dot(q, view.centre) < -1

    def surface_density(self, view: SphereView, direction: mi.Vector3f) -> mi.Float:
        """Density per solid angle of a direction from `surface_direction`."""
        _, cosine2, t = _nearer_hit(view, direction)
        return _surface_density(t, cosine2)

    def sample_surface(self, u: mi.Point2f) -> tuple[mi.Point3f, mi.Normal3f, mi.Point2f]:
        """World-space point uniform on the surface, the normal and uv there."""
        q = mi.Vector3f(mi.warp.square_to_uniform_sphere(u))
        return self.point(q), mi.Normal3f(q), self.uv(q)

    def surface_pdf(self, p: mi.Point3f) -> mi.Float:
        """Density per area of `sample_surface`."""
        return dr.inv_four_pi * dr.square(mi.Float(self.inv_lx))

    def point(self, q: mi.Vector3f) -> mi.Point3f:
        """World-space point of the surface with the normal q."""
        return mi.Point3f(dr.fma(q, self.lx, mi.Vector3f(self.centre)))

    def uv(self, q: mi.Vector3f) -> mi.Point2f:
        """Longitude and colatitude before `to_world`, as Mitsuba's `sphere` has them."""
        return longitude_and_colatitude(*(dr.dot(axis, q) for axis in (self.ex, self.ey, self.ez)))

    def hit(self, view: SphereView, direction: mi.Vector3f) -> Hit:
        """Return the nearer point where a drawn unit direction meets the light."""
        foot, cosine2, t = _nearer_hit(view, direction)
        q = dr.fma(direction, -dr.sqrt(cosine2), foot)
        q *= dr.rsqrt(dr.maximum(dr.squared_norm(q), TINY))
        return Hit(self.point(q), mi.Normal3f(q), self.uv(q), t * self.lx)


def _surface_density(distance: mi.Float, cosine2: mi.Float) -> mi.Float:
    """``t² / (4π |q·d|)``, with the distance t and the cosine at the surface."""
    floor = mi.Float(LEAST_COSINE2)
    return dr.inv_four_pi * dr.square(distance) * dr.rsqrt(dr.maximum(cosine2, floor))


def _nearer_hit(view: SphereView, direction: mi.Vector3f) -> tuple[mi.Vector3f, mi.Float, mi.Float]:
    """Foot of the perpendicular from the centre to a ray, squared cosine at the hit, distance.

    The squared cosine is floored at 0, for a direction that rounding moved beside the light.
    """
    moment = cross(direction, view.centre)
    foot = cross(direction, moment)
    cosine2 = dr.maximum(1 - dr.squared_norm(moment), 0)
    towards = dr.maximum(dr.dot(view.centre, direction), 0)
    t = view.root / dr.maximum(towards + dr.sqrt(cosine2), TINY)
    return foot, cosine2, t


def longitude_and_colatitude(x: mi.Float, y: mi.Float, z: mi.Float) -> mi.Point2f:
    """The uv of Mitsuba's `sphere` at a point of the unit sphere."""
    longitude = dr.atan2(y, x) * dr.inv_two_pi
    # The arc cosine of z loses the poles
    colatitude = dr.atan2(dr.sqrt(dr.fma(x, x, y * y)), z) * dr.inv_pi
    return mi.Point2f(dr.select(longitude < 0, longitude + 1, longitude), colatitude)


def is_sphere(linear: np.ndarray) -> bool:
    """Tell whether a 3×3 matrix takes the unit sphere to a sphere, up to `SPHERICITY`."""
    lengths = np.linalg.svd(linear, compute_uv=False)
    return bool(lengths[2] > (1 - SPHERICITY) * lengths[0])


def from_transform(to_world: mi.ScalarAffineTransform4d) -> Sphere:
    """Image of the unit sphere under a similarity, mirrored or not.

    The radius is the root mean square of the lengths of the three columns.
    """
    matrix = np.array(to_world.matrix, dtype=float)
    radius = float(np.linalg.norm(matrix[:3, :3]) / np.sqrt(3))
    axes = (mi.Vector3f(*column) for column in (matrix[:3, :3] / radius).T.tolist())
    centre = mi.Point3d(*matrix[:3, 3].tolist())
    return Sphere(mi.Float64(1 / radius), mi.Float(radius), *axes, centre)
