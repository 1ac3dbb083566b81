"""Cone, solid angle and irradiance of an elliptical light, in NumPy and double precision.

A light is given as in `oracles/data`: semi-axis vectors ``u``, ``w`` and centre ``c``, which is
relative to the reference point. Where only the cone matters, its frame and the tangents ``ta`` and
``tb`` of its half-angles stand for the light.
"""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path

import mpmath
import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad
from scipy.special import elliprj

DATA = Path(__file__).parent / "data"


def extreme_ellipses() -> dict[str, np.ndarray]:
    """The lights of `oracles/data`."""
    with np.load(DATA / "extreme_ellipses.npz", allow_pickle=False) as data:
        return dict(data)


@cache
def gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in [-1, 1] and weights of the Gauss-Legendre rule."""
    return np.polynomial.legendre.leggauss(count)


# ---- Transforms ----


def rotation(axis: ArrayLike, degrees: float) -> np.ndarray:
    """4×4 rotation about an axis (Rodrigues)."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = np.radians(degrees)
    result = np.eye(4)
    result[:3, :3] += np.sin(a) * k + (1 - np.cos(a)) * k @ k
    return result


def translation(x: float, y: float, z: float) -> np.ndarray:
    """4×4 translation."""
    result = np.eye(4)
    result[:3, 3] = x, y, z
    return result


def linear(columns: ArrayLike) -> np.ndarray:
    """4×4 matrix whose linear part has these columns."""
    result = np.eye(4)
    result[:3, :3] = np.transpose(columns)
    return result


# A shear out of and within the light's plane
SHEAR = linear([[1, 0.2, 0], [0.7, 1, 0], [0.3, -0.4, 1]])
MIRROR = np.diag([-1.0, 1, 1, 1])


