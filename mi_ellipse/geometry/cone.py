"""The elliptical cone of a light: frame, tangent semi-axes, solid angle, vector irradiance."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from .tracing import TINY, cross

# Floor of a difference of eigenvalues, in units of the longer semi-axis. The other difference is
# negligible there. The product of the floor with the square of any ratio of the semi-axes is
# representable.
SMALLEST = 1e-20

# Squared distance from the axis, in units of the longer semi-axis, below which it does not matter.
ON_AXIS = 1e-16

# From here on the first coefficient of the cubic equals its root in single precision. The terms of
# the cubic soon leave the range.
FAR = 1e9

# Least root λ of an ellipsoid, in units of its squared longest semi-axis. A point on the surface
# gets it. Its square is representable.
LOWEST_ROOT = 1e-24

# Steps of Bulirsch's complete elliptic integral (see `solid_angle`).
CEL_STEPS = 6


class Cone(NamedTuple):
    """The cone of directions that meet an elliptical light, or an ellipsoid.

    The directions are those with ``(X/ta)² + (Y/tb)² ≤ 1`` for ``X = d·x / d·z``,
    ``Y = d·y / d·z``, ``d·z > 0``. The axes are given along those of the light.
    """

    x: mi.Vector3f  # Major axis of the tangent ellipse
    y: mi.Vector3f  # Minor axis
    z: mi.Vector3f  # Axis of the cone, towards the light
    ta2: mi.Float  # Squared tangent of the larger half-angle
    tb2: mi.Float  # Squared tangent of the smaller half-angle
    inv_ta2: mi.Float  # 1 / ta2

    @property
    def ta(self) -> mi.Float:
        """Tangent of the larger half-angle."""
        return dr.sqrt(self.ta2)

    @property
    def tb(self) -> mi.Float:
        """Tangent of the smaller half-angle."""
        return dr.sqrt(self.tb2)

    def to_local(self, v: mi.Vector3f) -> mi.Vector3f:
        """Components along ``(x, y, z)`` of a vector given in the light's frame."""
        return mi.Vector3f(dr.dot(v, self.x), dr.dot(v, self.y), dr.dot(v, self.z))

    def from_local(self, v: mi.Vector3f) -> mi.Vector3f:
        """Light-frame vector from its components along ``(x, y, z)``."""
        return dr.fma(self.x, v.x, dr.fma(self.y, v.y, self.z * v.z))


class RoundCone(NamedTuple):
    """The cone of directions that meet a sphere: that of a `Cone` with ``ta = tb``.

    Directions across it are made where they are asked for. Most draws and densities need none.
    """

    z: mi.Vector3f  # Axis of the cone, towards the light
    ta2: mi.Float  # Squared tangent of the half-angle
    inv_ta2: mi.Float  # 1 / ta2
    sine2: mi.Float  # Squared sine of the half-angle

    @property
    def tb2(self) -> mi.Float:
        """Squared tangent of the half-angle."""
        return self.ta2

    @property
    def ta(self) -> mi.Float:
        """Tangent of the half-angle."""
        return dr.sqrt(self.ta2)

    @property
    def tb(self) -> mi.Float:
        """Tangent of the half-angle."""
        return self.ta

    @property
    def cosine2(self) -> mi.Float:
        """Squared cosine of the half-angle."""
        return self.sine2 * self.inv_ta2

    @property
    def height(self) -> mi.Float:
        """One minus the cosine of the half-angle, without cancellation."""
        return self.sine2 / (mi.Float(1) + dr.sqrt(self.cosine2))

    def across(self) -> tuple[mi.Vector3f, mi.Vector3f]:
        """Two axes across the cone, any will do.

        T. Duff et al., *Building an Orthonormal Basis, Revisited* (JCGT 2017).
        """
        x, y, z = self.z
        one = mi.Float(1)
        sign = dr.mulsign(one, z)
        a = -dr.rcp(sign + z)
        b = x * y * a
        return (
            mi.Vector3f(dr.fma(sign * x * x, a, one), sign * b, -sign * x),
            mi.Vector3f(b, dr.fma(y * y, a, sign), -y),
        )

    @property
    def x(self) -> mi.Vector3f:
        """Axis across the cone."""
        return self.across()[0]

    @property
    def y(self) -> mi.Vector3f:
        """The other axis across the cone."""
        return self.across()[1]

    def to_local(self, v: mi.Vector3f) -> mi.Vector3f:
        """Components along ``(x, y, z)`` of a vector given in the light's frame."""
        x, y = self.across()
        return mi.Vector3f(dr.dot(v, x), dr.dot(v, y), dr.dot(v, self.z))

    def from_local(self, v: mi.Vector3f) -> mi.Vector3f:
        """Light-frame vector from its components along ``(x, y, z)``."""
        x, y = self.across()
        return dr.fma(x, v.x, dr.fma(y, v.y, self.z * v.z))


