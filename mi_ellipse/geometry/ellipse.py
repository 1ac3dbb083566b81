"""The planar ellipse: principal axes, area, and how it is seen from a point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import drjit as dr
import mitsuba as mi

from . import cone
from .cone import Cone
from .light import Hit, View, field_values
from .tracing import cross

# A reference point closer to the plane of the light counts as being at this height, in units of the
# longer semi-axis. `1/z` then stays finite for points in the plane. The height is far below what
# single-precision coordinates resolve.
PLANE_FLOOR = 1e-12

# Directions along the plane meet it at this distance, in units of the longer semi-axis. It is far
# beyond the range of the cone and finite.
FARTHEST = 1e25


class EllipseView(View):
    """An ellipse as it is seen from a point, along ``(ex, ey, normal)``."""

    @cached_property
    def root(self) -> mi.Float:
        """The confocal root, on which the whole cone rests."""
        return cone.confocal_root(self.position, self.light.ratio)

    @cached_property
    def cone(self) -> Cone:
        """The cone of directions that meet the light."""
        light = self.light
        return cone.of_ellipse(
            self.position, self.root, light.ratio32, light.inv_ratio, light.eccentricity2
        )

    @property
    def lit(self) -> mi.Mask:
        """True on the emitting side of the light.

        The sign is that of the double-precision height, so draw and density also agree for points
        in the plane of the light.
        """
        return self.centre.z < mi.Float(0)


@dataclass
class PrincipalAxes:
    """The numbers of an elliptical light that follow from its transform, without its centre.

    The kernel loads these numbers for every path and call. So a number that follows from others is
    no field. The kernel loads up to eight numbers of one size at once. The last three serve
    textures alone. They are in double precision because the eight of single precision are full,
    with the centre and an RGB radiance.
    """

    ex: mi.Vector3d  # Direction of the longer principal axis
    ey: mi.Vector3d  # Direction of the shorter principal axis
    inv_lx: mi.Float64  # 1 / lx
    ratio: mi.Float64  # ly / lx, in (0, 1]
    lx: mi.Float  # Length of the longer semi-axis
    inv_ratio: mi.Float  # lx / ly
    parameter_cos: mi.Float64  # First column of the rotation (or reflection) that takes principal
    parameter_sin: mi.Float64  # coordinates (a, b) to those of the unit disk before `to_world`
    handedness: mi.Float64  # +1 for that rotation, -1 for that reflection


@dataclass
class StoredEllipse(PrincipalAxes):
    """An elliptical light as a lamp keeps it between traces; arrays of many lights too."""

    centre: mi.Point3f  # Mitsuba keeps transforms in single precision

    def light(self) -> Ellipse:
        """Return the light for one trace."""
        return Ellipse(**(field_values(self) | {"centre": mi.Point3d(self.centre)}))


@dataclass
class Ellipse(PrincipalAxes):
    """An elliptical light in world space, for one trace.

    The light is ``{centre + a·lx·ex + b·ly·ey : a² + b² ≤ 1}`` with ``lx ≥ ly``; it emits towards
    ``normal = ex × ey``. Whatever cancels against the reference point is in double precision. With
    a single-precision normal, the solid angle of a rotated light seen from its own plane is off by
    factors of up to 20.

    A cached property is a variable of the trace that first asks for it. So each trace takes a light
    of its own from `StoredEllipse.light`.
    """

    planar: ClassVar[bool] = True

    centre: mi.Point3d

    def stored(self) -> StoredEllipse:
        """Return what a lamp keeps."""
        return StoredEllipse(**(field_values(self) | {"centre": mi.Point3f(self.centre)}))

    def seen_from(self, point: mi.Point3f) -> EllipseView:
        """Return the view of the light from a world-space point."""
        return EllipseView(self, self.light_coordinates(point))

    @cached_property
    def normal(self) -> mi.Vector3d:
        """Direction of emission."""
        return cross(self.ex, self.ey)

    @cached_property
    def axes32(self) -> tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]:
        """``(ex, ey, normal)`` in single precision."""
        return mi.Vector3f(self.ex), mi.Vector3f(self.ey), mi.Vector3f(self.normal)

    @cached_property
    def ratio32(self) -> mi.Float:
        """The ratio in single precision."""
        return mi.Float(self.ratio)

    @property
    def eccentricity2(self) -> mi.Float:
        """``1 - ratio²`` of the ratio in single precision.

        The rounding shows near circles. There it turns axes of the cone, which do not matter.
        """
        return dr.fma(-self.ratio32, self.ratio32, 1)

    @property
    def ly(self) -> mi.Float:
        """Length of the shorter semi-axis."""
        return self.lx * self.ratio32

    @property
    def area(self) -> mi.Float:
        """Surface area."""
        return dr.pi * self.lx * self.ly

    def light_coordinates(self, reference: mi.Point3f) -> mi.Vector3d:
        """Vector from a world-space point to the centre, along ``(ex, ey, normal)`` in units of lx.

        The third component is positive behind the light and negative on the emitting side. It is
        never zero (`PLANE_FLOOR`).
        """
        offset = (mi.Point3d(self.centre) - mi.Point3d(reference)) * self.inv_lx
        height = dr.dot(offset, self.normal)
        return mi.Vector3d(
            dr.dot(offset, self.ex),
            dr.dot(offset, self.ey),
            dr.mulsign(dr.maximum(dr.abs(height), PLANE_FLOOR), height),
        )

    def to_light(self, v: mi.Vector3f) -> mi.Vector3f:
        """Components of a world-space vector along ``(ex, ey, normal)``."""
        ex, ey, _ = self.axes32
        height = dr.dot(mi.Vector3d(v), self.normal)  # Cancels at grazing angles
        return mi.Vector3f(dr.dot(v, ex), dr.dot(v, ey), height)

    def to_world(self, v: mi.Vector3f) -> mi.Vector3f:
        """World-space vector from its components along ``(ex, ey, normal)``."""
        ex, ey, normal = self.axes32
        return dr.fma(ex, v.x, dr.fma(ey, v.y, normal * v.z))

    def surface_direction(
        self, view: EllipseView, u: mi.Point2f
    ) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction to a point uniform on the surface, its density, and that the point is seen.

        Through the concentric map (Shirley and Chiu, *A Low Distortion Map Between Disk and
        Square*, 1997).
        """
        point = mi.warp.square_to_uniform_disk_concentric(u)
        offset = mi.Vector3f(point.x, self.ratio32 * point.y, 0)
        d = dr.normalize(view.centre + offset)
        return d, self.surface_density(view, d), mi.Mask(True)

    def surface_density(self, view: EllipseView, direction: mi.Vector3f) -> mi.Float:
        """Density per solid angle of a direction to a point that is uniform on the surface.

        ``r² / (A cos θ)`` with the distance r, the area A and the angle θ at the light.
        """
        cosine = direction.z
        distance = view.centre.z / cosine
        return dr.square(distance) / (dr.pi * self.ratio32 * dr.abs(cosine))

    def sample_surface(self, u: mi.Point2f) -> tuple[mi.Point3f, mi.Normal3f, mi.Point2f]:
        """World-space point uniform on the surface, the normal and uv there."""
        a, b = self.from_disk(mi.warp.square_to_uniform_disk_concentric(u))
        return self.point(a, b), mi.Normal3f(self.normal), self.uv(a, b)

    def surface_pdf(self, p: mi.Point3f) -> mi.Float:
        """Density per area of `sample_surface`."""
        return dr.rcp(self.area)

    def hit(self, view: EllipseView, direction: mi.Vector3f) -> Hit:
        """Return the point where a drawn direction meets the light.

        Parameters
        ----------
        view
            The light as it is seen from the reference point.
        direction
            Unit direction along ``(ex, ey, normal)`` that meets the light.
        """
        a, b, distance = self.point_from_direction(view.centre, direction)
        return Hit(self.point(a, b), mi.Normal3f(self.axes32[2]), self.uv(a, b), distance)

    def point_from_direction(
        self, centre: mi.Vector3f, direction: mi.Vector3f
    ) -> tuple[mi.Float, mi.Float, mi.Float]:
        """Principal coordinates and distance of the point where a direction meets the light.

        Parameters
        ----------
        centre
            `View.centre` of the reference point.
        direction
            Unit direction along ``(ex, ey, normal)`` that meets the light.

        Returns
        -------
        a, b
            Principal coordinates. Nearer than one semi-axis, ``a² + b² ≤ 1`` up to the rounding of
            a plane intersection. Farther away, they are clamped to the ellipse: at grazing angles a
            quarter of the plain intersections of drawn directions miss it.
        distance
            Distance from the reference point in world units.
        """
        t = dr.minimum(dr.abs(centre.z / direction.z), FARTHEST)
        a = dr.fma(direction.x, t, -centre.x)
        b = dr.fma(direction.y, t, -centre.y) * self.inv_ratio
        one = mi.Float(1)
        near = t < one

        a_clamped = dr.clip(a, -one, one)
        half_chord = dr.sqrt(dr.fma(-a_clamped, a_clamped, one))
        a = dr.select(near, a, a_clamped)
        b = dr.select(near, b, dr.clip(b, -half_chord, half_chord))
        offset = mi.Vector3f(centre.x + a, dr.fma(b, self.ratio32, centre.y), centre.z)
        distance = dr.select(near, t, dr.norm(offset))
        return a, b, distance * self.lx

    def point(self, a: mi.Float, b: mi.Float) -> mi.Point3f:
        """World-space point with the principal coordinates ``(a, b)``."""
        ex, ey, _ = self.axes32
        centre = mi.Vector3f(self.centre)
        return mi.Point3f(dr.fma(ex, a * self.lx, dr.fma(ey, b * self.ly, centre)))

    def uv(self, a: mi.Float, b: mi.Float) -> mi.Point2f:
        """The (radius, angle / 2π) parameterisation of Mitsuba's `disk` at ``(a, b)``."""
        c, s = mi.Float(self.parameter_cos), mi.Float(self.parameter_sin)
        b = b * mi.Float(self.handedness)
        x = c * a - s * b
        y = s * a + c * b
        v = dr.atan2(y, x) * dr.inv_two_pi
        return mi.Point2f(dr.sqrt(x * x + y * y), dr.select(v < 0, v + 1, v))

    def from_uv(self, uv: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """Principal coordinates at a point of that parameterisation."""
        y, x = dr.sincos(dr.two_pi * uv.y)
        return self.from_disk(mi.Point2f(x * uv.x, y * uv.x))

    def from_disk(self, point: mi.Point2f) -> tuple[mi.Float, mi.Float]:
        """Principal coordinates of a point of the unit disk before `to_world`."""
        c, s = mi.Float(self.parameter_cos), mi.Float(self.parameter_sin)
        a = c * point.x + s * point.y
        b = c * point.y - s * point.x
        return a, b * mi.Float(self.handedness)


def from_transform(to_world) -> Ellipse:
    """Principal axes of the image of the unit disk under an affine map.

    These are the singular vectors of the image axes ``[U W]``, in double precision. The angle of
    the major axis on the disk is ``½ atan2(2 U·W, U·U - W·W)``. The shorter length follows from the
    area, which loses nothing on needles.

    Parameters
    ----------
    to_world
        A transform of any precision, or its 4×4 matrix. It maps the unit disk of the object-space
        XY plane to the light. The side towards the image of +Z emits. Mitsuba's `disk` does the
        same, also under mirrors.
    """
    matrix = mi.Matrix4d(getattr(to_world, "matrix", to_world))
    u, w, centre = (mi.Vector3d(matrix[0, k], matrix[1, k], matrix[2, k]) for k in (0, 1, 3))
    image_z = mi.Vector3d(matrix[0, 2], matrix[1, 2], matrix[2, 2])

    uu, ww, uw = dr.dot(u, u), dr.dot(w, w), dr.dot(u, w)
    sin_t, cos_t = dr.sincos(0.5 * dr.atan2(2 * uw, uu - ww))
    major = u * cos_t + w * sin_t
    lx = dr.norm(major)
    ex = major / lx

    area_normal = cross(u, w)
    area_over_pi = dr.norm(area_normal)
    ratio = dr.minimum(area_over_pi / (lx * lx), 1)
    handedness = dr.mulsign(mi.Float64(1), dr.dot(area_normal, image_z))
    normal = area_normal * (handedness / area_over_pi)
    ey = cross(normal, ex)

    return Ellipse(
        centre=mi.Point3d(centre),
        ex=ex,
        ey=ey,
        inv_lx=dr.rcp(lx),
        ratio=ratio,
        lx=mi.Float(lx),
        inv_ratio=mi.Float(dr.rcp(ratio)),
        parameter_cos=cos_t,
        parameter_sin=sin_t,
        handedness=handedness,
    )
