"""Strategy `projected_solid_angle`: directions almost proportional to the cosine at the surface."""

from __future__ import annotations

from functools import cache, partial
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from ..geometry.cone import Cone, RoundCone
from ..geometry.light import View
from ..geometry.tracing import TINY, branch
from . import cap
from .solid_angle import SolidAngle, on_disk
from .strategy import register

# Squared scale c² of the tangent T of the latitude λ. The primitive of (1 + c² T²)^(-3/2) is
# elementary, and c² = 4/3 matches the wanted weight cos² λ to second order. Over slices from pole
# to pole the best value is 1.82. So up to 0.4 is added for long slices. This lowers the variance of
# lights that fill the view by 35 % (derivations/latitude.py).
LATITUDE_SCALE2 = 4 / 3
LONG_SLICES = 0.4

# Directions are drawn uniformly in solid angle, in half the time, if the cosine at the surface
# stays within this part of its value on the axis, over the whole light.
LEAST_CHANGE = 0.05

# Largest κ η (see `Slices`). Single precision resolves η to 6e-4 there. For longer needles, the
# peak of the integral of the cosine is narrower than the peak of what is drawn. Higher limits lower
# the variance of these needles, but their bias is not measured.
HIGHEST_PEAK = 100

# A side of the horizon that is thinner than this part of τ_max gets no draws of its own: the
# density of the other side covers it.
THINNEST_SIDE = 1e-5

# Weight of q beside that of q² in `_profile`. Without it the density falls to zero at the horizon
# of the geometric normal. The cosine of a shading normal does not fall to zero there. A higher
# weight raises the least density, and the variance too. At 0.25 the least density is 0.088 of the
# uniform one, and the mean relative variance is 0.0135 (derivations/slices.py).
AT_HORIZON = 0.25

# Places where the factors at the ends of a side are measured. If the horizon divides the cone, they
# are this q and one minus it, because the limits themselves are 0/0. Else they are this x.
END_NODE = 0.12
OUTER_NODE = 0.8

# Floors and limits of single precision (derivations/floors.py)
LEAST_LEFT = 1e-7  # Part of the range of `_profile` left at a rim, where the density falls to 0
LEAST_Q = 1e-7  # q at a horizon, where the density can fall to 0
LEAST_QUANTILE = 1e-9  # It acts as 0 in single precision: it is lost beside 1
LARGEST_QUANTILE = 1 - 6e-8  # The largest number below 1
INWARDS = 3e-7  # Part of the width of a cone that is left out at its rims
LARGEST_TANGENT2 = 1e16  # Beyond a tangent of 1e8 the half-angle is 90° to single precision
LEAST_TILT2 = 1e-12  # Squared sine between normal and axis below which every pole will do
AT_POLE = 1e-18  # Cosine of the latitude of a pole; its inverse square is finite


# Least density towards a sphere that the horizon does not divide, as a part of the uniform one. So
# many draws are uniform that it is reached at the rim, where the density would follow the cosine
# down to zero. The cosine of a shading normal need not fall. The slices have this least density too
# (`AT_HORIZON`). It costs a relative variance of 0.0064 at most (derivations/cap.py).
LEAST_DENSITY = 0.088


class Record(NamedTuple):
    """What is computed once per reference point."""

    cone: Cone | RoundCone
    n: mi.Vector3f  # Surface normal in the frame of the cone; zero in media


class RoundRecord(NamedTuple):
    """What is computed once per reference point, for a sphere."""

    cone: RoundCone
    n: mi.Vector3f  # Surface normal in the frame of the light; zero in media
    divided: mi.Mask  # The horizon divides the sphere
    uniform_share: mi.Float  # Part of the draws that is uniform, if it does not; 1 in media


