"""The ellipsoid: principal axes, surface, and how it is seen from a point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from . import cone
from .cone import Cone, Confocal
from .light import Hit, View, field_values
from .sphere import LEAST_COSINE2, longitude_and_colatitude
from .tracing import TINY, cross

# Sweeps of the Jacobi rotations that find the principal axes. They converge cubically: after four
# the axes are orthogonal to 1e-15, up to ratios of 1e6 under shears.
SWEEPS = 5


class EllipsoidView(View):
    """An ellipsoid as it is seen from a point, along its ``(ex, ey, ez)``."""

    @cached_property
    def confocal(self) -> Confocal:
        """What cancels near the surface, in double precision."""
        return cone.confocal(self.position, self.light.ratio, self.light.flatness)

    @cached_property
    def excess(self) -> mi.Float:
        """Squared distance from the centre less one, where the ellipsoid is the unit sphere."""
        light = self.light
        return mi.Float(self.confocal.c) * dr.square(light.inv_ratio * light.inv_flatness)

    @cached_property
    def root(self) -> mi.Float:
        """The confocal root, on which the whole cone rests."""
        return cone.confocal_root_of_solid(self.confocal)

    @cached_property
    def cone(self) -> Cone:
        """The cone of directions that meet the light."""
        return cone.of_ellipsoid(self.centre, self.root, self.light.ratio32, self.light.flatness32)

    @property
    def lit(self) -> mi.Mask:
        """True outside: the light shines outwards.

        The sign is that of the double-precision constant term.
        """
        return self.excess > mi.Float(0)

    @property
    def outside(self) -> mi.Mask:
        """True outside: inside, every direction meets the light."""
        return self.lit


@dataclass
class SemiAxes:
    """The numbers of an ellipsoid that follow from its transform, without its centre."""

    ex: mi.Vector3d  # Directions of the longest
    ey: mi.Vector3d  # and of the middle semi-axis
    inv_lx: mi.Float64  # 1 / lx
    ratio: mi.Float64  # Middle semi-axis over lx, in (0, 1]
    flatness: mi.Float64  # Shortest semi-axis over lx, in (0, ratio]
    lx: mi.Float  # Length of the longest semi-axis
    inv_ratio: mi.Float  # 1 / ratio
    inv_flatness: mi.Float  # 1 / flatness
    parameter_x: mi.Vector3f  # Rows of the rotation (or reflection) that takes coordinates of the
    parameter_y: mi.Vector3f  # principal unit sphere to those of the unit sphere before `to_world`;
    parameter_z: mi.Vector3f  # for textures alone


@dataclass
class StoredEllipsoid(SemiAxes):
    """An ellipsoid as a lamp keeps it between traces; arrays of many too."""

    centre: mi.Point3f  # Mitsuba keeps transforms in single precision

    def light(self) -> Ellipsoid:
        """Return the light for one trace."""
        return Ellipsoid(**(field_values(self) | {"centre": mi.Point3d(self.centre)}))


@dataclass
class Ellipsoid(SemiAxes):
    """An ellipsoid in world space that shines outwards, for one trace.

    It is ``{centre + lx (q.x ex + ratio q.y ey + flatness q.z ez) : |q| ≤ 1}``; q are the
    coordinates of the *unit sphere*. Whatever cancels against the reference point is in double
    precision.
    """

    planar: ClassVar[bool] = False

    centre: mi.Point3d

    def stored(self) -> StoredEllipsoid:
        """Return what a lamp keeps."""
        return StoredEllipsoid(**(field_values(self) | {"centre": mi.Point3f(self.centre)}))

    def seen_from(self, point: mi.Point3f) -> EllipsoidView:
        """Return the view of the light from a world-space point."""
        return EllipsoidView(self, self.light_coordinates(point))

    @cached_property
    def ez(self) -> mi.Vector3d:
        """Direction of the shortest semi-axis."""
        return cross(self.ex, self.ey)

    @cached_property
    def axes32(self) -> tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]:
        """``(ex, ey, ez)`` in single precision."""
        return mi.Vector3f(self.ex), mi.Vector3f(self.ey), mi.Vector3f(self.ez)

    @cached_property
    def ratio32(self) -> mi.Float:
        """The ratio in single precision."""
        return mi.Float(self.ratio)

    @cached_property
    def flatness32(self) -> mi.Float:
        """The flatness in single precision."""
        return mi.Float(self.flatness)

    @property
    def area(self) -> mi.Float:
        """Surface area in world units, from values that are known.

        ``4π R_G(a²b², a²c², b²c²)`` with the symmetric elliptic integral of the second kind (B. C.
        Carlson, *Numerical computation of real or complex elliptic integrals*, 1995).
        """
        from scipy.special import elliprg  # Slow to import, and seldom needed

        b, c, a = (np.array(v, dtype=float) for v in (self.ratio, self.flatness, self.lx))
        return mi.Float(4 * np.pi * a**2 * elliprg(b**2, c**2, (b * c) ** 2))

    def light_coordinates(self, reference: mi.Point3f) -> mi.Vector3d:
        """Vector from a world-space point to the centre, along ``(ex, ey, ez)`` in units of lx."""
        offset = (mi.Point3d(self.centre) - mi.Point3d(reference)) * self.inv_lx
        return mi.Vector3d(
            dr.dot(offset, self.ex), dr.dot(offset, self.ey), dr.dot(offset, self.ez)
        )

    def to_light(self, v: mi.Vector3f) -> mi.Vector3f:
        """Components of a world-space vector along ``(ex, ey, ez)``."""
        ex, ey, ez = self.axes32
        return mi.Vector3f(dr.dot(v, ex), dr.dot(v, ey), dr.dot(v, ez))

    def to_world(self, v: mi.Vector3f) -> mi.Vector3f:
        """World-space vector from its components along ``(ex, ey, ez)``."""
        ex, ey, ez = self.axes32
        return dr.fma(ex, v.x, dr.fma(ey, v.y, ez * v.z))

    def to_sphere(self, v: mi.Vector3f) -> mi.Vector3f:
        """Map a vector along ``(ex, ey, ez)`` to the unit sphere; or a point of it to a normal."""
        return mi.Vector3f(v.x, v.y * self.inv_ratio, v.z * self.inv_flatness)

    def from_sphere(self, q: mi.Vector3f) -> mi.Vector3f:
        """Vector along ``(ex, ey, ez)`` from the centre to a point of the unit sphere."""
        return mi.Vector3f(q.x, q.y * self.ratio32, q.z * self.flatness32)

    # ---- Points of the surface ----

    def surface_direction(
        self, view: EllipsoidView, u: mi.Point2f
    ) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction to a point uniform on the unit sphere, its density, whether the point is seen.

        For a sphere it is uniform on the surface. The point is seen where the view is on the outer
        side of its tangent plane. From the point, the density loses less than `surface_density`
        does, for which single precision has no digit left from some 1e6 sizes away.
        """
        q = mi.Vector3f(mi.warp.square_to_uniform_sphere(u))
        offset = view.centre + self.from_sphere(q)
        distance = dr.maximum(dr.norm(offset), TINY)  # The view may be at the very point
        d = offset / distance
        on_sphere = self.to_sphere(d)
        cosine = -dr.dot(q, on_sphere)
        pdf = self._surface_density(distance, dr.square(cosine), on_sphere)
        return d, pdf, dr.dot(q, self.to_sphere(view.centre)) < -1

    def surface_density(self, view: EllipsoidView, direction: mi.Vector3f) -> mi.Float:
        """Density per solid angle of a direction from `surface_direction`."""
        t, disc, _, d, _ = self._nearer_hit(view, direction)
        return self._surface_density(t, disc, d)

    def _surface_density(self, t: mi.Float, cosine2: mi.Float, d: mi.Vector3f) -> mi.Float:
        """``t² / (4π e h |q·d|)`` for the distance t, with q and d on the unit sphere."""
        cosine2 = dr.maximum(cosine2, LEAST_COSINE2 * dr.squared_norm(d))
        density = dr.inv_four_pi * (self.inv_ratio * self.inv_flatness)
        return density * dr.square(t) * dr.rsqrt(cosine2)

    def sample_surface(self, u: mi.Point2f) -> tuple[mi.Point3f, mi.Normal3f, mi.Point2f]:
        """World-space point that is uniform on the unit sphere, the normal and uv there."""
        q = mi.Vector3f(mi.warp.square_to_uniform_sphere(u))
        return self.point(q), self.normal(q), self.uv(q)

    def surface_pdf(self, p: mi.Point3f) -> mi.Float:
        """Density per area of `sample_surface`: ``1/(4π lx² e h |A⁻ᵀ q|)``."""
        offset = self.to_light(mi.Vector3f(p - mi.Point3f(self.centre))) * mi.Float(self.inv_lx)
        q = dr.normalize(self.to_sphere(offset))
        size2 = dr.square(self.lx) * self.ratio32 * self.flatness32
        return dr.inv_four_pi / (size2 * dr.norm(self.to_sphere(q)))

    def point(self, q: mi.Vector3f) -> mi.Point3f:
        """World-space point of the surface."""
        return mi.Point3f(self.to_world(self.from_sphere(q)) * self.lx + mi.Vector3f(self.centre))

    def normal(self, q: mi.Vector3f) -> mi.Normal3f:
        """World-space normal at a point of the surface."""
        return mi.Normal3f(self.to_world(dr.normalize(self.to_sphere(q))))

    def uv(self, q: mi.Vector3f) -> mi.Point2f:
        """Longitude and colatitude of the unit sphere before `to_world`: those of `sphere`."""
        rows = self.parameter_x, self.parameter_y, self.parameter_z
        return longitude_and_colatitude(*(dr.dot(row, q) for row in rows))

    # ---- Where a direction meets it ----

    def hit(self, view: EllipsoidView, direction: mi.Vector3f) -> Hit:
        """Return the nearer point where a drawn direction meets the light.

        Parameters
        ----------
        view
            The light as it is seen from a reference point outside.
        direction
            Unit direction along ``(ex, ey, ez)`` that meets the light.
        """
        q, t = self.point_from_direction(view, direction)
        return Hit(self.point(q), self.normal(q), self.uv(q), t * self.lx)

    def point_from_direction(
        self, view: EllipsoidView, direction: mi.Vector3f
    ) -> tuple[mi.Vector3f, mi.Float]:
        """Point of the unit sphere that a direction meets, and its distance in units of lx."""
        t, disc, o, d, moment = self._nearer_hit(view, direction)
        along2 = dr.squared_norm(d)
        # From far away the point nearest to the ray's line loses less than the ray does.
        inv = dr.rcp(along2)
        across = (cross(d, moment) - d * dr.sqrt(disc)) * inv
        far = dr.squared_norm(o) > 4
        q = dr.select(far, across, dr.fma(d, t, o))
        return q * dr.rsqrt(dr.maximum(dr.squared_norm(q), TINY)), t

    def _nearer_hit(
        self, view: EllipsoidView, direction: mi.Vector3f
    ) -> tuple[mi.Float, mi.Float, mi.Vector3f, mi.Vector3f, mi.Vector3f]:
        """Distance in units of lx, ``|d|² - |o × d|²``, and o, d, ``o × d`` on the unit sphere.

        The discriminant is not ``(o·d)² - |d|² (|o|² - 1)``, which cancels far away; it is floored
        at 0, for a direction that rounding moved beside the light.
        """
        o, d = -self.to_sphere(view.centre), self.to_sphere(direction)
        moment = cross(o, d)
        disc = dr.maximum(dr.squared_norm(d) - dr.squared_norm(moment), 0)
        towards = dr.maximum(-dr.dot(o, d), 0)
        t = view.excess / dr.maximum(towards + dr.sqrt(disc), TINY)
        return t, disc, o, d, moment


