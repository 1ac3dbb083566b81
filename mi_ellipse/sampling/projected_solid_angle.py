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

# A side of the horizon thinner than this part of the cone is left to the other side's density.
THINNEST_SIDE = 1e-5

# Share of the draws that cover the whole cone where the horizon is near: without it the density
# falls to zero at the horizon of the geometric normal, where a shading normal's cosine does not.
DEFENSIVE_SHARE = 0.15

# Slices whose density is matched: close to both ends, where the limits themselves are 0/0, and one
# between (see `_profile`).
END_NODE = 0.06


class Side(NamedTuple):
    """Density of the slices on one side of the horizon."""

    start: mi.Float  # η at x = 0: the horizon, or the middle of a cone that it does not divide
    extent: mi.Float  # Range of η to x = 1, a rim of the cone
    divided: mi.Mask  # x covers [0, 1], otherwise [-1, 1]
    s0: mi.Float  # Density relative to the profile at three of its quantiles: 0, ½ and 1
    s1: mi.Float
    s2: mi.Float
    total: mi.Float  # Mean of that density


class Record(NamedTuple):
    """What is computed once per reference point.

    Great circles through a pole ``e`` perpendicular to the normal slice the cone, so that the
    horizon is a slice too. A slice is given by ``η = tan(ψ/2)``, ψ the longitude from ``z``
    towards ``m``; these vectors are in the frame of the cone.
    """

    m: mi.Vector3f
    z: mi.Vector3f
    e: mi.Vector3f
    cone: cone.Cone
    eta_max: mi.Float  # The cone covers [-eta_max, eta_max]
    inv_eta_max: mi.Float
    eta_horizon: mi.Float
    ce: mi.Float  # Tangent of the latitude of the slices' centres: ce cos ψ + sk sin ψ
    sk: mi.Float
    height: mi.Float  # and of their half-lengths, over √(1 - (tan ψ / tan ψmax)²)
    scale: mi.Float  # c of `LATITUDE_SCALE2`, or 1 where there is no normal
    no_normal: mi.Mask  # In media, and where the wedge degenerates: uniform in solid angle
    straddling: mi.Mask  # The horizon divides the cone; η < eta_horizon is its minor side
    minor_share: mi.Float  # Probability of the minor side
    defensive_share: mi.Float


class Slice(NamedTuple):
    """The part of a slice that lies in the cone."""

    start: mi.Float  # s = c T / √(1 + c² T²) at its lower end, T the tangent of the latitude
    length: mi.Float  # Range of s, without cancellation
    centre: mi.Float  # T at its centre
    cos2_half: mi.Float  # 1 / (1 + η²)


def _select(mask: mi.Mask, a, b):
    """`dr.select` for vectors of any kind."""
    return dr.select(mask, mi.Vector3f(a), mi.Vector3f(b))


def _not(mask: mi.Mask) -> mi.Mask:
    """Negation that also works in scalar variants, where `~` of a `bool` is an integer."""
    return dr.select(mask, mi.Mask(False), mi.Mask(True))


def _slice(record: Record, eta: mi.Float) -> Slice:
    """The slice at η."""
    eta2 = eta * eta
    i = dr.rcp(1 + eta2)
    centre = dr.fma(record.ce, 1 - eta2, 2 * record.sk * eta) * i
    inside = (
        (record.eta_max - eta)
        * (record.eta_max + eta)
        * dr.fma(-dr.square(record.eta_max), eta2, 1)
    )
    half = record.height * record.inv_eta_max * i * dr.sqrt(dr.maximum(inside, 0))

    mid, half = record.scale * centre, record.scale * half
    a, b = mid - half, mid + half
    ra, rb = dr.sqrt(dr.fma(a, a, 1)), dr.sqrt(dr.fma(b, b, 1))
    total = dr.maximum(dr.fma(dr.abs(b), ra, dr.abs(a) * rb), cone.TINY)
    inv = dr.rcp(total * ra * rb)
    over_roots = total * inv  # 1 / (ra rb)
    same_side = a * b > 0
    length = dr.select(same_side, 4 * dr.abs(mid) * half * inv, total * over_roots)
    return Slice(a * rb * over_roots, length, centre, i)


def _weight(record: Record, eta: mi.Float) -> mi.Float:
    """Integral of the cosine over a slice, up to a constant; of one where there is no normal."""
    _, length, centre, i = _slice(record, eta)
    above = dr.abs((eta - record.eta_horizon) * dr.fma(eta, record.eta_horizon, 1)) * i
    centre2 = dr.square(centre)
    r2 = dr.fma(dr.square(record.scale), centre2, 1)
    latitude = r2 * dr.sqrt(r2) / dr.square(1 + centre2)
    return length * i * dr.select(record.no_normal, 1, above * latitude)