class Slices(NamedTuple):
    """The slices of a cone.

    Great circles slice the cone. They pass through a pole that is perpendicular to the normal and
    to the axis of the cone. So the horizon is a slice too. A slice is given by ``η = tan(ψ/2)``. ψ
    is the longitude from the axis towards the normal.

    The variable that is drawn is ``τ = η / √(1 + κ² η²)``, because a narrow peak in η is broad in
    τ. Such a peak occurs for a needle that is tilted against the slices: they cross it at latitudes
    that change fast with ψ, and the integral of the cosine falls with the fourth power of the
    cosine of the latitude. Near the axis κ η is the tangent of that latitude. It is less where the
    slices are long.
    """

    m: mi.Vector2f  # Direction of the normal about the axis; the pole is (-m.y, m.x, 0)
    eta_max: mi.Float  # The cone covers [-eta_max, eta_max]
    inv_eta_max: mi.Float
    eta_horizon: mi.Float
    kappa2: mi.Float | None  # κ²; None for a sphere, where it is 0
    tau_max: mi.Float  # τ at eta_max
    tau_horizon: mi.Float
    # Tangent of the latitude of the centre of a slice, over ½ sin ψ; None for a sphere: it is 0
    slope: mi.Float | None
    height: mi.Float  # Tangent of its half-length, over cos ψ √(1 - (tan ψ / tan ψmax)²)
    scale: mi.Float  # c of `LATITUDE_SCALE2`
    inv_scale: mi.Float
    straddling: mi.Mask  # The horizon divides the cone; the minor side is η < eta_horizon
    minor_share: mi.Float  # Probability of the minor side
    at_horizon: float  # `AT_HORIZON`, or 0 for one side alone


class Slice(NamedTuple):
    """The part of a slice that lies in the cone."""

    start: mi.Float  # s = c T / √(1 + c² T²) at its lower end; T is the tangent of the latitude
    length: mi.Float  # Range of s, without cancellation
    cos2_half: mi.Float  # 1 / (1 + η²)


class Side(NamedTuple):
    """Density of the slices on one side of the horizon.

    It is the density of `_profile` times a factor. The factor is linear between three quantiles of
    the profile.
    """

    start: mi.Float  # τ at x = 0: the horizon, or the middle of a cone that it does not divide
    extent: mi.Float  # Range of τ to x = 1, a rim of the cone
    s0: mi.Float  # Factor at the quantiles 0, ½ and 1, or at both rims and in the middle
    s1: mi.Float
    s2: mi.Float
    total: mi.Float  # Mean of the factor


def _not(mask: mi.Mask) -> mi.Mask:
    """Negation that also works in scalar variants. There, `~` of a `bool` is an integer."""
    return dr.select(mask, mi.Mask(False), mi.Mask(True))


def _tau(kappa2: mi.Float | None, eta: mi.Float) -> tuple[mi.Float, mi.Float]:
    """τ and its derivative."""
    if kappa2 is None:
        return eta, mi.Float(1)
    r = dr.rsqrt(dr.fma(kappa2, eta * eta, 1))
    return eta * r, r * r * r


def _eta(kappa2: mi.Float | None, tau: mi.Float) -> tuple[mi.Float, mi.Float]:
    """η and its derivative."""
    if kappa2 is None:
        return tau, mi.Float(1)
    r = dr.rsqrt(dr.fma(-kappa2, tau * tau, 1))
    return tau * r, r * r * r


class _CrossSection(NamedTuple):
    """Where a slice meets the cone, as tangents of the latitude times c of `LATITUDE_SCALE2`."""

    mid: mi.Float | None  # None for a sphere: it is 0
    size: mi.Float  # Half-length in the middle of the cone
    inside: mi.Float  # Square of the part of `size` that is left at this η
    cos2_half: mi.Float


def _cross_section(cut: Slices, eta: mi.Float) -> _CrossSection:
    one, inv = mi.Float(1), cut.inv_eta_max
    i = dr.rcp(dr.fma(eta, eta, one))
    scaled, etas = cut.scale * i, cut.eta_max * eta
    # The differences are exact at a rim
    inside = ((cut.eta_max - eta) * inv) * ((cut.eta_max + eta) * inv)
    inside *= dr.fma(-etas, etas, one)
    mid = None if cut.slope is None else cut.slope * eta * scaled
    return _CrossSection(mid, cut.height * scaled, inside, i)


