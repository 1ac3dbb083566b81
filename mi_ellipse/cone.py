"""The elliptical cone seen from a point: frame, tangent semi-axes, solid angle, irradiance."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from .ellipse import Ellipse

# Smallest normal single-precision number: a floor for denominators whose numerators vanish too.
TINY = 1.1754944e-38

# Steps of the confocal root before the last one, Newton's.
ROOT_STEPS = 2

# Part of the sum below which the weight of a pole does not matter to a step. It keeps products
# within the range of single precision.
NEGLIGIBLE = 1e-12

# Steps of Bulirsch's complete elliptic integral (see `solid_angle`).
CEL_STEPS = 6


class Cone(NamedTuple):
    """The cone of directions that meet an elliptical light.

    The directions are those with ``(X/ta)² + (Y/tb)² ≤ 1`` for ``X = d·x / d·z``,
    ``Y = d·y / d·z``, ``d·z > 0``. The axes are given along the light's ``(ex, ey, normal)``.
    """

    x: mi.Vector3f  # Major axis of the tangent ellipse
    y: mi.Vector3f  # Minor axis
    z: mi.Vector3f  # Axis of the cone, towards the light
    ta: mi.Float  # Tangent of the larger half-angle
    tb: mi.Float  # Tangent of the smaller half-angle
    ta2: mi.Float  # Their squares, which cost less
    tb2: mi.Float

    def to_local(self, v: mi.Vector3f) -> mi.Vector3f:
        """Components along ``(x, y, z)`` of a vector given in the light's frame."""
        return mi.Vector3f(dr.dot(v, self.x), dr.dot(v, self.y), dr.dot(v, self.z))

    def from_local(self, v: mi.Vector3f) -> mi.Vector3f:
        """Light-frame vector from its components along ``(x, y, z)``."""
        return self.x * v.x + self.y * v.y + self.z * v.z


def _positive_root(b: mi.Float, p: mi.Float, k: mi.Float = 1.0) -> mi.Float:
    """Positive root of ``k x² - b x - p = 0`` for ``p ≥ 0``, ``k > 0``."""
    q = 0.5 * (dr.abs(b) + dr.sqrt(dr.fma(b, b, 4 * k * p)))
    return dr.select(b > 0, q, p) / dr.maximum(dr.select(b > 0, k, q), TINY)


class Root(NamedTuple):
    """Root of the confocal equation, and the reciprocals of its denominators."""

    value: mi.Float  # λ
    inverse: mi.Float  # 1 / λ
    inverse_x: mi.Float  # 1 / (1 + λ)
    inverse_y: mi.Float  # 1 / (e² + λ)


def confocal_root(centre: mi.Vector3d, ratio: mi.Float64) -> Root:
    """Positive root λ of ``x²/(1 + λ) + y²/(e² + λ) + z²/λ = 1``.

    Every step replaces two of the three poles by one and a constant, which have the same value and
    two derivatives at the current λ, keeps the third, and solves the quadratic (Gragg's scheme for
    secular equations; Borges and Gragg 1993); the last step is Newton's. What cancels near the rim,
    the values at λ = 0 of the sums less one, is formed once in double precision; the steps need
    only single precision.

    Largest relative error over 300 000 lights, most of them needles seen from close to their plane
    and rim: 4e-7 for 99.99 %, 5e-3 for the worst of all, with two steps or more.
    """
    x2, y2, z2 = centre.x * centre.x, centre.y * centre.y, centre.z * centre.z
    e2 = ratio * ratio
    # For the poles of x and y: (sum - 1) (1 + λ) (e² + λ) = in_plane + λ linear - λ²
    outside_x = mi.Float(x2 - 1)
    in_plane = mi.Float((x2 - 1) * e2 + y2)
    linear = mi.Float((x2 - 1) - e2 + y2)
    x2, y2, z2, e2 = mi.Float(x2), mi.Float(y2), mi.Float(z2), mi.Float(e2)

    # An upper bound: the poles of x and y merged, or, close to the light, those of y and z
    outside = x2 + y2 + z2 > 1
    root = _positive_root(
        dr.select(outside, x2 + y2 + z2 - e2, outside_x + y2 + z2),
        dr.select(outside, z2 * e2, y2 + z2),
    )
    for _ in range(ROOT_STEPS):
        # Merge y's pole with z's, at 0, where λ is beyond it, otherwise with x's, at 1. Of the two,
        # the near one has the weight `w1` and the distance `p1` from -λ.
        far = root > e2
        w1, w2 = dr.select(far, z2, y2), dr.select(far, y2, x2)
        p1 = root + dr.select(far, 0.0, e2)
        w1 = dr.maximum(w1, NEGLIGIBLE * p1)
        inv_p2 = dr.rcp(root + dr.select(far, e2, 1.0))
        t = p1 * inv_p2
        s = w2 * t * t
        # Their sum v has the derivatives -m2 / p1² and 2 m3 / p1³.
        m2, m3 = w1 + s, dr.fma(s, t, w1)
        inv = dr.rcp(m3 * p1)
        inv_m3, inv_p1 = inv * p1, inv * m3
        ratio = m2 * inv_m3
        # The pole -d, the weight w and the constant 1 - k of the same value and derivatives
        d = p1 * s * (1 - t) * inv_m3 + dr.select(far, 0.0, e2)
        w = m2 * dr.square(ratio)
        excess = dr.fma(root, linear - root, in_plane) * inv_p2  # (v - 1) p1, if not far
        constant = w1 * w2 * t * dr.square(1 - t) * inv
        k = dr.select(far, 1 - constant, dr.fma(m2, ratio, -excess) * inv_p1)
        b = dr.select(
            far,
            outside_x + w + dr.fma(constant, 1 - d, d),
            dr.fma(k, root, excess * ratio) + z2,
        )
        p, q = dr.select(far, w, z2) * inv_p1, dr.select(far, 1 - d, d) * inv_p1
        # In units of p1, the squares stay within the range of single precision.
        root = _positive_root(b * inv_p1, p * q, k) * p1 - dr.select(far, d, 0.0)
        root = dr.maximum(root, z2)

    inverse, inverse_x, inverse_y = dr.rcp(root), dr.rcp(1 + root), dr.rcp(e2 + root)
    excess = dr.fma(root, linear - root, in_plane) * inverse_x * inverse_y
    wx, wy, wz = x2 * dr.square(inverse_x), y2 * dr.square(inverse_y), z2 * dr.square(inverse)
    change = (excess + z2 * inverse) / (wx + wy + wz)
    # The change is so small that the reciprocals can follow it linearly.
    return Root(
        root + change,
        inverse * (1 - change * inverse),
        inverse_x * (1 - change * inverse_x),
        inverse_y * (1 - change * inverse_y),
    )


