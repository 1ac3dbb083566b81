"""Coefficients of `solid_angle._angular_warp`: least largest deviation from a uniform density.

Minimised is the largest ``|p Ω - 1|`` over all pairs of half-angles up to 89.99°, p the density and
Ω the solid angle. It is stated here anew, in NumPy and double precision. The search is that of
Nelder and Mead from the committed coefficients, and from disturbed ones. The largest deviation
depends on some of the coefficients only where half-angles are near 90°, so it fixes them to a few
hundredths. The committed ones have two decimals; their largest deviation is within 2 % of the least
one found.
"""

from __future__ import annotations

import numpy as np
from mi_ellipse.sampling.solid_angle import WARP_PLACE, WARP_STRENGTH
from scipy.optimize import minimize

COMMITTED = np.array([*WARP_STRENGTH, *WARP_PLACE])
LIMIT = 89.99


def half_angles(limit: float, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of half-angles in radians, the larger up to a limit in degrees; shape (pairs, 1)."""
    larger = np.linspace(0.02, np.radians(limit), count)
    parts = np.append(np.linspace(0.02, 1, 25), 1e-3)
    alpha, beta = np.broadcast_arrays(larger[:, None], larger[:, None] * parts)
    return alpha.reshape(-1, 1), beta.reshape(-1, 1)


def warp(coefficients: np.ndarray, alpha, beta, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eccentric angle t of angles s in a quadrant, and dt/ds; half-angles of shape (pairs, 1).

    Tangent over ρ, tangent of the double angle times κ, tangent times ρ.
    """
    k0, k1, k2, k3, p1, p2 = coefficients
    a, b = (0.5 / (1 + np.cos(angle)) - 0.25 for angle in (alpha, beta))
    kappa = 1 / (1 + (a - b) * (a * (k0 * a + k1) + b * (k2 * a + k3)))
    rho = 1 - a * (p2 * a + p1)
    first = np.arctan2(np.sin(s), rho * np.cos(s))
    second = 0.5 * np.arctan2(kappa * np.sin(2 * first), np.cos(2 * first))
    t = np.arctan2(rho * np.sin(second), np.cos(second))
    growth = rho / (np.sin(s) ** 2 + (rho * np.cos(s)) ** 2)
    growth = growth * kappa / (np.cos(2 * first) ** 2 + (kappa * np.sin(2 * first)) ** 2)
    return t, growth * rho / (np.cos(second) ** 2 + (rho * np.sin(second)) ** 2)


def solid_angle_per_azimuth(alpha, beta, t: np.ndarray) -> np.ndarray:
    """``(1 - cos θmax) dφ/dt``, φ the azimuth of the eccentric angle t."""
    x, y = np.sin(alpha / 2) * np.cos(t), np.sin(beta / 2) * np.sin(t)
    radius2 = x**2 + y**2
    cot2 = ((x / np.tan(alpha)) ** 2 + (y / np.tan(beta)) ** 2) / radius2
    height = 1 / (1 + cot2 + np.sqrt(cot2 * (1 + cot2)))
    return height * np.sin(alpha / 2) * np.sin(beta / 2) / radius2


def deviation(coefficients: np.ndarray, alpha, beta, azimuths: int = 48) -> np.ndarray:
    """``p Ω - 1`` at azimuths of a quadrant, for half-angles of shape (pairs, 1)."""
    t, growth = warp(coefficients, alpha, beta, np.linspace(0, np.pi / 2, azimuths + 1))
    part = solid_angle_per_azimuth(alpha, beta, t) * growth
    total = (part.sum(axis=1) - 0.5 * (part[:, 0] + part[:, -1])) / azimuths
    return total[:, None] / part - 1


def largest(coefficients: np.ndarray, limit: float = LIMIT, count: int = 60) -> float:
    """Largest deviation over half-angles up to a limit in degrees."""
    return float(np.abs(deviation(coefficients, *half_angles(limit, count))).max())


def derive(start: np.ndarray = COMMITTED, steps: int = 1500, count: int = 60) -> np.ndarray:
    """Coefficients of the least largest deviation that a search from a start finds."""
    pairs = half_angles(LIMIT, count)
    options = {"maxfev": steps, "xatol": 1e-4, "fatol": 1e-7}
    return minimize(
        lambda k: np.abs(deviation(k, *pairs)).max(), start, method="Nelder-Mead", options=options
    ).x


def main() -> None:
    """Print what is derived beside what is committed."""
    rng = np.random.default_rng(0)
    starts = [COMMITTED, *(COMMITTED + rng.normal(scale=0.2, size=(4, 6)))]
    best = min((derive(start) for start in starts), key=largest)
    print("derived  ", *(f"{k:.2f}" for k in best), f" largest {largest(best):.5f}")
    print("committed", *(f"{k:.2f}" for k in COMMITTED), f" largest {largest(COMMITTED):.5f}")
    for limit in (45, 63, LIMIT):
        print(f"  up to {limit}°: ±{100 * largest(COMMITTED, limit):.3f} %")


if __name__ == "__main__":
    main()