def _slice(cut: Slices, eta: mi.Float) -> Slice:
    """The slice at η."""
    mid, size, inside, i = _cross_section(cut, eta)
    half = size * dr.sqrt(dr.maximum(inside, 0))
    if mid is None:
        end = half * dr.rsqrt(dr.fma(half, half, 1))
        return Slice(-end, dr.maximum(end + end, TINY), i)
    a, b = mid - half, mid + half
    one = mi.Float(1)
    ra, rb = dr.sqrt(dr.fma(a, a, one)), dr.sqrt(dr.fma(b, b, one))
    total = dr.maximum(dr.fma(dr.abs(b), ra, dr.abs(a) * rb), TINY)
    inv = dr.rcp(total * ra * rb)
    over_roots = total * inv  # 1 / (ra rb)
    same_side = a * b > 0
    length = dr.select(same_side, 4 * dr.abs(mid) * inv * half, total * over_roots)
    return Slice(a * rb * over_roots, length, i)


def _weight(cut: Slices, eta: mi.Float) -> mi.Float:
    """Integral of the cosine over a slice, up to a constant.

    The length of the slice is that of `_slice`. It stands under one root with the other factors.
    """
    mid, size, inside, i = _cross_section(cut, eta)
    one, half2 = mi.Float(1), size * size * inside
    above = dr.abs((eta - cut.eta_horizon) * dr.fma(eta, cut.eta_horizon, one)) * i
    if mid is None:
        return i * i * above * dr.sqrt(inside / (one + half2))
    mid2 = mid * mid

    # For a slice from a = mid - half to b: (length / 2 half)² = ratio / ((1 + a²) (1 + b²))
    ab, sum2 = mid2 - half2, mid2 + half2
    product = dr.fma(ab, ab, sum2 + sum2 + one)
    root = dr.sqrt(product) + one
    larger = dr.square(root + dr.abs(ab))
    total = 2 * (sum2 + root)
    same_side = ab > 0
    ratio = dr.select(same_side, total, larger) / dr.select(same_side, larger, total)
    length2 = ratio * (inside / product)

    r2, tangent = mid2 + one, mid * cut.inv_scale
    latitude = r2 / dr.square(dr.fma(tangent, tangent, one))
    return i * i * above * latitude * dr.sqrt(length2 * r2)


def _profile(q: mi.Float, divided: mi.Mask, at_horizon: float) -> tuple[mi.Float, mi.Float]:
    """Density of the slices before it is matched, and its distribution function.

    The distribution is that of Kumaraswamy, ``1 - (1 - w)^(3/2)``. Its density falls to zero at a
    rim, q = 1, as the length of a slice does. From the middle of a cone w is q. From the horizon w
    is q² and a little of q, because the cosine grows from there.
    """
    inv = 1 / (1 + at_horizon)
    w = dr.select(divided, q * (q + at_horizon) * inv, q)
    g = dr.sqrt(dr.maximum(1 - w, LEAST_LEFT))
    return 1.5 * g * dr.select(divided, (2 * q + at_horizon) * inv, 1), 1 - g * g * g


def _inverse_profile(u: mi.Float, divided: mi.Mask, at_horizon: float) -> mi.Float:
    """q at which the distribution function of `_profile` is u."""
    g = dr.cbrt(1 - u)
    w = 1 - g * g
    from_horizon = dr.sqrt(dr.fma(1 + at_horizon, w, 0.25 * at_horizon**2)) - 0.5 * at_horizon
    return dr.select(divided, from_horizon, w)