def from_point(ellipse: Ellipse, reference: mi.Point3f) -> Cone:
    """Cone of the directions from a world-space point that meet a light.

    Eigen-decomposition of the dual cone matrix ``U Uᵀ + W Wᵀ - C Cᵀ`` in confocal coordinates:
    in the light's principal frame all three eigenvalues follow from one root without
    cancellation, also for points in the light's plane, needles and distant lights.
    """
    centre = ellipse.light_coordinates(reference)
    ratio, eccentricity2 = ellipse.ratio, ellipse.eccentricity2
    _, inv_root, inv_x_root, inv_y_root = confocal_root(centre, ratio)

    xc, yc, zc = mi.Float(centre.x), mi.Float(centre.y), mi.Float(centre.z)
    e2 = mi.Float(ratio * ratio)
    y2, z2 = yc * yc, zc * zc

    # The two positive eigenvalues as μ1 and 1 - μ2/e²
    yy = y2 * eccentricity2 * inv_y_root
    product = yy * e2  # of e² - μ2 and μ1 - e²
    t = dr.fma(z2, inv_root, yy)
    sigma = t - e2
    disc = dr.sqrt(dr.fma(sigma, sigma, 4 * product))
    mu1 = 0.5 * (t + e2 + disc)
    large = 0.5 * (dr.abs(sigma) + disc)
    m2 = dr.select(sigma > 0, product / dr.maximum(large, TINY), large)

    # μ1 μ2 μ3 = det² gives the smaller eigenvalue its full precision
    ta2 = mu1 * inv_root
    height = zc * inv_root
    tb2 = dr.minimum(ta2, dr.square(height) * e2 / mu1)

    z = dr.normalize(mi.Vector3f(xc * inv_x_root, yc * inv_y_root, height))

    # Minor axis; it vanishes for a circle seen on its axis, where every direction will do.
    y = mi.Vector3f(
        xc * height * (m2 / dr.maximum(eccentricity2 + m2, TINY)),
        yc * height,
        -m2 * dr.square(ellipse.inv_ratio) * mu1,
    )
    # Only rounding is left of it there, or what is along z.
    size2 = dr.squared_norm(y)
    y = y - z * dr.dot(y, z)
    y = dr.normalize(dr.select(dr.squared_norm(y) > 0.25 * size2, y, mi.Vector3f(0, z.z, -z.y)))
    return Cone(x=dr.cross(y, z), y=y, z=z, ta=dr.sqrt(ta2), tb=dr.sqrt(tb2), ta2=ta2, tb2=tb2)


def solid_angle(cone: Cone) -> mi.Float:
    """Solid angle of the cone.

    ``(4/3) ta tb R_J(0, 1 + ta², 1 + tb², 1)`` in Bulirsch's form of the complete elliptic
    integral; 6 steps are exact to 6e-7 over half-angle tangents in [1e-6, 1e6].
    """
    ta, tb = cone.ta, cone.tb
    a = dr.fma(ta, ta, 1)
    kc = dr.sqrt(dr.fma(tb, tb, 1) / a)
    p = dr.rsqrt(a)
    q = dr.rcp(p)
    f_sum, e, m = mi.Float(0), kc, mi.Float(1)
    for _ in range(CEL_STEPS):
        f = f_sum
        f_sum = f + q / p
        g = e / p
        q = 2 * dr.fma(f, g, q)
        p = p + g
        m = m + kc
        kc = 2 * dr.sqrt(e)
        e = kc * m
    cel = 0.5 * dr.pi * dr.fma(f_sum, m, q) / (m * (m + p))
    return 4 * (ta * dr.rsqrt(a)) * (tb / a) * cel
