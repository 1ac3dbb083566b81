"""What elliptical lights do, in NumPy and double precision, without a line of the package.

A light is given as in `tests/data`: centre ``c`` and semi-axis vectors ``u``, ``w``, all relative
to the reference point where the function says so.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mpmath
import numpy as np
from scipy.special import elliprj

DATA = Path(__file__).parent / "data"


def extreme_ellipses() -> dict[str, np.ndarray]:
    """The lights of `tests/data`."""
    with np.load(DATA / "extreme_ellipses.npz", allow_pickle=False) as data:
        return dict(data)


@cache
def gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in [-1, 1] and weights of the Gauss-Legendre rule."""
    return np.polynomial.legendre.leggauss(count)


# ---- Transforms ----


def rotation(axis, degrees: float) -> np.ndarray:
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


def linear(columns) -> np.ndarray:
    """4×4 matrix whose linear part has these columns."""
    result = np.eye(4)
    result[:3, :3] = np.transpose(columns)
    return result


# A shear out of and within the light's plane
SHEAR = linear([[1, 0.2, 0], [0.7, 1, 0], [0.3, -0.4, 1]])
MIRROR = np.diag([-1.0, 1, 1, 1])


def seen_from(matrix: np.ndarray, point) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(u, w, c) of the image of the unit disk, ``c`` relative to the point."""
    return matrix[:3, 0], matrix[:3, 1], matrix[:3, 3] - np.asarray(point, float)


# ---- The cone ----


def cone(u, w, c) -> tuple[np.ndarray, float, float]:
    """Rows (x, y, z) of the frame and the tangents ta ≥ tb, by an eigen-solve."""
    dual = np.outer(u, u) + np.outer(w, w) - np.outer(c, c)
    values, vectors = np.linalg.eigh(dual)  # ascending: -μ3, μ2, μ1
    x, y, z = vectors[:, 2], vectors[:, 1], vectors[:, 0]
    z = z * np.sign(z @ c)
    if np.dot(np.cross(x, y), z) < 0:
        y = -y
    ta, tb = np.sqrt(np.maximum(values[[2, 1]], 0) / -values[0])
    return np.array([x, y, z]), float(ta), float(tb)


def solid_angle(ta, tb):
    """Carlson's form, without cancellation."""
    return 4 / 3 * ta * tb * elliprj(0, 1 + ta**2, 1 + tb**2, 1)


def on_cone(ta: float, tb: float, turn, height) -> tuple[np.ndarray, np.ndarray]:
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


def cone_grid(ta: float, tb: float, turns: int = 128, heights: int = 64, rounded: bool = False):
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


def irradiance(u, w, c, n, nodes: int = 20000) -> float:
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
        total += np.sign(n @ across) * np.arctan2(np.linalg.norm(across), end @ start)
    return 0.5 * abs(float(total))


def irradiance_by_area(u, w, c, n, nodes: int = 200) -> float:
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


@cache
def extreme_ellipsoids(per_stratum: int = 40) -> dict[str, np.ndarray]:
    """Ellipsoids seen from outside, as `extreme_ellipses`: axes as columns, and the truth.

    Centre and reference point are rounded to single precision, the axes are not.
    """
    rng = np.random.default_rng(5)
    cases = [_extreme(rng, name) for name in STRATA for _ in range(per_stratum)]
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
        "stratum": np.repeat(np.arange(len(STRATA)), per_stratum),
        "labels": np.array(STRATA),
    }


def _extreme(rng, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    }.get(name, [1, a, b])
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