@cache
def _nodes(at_horizon: float) -> tuple[tuple[float, float, float, float], ...]:
    """Places where the factors are measured, and one over the profile there.

    An entry holds q and its reciprocal density for a cone that the horizon divides. Then it holds x
    and its reciprocal density for other cones.
    """
    nodes = []
    for quantile in (0.0, 0.5, 1.0):
        q = min(max(_inverse_profile(quantile, True, at_horizon), END_NODE), 1 - END_NODE)
        x = (2 * quantile - 1) * OUTER_NODE
        p_divided, _ = _profile(q, True, at_horizon)
        p_whole, _ = _profile(abs(x), False, at_horizon)
        nodes.append((q, 1 / p_divided, x, 1 / p_whole))
    return tuple(nodes)


def _side(cut: Slices, minor: mi.Mask) -> Side:
    """Match the density of the slices on a side of the horizon."""
    divided = cut.straddling
    start = dr.select(divided, cut.tau_horizon, 0)
    extent = dr.select(minor, -cut.tau_max, cut.tau_max) - start
    values = []
    for q, inv_divided, x, inv_whole in _nodes(cut.at_horizon):
        eta, stretch = _eta(cut.kappa2, dr.fma(extent, dr.select(divided, q, x), start))
        values.append(_weight(cut, eta) * (dr.select(divided, inv_divided, inv_whole) * stretch))
    s0, s1, s2 = values
    return Side(start, extent, s0, s1, s2, 0.25 * (s0 + s1 + s1 + s2))


def _side_density(cut: Slices, side: Side, tau: mi.Float) -> mi.Float:
    """Density of τ on one side."""
    divided = cut.straddling
    inv = dr.rcp(side.extent)
    x = (tau - side.start) * inv
    density, u = _profile(
        dr.clip(dr.select(divided, x, dr.abs(x)), LEAST_Q, 1), divided, cut.at_horizon
    )
    y = dr.select(divided, 2 * u - 1, dr.mulsign(u, x))  # -1, 0 and 1 where the factors are
    outer = dr.select(y < 0, side.s0, side.s2)
    factor = dr.fma(dr.abs(y), outer - side.s1, side.s1) * dr.select(divided, 1, 0.5)
    return density * factor * dr.abs(inv) / dr.maximum(side.total, TINY)


def _draw_on_side(cut: Slices, side: Side, u: mi.Float) -> mi.Float:
    """τ at which the distribution function of `_side_density` is u."""
    # In units of the sum of the factors; outwards from the middle one
    v = dr.fma(4 * side.total, u, -(side.s0 + side.s1))
    left = v < 0
    v, outer = dr.abs(v), dr.select(left, side.s0, side.s2)
    y = v / (side.s1 + dr.sqrt(dr.maximum(dr.fma(v, outer - side.s1, dr.square(side.s1)), 0)))
    y = dr.select(left, -y, y)

    divided = cut.straddling
    quantile = dr.select(divided, dr.fma(0.5, y, 0.5), dr.abs(y))
    quantile = dr.clip(quantile, LEAST_QUANTILE, LARGEST_QUANTILE)
    q = _inverse_profile(quantile, divided, cut.at_horizon)
    x = dr.select(left & _not(divided), -q, q)
    return dr.fma(side.extent, x, side.start)


def _within(cut: Slices, eta: mi.Float) -> mi.Float:
    """Keep η in the cone; rounding leaves cones that are thinner than the spacing of floats."""
    limit = (1 - INWARDS) * cut.eta_max
    return dr.clip(eta, -limit, limit)


def _density(
    cut: Slices, side: Side, minor: mi.Mask, eta: mi.Float, strip: Slice, tangent: mi.Float
) -> mi.Float:
    """Density per solid angle at the slice η of this side, at the latitude with this tangent."""
    share = dr.select(minor, cut.minor_share, 1 - cut.minor_share)
    tau, stretch = _tau(cut.kappa2, eta)
    density = share * stretch * _side_density(cut, side, tau)
    tangent2 = dr.square(tangent)
    one = mi.Float(1)
    r2 = (one + tangent2) / dr.fma(dr.square(cut.scale), tangent2, one)
    latitude = cut.scale * r2 * dr.sqrt(r2)
    return 0.5 * density * latitude / (strip.length * strip.cos2_half)


