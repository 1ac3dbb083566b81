"""Numbers of steps and nodes, and the series coefficient of textured lights.

- CEL_STEPS: errors of Bulirsch's steps against Carlson's R_J, in double precision. 6 are the fewest
  whose error is below the rounding of single precision over half-angle tangents in [1e-6, 1e6].
- NODES of the clipped irradiance: error against 256 nodes, relative to the irradiance without a
  horizon. 32 nodes keep it within 1e-6 for half-angle tangents up to 10 (84°), aspect ratios from
  0.01 and normals in all directions. It grows beyond: 1e-4 at tangents up to 100.
- Two steps of `cone.confocal_root`: relative errors of the start, of Cauchy's step and of
  Schröder's, in double precision.
- NEARNESS of textured lights, 1/8: the relative variance of area sampling of the solid angle, on
  the axis of a disk of tangent T, over T² as T grows.
- NEWTON_STEPS and NODES of `concentric`: errors of the eccentric angle after steps of Newton's
  method from the angular warp, over half-angles up to 89.99°. Against 64 nodes and
  8 steps: 4e-8 after two steps.
"""

from __future__ import annotations

import mitsuba as mi
import numpy as np
from mi_ellipse.geometry import irradiance
from mi_ellipse.geometry.cone import CEL_STEPS, ON_AXIS
from mi_ellipse.sampling.concentric import NEWTON_STEPS
from mi_ellipse.sampling.concentric import NODES as CONCENTRIC_NODES
from scipy.special import elliprj

from .angular_warp import COMMITTED, LIMIT, half_angles, solid_angle_per_azimuth, warp
from .floors import ROUNDING

# Largest half-angle tangent and least aspect ratio
CLASSES_OF_IRRADIANCE = (1, 0.1), (10, 0.1), (10, 0.01), (100, 0.01)


def solid_angle_error(steps: int, count: int = 60) -> float:
    """Largest relative error of Bulirsch's form after a number of steps."""
    grid = 10 ** np.linspace(-6, 6, count)
    ta, tb = (t[np.tril_indices(count)] for t in np.meshgrid(grid, grid, indexing="ij"))
    exact = 4 / 3 * ta * tb * elliprj(0, 1 + ta**2, 1 + tb**2, 1)
    a = 1 + ta**2
    kc, p = np.sqrt((1 + tb**2) / a), a**-0.5
    q, total, e, m = 1 / p, 0.0, kc, 1.0
    for _ in range(steps):
        total, f = total + q / p, total
        g = e / p
        q = 2 * (f * g + q)
        p, m = p + g, m + kc
        kc = 2 * np.sqrt(e)
        e = kc * m
    cel = 0.5 * np.pi * (total * m + q) / (m * (m + p))
    return float(np.abs(4 * ta * tb * a**-1.5 * cel / exact - 1).max())


def irradiance_errors(
    nodes: int, widest: float, thinnest: float, count: int = 4000, seed: int = 5
) -> np.ndarray:
    """Errors of the clipped irradiance with a number of nodes, in units without a horizon.

    Half-angle tangents up to `widest`, aspect ratios down to `thinnest`, normals in all directions.
    """
    rng = np.random.default_rng(seed)
    ta = 10 ** rng.uniform(-2, np.log10(widest), count)
    tb = ta * 10 ** rng.uniform(np.log10(thinnest), 0, count)
    normal = rng.normal(size=(3, count))
    normal /= np.linalg.norm(normal, axis=0)
    arguments = mi.Float64(ta), mi.Float64(tb), mi.Vector3d(normal)

    def evaluate(number: int) -> np.ndarray:
        before = irradiance.NODES, irradiance.WEIGHTS
        try:
            irradiance.NODES, irradiance.WEIGHTS = np.polynomial.legendre.leggauss(number)
            n = mi.Vector3d(arguments[2].x, arguments[2].y, abs(arguments[2].z))
            return np.array(irradiance._below(*arguments[:2], n))
        finally:
            irradiance.NODES, irradiance.WEIGHTS = before

    whole = np.pi * ta * tb / np.sqrt((1 + ta**2) * (1 + tb**2))
    return np.abs((evaluate(nodes) - evaluate(256)) / whole)