def _positive_root(b: mi.Float, p: mi.Float, k: mi.Float) -> mi.Float:
    """Positive root of ``k x² - b x - p = 0`` for ``p ≥ 0``, ``k > 0``."""
    k, p = k + k, p + p
    q = dr.abs(b) + dr.sqrt(dr.fma(b, b, k * p))
    rising = b > 0
    return dr.select(rising, q, p) / dr.maximum(dr.select(rising, k, q), TINY)


def _taylor(root: mi.Float, a: mi.Float, b: mi.Float, c: mi.Float) -> tuple[mi.Float, ...]:
    """Value, slope and half the second derivative of the cubic ``λ³ - a λ² - b λ - c``."""
    first = root - a
    second = dr.fma(first, root, -b)
    value = dr.fma(second, root, -c)
    first += root
    return value, dr.fma(first, root, second), first + root


def _cauchy(root: mi.Float, a: mi.Float, b: mi.Float, c: mi.Float) -> mi.Float:
    """One step of Cauchy's method towards the largest root of the cubic.

    It solves the Taylor polynomial of second order. It never leaves the side of the root where the
    cubic rises.
    """
    zero = mi.Float(0)
    value, slope, curvature = _taylor(root, a, b, c)
    disc = dr.fma(slope, slope, -4 * curvature * value)
    disc = dr.select(disc > zero, disc, zero)
    return root - (value + value) / dr.maximum(slope + dr.sqrt(disc), TINY)


def _refine(root: mi.Float, a: mi.Float, b: mi.Float, c: mi.Float) -> mi.Float:
    """Largest root of the cubic ``λ³ - a λ² - b λ - c``, from a starting value in two steps.

    The second step is the inverse of the cubic to fourth order (Schröder).
    """
    root = _cauchy(root, a, b, c)
    value, slope, curvature = _taylor(root, a, b, c)
    inv = dr.rcp(slope)
    change = value * inv
    q = change * (curvature * inv)
    one = mi.Float(1)
    root -= change * dr.fma(q, dr.fma(2, q, one), dr.fma(-change * change, inv, one))
    return dr.select(a > FAR, a, root)


def confocal_root(centre: mi.Vector3d, ratio: mi.Float64) -> mi.Float:
    """Positive root λ of ``x²/(1 + λ) + y²/(e² + λ) + z²/λ = 1``.

    It is the largest root of the cubic ``λ³ - a λ² - b λ - c``, and the only positive one. The
    other roots are in ``[-e², 0]`` and ``[-1, -e²]``. Near the rim, only the sums `a` and `b`
    cancel. They are formed in double precision. The root is then well-conditioned in single
    precision, however close the other roots are to it.

    The start is the larger of two values. One is the root of the cubic without its last or its
    first term. The other one is the root of ``r²/(m/r² + λ) + z²/λ = 1`` for ``r² = x² + y²`` and
    ``m = x² + e² y²``: a lower bound by Jensen's inequality, exact for circles and far lights.

    The largest relative error over 1 000 000 lights, most of them needles seen from close to their
    plane and rim, is 1 at the start and 0.015 after one step, in exact arithmetic. After both steps
    in single precision it is 2.6e-7. This holds for ``c > 1e-31``. A needle of aspect 1e6 that is
    seen from less than 3e-10 above its plane has a smaller c. Terms of the cubic then leave the
    range of single precision, and the error can be as large as the root.
    """
    x, y, z = centre
    x2, y2, z2, e2 = dr.fma(x, x, ON_AXIS), y * y, z * z, ratio * ratio
    yz2, x2_less_1 = y2 + z2, x2 - 1
    a = mi.Float(x2_less_1 + yz2 - e2)
    b = mi.Float(dr.fma(x2_less_1 + z2, e2, yz2))
    r2, m = x2 + y2, dr.fma(y2, e2, x2)
    middle = mi.Float(dr.fma(r2, x2 + yz2, -m))
    r2, m, z2 = mi.Float(r2), mi.Float(m), mi.Float(z2)
    c = z2 * mi.Float(e2)

    zero, one = mi.Float(0), mi.Float(1)

    # λ² - a λ - b = 0 or -a λ² - b λ - c = 0
    large = b > zero
    root = _positive_root(dr.select(large, a, b), dr.select(large, b, c), dr.select(large, one, -a))
    other = _positive_root(middle, m * z2, r2)
    root = _refine(dr.select(other > root, other, root), a, b, c)
    return dr.select(root > z2, root, z2)