def _minor_share(h: mi.Float) -> mi.Float:
    """Share of the draws for the smaller side of a cone that the horizon divides.

    The share of each side of a small light is in proportion to the power 3/8 of its irradiance.
    This polynomial is within 10.6 % of that up to h = 0.95. A factor of 0.30 instead of 0.25 would
    be within 7.2 %. The factor stays as it is, so that pictures stay the same. The power 1 would be
    best for the squared error of an image, and the power 0 for the mean relative variance. For
    lights that fill the view the share comes close to one half, because h is a ratio of tangents.

    Parameters
    ----------
    h
        Place of the horizon: 0 is the axis of the cone, 1 is the rim.
    """
    return 0.5 * (1 - h) * dr.fma(0.25, h, 1)


def _slices(seen: Cone | RoundCone, n: mi.Vector3f, one_sided: bool) -> Slices:
    """Slices of a cone for a normal in its frame."""
    ta2, tb2 = (dr.minimum(t2, LARGEST_TANGENT2) for t2 in (seen.ta2, seen.tb2))

    # Flip the normal to the side of the axis
    one = mi.Float(1)
    flipped = n.z < 0
    nz, nm2 = dr.abs(n.z), dr.fma(n.x, n.x, n.y * n.y)
    tilted = nm2 > LEAST_TILT2
    inv_nm = dr.rsqrt(dr.maximum(nm2, LEAST_TILT2))
    nm = nm2 * inv_nm
    inv_nm = dr.select(flipped, -inv_nm, inv_nm)
    m = mi.Vector2f(dr.select(tilted, n.x * inv_nm, one), dr.select(tilted, n.y * inv_nm, 0))

    # Express the dual cone diag(ta², tb², -1) along m, the pole and the axis
    tan2_max = dr.fma(ta2 * m.x, m.x, tb2 * m.y * m.y)
    inv_tan = dr.rsqrt(tan2_max)
    secant = one + dr.sqrt(one + tan2_max)
    eta_max, inv_eta_max = tan2_max * inv_tan / secant, secant * inv_tan
    inv_tan2 = dr.square(inv_tan)
    slope = None if isinstance(seen, RoundCone) else (tb2 - ta2) * (2 * m.x * m.y) * inv_tan2
    height2 = tb2 * (ta2 * inv_tan2)
    short = dr.rcp(one + height2)
    scale2 = dr.fma(-LONG_SLICES, short, LATITUDE_SCALE2 + LONG_SLICES)
    inv_scale = dr.rsqrt(scale2)

    kappa2 = None
    if slope is not None:
        kappa2 = dr.minimum(dr.square(slope) * short, dr.square(HIGHEST_PEAK * inv_eta_max))
    eta_horizon = -nz / (one + nm)
    tau_max, tau_horizon = _tau(kappa2, eta_max)[0], _tau(kappa2, eta_horizon)[0]
    straddling = tau_horizon > -tau_max * (1 - THINNEST_SIDE)
    if one_sided:
        share = dr.select(flipped, 1.0, 0.0)
    else:
        # The argument is the distance of the horizon from the axis of the cone; 1 is the rim
        share = _minor_share(nz * inv_tan / dr.maximum(nm, TINY))

    return Slices(
        m=m,
        eta_max=eta_max,
        inv_eta_max=inv_eta_max,
        eta_horizon=eta_horizon,
        kappa2=kappa2,
        tau_max=tau_max,
        tau_horizon=tau_horizon,
        slope=slope,
        height=dr.sqrt(height2),
        scale=scale2 * inv_scale,
        inv_scale=inv_scale,
        straddling=straddling,
        minor_share=dr.select(straddling, share, 0),
        at_horizon=0 if one_sided else AT_HORIZON,
    )


