"""Polynomials of `solid_angle._azimuth`: sine and cosine of the quarter angle.

With w = v², the fraction of the quarter angle squared, ``sin(πv/4) / v`` and ``cos(πv/4)`` are
smooth functions on [0, 1]. The polynomials are their Chebyshev series, cut off after the cubic
term: the least squares under the weight 1/√(w(1 - w)). Their largest errors are within 3 % of the
least possible, which Remez' exchange finds. Both are below half a unit of single precision, 6e-8.

All is computed in double precision; the committed coefficients have 9 digits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mi_ellipse.sampling.solid_angle import QUARTER_COSINE, QUARTER_SINE

DEGREE = 3
Function = Callable[[np.ndarray], np.ndarray]


def sine_over_fraction(w: np.ndarray) -> np.ndarray:
    """Sine of the quarter angle over its fraction v, w = v²."""
    return np.pi / 4 * np.sinc(np.sqrt(w) / 4)


def cosine(w: np.ndarray) -> np.ndarray:
    """Cosine of the quarter angle."""
    return np.cos(np.pi / 4 * np.sqrt(w))


def chebyshev(function: Function, nodes: int = 200) -> np.ndarray:
    """Coefficients, constant first, of the Chebyshev series on [0, 1] cut off after `DEGREE`."""
    angle = (np.arange(nodes) + 0.5) * np.pi / nodes
    values = function((1 + np.cos(angle)) / 2)
    series = [2 * np.mean(values * np.cos(k * angle)) for k in range(DEGREE + 1)]
    series[0] /= 2
    fit = np.polynomial.Chebyshev(series, domain=[0, 1])
    return fit.convert(kind=np.polynomial.Polynomial, domain=[-1, 1]).coef


def largest_error(function: Function, coefficients) -> float:
    """Largest absolute error of a polynomial on [0, 1]."""
    w = np.linspace(0, 1, 100_001)
    return float(np.abs(np.polyval(coefficients[::-1], w) - function(w)).max())


def remez(function: Function, rounds: int = 8) -> float:
    """Least largest absolute error of a polynomial of this degree on [0, 1]."""
    w = np.linspace(0, 1, 100_001)
    values = function(w)
    x = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, DEGREE + 2))
    for _ in range(rounds):
        signs = (-1.0) ** np.arange(DEGREE + 2)
        matrix = np.column_stack([np.vander(x, DEGREE + 1, increasing=True), signs])
        coefficients = np.linalg.solve(matrix, function(x))[:-1]
        error = np.polyval(coefficients[::-1], w) - values
        parts = np.split(np.arange(len(w)), np.flatnonzero(np.diff(np.sign(error))) + 1)
        x = np.array([w[part[np.argmax(np.abs(error[part]))]] for part in parts])
    return float(np.abs(error).max())


def main() -> None:
    """Print what is derived beside what is committed."""
    for name, function, committed in (
        ("sine", sine_over_fraction, QUARTER_SINE),
        ("cosine", cosine, QUARTER_COSINE),
    ):
        print(name, "derived  ", *(f"{c:.9g}" for c in chebyshev(function)))
        print(name, "committed", *(f"{c:.9g}" for c in committed))
        error, least = largest_error(function, committed), remez(function)
        print(f"  largest error {error:.3g}, {error / least:.3f} of the least possible")


if __name__ == "__main__":
    main()