def coarse_root(
    x2: mi.Float, y2: mi.Float, z2: mi.Float, e2: mi.Float, h2: mi.Float
) -> tuple[mi.Float, mi.Float]:
    """About the positive root λ of ``x²/(1 + λ) + y²/(e² + λ) + z²/(h² + λ) = 1``.

    One step of `_refine` from the start of `confocal_root`, in single precision. Also returns the
    product of λ and the two other roots: the constant term of the cubic, positive outside.
    """
    one = mi.Float(1)
    sum2, eh2 = e2 + h2, e2 * h2
    a = x2 + y2 + z2 - one - sum2
    b = dr.fma(x2, sum2, dr.fma(y2, one + h2, dr.fma(z2, one + e2, -sum2 - eh2)))
    c = dr.fma(x2 - one, eh2, dr.fma(y2, h2, z2 * e2))

    large = b > 0
    root = _positive_root(dr.select(large, a, b), dr.select(large, b, c), dr.select(large, one, -a))
    r2 = x2 + y2
    mean = dr.fma(y2, e2, x2) / dr.maximum(r2, TINY)
    other = _positive_root(r2 + z2 - mean - h2, dr.fma(mean, z2 - h2, h2 * r2), one)
    root = dr.maximum(dr.maximum(root, other), TINY)
    return dr.select(a > FAR, a, _cauchy(root, a, b, c)), c


def of_ellipse(
    position: mi.Vector3d,
    root: mi.Float,
    ratio32: mi.Float,
    inv_ratio: mi.Float,
    eccentricity2: mi.Float,
) -> Cone:
    """Cone of the directions that meet a planar ellipse.

    This is the eigen-decomposition of the dual cone matrix ``U Uᵀ + W Wᵀ - C Cᵀ`` in confocal
    coordinates. In the principal frame of the light, all three eigenvalues follow from one root
    without cancellation. That holds for points in the light's plane, needles and distant lights.

    Parameters
    ----------
    position
        Vector from the reference point to the centre along the light's ``(ex, ey, normal)``, in
        units of the longer semi-axis.
    root
        `confocal_root` of the position.
    ratio32, inv_ratio, eccentricity2
        Shorter over longer semi-axis; its reciprocal; one minus its square.
    """
    centre = mi.Vector3f(position)
    xc, yc, zc = centre
    zero, one, half = mi.Float(0), mi.Float(1), mi.Float(0.5)
    e2 = dr.square(ratio32)
    inv_root, inv_x, inv_y = dr.rcp(root), dr.rcp(one + root), dr.rcp(e2 + root)
    height = zc * inv_root

    z = dr.normalize(mi.Vector3f(xc * (root * inv_x), yc * (root * inv_y), zc))

    # The two positive eigenvalues as μ1 and 1 - μ2/e²
    yy = yc * yc * eccentricity2 * inv_y
    product = 2 * yy * e2  # Twice that of e² - μ2 and μ1 - e²
    t = dr.fma(zc, height, yy)
    sigma = t - e2
    disc = dr.sqrt(dr.fma(sigma, sigma, product + product))
    mu1 = half * (t + e2 + disc)
    larger = dr.maximum(dr.abs(sigma) + disc, SMALLEST)
    m2 = dr.select(sigma > zero, product * dr.rcp(larger), half * larger)

    # μ1 μ2 μ3 = det² gives the smaller eigenvalue its full precision
    inv_mu1 = dr.rcp(mu1)
    ta2 = mu1 * inv_root
    tb2 = dr.square(height) * (e2 * inv_mu1)

    # Minor axis. It vanishes for a circle seen on its axis, where every direction across will do.
    along = eccentricity2 + m2
    y = mi.Vector3f(
        xc * height * m2,
        yc * height * along,
        -(dr.square(inv_ratio) * mu1 * m2) * along,
    )
    y = _minor_axis(y, z, mi.Vector3f(zero, one, zero))
    return Cone(cross(y, z), y, z, ta2, tb2, root * inv_mu1)


