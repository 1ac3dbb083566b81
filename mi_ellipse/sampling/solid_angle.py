"""Strategy `solid_angle`: directions almost uniform in solid angle, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from ..geometry.cone import Cone, RoundCone
from ..geometry.light import View
from . import cap
from .strategy import register

# Sine and cosine of the quarter angle, as polynomials of its fraction and of the square of the
# fraction. They are Chebyshev series (derivations/azimuth.py).
QUARTER_SINE = 0.785398161, -8.07454348e-2, 2.49000696e-3, -3.59543993e-5
QUARTER_COSINE = 0.999999972, -3.08424253e-1, 1.58499130e-2, -3.18878992e-4

# Coefficients of the angular warp. They minimise the largest deviation of the density from uniform,
# over all half-angles (derivations/angular_warp.py).
WARP_STRENGTH = -1.26, 1.78, 6.17, -2.29
WARP_PLACE = 1.34, 3.65


class Record(NamedTuple):
    """What is computed once per reference point."""

    cone: Cone
    a2: mi.Float  # sin²(α/2); α is the larger half-angle
    ratio: mi.Float  # sin(β/2) / sin(α/2); β is the smaller half-angle
    ratio2: mi.Float  # Its square
    ka: mi.Float  # (sin(α/2) / ta)²
    kb: mi.Float  # (sin(β/2) / tb)²
    inv_kappa: mi.Float  # Strength of the angular warp; 1 for circles
    rho: mi.Float  # Where along the quadrant the warp acts


def on_disk(u: mi.Point2f) -> mi.Point2f:
    """Uniform point of the unit disk: the azimuth from the first number, from `_azimuth`."""
    c, s = _azimuth(u.x)
    r = dr.sqrt(u.y)
    return mi.Point2f(c * r, s * r)


def _azimuth(u: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Cosine and sine of the angle ``2π u - π``, with a common factor.

    It takes a third of the time of `drjit.sincos`, whose reduction of large angles is of no use
    here. Polynomials give the quarter angle, exact to 3e-8. The angle is then doubled twice.
    """
    v = dr.fma(2, u, -1)
    w = v * v
    s0, s1, s2, s3 = QUARTER_SINE
    c0, c1, c2, c3 = QUARTER_COSINE
    s = v * dr.fma(dr.fma(dr.fma(s3, w, s2), w, s1), w, s0)
    c = dr.fma(dr.fma(dr.fma(c3, w, c2), w, c1), w, c0)
    c, s = dr.fma(c, c, -s * s), (c + c) * s
    return dr.fma(c, c, -s * s), (c + c) * s