def seen_from(matrix: np.ndarray, point: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(u, w, c) of the image of the unit disk, ``c`` relative to the point."""
    return matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] - np.asarray(point, float)


# ---- The cone ----


def dual_cone(c: ArrayLike, *semi_axes: ArrayLike) -> np.ndarray:
    """Symmetric 3×3 matrix ``Q`` with ``n·Q n = 0`` for the planes ``n`` that touch the light.

    Of an ellipse with its two semi-axis vectors, of an ellipsoid with three.
    """
    return sum(np.outer(axis, axis) for axis in semi_axes) - np.outer(c, c)


def cone(u: ArrayLike, w: ArrayLike, c: ArrayLike) -> tuple[np.ndarray, float, float]:
    """Rows (x, y, z) of the frame and the tangents ta ≥ tb, by an eigen-solve.

    The frame is right-handed, x along the larger half-angle, z towards the light.
    """
    (negative, _, largest), vectors = np.linalg.eigh(dual_cone(c, u, w))
    # The eigenvalue of a needle is lost in the rounding of the largest one. The determinant of the
    # matrix, -det(u, w, c)², gives it without that loss.
    middle = np.linalg.det(np.array([u, w, c])) ** 2 / (-negative * largest)
    x, z = vectors[:, 2], vectors[:, 0]
    z = z * np.sign(z @ c)
    ta, tb = np.sqrt(np.array([largest, middle]) / -negative)
    return np.array([x, np.cross(z, x), z]), float(ta), float(tb)


def solid_angle(ta: ArrayLike, tb: ArrayLike) -> np.ndarray:
    """Carlson's form, without cancellation."""
    return 4 / 3 * ta * tb * elliprj(0, 1 + ta**2, 1 + tb**2, 1)


def on_cone(
    ta: float, tb: float, turn: np.ndarray, height: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Directions inside the cone (its frame) at ``turn``, ``height`` in [0, 1].

    The tangent ellipse's eccentric angle is ``2π turn``, and along a radius ``1 - cos θ`` is
    proportional to the height. Second result: solid angle per unit of ``turn × height``.
    """
    x, y = ta * np.cos(2 * np.pi * turn), tb * np.sin(2 * np.pi * turn)
    r2 = x * x + y * y
    extent = r2 / (1 + r2 + np.sqrt(1 + r2))  # 1 - cos θmax
    h = extent * height
    s = np.sqrt(h * (2 - h) / r2)
    return np.stack([x * s, y * s, 1 - h], -1), 2 * np.pi * extent * ta * tb / r2


def cone_grid(
    ta: float, tb: float, turns: int = 128, heights: int = 64, rounded: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Quadrature over the cone: directions (its frame) and weights that sum to the solid angle.

    Midpoints around the axis, where everything is periodic, and Gauss-Legendre nodes along it.
    With `rounded` for integrands that are infinite at the rim as one over the root of the distance.
    """
    node, weight = gauss(heights)
    along, weight = 0.5 + 0.5 * node, 0.5 * weight
    if rounded:
        along, weight = along * (2 - along), weight * 2 * (1 - along)
    turn, height = np.meshgrid((np.arange(turns) + 0.5) / turns, along, indexing="ij")
    d, jacobian = on_cone(ta, tb, turn.ravel(), height.ravel())
    return d, jacobian * np.tile(weight, turns) / turns


# ---- Irradiance ----


def whole_irradiance(ta: float, tb: float) -> float:
    """``∫ z·ω dω`` over a cone with axis z: the length of the vector irradiance.

    It is the area of an ellipse with the sines of the half-angles as its semi-axes.
    """
    return np.pi * ta * tb / np.sqrt((1 + ta**2) * (1 + tb**2))


def irradiance(u: ArrayLike, w: ArrayLike, c: ArrayLike, n: ArrayLike, nodes: int = 20000) -> float:
    """``∫ max(0, n·ω) dω`` over the light by Stokes' theorem: ½ ∮ n·(r × dr) / r².

    The boundary is what is left of the rim above the horizon, by Gauss-Legendre quadrature, and
    the chord along the horizon, in closed form: the angle between its ends.
    """
    u, w, c, n = (np.asarray(v, float) for v in (u, w, c, n))
    # n·r(t) = n·c + R cos(t - t0) is positive around t0
    amplitude, t0 = np.hypot(n @ u, n @ w), np.arctan2(n @ w, n @ u)
    whole = n @ c >= amplitude
    if n @ c <= -amplitude:
        return 0.0
    half = np.pi if whole else np.arccos(-(n @ c) / amplitude)

    node, weight = gauss(64)
    panels = np.linspace(t0 - half, t0 + half, nodes // 64 + 1)
    t = (panels[:-1, None] + np.diff(panels)[:, None] * (0.5 + 0.5 * node)).ravel()
    weights = (np.diff(panels)[:, None] * 0.5 * weight).ravel()[:, None]
    cos_t, sin_t = np.cos(t)[:, None], np.sin(t)[:, None]
    r = c + u * cos_t + w * sin_t
    dr = w * cos_t - u * sin_t
    total = np.sum(np.cross(r, dr) @ n / np.sum(r * r, 1) * weights[:, 0])
    if not whole:
        start, end = (c + u * np.cos(t) + w * np.sin(t) for t in (t0 - half, t0 + half))
        across = np.cross(end, start)
        angle = np.arctan2(np.linalg.norm(across), end @ start)
        # In proportion to the normal, as the rim is: one rounded to single precision has no length
        # of 1, and where a thin part is left, the two cancel.
        total += np.linalg.norm(n) * np.sign(n @ across) * angle
    return 0.5 * abs(float(total))


def irradiance_by_area(
    u: ArrayLike, w: ArrayLike, c: ArrayLike, n: ArrayLike, nodes: int = 200
) -> float:
    """The same over the surface, ``∫ max(0, n·ω) cos θ / r² dA``, from points not too near."""
    node, weight = gauss(nodes)
    r, wr = 0.5 + 0.5 * node, 0.5 * weight
    t = 2 * np.pi * (np.arange(2 * nodes) + 0.5) / (2 * nodes)
    a, b = (r[:, None] * f(t) for f in (np.cos, np.sin))
    p = c + a[..., None] * u + b[..., None] * w
    r2 = np.sum(p * p, -1)
    cross = np.cross(u, w)
    integrand = np.maximum(p @ n, 0) * np.abs(p @ cross) / r2**2
    return float(np.sum(integrand * (wr * r)[:, None]) * np.pi / nodes)


def irradiance_by_chords(ta: float, tb: float, n: ArrayLike) -> float:
    """The same over chords parallel to a horizon that divides the light; n along the cone's frame.

    Where only a thin part is above the horizon, nothing cancels, as it does along the rim.

    With the tangent ellipse scaled to the unit disk and turned so that the horizon is ``x = h``,
    the irradiance is ``ta tb |g| ∫ (x - h) ∫ (1 + |X|²)⁻² dy dx``; the inner integral is
    elementary.
    """
    tangents, n = np.array([ta, tb]), np.asarray(n, float)
    g = tangents * n[:2]
    scale = np.hypot(*g)
    along = tangents * g / scale
    across = tangents * np.array([-g[1], g[0]]) / scale
    horizon = -n[2] / scale
    cc = across @ across

    def integrand(t: float) -> float:
        x, y = np.sin(t), np.cos(t)
        a, b = 1 + x * x * (along @ along), 2 * x * (along @ across)
        root = 2 * np.sqrt(cc + (x * ta * tb) ** 2)  # √(4 a cc - b²)

        def primitive(y: float) -> float:  # of (a + b y + cc y²)⁻²
            slope = 2 * cc * y + b
            return (
                slope / (a + y * (b + cc * y)) + 4 * cc / root * np.arctan(slope / root)
            ) / root**2

        return (x - horizon) * (primitive(y) - primitive(-y)) * y

    # For large cones the integrand peaks about the axis.
    start = np.arcsin(max(horizon, -1))
    peak = np.logspace(-8, 0, 17)
    ends = np.unique(np.clip([*-peak, 0, *peak, start, np.pi / 2], start, np.pi / 2))
    total = sum(
        quad(integrand, *piece, epsabs=0, epsrel=1e-9, limit=200)[0]
        for piece in itertools.pairwise(ends)
    )
    return ta * tb * scale * total


# ---- Ellipsoids ----


def solid_cone(axes, c) -> tuple[np.ndarray, float, float]:
    """`cone` of the ellipsoid ``{c + axes q : |q| ≤ 1}``, its semi-axis vectors as columns.

    Eigen-decomposition of ``axes axesᵀ - c cᵀ`` in 60-digit arithmetic.
    """
    with mpmath.workdps(60):
        a, c = mpmath.matrix(np.asarray(axes).tolist()), mpmath.matrix(np.asarray(c).tolist())
        values, vectors = mpmath.eigsy(a * a.T - c * c.T)  # ascending: -μ3, μ2, μ1
        ta, tb = (float(mpmath.sqrt(values[k] / -values[0])) for k in (2, 1))
        x, y, z = (np.array([float(vectors[i, k]) for i in range(3)]) for k in (2, 1, 0))
        z = z * np.sign(float(sum(vectors[i, 0] * c[i] for i in range(3)))) if any(c) else z
    if np.dot(np.cross(x, y), z) < 0:
        y = -y
    return np.array([x, y, z]), ta, tb


def solid_irradiance(axes, c, n, turns: int = 1024, heights: int = 256) -> float:
    """``∫ max(0, n·ω) dω`` over an ellipsoid by quadrature over its cone."""
    frame, ta, tb = solid_cone(axes, c)
    d, weight = cone_grid(ta, tb, turns, heights)
    return float(np.sum(weight * np.maximum(d @ frame @ np.asarray(n, float), 0)))


STRATA = (
    "ordinary", "sphere", "near sphere", "prolate", "oblate", "1e-5 above", "1e-2 above",
    "1e6 away", "needle", "beyond the tip", "pancake", "blade", "on an axis",
    "in a principal plane", "world offset",
)  # fmt: skip


STRATA_OF_SPHERES = (
    "ordinary", "1e-5 above", "1e-2 above", "1e6 away", "on an axis", "world offset",
)  # fmt: skip


@cache
def extreme_ellipsoids(per_stratum: int = 40) -> dict[str, np.ndarray]:
    """Ellipsoids seen from outside, as `extreme_ellipses`: axes as columns, and the truth.

    Centre and reference point are rounded to single precision, the axes are not.
    """
    rng = np.random.default_rng(5)
    return _with_truth(STRATA, [_extreme(rng, name) for name in STRATA for _ in range(per_stratum)])


@cache
def extreme_spheres(per_stratum: int = 40) -> dict[str, np.ndarray]:
    """Spheres seen from outside, as `extreme_ellipsoids`."""
    rng = np.random.default_rng(6)
    names = [name for name in STRATA_OF_SPHERES for _ in range(per_stratum)]
    return _with_truth(STRATA_OF_SPHERES, [_extreme(rng, name, sphere=True) for name in names])


def _with_truth(strata: tuple[str, ...], cases: list) -> dict[str, np.ndarray]:
    axes, centre, reference = (np.array(part) for part in zip(*cases, strict=True))
    centre, reference = (np.float32(v).astype(float) for v in (centre, reference))
    seen = [solid_cone(*each) for each in zip(axes, centre - reference, strict=True)]
    frame, ta, tb = (np.array(part) for part in zip(*seen, strict=True))
    return {
        "axes": axes,
        "centre": centre,
        "reference": reference,
        "frame": frame,
        "ta": ta,
        "tb": tb,
        "solid_angle": solid_angle(ta, tb),
        "stratum": np.repeat(np.arange(len(strata)), len(cases) // len(strata)),
        "labels": np.array(strata),
    }


def _extreme(rng, name: str, sphere: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Semi-axis vectors as columns, centre and reference point of one of `STRATA`."""
    a, b = np.sort(rng.uniform(0.1, 1, 2))[::-1]
    thin = 10 ** rng.uniform(-6, -3, 2)
    lengths = {
        "sphere": [a, a, a],
        "near sphere": [1, 1 - 1e-6, 1 - 2e-6],
        "prolate": [1, b, b],
        "oblate": [1, 1, b],
        "needle": [1, *thin],
        "beyond the tip": [1, *thin],
        "pancake": [1, a, thin[0]],
        "blade": [1, 1e-3, 1e-6],
    }.get("sphere" if sphere else name, [1, a, b])
    lengths = np.sort(lengths)[::-1]
    height = {"1e-5 above": 1e-5, "1e-2 above": 1e-2, "1e6 away": 1e6}.get(
        name, 10 ** rng.uniform(-3, 1)
    )
    q = rng.normal(size=3)
    q[rng.integers(3)] *= name != "in a principal plane"
    if name in ("on an axis", "beyond the tip"):
        q = np.eye(3)[0 if name == "beyond the tip" else rng.integers(3)]
    q /= np.linalg.norm(q)
    point = q * lengths + height * (q / lengths) / np.linalg.norm(q / lengths)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if name in ("on an axis", "beyond the tip", "in a principal plane"):
        turn = np.eye(3)  # So that rounding moves nothing from axis and plane
    centre = np.float32(1e3 * rng.normal(size=3)) if name == "world offset" else np.zeros(3)
    return turn * lengths, centre, turn @ point + centre