def _minor_axis(y: mi.Vector3f, z: mi.Vector3f, otherwise: mi.Vector3f) -> mi.Vector3f:
    """Make an axis orthogonal to z. Take another axis where only rounding is left of it.

    It is also rounding if its square is below the normal numbers, which have fewer digits there.
    """
    size2, overlap = dr.squared_norm(y), dr.dot(y, z)
    left2 = dr.fma(-overlap, overlap, size2)
    y = (y - z * overlap) * dr.rsqrt(left2)
    return dr.select(left2 > dr.fma(0.25, size2, TINY), y, otherwise)


class Confocal(NamedTuple):
    """Coefficients in double precision of the cubic whose largest root is λ.

    The cubic is that of ``x²/(1 + λ) + y²/(e² + λ) + z²/(h² + λ) = 1``, for an ellipsoid with the
    semi-axes 1, e, h and its centre at (x, y, z). Near the surface only these sums cancel.
    """

    x2: mi.Float64
    y2: mi.Float64
    z2: mi.Float64
    e2: mi.Float64
    h2: mi.Float64
    x2_less_1: mi.Float64
    z2_less_h2: mi.Float64
    c: (
        mi.Float64
    )  # Minus the constant term: e² h² (|o|² - 1), o the point where it is a unit sphere


def confocal(centre: mi.Vector3d, ratio: mi.Float64, flatness: mi.Float64) -> Confocal:
    """What the root needs that cancels, for the semi-axes 1, e = ratio, h = flatness."""
    x, y, z = centre
    x2, y2, z2, e2, h2 = dr.fma(x, x, ON_AXIS), y * y, z * z, ratio * ratio, flatness * flatness
    x2_less_1 = x2 - 1
    c = dr.fma(dr.fma(x2_less_1, e2, y2), h2, z2 * e2)
    return Confocal(x2, y2, z2, e2, h2, x2_less_1, z2 - h2, c)


def _merged(
    weight: mi.Float64, moment: mi.Float64, other: mi.Float64, excess: mi.Float64, pole: mi.Float64
) -> mi.Float:
    """Positive root of ``w/(m/w + λ) + v/(p + λ) = 1``: two poles merged into their mean.

    Parameters
    ----------
    weight, moment
        w and m of the merged poles.
    other, excess, pole
        v, ``v - p`` and p of the third pole.
    """
    mean = moment / dr.maximum(weight, ON_AXIS)
    b = mi.Float(weight + excess - mean)
    p = mi.Float(dr.maximum(dr.fma(weight, pole, mean * excess), 0))
    return _positive_root(b, p, mi.Float(1))


def confocal_root_of_solid(terms: Confocal) -> mi.Float:
    """Largest root λ of ``x²/(1 + λ) + y²/(e² + λ) + z²/(h² + λ) = 1``, positive outside.

    The start is the larger of two lower bounds by Jensen's inequality: the poles of x and y, or of
    y and z, merged into their mean.
    """
    x2, y2, z2, e2, h2, x2_less_1, z2_less_h2, c = terms
    r2, s2, moment = x2 + y2, y2 + z2, y2 * e2
    a = mi.Float(x2_less_1 + (y2 - e2) + z2_less_h2)
    b = mi.Float(dr.fma(x2_less_1 + z2, e2, dr.fma(x2_less_1 + y2 - e2, h2, s2)))

    root = _merged(r2, x2 + moment, z2, z2_less_h2, h2)
    other = _merged(s2, dr.fma(z2, h2, moment), x2, x2_less_1, mi.Float64(1))
    root = dr.select(other > root, other, root)
    root = _refine(root, a, b, mi.Float(dr.maximum(c, 0)))
    return dr.maximum(root, mi.Float(dr.maximum(z2_less_h2, LOWEST_ROOT)))