def _angular_warp(b0: mi.Float, b1: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Parameters 1/κ, ρ of the warp that makes the density more uniform along the azimuth.

    The plain half-angle map has the same density at both ends of the quadrant. κ removes the
    deviation between them, and ρ places the warp. Every choice gives an exact density. The
    polynomials here are fitted: they minimise the largest deviation from uniform over all
    half-angles.

    Parameters
    ----------
    b0, b1
        ``1 / (2 (1 + cos α))`` of the larger and the smaller half-angle. It is ¼ for small lights,
        and ½ for lights that fill the hemisphere.
    """
    least, one = mi.Float(0.25), mi.Float(1)
    a, b = b0 - least, b1 - least
    k0, k1, k2, k3 = WARP_STRENGTH
    p0, p1 = WARP_PLACE
    inv_kappa = dr.fma(a - b, dr.fma(a, dr.fma(k0, a, k1), b * dr.fma(k2, a, k3)), one)
    rho = one - a * dr.fma(p1, a, p0)
    return inv_kappa, rho


def rim(record: Record, c: mi.Float, s: mi.Float) -> mi.Float:
    """Density ``sin(α/2) sin(β/2) dt`` per solid angle at an azimuth with the eccentric angle t.

    It is also ``sin²(α/2) |(cos t, ratio sin t)|² / (1 - cos θmax)``. θmax is the angle between
    axis and rim.

    Parameters
    ----------
    c, s
        Cosine and sine of t, or multiples of them. The result grows with their square.
    """
    c2, s2 = c * c, s * s
    stretch = dr.fma(record.ka, c2, record.kb * s2)
    extent2 = record.a2 * dr.fma(record.ratio2, s2, c2)
    secant2 = stretch + extent2  # stretch / cos² θmax
    return secant2 + dr.sqrt(stretch * secant2)


class Warped(NamedTuple):
    """An azimuth after the angular warp."""

    c: mi.Float  # Cosine and sine of its eccentric angle t, times a common factor f
    s: mi.Float
    growth: mi.Float  # Numerator of f² dt/ds; here s is the angle before the warp
    growth_over: mi.Float  # Its denominator


def warp(record: Record, c: mi.Float, s: mi.Float) -> Warped:
    """Eccentric angle of the azimuth from the cosine and sine of the uniform angle.

    The warp stretches the tangent by ρ, multiplies the tangent of the double angle by κ, and
    stretches back.
    """
    c = record.rho * c
    c2, s2 = c * c, s * s
    cos2, sin2 = record.inv_kappa * (c2 - s2), (c + c) * s
    norm = dr.sqrt(dr.fma(cos2, cos2, sin2 * sin2))
    half = norm + dr.abs(cos2)
    upright = cos2 >= 0
    sign = dr.sign(dr.select(upright, c, s))
    return Warped(
        c=sign * dr.select(upright, half, sin2),
        s=sign * record.rho * dr.select(upright, sin2, half),
        growth=2 * dr.square(record.rho) * record.inv_kappa * (c2 + s2) * half,
        growth_over=norm,
    )


def direction(
    record: Record, c: mi.Float, s: mi.Float, density: mi.Float, u: mi.Float
) -> mi.Vector3f:
    """Direction in the cone's frame.

    Parameters
    ----------
    c, s, density
        Multiples of the cosine and sine of the eccentric angle of its azimuth, and `rim` for them.
    u
        Fraction of ``1 - cos θmax``, in [0, 1].
    """
    height = record.a2 * u
    drop = height * dr.fma(record.ratio2 * s, s, c * c)  # density (1 - cos θ)
    inv = dr.rcp(density)  # Beside the root, not after it
    r = inv * dr.sqrt(height * dr.fma(2, density, -drop))
    return mi.Vector3f(c * r, record.ratio * s * r, dr.fma(-drop, inv, 1))


@register(
    "solid_angle",
    colour="#0072B2",
    mark="^",
    sentence="Almost uniform in solid angle, in closed form: bounded variance near the lamp.",
)
class SolidAngle:
    """Directions almost uniform in solid angle over the whole light.

    The density is within ±0.03 % of uniform for half-angles up to 45°, ±0.08 % up to 63° and ±1.8 %
    always. The strategy needs no elliptic integral and no inversion.

    The azimuth runs with the eccentric angle of an ellipse, corrected by one closed-form warp. The
    semi-axes of this ellipse are the sines of half the half-angles. Along the radius ``1 - cos θ``
    is uniform. So the density depends on the azimuth alone. On a sphere it is constant.
    """

    def prepare(self, view: View, normal: mi.Normal3f) -> Record | RoundCone:
        """Compute cone and warp of a reference point. Its normal is not used."""
        seen = view.cone
        return seen if isinstance(seen, RoundCone) else self.record(seen)

    def record(self, seen: Cone) -> Record:
        """Warp of a cone."""
        one = mi.Float(1)
        cos_a, cos_b = dr.rsqrt(one + seen.ta2), dr.rsqrt(one + seen.tb2)
        fa, fb = one + cos_a, one + cos_b
        inv = 0.5 / (fa * fb)
        b0, b1 = fb * inv, fa * inv  # 1 / (2 (1 + cos))
        inv_kappa, rho = _angular_warp(b0, b1)
        ka, kb = dr.square(cos_a) * b0, dr.square(cos_b) * b1
        ratio2 = 2 * fa * (seen.tb2 * kb) * (one + seen.inv_ta2)
        return Record(
            cone=seen,
            a2=seen.ta2 * ka,
            ratio=dr.sqrt(ratio2),
            ratio2=ratio2,
            ka=ka,
            kb=kb,
            inv_kappa=inv_kappa,
            rho=rho,
        )

    def sample(
        self, record: Record | RoundCone, u: mi.Point2f
    ) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's frame, its density, and validity."""
        if isinstance(record, RoundCone):
            return cap.uniform(record, on_disk(u)), cap.uniform_density(record), mi.Mask(True)
        d, pdf = self.sample_local(record, u)
        return record.cone.from_local(d), pdf, mi.Mask(True)

    def pdf(self, record: Record | RoundCone, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the light."""
        if isinstance(record, RoundCone):
            return cap.uniform_density(record)
        return self.pdf_local(record, record.cone.to_local(direction))

    def sample_local(self, record: Record, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float]:
        """Direction in the frame of the cone, and its density."""
        c, s, growth, growth_over = warp(record, *_azimuth(u.x))
        density = rim(record, c, s)
        spread = record.a2 * record.ratio * growth
        pdf = dr.inv_two_pi * density / spread * growth_over
        return direction(record, c, s, density, u.y), pdf

    def pdf_local(self, record: Record, d: mi.Vector3f) -> mi.Float:
        """Density of a direction in the frame of the cone."""
        c, s = d.x * record.ratio, d.y
        largest = dr.maximum(dr.abs(c), dr.abs(s))
        scale = dr.rcp(largest)
        axial = largest == 0
        c, s = dr.select(axial, 1, c * scale), dr.select(axial, 0, s * scale)

        # The inverse of the warp
        density = rim(record, c, s)
        rho2, inv_kappa = dr.square(record.rho), record.inv_kappa
        c2, s2 = rho2 * c * c, s * s
        cos2, sin2 = c2 - s2, 2 * record.rho * inv_kappa * c * s
        norm = dr.sqrt(dr.fma(cos2, cos2, sin2 * sin2))
        shift = 0.5 * norm * ((norm + cos2) + rho2 * (norm - cos2))
        density *= dr.inv_two_pi * rho2 * inv_kappa * (c2 + s2)
        return density / (record.a2 * record.ratio * shift)