def _profile(x: mi.Float, divided: mi.Mask) -> tuple[mi.Float, mi.Float]:
    """Density of the slices before it is matched, and its distribution function.

    Kumaraswamy's, ``1 - (1 - q^α)^(3/2)``: at a rim it falls to zero as the length of a slice does.
    From the horizon to a rim α is 2 and q is x; with two rims α is 3/2 and q is ``½ (1 + x)``.
    """
    q = dr.clip(dr.select(divided, x, dr.fma(0.5, x, 0.5)), 1e-7, 1)
    root = dr.sqrt(q)
    # 1 - q^α without cancellation at q = 1
    g = dr.sqrt(dr.maximum(1 - q, 1e-7) * dr.select(divided, 1 + q, (1 + root + q) / (1 + root)))
    return dr.select(divided, 3 * q, 1.125 * root) * g, 1 - g * g * g


def _inverse_profile(u: mi.Float, divided: mi.Mask) -> mi.Float:
    """x at which the distribution function of `_profile` is u."""
    g = dr.cbrt(1 - u)
    power = u * (1 + g) / (1 + g + g * g)
    return dr.select(divided, dr.sqrt(power), dr.fma(2, dr.square(dr.cbrt(power)), -1))


def _side(record: Record, minor: mi.Mask) -> Side:
    """Match the density of the slices on a side of the horizon, which is a zero of it."""
    divided = record.straddling
    start = dr.select(divided, record.eta_horizon, 0)
    extent = dr.select(minor, -record.eta_max, record.eta_max) - start
    values = []
    for u in (0.0, 0.5, 1.0):
        whole, half = (_node(u, divided) for divided in (False, True))
        eta = dr.fma(extent, dr.select(divided, half[0], whole[0]), start)
        values.append(_weight(record, eta) * dr.select(divided, 1 / half[1], 1 / whole[1]))
    s0, s1, s2 = values
    return Side(start, extent, divided, s0, s1, s2, 0.25 * (s0 + 2 * s1 + s2))


def _node(u: float, divided: bool) -> tuple[float, float]:
    """x at a quantile of `_profile`, or close to an end of it, and the density there."""
    x = _inverse_profile(u, divided)
    low, high = (END_NODE, 1 - END_NODE) if divided else (2 * END_NODE - 1, 1 - 2 * END_NODE)
    x = min(max(x, low), high)
    return x, _profile(x, divided)[0]


def _side_density(side: Side, eta: mi.Float) -> mi.Float:
    """Density of η on one side."""
    extent = dr.select(side.extent < 0, -1, 1) * dr.maximum(dr.abs(side.extent), cone.TINY)
    x = (eta - side.start) / extent
    density, u = _profile(x, side.divided)
    left = u < 0.5
    p0, p1 = dr.select(left, side.s0, side.s1), dr.select(left, side.s1, side.s2)
    warp = dr.lerp(p0, p1, dr.select(left, 2 * u, 2 * u - 1))
    return density * warp / dr.maximum(side.total * dr.abs(extent), cone.TINY)


def _quantile(side: Side, u: mi.Float) -> mi.Float:
    """The quantile of `_profile` at which the distribution function of `_side_density` is u."""
    v = 4 * side.total * u
    left_total = side.s0 + side.s1
    left = v < left_total
    v = dr.select(left, v, v - left_total)
    p0, p1 = dr.select(left, side.s0, side.s1), dr.select(left, side.s1, side.s2)
    t = v / (p0 + dr.sqrt(dr.maximum(dr.fma(v, p1 - p0, p0 * p0), 0)))
    return 0.5 * dr.select(left, t, 1 + t)


def _within(record: Record, eta: mi.Float) -> mi.Float:
    """η in the cone: rounding takes directions out of those thinner than its own spacing."""
    limit = (1 - 3e-7) * record.eta_max
    return dr.clip(eta, -limit, limit)


def _density(
    record: Record, side: Side, minor: mi.Mask, eta: mi.Float, seen: Slice, tangent: mi.Float
) -> mi.Float:
    """Density per solid angle at the slice η, on this side, and the latitude with this tangent."""
    share = dr.select(minor, record.minor_share, 1 - record.minor_share)
    density = share * _side_density(side, eta)
    whole, _ = _profile(eta * record.inv_eta_max, mi.Mask(False))
    density = dr.lerp(density, whole * record.inv_eta_max, record.defensive_share)

    tangent2 = dr.square(tangent)
    r2 = (1 + tangent2) / dr.fma(dr.square(record.scale), tangent2, 1)
    latitude = record.scale * r2 * dr.sqrt(r2)
    return 0.5 * density * latitude / (seen.length * seen.cos2_half)