def root_errors(count: int = 100_000, seed: int = 1) -> list[float]:
    """Largest relative errors of the confocal root: start, first and second step.

    Against Newton's method from above in double precision, over needles and circles seen from far
    and near.
    """
    rng = np.random.default_rng(seed)
    e2 = 10 ** rng.uniform(-6, 0, count)
    angle = rng.uniform(0, 2 * np.pi, count)
    distance = 10 ** rng.uniform(-1, 1, count)
    x2 = (distance * np.cos(angle)) ** 2 + ON_AXIS
    y2 = (distance * np.sin(angle)) ** 2
    z2 = 10 ** rng.uniform(-4, 1, count)
    a, b, c = x2 - 1 + y2 + z2 - e2, e2 * (x2 - 1 + z2) + y2 + z2, z2 * e2

    def positive(b, p, k):
        q = np.abs(b) + np.sqrt(b * b + 4 * k * p)
        return np.where(b > 0, q / (2 * k), 2 * p / q)

    large = b > 0
    root = positive(np.where(large, a, b), np.where(large, b, c), np.where(large, 1, -a))
    r2, m = x2 + y2, x2 + e2 * y2
    root = np.maximum(root, positive(r2 * (x2 + y2 + z2) - m, m * z2, r2))
    exact = x2 + y2 + z2  # Above the root
    for _ in range(200):
        value = ((exact - a) * exact - b) * exact - c
        exact = exact - value / ((3 * exact - 2 * a) * exact - b)

    errors = [root]
    value, slope, half = _taylor(root, a, b, c)
    root = root - 2 * value / (slope + np.sqrt(np.maximum(slope**2 - 4 * half * value, 0)))
    errors.append(root)
    value, slope, half = _taylor(root, a, b, c)
    change = value / slope
    q = change * half / slope
    errors.append(root - change * (1 + q * (1 + 2 * q) - change**2 / slope))
    return [float(np.abs(found / exact - 1).max()) for found in errors]


def _taylor(root, a, b, c):
    """Value, slope and half the second derivative of ``λ³ - a λ² - b λ - c``."""
    value = ((root - a) * root - b) * root - c
    return value, (3 * root - 2 * a) * root - b, 3 * root - a


def azimuth_errors(steps: int, count: int = 16) -> float:
    """Largest error of the eccentric angle of `concentric` after steps of Newton's method."""
    alpha, beta = half_angles(LIMIT, 30)
    s = np.linspace(0.01, np.pi / 2 - 0.01, 60)

    def cumulative(t: np.ndarray, nodes: int) -> np.ndarray:
        x, w = np.polynomial.legendre.leggauss(nodes)
        parts = (solid_angle_per_azimuth(alpha, beta, t * (1 + k) / 2) for k in x)
        return t / 2 * sum(weight * part for weight, part in zip(w, parts, strict=True))

    def invert(nodes: int, number: int) -> np.ndarray:
        t, _ = warp(COMMITTED, alpha, beta, s)
        quadrant = cumulative(np.full((1, 1), np.pi / 2), nodes)
        for _ in range(number):
            error = cumulative(t, nodes) - s * 2 / np.pi * quadrant
            t = t - error / solid_angle_per_azimuth(alpha, beta, t)
        return t

    return float(np.abs(invert(count, steps) - invert(64, 8)).max())


def nearness(tangent: float) -> float:
    """Relative variance of area sampling over T², on the axis of a disk: in closed form."""
    t2 = tangent**2
    mean = 2 * (1 - (1 + t2) ** -0.5) / t2
    second = (1 - (1 + t2) ** -2) / (2 * t2)
    return (second / mean**2 - 1) / t2


def main() -> None:
    """Print what is derived beside what is committed."""
    mi.set_variant("llvm_ad_rgb")
    for steps in range(4, 8):
        print(f"CEL_STEPS {steps}: {solid_angle_error(steps):.1e}, rounding {ROUNDING:.1e}")
    print(f"  committed {CEL_STEPS}")
    for nodes in (8, 16, 32, 64):
        for widest, thinnest in CLASSES_OF_IRRADIANCE:
            errors = irradiance_errors(nodes, widest, thinnest)
            print(f"{nodes} nodes, tangents to {widest:g}, aspect from {thinnest:g}:", end="")
            print(f" largest {errors.max():.1e}, 99 % within {np.quantile(errors, 0.99):.1e}")
    nodes = len(CONCENTRIC_NODES)
    for steps in range(NEWTON_STEPS + 1):
        print(f"concentric, {nodes} nodes, {steps} steps: {azimuth_errors(steps, nodes):.1e}")
    print("confocal root:", *(f"{error:.1e}" for error in root_errors()))
    for tangent in (10, 100, 1000):
        print(f"nearness at tangent {tangent}: {nearness(tangent):.4f}")


if __name__ == "__main__":
    main()