def from_transform(to_world) -> Ellipsoid:
    """Principal axes of the image of the unit ball under an affine map.

    The singular value decomposition of its linear part, in double precision.

    Parameters
    ----------
    to_world
        An invertible transform of any precision, or its 4×4 matrix.
    """
    matrix = mi.Matrix4d(getattr(to_world, "matrix", to_world))
    columns, right = _singular_vectors(
        [mi.Vector3d(matrix[0, k], matrix[1, k], matrix[2, k]) for k in range(3)]
    )
    lengths = [dr.norm(column) for column in columns]
    for i, k in ((0, 1), (1, 2), (0, 1)):
        swap = lengths[i] < lengths[k]
        for values in (lengths, columns, right):
            values[i], values[k] = (
                dr.select(swap, values[k], values[i]),
                dr.select(swap, values[i], values[k]),
            )
    (a, b, c), (ex, ey, ez) = lengths, (v / n for v, n in zip(columns, lengths, strict=True))

    # The third axis is ex × ey. Where that is the other way, so is the coordinate along it.
    right[2] = right[2] * dr.mulsign(mi.Float64(1), dr.dot(cross(ex, ey), ez))
    ratio, flatness = b / a, c / a
    return Ellipsoid(
        centre=mi.Point3d(matrix[0, 3], matrix[1, 3], matrix[2, 3]),
        ex=ex,
        ey=ey,
        inv_lx=dr.rcp(a),
        ratio=ratio,
        flatness=flatness,
        lx=mi.Float(a),
        inv_ratio=mi.Float(dr.rcp(ratio)),
        inv_flatness=mi.Float(dr.rcp(flatness)),
        parameter_x=mi.Vector3f(right[0].x, right[1].x, right[2].x),
        parameter_y=mi.Vector3f(right[0].y, right[1].y, right[2].y),
        parameter_z=mi.Vector3f(right[0].z, right[1].z, right[2].z),
    )