def _rescaled(u: mi.Float, share: mi.Float, below: mi.Mask) -> mi.Float:
    """A number of [0, share), where `below`, or of [share, 1), moved to [0, 1)."""
    width = dr.select(below, share, 1 - share)
    return dr.select(below, u, u - share) / dr.maximum(width, cone.TINY)


def _minor_share(h: mi.Float) -> mi.Float:
    """Share of the draws for the smaller side, the horizon at h between axis and rim.

    The sides of a small light are drawn in proportion to the power 3/8 of their irradiances: this
    polynomial is within 11 % of that. The power 1 is best for the squared error of an image, 0 for
    the mean relative variance.
    """
    return 0.5 * (1 - h) * dr.fma(0.25, h, 1)


class _Wedge(NamedTuple):
    """Slices of the cone through a pole, named as in `Record`."""

    m: mi.Vector3f
    z: mi.Vector3f
    e: mi.Vector3f
    tan_max: mi.Float
    ce: mi.Float
    sk: mi.Float
    height: mi.Float


def _pole(n: mi.Vector3f, ta2: mi.Float, tb2: mi.Float) -> mi.Vector3f:
    """A pole perpendicular to the normal and outside the cone.

    Perpendicular to the axis of the cone as well it is always outside. Slices along a needle that
    is tilted against them have a weight with a peak that three nodes miss; across it they are
    short and their weight is smooth.

    Parameters
    ----------
    n
        Surface normal in the frame of the cone.
    ta2, tb2
        Squared tangents of the half-angles.
    """
    e = mi.Vector3f(n.y, -n.x, 0)
    e = _select(dr.squared_norm(e) < 1e-12, mi.Vector3f(0, 1, 0), e)

    crosswise = mi.Vector3f(-n.x * n.y, dr.fma(-n.y, n.y, 1), -n.z * n.y)
    outside = dr.square(crosswise.x) * tb2 + dr.square(crosswise.y) * ta2
    is_needle = (ta2 > CROSSWISE_ASPECT**2 * tb2) & (tb2 < CROSSWISE_TANGENT**2)
    is_outside = outside > CROSSWISE_CLEARANCE * dr.square(crosswise.z) * ta2 * tb2
    is_crosswise = is_needle & is_outside & (crosswise.y > CROSSWISE_SINE2)
    e = _select(is_crosswise, crosswise, e)
    return e * dr.rsqrt(dr.squared_norm(e))


def _wedge(e: mi.Vector3f, ta2: mi.Float, tb2: mi.Float) -> tuple[_Wedge, mi.Mask]:
    """Slices of the cone through a pole outside it.

    The dual cone ``diag(ta², tb², -1)`` restricted to the plane perpendicular to the pole has the
    eigenvectors ``m`` and ``z``, with a positive and a negative eigenvalue.

    Returns
    -------
    wedge, valid
        `valid` is false where rounding leaves no wedge, or none that it resolves.
    """

    def dual(p, q):
        return dr.fma(ta2 * p.x, q.x, dr.fma(tb2 * p.y, q.y, -p.z * q.z))

    x2, y2, z2 = e.x * e.x, e.y * e.y, e.z * e.z
    equator2 = x2 + y2
    across = dr.fma(ta2, y2, tb2 * x2)
    determinant = dr.fma(-ta2 * tb2, z2, across)  # Its negative
    half_trace = 0.5 * (dr.fma(ta2, y2 + z2, tb2 * (x2 + z2)) - equator2)
    hyp = dr.sqrt(dr.fma(half_trace, half_trace, determinant))
    large = dr.maximum(dr.abs(half_trace) + hyp, cone.TINY)
    small = determinant / large
    positive = dr.select(half_trace > 0, large, small)
    negative = dr.select(half_trace > 0, small, large)
    valid = (positive > 0) & (negative > 0) & dr.isfinite(large)
    root = dr.sqrt(dr.select(valid, positive, 1))
    inv_root, inv_negative = dr.rcp(root), dr.rcp(dr.select(valid, negative, 1))

    # Of two vectors that span the plane; the second has no third component.
    first, second = dr.fma(negative, equator2, across), e.x * e.y * e.z * (tb2 - ta2)
    z = dr.normalize(
        mi.Vector3f(
            -dr.fma(e.x * e.z, first, e.y * second),
            dr.fma(e.x, second, -e.y * e.z * first),
            equator2 * first,
        )
    )
    m = dr.cross(e, z)
    ce, sk = -dual(e, z) * inv_negative, dual(m, e) * dr.square(inv_root)
    height = dr.sqrt(ta2) * dr.sqrt(tb2) * inv_negative * inv_root
    valid &= dr.abs(ce) + dr.abs(sk) + height < STEEPEST
    return _Wedge(m, z, e, root * dr.sqrt(inv_negative), ce, sk, height), valid


