"""Strategy `projected_solid_angle`: directions almost proportional to the cosine at the surface."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from .. import cone
from ..ellipse import Ellipse

# Squared scale of the tangent of the latitude: the primitive of (1 + c² T²)^(-3/2) is elementary,
# and c² = 4/3 matches the wanted weight cos² λ to second order. Over slices from pole to pole the
# best is 1.7-2: adding up to 0.4 for long slices halves the variance of lights that fill the view.
LATITUDE_SCALE2 = 4 / 3
LONG_SLICES = 0.4

# Needles are cut crosswise: where the cone is this much longer than wide, narrower than this
# tangent, the pole this far outside (squared, 1 being the rim), and this far (sine squared) from
# the plane of the needle, towards which it falls when the normal is perpendicular to that plane.
CROSSWISE_ASPECT = 4
CROSSWISE_TANGENT = 2
CROSSWISE_CLEARANCE = 20
CROSSWISE_SINE2 = 0.05

# Tangent of the latitude up to which single precision resolves directions along a slice. Beyond,
# for lights that almost fill a half-space about the pole, draws are uniform in solid angle.
STEEPEST = 3e4

# A side of the horizon is drawn in proportion to this power of its irradiance. 1 is best for the
# squared error of an image, 0 for the mean relative variance; against ½, 0.4 takes a quarter to a
# third off the latter and adds 9 to 33 % to the former, by class of light.
SIDE_EXPONENT = 0.4

# A side of the horizon thinner than this part of the cone is left to the other side's density.
THINNEST_SIDE = 1e-5

# Share of the draws that cover the whole cone where the horizon is near: without it the density
# falls to zero at the horizon of the geometric normal, where a shading normal's cosine does not.
DEFENSIVE_SHARE = 0.15

# Positions on a side at which the density of the slices is matched: close to both ends, where the
# limits themselves are 0/0, and the median of the Kumaraswamy density.
END_NODE = 0.06
MEDIAN_POWER = 1 - 0.5 ** (2 / 3)


class Slices(NamedTuple):
    """Density of the slices on one side of the horizon.

    The position ``q`` in [0, 1] follows a Kumaraswamy density, warped by one that is linear
    between its values at three quantiles.
    """

    start: mi.Float  # η at q = 0
    extent: mi.Float  # Range of η
    squared: mi.Mask  # Exponent of the Kumaraswamy density: 2, or 3/2 away from a horizon
    s0: mi.Float  # Relative density at the quantiles 0, ½ and 1
    s1: mi.Float
    s2: mi.Float
    total: mi.Float  # Mean of that density


class Record(NamedTuple):
    """What is computed once per reference point.

    Great circles through a pole ``e`` perpendicular to the normal slice the cone, so that the
    horizon is a slice too. A slice is given by ``η = tan(ψ/2)``, ψ the longitude from ``z``
    towards ``m``; all vectors are in the light's frame with its third axis flipped such that the
    light lies above.
    """

    m: mi.Vector3f
    z: mi.Vector3f
    e: mi.Vector3f
    third: mi.Float  # Sign that flips the third axis
    eta_max: mi.Float  # The cone covers [-eta_max, eta_max]
    eta_horizon: mi.Float
    ce: mi.Float  # Tangent of the latitude of the slices' centres: ce cos ψ + sk sin ψ
    sk: mi.Float
    height: mi.Float  # and of their half-lengths, over √(1 - (tan ψ / tan ψmax)²)
    scale: mi.Float  # c of `LATITUDE_SCALE2`, or 1 where there is no normal
    no_normal: mi.Mask  # In media, and where the wedge degenerates: uniform in solid angle
    straddling: mi.Mask  # The horizon divides the cone
    major: Slices  # The side of the horizon with the larger part of the cone, or all of it
    minor: Slices
    minor_share: mi.Float  # Probability of the minor side
    defensive_share: mi.Float


def _select(mask: mi.Mask, a, b):
    """`dr.select` for vectors of any kind."""
    return dr.select(mask, mi.Vector3f(a), mi.Vector3f(b))


def _not(mask: mi.Mask) -> mi.Mask:
    """Negation that also works in scalar variants, where `~` of a `bool` is an integer."""
    return dr.select(mask, mi.Mask(False), mi.Mask(True))


def _any_perpendicular(v: mi.Vector3f) -> mi.Vector3f:
    return _select(dr.abs(v.x) <= dr.abs(v.y), mi.Vector3f(0, v.z, -v.y), mi.Vector3f(-v.z, 0, v.x))


def _slice(record, eta: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
    """The part of a slice that lies in the cone.

    Returns
    -------
    start
        ``s = c T / √(1 + c² T²)`` at its lower end, T the tangent of the latitude.
    length
        Range of s, without cancellation.
    centre
        T at its centre.
    """
    eta2 = eta * eta
    i = dr.rcp(1 + eta2)
    centre = dr.fma(record.ce, 1 - eta2, 2 * record.sk * eta) * i
    inside = (
        (record.eta_max - eta)
        * (record.eta_max + eta)
        * dr.fma(-dr.square(record.eta_max), eta2, 1)
    )
    half = record.height * i * dr.sqrt(dr.maximum(inside, 0)) / record.eta_max

    mid, half = record.scale * centre, record.scale * half
    a, b = mid - half, mid + half
    ra, rb = dr.sqrt(dr.fma(a, a, 1)), dr.sqrt(dr.fma(b, b, 1))
    sa, sb = a / ra, b / rb
    same_side = a * b > 0
    total = dr.maximum(dr.fma(dr.abs(b), ra, dr.abs(a) * rb), cone.TINY)
    stable = 4 * dr.abs(mid) * half / (total * ra * rb)
    return sa, dr.select(same_side, stable, sb - sa), centre


def _weight(record, eta: mi.Float, horizon: mi.Float) -> mi.Float:
    """Integral of the cosine over a slice, up to a constant; of one where there is no normal."""
    _, length, centre = _slice(record, eta)
    i = dr.rcp(1 + dr.square(eta))
    above = dr.abs((eta - horizon) * dr.fma(eta, horizon, 1)) * i
    centre2 = dr.square(centre)
    r = dr.sqrt(dr.fma(dr.square(record.scale), centre2, 1))
    latitude = r * r * r / dr.square(1 + centre2)
    return length * i * dr.select(record.no_normal, 1, above * latitude)


def _slices(record, start, end, squared) -> Slices:
    """Match the density of the slices between two values of η, the horizon being a zero of it."""
    extent = end - start
    values = []
    for power_from_q in (END_NODE, None, 1 - END_NODE):
        if power_from_q is None:
            power2 = power15 = MEDIAN_POWER
            q2, q15 = MEDIAN_POWER ** (1 / 2), MEDIAN_POWER ** (2 / 3)
        else:
            q2 = q15 = power_from_q
            power2, power15 = q2**2, q15**1.5
        kumaraswamy2 = 3 * q2 * (1 - power2) ** 0.5
        kumaraswamy15 = 2.25 * q15**0.5 * (1 - power15) ** 0.5
        eta = dr.fma(extent, dr.select(squared, q2, q15), start)
        values.append(
            _weight(record, eta, record.eta_horizon)
            * dr.select(squared, 1 / kumaraswamy2, 1 / kumaraswamy15)
        )
    s0, s1, s2 = values
    return Slices(start, extent, squared, s0, s1, s2, 0.25 * (s0 + 2 * s1 + s2))


def _kumaraswamy(q: mi.Float, squared: mi.Mask) -> tuple[mi.Float, mi.Float]:
    """Density ``1.5 α q^(α-1) √(1 - q^α)`` and distribution function ``1 - (1 - q^α)^1.5``."""
    q = dr.clip(q, 1e-7, 1)
    rest = dr.maximum(1 - q, 1e-7)
    r = dr.sqrt(q)
    # 1 - q^α without cancellation at q = 1
    g = dr.sqrt(rest * dr.select(squared, 1 + q, (1 + r + q) / (1 + r)))
    return dr.select(squared, 3 * q, 2.25 * r) * g, 1 - g * g * g


def _inverse_kumaraswamy(u: mi.Float, squared: mi.Mask) -> mi.Float:
    """Position at which the distribution function of `_kumaraswamy` is u."""
    g = dr.cbrt(1 - u)
    power = u * (1 + g) / (1 + g + g * g)
    return dr.select(squared, dr.sqrt(power), dr.square(dr.cbrt(power)))


def _slice_density(slices: Slices, eta: mi.Float) -> mi.Float:
    """Density of η on one side."""
    density, u = _kumaraswamy((eta - slices.start) / slices.extent, slices.squared)
    left = u < 0.5
    p0, p1 = dr.select(left, slices.s0, slices.s1), dr.select(left, slices.s1, slices.s2)
    warp = dr.lerp(p0, p1, dr.select(left, 2 * u, 2 * u - 1))
    warp = warp / dr.maximum(slices.total, cone.TINY)
    return density * warp / dr.maximum(dr.abs(slices.extent), cone.TINY)


def _draw_slice(slices: Slices, u: mi.Float) -> mi.Float:
    """η drawn from `_slice_density`."""
    v = 4 * slices.total * u
    left_total = slices.s0 + slices.s1
    left = v < left_total
    v = dr.select(left, v, v - left_total)
    p0 = dr.select(left, slices.s0, slices.s1)
    p1 = dr.select(left, slices.s1, slices.s2)
    t = v / (p0 + dr.sqrt(dr.maximum(dr.fma(v, p1 - p0, p0 * p0), 0)))
    u = dr.clip(0.5 * dr.select(left, t, 1 + t), 1e-9, 1 - 6e-8)
    return dr.fma(slices.extent, _inverse_kumaraswamy(u, slices.squared), slices.start)


def _density(record: Record, eta: mi.Float, tangent: mi.Float) -> mi.Float:
    """Density per solid angle at the slice η and the latitude with this tangent."""
    # Rounding takes directions out of cones that are thinner than the spacing of directions.
    limit = (1 - 3e-7) * record.eta_max
    eta = dr.clip(eta, -limit, limit)
    _, length, _ = _slice(record, eta)
    is_minor = record.straddling & (eta < record.eta_horizon)
    major, minor = _slice_density(record.major, eta), _slice_density(record.minor, eta)
    split = dr.select(is_minor, record.minor_share * minor, (1 - record.minor_share) * major)
    whole, _ = _kumaraswamy(0.5 + 0.5 * eta / record.eta_max, mi.Mask(False))
    whole = 0.5 * whole / record.eta_max
    density = dr.lerp(split, whole, record.defensive_share)

    tangent2 = dr.square(tangent)
    r = dr.sqrt((1 + tangent2) / dr.fma(dr.square(record.scale), tangent2, 1))
    latitude = record.scale * r * r * r / length
    return 0.5 * density * latitude * (1 + dr.square(eta))


class _Wedge(NamedTuple):
    """Slices of the cone through a pole, named as in `Record`."""

    m: mi.Vector3f
    z: mi.Vector3f
    e: mi.Vector3f
    tan_max: mi.Float
    ce: mi.Float
    sk: mi.Float
    height: mi.Float


def _pole(
    n: mi.Vector3f,
    axis: mi.Vector3f,
    frame: tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f],
    ta: mi.Float,
    tb: mi.Float,
) -> mi.Vector3f:
    """A pole perpendicular to the normal and outside the cone.

    Perpendicular to an axis in the dual cone as well it is always outside. Slices along a needle
    that is tilted against them have a weight with a peak that three nodes miss; across it they are
    short and their weight is smooth.

    Parameters
    ----------
    n
        Surface normal.
    axis
        A direction in the dual cone, such as the axis of the cone.
    frame
        The cone's major, minor and central axis.
    ta, tb
        Tangents of the half-angles.
    """
    e = dr.cross(n, axis)
    e = _select(dr.squared_norm(e) < 1e-12, _any_perpendicular(axis), e)
    e = dr.normalize(e)
    e = dr.normalize(e - axis * dr.dot(e, axis))

    x, y, z = frame
    crosswise = y - n * dr.dot(n, y)
    rim2 = dr.square(dr.dot(crosswise, x) / ta) + dr.square(dr.dot(crosswise, y) / tb)
    is_needle = (ta > CROSSWISE_ASPECT * tb) & (tb < CROSSWISE_TANGENT)
    is_outside = rim2 > CROSSWISE_CLEARANCE * dr.square(dr.dot(crosswise, z))
    length2 = dr.squared_norm(crosswise)
    return _select(
        is_needle & is_outside & (length2 > CROSSWISE_SINE2), crosswise * dr.rsqrt(length2), e
    )


def _wedge(c: mi.Vector3f, b: mi.Float, e: mi.Vector3f, inside: mi.Vector3f):
    """Slices of the cone through a pole.

    Parameters
    ----------
    c
        Centre of the light in its own frame, with semi-axes 1 and `b`.
    e
        Pole outside the cone.
    inside
        A direction well inside the cone.

    Returns
    -------
    wedge, valid
        `valid` is false where rounding leaves no wedge, or none that it resolves.
    """
    # Dual conic of the cone's projection along the pole, and its eigenvectors
    g1 = dr.normalize(c - e * dr.dot(c, e))
    g2 = dr.cross(e, g1)
    u1, u2, w1, w2 = g1.x, g2.x, b * g1.y, b * g2.y
    c_perp = dr.dot(c, g1)
    d22, d12 = u2 * u2 + w2 * w2, u1 * u2 + w1 * w2
    d11 = u1 * u1 + w1 * w1 - c_perp * c_perp
    delta = c_perp * c_perp * d22 - dr.square(u1 * w2 - u2 * w1)
    mean = 0.5 * (d11 + d22)
    hyp = dr.sqrt(dr.square(0.5 * (d11 - d22)) + d12 * d12)
    positive = dr.select(  # λ+
        mean >= 0, hyp + mean, delta / dr.maximum(hyp - mean, cone.TINY)
    )
    negative = delta / dr.maximum(positive, cone.TINY)  # λ-
    valid = (positive > 0) & (negative > 0) & dr.isfinite(positive) & dr.isfinite(negative)
    positive, negative = dr.select(valid, positive, 1), dr.select(valid, negative, 1)

    z = dr.normalize(g1 * (d22 + negative) - g2 * d12)
    z = z * dr.sign(dr.dot(z, inside))
    m = dr.cross(e, z)

    def dual(p, q):
        return p.x * q.x + b * b * p.y * q.y - dr.dot(c, p) * dr.dot(c, q)

    ce, sk = -dual(e, z) / negative, dual(m, e) / positive
    height = b * c.z / (negative * dr.sqrt(positive))
    valid &= dr.abs(ce) + dr.abs(sk) + height < STEEPEST
    wedge = _Wedge(
        m=m,
        z=z,
        e=e,
        tan_max=dr.sqrt(positive / negative),
        ce=ce,
        sk=sk,
        height=height,
    )
    return wedge, valid


class ProjectedSolidAngle:
    """Directions almost proportional to the cosine at the surface, over the whole light.

    The cone is cut into slices that the horizon does not cross; a slice is drawn from a density
    that matches the integral of the cosine over it at three of them, and the latitude along it in
    closed form. The density is exact and no iteration is needed.

    The renderer tells an emitter the geometric normal and not which side of the surface is seen.
    Where the horizon divides the cone, each side gets a share of the draws in proportion to a
    power of its irradiance; where the horizon is near, a share of the draws covers the whole
    cone. So the estimate is unbiased for two-sided, transmitting, bumped and smoothly shaded
    surfaces. In media, where there is no normal, directions are almost uniform in solid angle.

    Parameters
    ----------
    one_sided
        Draw only what lies above the surface, on the side of its geometric normal: less variance,
        and a *biased* picture of surfaces seen from behind, of transmission, and of shading
        normals that differ from the geometric one.
    """

    def __init__(self, one_sided: bool = False):
        self.one_sided = one_sided

    def prepare(self, ellipse: Ellipse, reference: mi.Point3f, normal: mi.Normal3f) -> Record:
        """Wedge of a reference point and its normal."""
        seen = cone.from_point(ellipse, reference)
        c = mi.Vector3f(ellipse.light_coordinates(reference))
        third = dr.sign(c.z)
        flip = mi.Vector3f(1, 1, third)
        c = c * flip
        b = mi.Float(ellipse.ratio)
        n = ellipse.to_light(normal) * flip
        x, y, z = seen.x * flip, seen.y * flip, seen.z * flip

        inside_dual = dr.dot(z, c) > dr.sqrt(z.x * z.x + dr.square(b * z.y))
        axis = _select(inside_dual, z, mi.Vector3f(0, 0, 1))
        wedge, valid = _wedge(c, b, _pole(n, axis, (x, y, z), seen.ta, seen.tb), z)
        no_normal = (dr.squared_norm(n) == 0) | _not(valid)
        m, z, e = (_select(no_normal, *pair) for pair in ((x, wedge.m), (z, wedge.z), (y, wedge.e)))
        tan_max = dr.select(no_normal, seen.ta, wedge.tan_max)
        eta_max = tan_max / (1 + dr.sqrt(dr.fma(tan_max, tan_max, 1)))

        # Turn the normal to the side of z, then m to the side of the normal.
        nz = dr.dot(n, z)
        flipped = nz < 0
        nz = dr.abs(nz)
        nm = dr.select(flipped, -1, 1) * dr.dot(n, m)
        mirror = dr.select(nm < 0, -1, 1)
        m, nm = m * mirror, dr.abs(nm)

        eta_horizon = -nz / (1 + nm)
        long = 1 - dr.rcp(1 + dr.square(wedge.height))
        scale = dr.sqrt(dr.fma(LONG_SLICES, long, LATITUDE_SCALE2))
        straddling = (eta_horizon > -eta_max * (1 - THINNEST_SIDE)) & _not(no_normal)
        shape = Record(
            m=m,
            z=z,
            e=e,
            third=third,
            eta_max=eta_max,
            eta_horizon=eta_horizon,
            ce=dr.select(no_normal, 0, wedge.ce),
            sk=dr.select(no_normal, 0, wedge.sk * mirror),
            height=dr.select(no_normal, seen.tb, wedge.height),
            scale=dr.select(no_normal, 1, scale),
            no_normal=no_normal,
            straddling=straddling,
            major=None,
            minor=None,
            minor_share=None,
            defensive_share=None,
        )
        major = _slices(shape, dr.select(straddling, eta_horizon, -eta_max), eta_max, straddling)
        minor = _slices(shape, eta_horizon, -eta_max, mi.Mask(True))
        if self.one_sided:
            minor_share = dr.select(flipped, 1, 0)
            defensive_share = mi.Float(0)
        else:
            minor_irradiance = dr.abs(minor.extent) * minor.total * 2 * (1 + nm) / scale
            secants2 = (1 + dr.square(seen.ta)) * (1 + dr.square(seen.tb))
            whole = (
                dr.pi * seen.ta * seen.tb * dr.rsqrt(secants2) * dr.abs(dr.dot(n, seen.z * flip))
            )
            ratio = dr.power(minor_irradiance / (minor_irradiance + whole), SIDE_EXPONENT)
            minor_share = ratio / (1 + ratio)
            near = dr.clip(2 * tan_max * nm / dr.maximum(nz, cone.TINY) - 1, 0, 1)
            defensive_share = dr.select(no_normal, 0, DEFENSIVE_SHARE * near)
        return shape._replace(
            major=major,
            minor=minor,
            minor_share=dr.select(straddling, minor_share, 0),
            defensive_share=defensive_share,
        )

    def sample(self, record: Record, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's ``(ex, ey, normal)``, its density, and validity."""
        # Split the first number between the defensive share and the two sides.
        share = record.defensive_share
        whole = u.x < share
        v = dr.select(whole, u.x / dr.maximum(share, cone.TINY), (u.x - share) / (1 - share))
        minor = record.minor_share
        is_minor = v < minor
        v_side = dr.select(
            is_minor,
            v / dr.maximum(minor, cone.TINY),
            (v - minor) / dr.maximum(1 - minor, cone.TINY),
        )
        side = Slices(
            *(
                dr.select(is_minor, minor, major)
                for minor, major in zip(record.minor, record.major, strict=True)
            )
        )
        q = _inverse_kumaraswamy(dr.clip(v, 1e-9, 1 - 6e-8), mi.Mask(False))
        eta = dr.select(
            whole, record.eta_max * dr.fma(2, q, -1), _draw_slice(side, dr.clip(v_side, 0, 1))
        )

        start, length, _ = _slice(record, eta)
        s = dr.fma(length, u.y, start)
        tangent = s / (record.scale * dr.sqrt(dr.maximum(dr.fma(-s, s, 1), cone.TINY)))
        i = dr.rcp(1 + dr.square(eta))
        d = record.m * (2 * eta * i) + record.z * ((1 - dr.square(eta)) * i) + record.e * tangent
        d = d * dr.rsqrt(1 + dr.square(tangent))
        d = mi.Vector3f(d.x, d.y, d.z * record.third)
        return d, _density(record, eta, tangent), mi.Mask(True)

    def pdf(self, record: Record, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the light."""
        d = mi.Vector3f(direction.x, direction.y, direction.z * record.third)
        dm, dz = dr.dot(d, record.m), dr.dot(d, record.z)
        # The pole itself has no longitude; the floor keeps the squared tangent finite.
        r = dr.maximum(dr.sqrt(dr.fma(dm, dm, dz * dz)), 1e-18)
        eta = dm / dr.maximum(r + dz, 1e-18)
        return _density(record, eta, dr.dot(d, record.e) / r)
