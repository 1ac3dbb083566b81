"""Irradiance from a cone of unit radiance, clipped at the horizon of a surface."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .tracing import TINY

# Gauss-Legendre rule over the azimuths at which the horizon cuts the cone. With 32 nodes the error
# is some 1e-6 of the irradiance without the horizon, for tangents of the half-angles up to 10 and
# ratios of these tangents from 0.01. For tangents up to 100 the error reaches 1.3e-4
# (derivations/quadrature.py).
NODES, WEIGHTS = np.polynomial.legendre.leggauss(32)


def clipped(ta: mi.Float, tb: mi.Float, normal: mi.Vector3f) -> mi.Float:
    """Irradiance from the part of a cone above the horizon of a normal.

    The irradiance of the whole cone has a closed form (`cone.vector_irradiance`). It counts the
    part below the horizon as negative. Where the horizon divides the cone, this function adds that
    part again. The part is a smooth integral over the azimuth about the axis of the cone, in closed
    form along the radius. All of it is in double precision.

    Parameters
    ----------
    ta, tb
        Tangents of the larger and the smaller half-angle.
    normal
        Unit normal in the frame of the cone.

    Returns
    -------
    mi.Float
        Irradiance over radiance, in [0, π].
    """
    ta, tb = mi.Float64(ta), mi.Float64(tb)
    n = mi.Vector3d(normal)
    sign = dr.mulsign(mi.Float64(1), n.z)
    n *= sign
    whole = dr.pi * ta * tb / dr.sqrt((1 + ta * ta) * (1 + tb * tb)) * n.z
    missing = _below(ta, tb, n)
    return mi.Float(dr.select(sign > 0, whole + missing, missing))


def _below(ta: mi.Float64, tb: mi.Float64, n: mi.Vector3d) -> mi.Float64:
    """Irradiance from the part of the cone below the horizon, at its lower side; ``n.z ≥ 0``."""
    # The horizon is the line n.x X + n.y Y + n.z = 0 of the tangent plane. It cuts the ellipse at
    # the eccentric angles `middle` ± `half`. Between them the ellipse is below the horizon.
    reach = dr.sqrt(dr.square(n.x * ta) + dr.square(n.y * tb))
    below = reach > n.z
    half = dr.acos(dr.select(below, n.z / dr.maximum(reach, TINY), 1))
    middle = dr.atan2(-n.y * tb, -n.x * ta)

    # The azimuths are eccentric angles of sin(θ/2). These do not crowd where the light is large.
    a1, b1 = (t / dr.sqrt(2 * (q + dr.sqrt(q))) for t, q in ((ta, 1 + ta * ta), (tb, 1 + tb * tb)))

    def half_angle(t):
        s, c = dr.sincos(t)
        return dr.atan2(a1 * tb * s, b1 * ta * c)

    centre = half_angle(middle)
    start = _within_half_turn(half_angle(middle - half) - centre)
    end = _within_half_turn(half_angle(middle + half) - centre)
    total = mi.Float64(0)
    for node, weight in zip(NODES, WEIGHTS, strict=True):
        s, c = dr.sincos(centre + start + (end - start) * float(0.5 + 0.5 * node))
        x, y = a1 * c, b1 * s
        rho2 = dr.maximum(x * x + y * y, TINY)
        towards = (n.x * x + n.y * y) / dr.sqrt(rho2)
        # Angles from the axis to the horizon and to the rim
        horizon = dr.atan2(n.z, -towards)
        rim = dr.atan(dr.sqrt(rho2 / (dr.square(x / ta) + dr.square(y / tb))))
        band = _radial(n.z, towards, rim) - _radial(n.z, towards, horizon)
        total -= float(weight) * 0.5 * (end - start) * a1 * b1 / rho2 * band
    return dr.select(below, dr.maximum(total, 0), 0)


def _within_half_turn(angle: mi.Float64) -> mi.Float64:
    return dr.select(
        angle > dr.pi, angle - 2 * dr.pi, dr.select(angle < -dr.pi, angle + 2 * dr.pi, angle)
    )


def _radial(upwards: mi.Float64, sideways: mi.Float64, theta: mi.Float64) -> mi.Float64:
    """Integral of ``(upwards cos θ + sideways sin θ) sin θ`` from 0 to θ."""
    s, c = dr.sincos(theta)
    return 0.5 * (upwards * s * s + sideways * (theta - s * c))