class ProjectedSolidAngle:
    """Directions almost proportional to the cosine at the surface, over the whole light.

    The cone is cut into slices that the horizon does not cross; a slice is drawn from a density
    that matches the integral of the cosine over it at three of them, and the latitude along it in
    closed form. The density is exact and no iteration is needed.

    The renderer tells an emitter the geometric normal and not which side of the surface is seen.
    Where the horizon divides the cone, each side gets a share of the draws; where the horizon is
    near, a share of the draws covers the whole cone. So the estimate is unbiased for two-sided,
    transmitting, bumped and smoothly shaded surfaces. In media, where there is no normal,
    directions are almost uniform in solid angle.

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
        n = seen.to_local(ellipse.to_light(normal))
        # Beyond a tangent of 1e8 the half-angle is 90° to single precision.
        ta2, tb2 = dr.minimum(seen.ta2, 1e16), dr.minimum(seen.tb2, 1e16)
        wedge, valid = _wedge(_pole(n, ta2, tb2), ta2, tb2)
        no_normal = (dr.squared_norm(n) == 0) | _not(valid)
        m = _select(no_normal, mi.Vector3f(1, 0, 0), wedge.m)
        z = _select(no_normal, mi.Vector3f(0, 0, 1), wedge.z)
        e = _select(no_normal, mi.Vector3f(0, 1, 0), wedge.e)
        tan_max = dr.select(no_normal, dr.sqrt(ta2), wedge.tan_max)
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
        record = Record(
            m=m,
            z=z,
            e=e,
            cone=seen,
            eta_max=eta_max,
            inv_eta_max=dr.rcp(eta_max),
            eta_horizon=eta_horizon,
            ce=dr.select(no_normal, 0, wedge.ce),
            sk=dr.select(no_normal, 0, wedge.sk * mirror),
            height=dr.select(no_normal, dr.sqrt(tb2), wedge.height),
            scale=dr.select(no_normal, 1, scale),
            no_normal=no_normal,
            straddling=straddling,
            minor_share=dr.select(straddling & flipped, 1.0, 0.0),
            defensive_share=mi.Float(0),
        )
        if self.one_sided:
            return record

        # Distance of the horizon from the axis of the cone, 1 being the rim
        h = nz / dr.maximum(tan_max * nm, cone.TINY)
        return record._replace(
            minor_share=dr.select(straddling, _minor_share(h), 0),
            defensive_share=dr.select(no_normal, 0, DEFENSIVE_SHARE * dr.clip(2 - h, 0, 1)),
        )

    def sample(self, record: Record, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's ``(ex, ey, normal)``, its density, and validity."""
        # Split the first number between the defensive share and the two sides.
        share = record.defensive_share
        whole = u.x < share
        v = _rescaled(u.x, share, whole)
        minor = v < record.minor_share
        v_side = _rescaled(v, record.minor_share, minor)
        _, horizon = _profile(record.eta_horizon * record.inv_eta_max, mi.Mask(False))
        minor = dr.select(whole, record.straddling & (v < horizon), minor)
        side = _side(record, minor)
        u1 = dr.select(whole, v, _quantile(side, dr.clip(v_side, 0, 1)))
        x = _inverse_profile(dr.clip(u1, 1e-9, 1 - 6e-8), side.divided & _not(whole))
        on_side = dr.fma(side.extent, x, side.start)
        eta = _within(record, dr.select(whole, record.eta_max * x, on_side))

        seen = _slice(record, eta)
        s = dr.fma(seen.length, u.y, seen.start)
        tangent = s / (record.scale * dr.sqrt(dr.maximum(dr.fma(-s, s, 1), cone.TINY)))
        i = seen.cos2_half
        d = record.m * (2 * eta * i) + record.z * (2 * i - 1) + record.e * tangent
        d = d * dr.rsqrt(1 + dr.square(tangent))
        d = record.cone.from_local(d)
        return d, _density(record, side, minor, eta, seen, tangent), mi.Mask(True)

    def pdf(self, record: Record, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the light."""
        d = record.cone.to_local(direction)
        dm, dz = dr.dot(d, record.m), dr.dot(d, record.z)
        # The pole itself has no longitude; the floor keeps the squared tangent finite.
        r = dr.maximum(dr.sqrt(dr.fma(dm, dm, dz * dz)), 1e-18)
        eta = _within(record, dm / dr.maximum(r + dz, 1e-18))
        minor = record.straddling & (eta < record.eta_horizon)
        tangent = dr.dot(d, record.e) / r
        return _density(record, _side(record, minor), minor, eta, _slice(record, eta), tangent)