def _singular_vectors(
    columns: list[mi.Vector3d],
) -> tuple[list[mi.Vector3d], list[mi.Vector3d]]:
    """Left singular vectors times singular values, and right singular vectors, in any order.

    One-sided Jacobi rotations make the columns orthogonal (M. R. Hestenes, *Inversion of Matrices
    by Biorthogonalization and Related Results*, 1958). They keep the relative precision of short
    columns.
    """
    right = [mi.Vector3d(1, 0, 0), mi.Vector3d(0, 1, 0), mi.Vector3d(0, 0, 1)]
    for _ in range(SWEEPS):
        for i, k in ((0, 1), (0, 2), (1, 2)):
            u, v = columns[i], columns[k]
            overlap = dr.dot(u, v)
            zeta = 0.5 * (dr.squared_norm(v) - dr.squared_norm(u))
            rest = dr.abs(zeta) + dr.sqrt(zeta * zeta + overlap * overlap)
            t = overlap / dr.maximum(rest, 1e-300)
            t = dr.mulsign(t, zeta)
            c = dr.rsqrt(1 + t * t)
            s = c * t
            for values in (columns, right):
                values[i], values[k] = (
                    values[i] * c - values[k] * s,
                    values[i] * s + values[k] * c,
                )
    return columns, right