@register(
    "projected_solid_angle",
    colour="#D55E00",
    mark="v",
    sentence="Almost proportional to the cosine at the surface, for lamps that are near or cut by"
    " the horizon.",
)
@register(
    "projected_solid_angle_one_sided",
    colour="#8C510A",
    mark="<",
    sentence="The same for flat, opaque surfaces seen from the front; biased for surfaces that are"
    " seen from behind.",
    one_sided=True,
)
class ProjectedSolidAngle:
    """Directions almost proportional to the cosine at the surface, over the whole light.

    The density is exact, and no iteration is needed. The cone is cut into slices that the horizon
    does not cross. A slice is drawn from a density that follows the integral of the cosine over the
    slice. This integral is computed for three slices. The latitude along the slice is drawn in
    closed form.

    The estimate is unbiased for two-sided, transmitting, bumped and smoothly shaded surfaces. The
    renderer tells an emitter the geometric normal, but not which side of the surface is seen. So
    each side gets a share of the draws where the horizon divides the cone, and the density does not
    vanish at the horizon.

    The strategy draws as `solid_angle` does in media, where there is no normal, and where the
    cosine hardly varies over the light.

    Towards a sphere that the horizon does not divide, the density is the cosine over the
    irradiance, with a small uniform share close to the horizon (`cap`).

    Parameters
    ----------
    one_sided
        Draw only on the side of the geometric normal if the horizon divides the light. The variance
        is lower. The picture is *biased* for surfaces seen from behind, for transmission, and for
        shading normals that differ from the geometric normal.
    """

    def __init__(self, one_sided: bool = False):
        self.one_sided = one_sided
        self.uniform = SolidAngle()

    def prepare(self, view: View, normal: mi.Normal3f) -> Record | RoundRecord:
        """Compute the cone of a reference point, and its normal in the frame of the cone."""
        if isinstance(view.cone, RoundCone):
            return self._prepare_round(view.cone, view.light.to_light(normal))
        return Record(view.cone, view.cone.to_local(view.light.to_light(normal)))

    def sample(
        self, record: Record | RoundRecord, u: mi.Point2f
    ) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's frame, its density, and validity."""
        if isinstance(record, RoundRecord):
            return *_branch_round(record, u, self._sample_divided, _sample_cap), mi.Mask(True)
        d, pdf = self._branch(record, u, self._sample_slices, self._sample_whole)
        return record.cone.from_local(d), pdf, mi.Mask(True)

    def pdf(self, record: Record | RoundRecord, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the light."""
        if isinstance(record, RoundRecord):
            return _branch_round(record, direction, self._pdf_divided, _pdf_cap)
        d = record.cone.to_local(direction)
        return self._branch(record, d, self._pdf_slices, self._pdf_whole)

    def _branch(self, record: Record, argument, sliced, whole):
        """Use slices where the cosine varies. Packets of neighbouring paths mostly agree on it."""
        seen, n = record.cone, record.n
        nx2, ny2, nz2 = n.x * n.x, n.y * n.y, n.z * n.z
        # The cosine varies across the cone. Where the normal is along the axis, it varies by the
        # width of the cone.
        across2, width2 = dr.fma(nx2, seen.ta2, ny2 * seen.tb2), nz2 * seen.ta2 * seen.ta2
        varies = dr.fma(0.25, width2, across2) > LEAST_CHANGE**2 * nz2
        return branch(argument, varies, partial(sliced, record), partial(whole, record))

    def _prepare_round(self, seen: RoundCone, n: mi.Vector3f) -> RoundRecord:
        """Tell whether the horizon divides a sphere, and how to draw if it does not."""
        least, mean = cap.least_cosine(seen, n)
        divided = least < -THINNEST_SIDE * dr.sqrt(seen.sine2)
        share = mi.Float(0)
        if not self.one_sided:
            part = least / dr.maximum(mean, TINY)
            share = dr.maximum((LEAST_DENSITY - part) / dr.maximum(1 - part, LEAST_DENSITY), 0)
        return RoundRecord(seen, n, divided, dr.select(dr.squared_norm(n) > 0, share, 1))

    def _sample_divided(self, record, u):
        """Direction in the frame of the light and its density."""
        seen = record.cone
        d, pdf = self._sample_slices(Record(seen, seen.to_local(record.n)), u)
        return seen.from_local(d), pdf

    def _pdf_divided(self, record, d):
        """Density of a direction in the frame of the light."""
        seen = record.cone
        return self._pdf_slices(Record(seen, seen.to_local(record.n)), seen.to_local(d))

    def _sample_slices(self, record, u):
        """Direction in the frame of the cone and its density."""
        cut = _slices(record.cone, record.n, self.one_sided)
        share = cut.minor_share
        minor = u.x < share
        # A side with no share has no draws, but the division needs a width.
        width = dr.maximum(dr.select(minor, share, 1 - share), TINY)
        u_side = dr.select(minor, u.x, u.x - share) / width
        side = _side(cut, minor)
        tau = _draw_on_side(cut, side, dr.clip(u_side, 0, 1))
        eta = _within(cut, _eta(cut.kappa2, tau)[0])

        strip = _slice(cut, eta)
        s = dr.fma(strip.length, u.y, strip.start)
        tangent = s * cut.inv_scale * dr.rsqrt(dr.maximum(dr.fma(-s, s, 1), TINY))
        cos_latitude = dr.rsqrt(1 + dr.square(tangent))
        dm = 2 * eta * strip.cos2_half * cos_latitude
        de = tangent * cos_latitude
        m = cut.m
        d = mi.Vector3f(
            dr.fma(m.x, dm, -m.y * de),
            dr.fma(m.y, dm, m.x * de),
            dr.fma(2, strip.cos2_half, -1) * cos_latitude,
        )
        return d, _density(cut, side, minor, eta, strip, tangent)

    def _pdf_slices(self, record, d):
        """Density of a direction in the frame of the cone."""
        cut = _slices(record.cone, record.n, self.one_sided)
        m = cut.m
        dm, de = dr.fma(m.x, d.x, m.y * d.y), dr.fma(m.x, d.y, -m.y * d.x)
        # The pole itself has no longitude. The floor keeps the squared tangent finite.
        r = dr.maximum(dr.sqrt(dr.fma(dm, dm, d.z * d.z)), AT_POLE)
        eta = _within(cut, dm / dr.maximum(r + d.z, AT_POLE))
        minor = cut.straddling & (eta < cut.eta_horizon)
        return _density(cut, _side(cut, minor), minor, eta, _slice(cut, eta), de / r)

    def _sample_whole(self, record, u):
        """Direction and density as in `_sample_slices`, but uniform in solid angle."""
        return self.uniform.sample_local(self.uniform.record(record.cone), u)

    def _pdf_whole(self, record, d):
        """Density as in `_pdf_slices`, but uniform in solid angle."""
        return self.uniform.pdf_local(self.uniform.record(record.cone), d)


def _branch_round(record: RoundRecord, argument, divided, whole):
    """Use slices where the horizon divides a sphere."""
    return branch(argument, record.divided, partial(divided, record), partial(whole, record))


def _sample_cap(record, u):
    """Direction and density as in `_sample_divided`, of a sphere that is not divided."""
    share = record.uniform_share
    is_uniform = u.y < share
    # A share that has no draws needs a width for the division.
    width = dr.maximum(dr.select(is_uniform, share, 1 - share), TINY)
    p = on_disk(mi.Point2f(u.x, dr.minimum((u.y - dr.select(is_uniform, 0, share)) / width, 1)))
    follows_cosine = cap.projected(record.cone, record.n, p)
    d = dr.select(is_uniform, cap.uniform(record.cone, p), follows_cosine)
    return d, _pdf_cap(record, d)


def _pdf_cap(record, d):
    """Density of a direction as in `_pdf_divided`, of the draws of `_sample_cap`."""
    share, uniform = record.uniform_share, cap.uniform_density(record.cone)
    return dr.lerp(cap.projected_density(record.cone, record.n, d), uniform, share)
