"""Strategy `solid_angle`: directions almost uniform in solid angle, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from .. import cone
from ..cone import Cone
from ..ellipse import Ellipse


class Record(NamedTuple):
    """What is computed once per reference point."""

    cone: Cone
    a1: mi.Float  # sin(α/2), half the larger half-angle
    b1: mi.Float  # sin(β/2), half the smaller half-angle
    ka: mi.Float  # (a1 / ta)²: change of scale from the tangent plane to that of half the angle
    kb: mi.Float
    inv_kappa: mi.Float  # Strength of the angular warp, 1 for circles
    rho: mi.Float  # Where along the quadrant the warp acts


def _angular_warp(b0: mi.Float, b1: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Parameters 1/κ, ρ of the warp that makes the density more uniform along the azimuth.

    The plain half-angle map has the same density at both ends of the quadrant. κ takes away the
    deviation between them, and ρ places the warp. Any choice gives an exact density: these are
    polynomials fitted to the least largest deviation from uniform over all half-angles.

    Parameters
    ----------
    b0, b1
        ``1 / (2 (1 + cos α))`` of the larger and the smaller half-angle: ¼ for small lights, ½ for
        those that fill the hemisphere.
    """
    a, b = b0 - 0.25, b1 - 0.25
    inv_kappa = dr.fma(a - b, dr.fma(a, dr.fma(-1.26, a, 1.78), b * dr.fma(6.17, a, -2.29)), 1)
    rho = 1 - a * dr.fma(3.65, a, 1.34)
    return inv_kappa, rho


def rim(record: Record, c: mi.Float, s: mi.Float) -> tuple[mi.Float, mi.Float]:
    """The rim of the cone at an azimuth.

    Parameters
    ----------
    c, s
        Cosine and sine of the eccentric angle ``t`` of the azimuth.

    Returns
    -------
    density
        ``a1 b1 dt`` per solid angle.
    extent
        ``1 - cos θmax``, θmax the angle between axis and rim.
    """
    c2, s2 = c * c, s * s
    stretch = dr.fma(record.ka, c2, record.kb * s2)
    r2 = dr.fma(dr.square(record.a1), c2, dr.square(record.b1) * s2) / stretch
    q = 1 + r2
    f = q + dr.sqrt(q)
    return stretch * f, r2 / f


def _density(record: Record, c: mi.Float, s: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Density per solid angle at an azimuth, constant along the radius, and the rim's extent.

    `c` and `s` may have a common factor: the c² + s² of `rim` cancels against that of the
    derivative of the inverse warp.
    """
    density, extent = rim(record, c, s)
    rho2 = dr.square(record.rho)
    c2, s2 = rho2 * c * c, s * s
    cos2, sin2 = c2 - s2, 2 * record.rho * record.inv_kappa * c * s
    norm = dr.sqrt(dr.fma(cos2, cos2, sin2 * sin2))
    shift = 0.5 * norm * ((norm + cos2) + rho2 * (norm - cos2))
    scale = record.a1 * record.b1 * shift
    return dr.inv_two_pi * rho2 * record.inv_kappa * density * (c2 + s2) / scale, extent


def warp(record: Record, c: mi.Float, s: mi.Float) -> tuple[mi.Float, mi.Float]:
    """Eccentric angle of the azimuth from the uniform angle, each as (cosine, sine).

    Stretches the tangent by ρ, multiplies the tangent of the double angle by κ and stretches back;
    the result has a common factor.
    """
    c = record.rho * c
    cos2, sin2 = record.inv_kappa * dr.fma(c, c, -s * s), 2 * c * s
    w = dr.sqrt(dr.fma(cos2, cos2, sin2 * sin2)) + dr.abs(cos2)
    upright = cos2 >= 0
    sign = dr.sign(dr.select(upright, c, s))
    return sign * dr.select(upright, w, sin2), sign * record.rho * dr.select(upright, sin2, w)


def direction(record: Record, c: mi.Float, s: mi.Float, height: mi.Float) -> mi.Vector3f:
    """Direction in the cone's frame, ``1 - cos θ`` being `height` there."""
    x, y = record.a1 * c, record.b1 * s
    r = dr.sqrt(height * (2 - height) / dr.fma(x, x, y * y))
    return mi.Vector3f(x * r, y * r, 1 - height)


class SolidAngle:
    """Directions almost uniform in solid angle over the whole light.

    The azimuth runs with the eccentric angle of an ellipse whose semi-axes are the sines of the
    half half-angles, corrected by one closed-form warp; along the radius ``1 - cos θ`` is uniform,
    so the density depends on the azimuth alone. It is within ±0.03 % of uniform for half-angles up
    to 45°, ±0.06 % up to 63° and ±1.8 % always. No elliptic integral, no inversion.
    """

    def prepare(self, ellipse: Ellipse, reference: mi.Point3f, normal: mi.Normal3f) -> Record:
        """Cone and warp of a reference point; its normal is not used."""
        seen = cone.from_point(ellipse, reference)
        # Beyond a tangent of 1e9 the half-angle is 90° to single precision.
        ta2, tb2 = dr.minimum(seen.ta2, 1e18), dr.minimum(seen.tb2, 1e18)
        qa, qb = 1 + ta2, 1 + tb2
        fa, fb = qa + dr.sqrt(qa), qb + dr.sqrt(qb)
        inv = 0.5 / (fa * fb)
        ka, kb = inv * fb, inv * fa
        inv_kappa, rho = _angular_warp(ka * qa, kb * qb)
        return Record(
            cone=seen,
            a1=dr.sqrt(ta2 * ka),
            b1=dr.sqrt(tb2 * kb),
            ka=ka,
            kb=kb,
            inv_kappa=inv_kappa,
            rho=rho,
        )

    def sample(self, record: Record, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Direction along the light's ``(ex, ey, normal)``, its density, and validity."""
        s, c = dr.sincos(dr.two_pi * u.x)
        c, s = warp(record, c, s)
        pdf, extent = _density(record, c, s)
        d = direction(record, c, s, extent * u.y)
        return record.cone.from_local(d), pdf, mi.Mask(True)

    def pdf(self, record: Record, direction: mi.Vector3f) -> mi.Float:
        """Density of a direction that meets the light."""
        d = record.cone.to_local(direction)
        c, s = d.x * record.b1, d.y * record.a1
        largest = dr.maximum(dr.abs(c), dr.abs(s))
        scale = dr.rcp(largest)
        axial = largest == 0
        c, s = dr.select(axial, 1, c * scale), dr.select(axial, 0, s * scale)
        return _density(record, c, s)[0]