def of_ellipsoid(centre: mi.Vector3f, root: mi.Float, ratio: mi.Float, flatness: mi.Float) -> Cone:
    """Cone of the directions that meet an ellipsoid; with a flatness of 0 that of `of_ellipse`.

    Parameters
    ----------
    centre
        Vector from the reference point to the centre along the semi-axes, in units of the longest.
    root
        Its `confocal_root_of_solid`.
    ratio, flatness
        Middle and shortest over longest semi-axis.
    """
    xc, yc, zc = centre
    zero, one, half = mi.Float(0), mi.Float(1), mi.Float(0.5)
    e2, h2 = dr.square(ratio), dr.square(flatness)
    # Differences of the squared semi-axes
    xy, yz = (one - ratio) * (one + ratio), (ratio - flatness) * (ratio + flatness)
    low = h2 + root
    inv_root, inv_x, inv_y = dr.rcp(root), dr.rcp(one + root), dr.rcp(e2 + root)
    height = zc * dr.rcp(low)
    wx, wy, wz = xc * xc * inv_x, yc * yc * inv_y, zc * height

    z = dr.normalize(mi.Vector3f(xc * (low * inv_x), yc * (low * inv_y), zc))

    # The two positive eigenvalues as μ1 - e² and (e² - μ2) / (e² - h²)
    sigma = dr.fma(xy, wy + wz, -yz * (wx + wy))
    product = 2 * wy * xy
    disc = dr.sqrt(dr.fma(sigma, sigma, 2 * product * yz))
    m1 = half * (sigma + disc)
    larger = dr.maximum(dr.abs(sigma) + disc, SMALLEST)
    m2 = dr.select(
        sigma > zero, product * dr.rcp(larger), half * larger * dr.rcp(dr.maximum(yz, SMALLEST))
    )

    # μ1 μ2 μ3, a sum of one sign, gives the smaller eigenvalue its full precision
    mu1 = e2 + m1
    inv_mu1 = dr.rcp(mu1)
    ta2 = mu1 * inv_root
    tb2 = dr.minimum(dr.fma(wz, e2, h2 * dr.fma(wx, e2, wy)) * (inv_mu1 * inv_root), ta2)

    # Minor axis; in a plane of symmetry, and for spheres, any direction across will do.
    along, steep = dr.fma(yz, m2, xy), (xy + yz) * height
    y = mi.Vector3f(xc * steep * (yz * m2), yc * steep * along, -(m1 + yz) * m2 * along)
    beside = dr.abs(z.y) < 0.9
    across = mi.Vector3f(zero, dr.select(beside, one, zero), dr.select(beside, zero, one))
    across = dr.normalize(across - z * dr.dot(across, z))
    y = _minor_axis(y, z, across)
    return Cone(cross(y, z), y, z, ta2, tb2, root * inv_mu1)


def solid_angle(cone: Cone | RoundCone) -> mi.Float:
    """Solid angle of the cone.

    It is ``(4/3) ta tb R_J(0, 1 + ta², 1 + tb², 1)`` (Carlson), here in Bulirsch's form of the
    complete elliptic integral. 6 steps are exact to 6e-7 over half-angle tangents in [1e-6, 1e6].
    """
    if isinstance(cone, RoundCone):
        return dr.two_pi * cone.height
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


def vector_irradiance(cone: Cone | RoundCone) -> mi.Vector3f:
    """Integral of the direction over the cone, in the frame in which the axes are given.

    It is ``π sin α sin β z`` with the half-angles α and β and the axis z: Heitz and Hill,
    *Real-Time Line- and Disk-Light Shading with Linearly Transformed Cosines* (SIGGRAPH course,
    2017). Its product with a normal is the irradiance from a unit radiance, if the light is above
    the horizon.
    """
    sines = cone.ta * cone.tb / dr.sqrt((1 + cone.ta2) * (1 + cone.tb2))
    return cone.z * (dr.pi * sines)
