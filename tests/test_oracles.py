"""The oracles: independent of the package, and of one mind where two of them answer."""

import ast
from pathlib import Path

import mpmath
import numpy as np
import pytest

import oracles.ellipse as oracle
from oracles.lights import CLASSES, make_lights

FOLDER = Path(oracle.__file__).parent


def test_nothing_comes_from_the_package():
    """Every import of every file: of other projects, or of a neighbour."""
    files = list(FOLDER.rglob("*.py"))
    assert len(files) > 3
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                assert not any(name.name.startswith("mi_ellipse") for name in node.names), file
            elif isinstance(node, ast.ImportFrom):
                assert node.level <= 1, file
                assert not (node.module or "").startswith("mi_ellipse"), file


def test_carlson_integral_is_the_solid_angle():
    """Against quadrature, in mpmath and on a grid."""
    for ta, tb in [(1e-3, 1e-3), (0.5, 0.2), (2, 0.5), (3, 3), (20, 0.01), (30, 10)]:
        a, b = mpmath.mpf(ta), mpmath.mpf(tb)

        def cap(t, a=a, b=b):
            r2 = (a * mpmath.cos(t)) ** 2 + (b * mpmath.sin(t)) ** 2
            return (1 - 1 / mpmath.sqrt(1 + r2)) * a * b / r2

        nodes = [0, 0.01, 0.1, 0.5, mpmath.pi / 2]
        exact = 4 * mpmath.quad(cap, nodes)
        assert abs(oracle.solid_angle(ta, tb) / exact - 1) < 1e-12
        if ta < 5:
            assert abs(oracle.cone_grid(ta, tb, 1024)[1].sum() / exact - 1) < 1e-12


def test_cone_at_the_extremes():
    """Against eigenvectors of 700-bit arithmetic.

    The eigenvalues are to each other as the squared tangents, so that an eigen-solve of rounding ε
    errs by ε / ta² for small lights and by ε ta² for flat cones: a hundred times that.
    """
    data = oracle.extreme_ellipses()
    u, w, centre, reference = (data[k].astype(float) for k in ("U", "W", "centre", "reference"))
    fair = (data["ta"] > 1e-3) & (data["ta"] < 1e3) & (data["input_rounding"] < 1e-4)
    assert fair.sum() > 100
    for i in np.flatnonzero(fair):
        frame, ta, tb = oracle.cone(u[i], w[i], centre[i] - reference[i])
        tolerance = 2e-14 * (data["ta"][i] ** 2 + data["ta"][i] ** -2)
        assert [ta, tb] == pytest.approx([data["ta"][i], data["tb"][i]], rel=tolerance)
        assert frame[2] == pytest.approx(data["cone_z"][i], abs=tolerance)


def test_the_two_irradiance_oracles_agree():
    """Rim against surface, above, across and below the horizon."""
    rng = np.random.default_rng(12)
    for _ in range(10):
        u, w = rng.normal(size=(2, 3))
        normal, centre = rng.normal(size=(2, 3))
        plane = np.cross(u, w)
        centre += 3 * plane / np.linalg.norm(plane)
        normal /= np.linalg.norm(normal)
        line = oracle.irradiance(u, w, centre, normal)
        surface = oracle.irradiance_by_area(u, w, centre, normal)
        assert line == pytest.approx(surface, rel=1e-5, abs=1e-6)  # A kink at the horizon


@pytest.mark.parametrize("straddling", [False, True], ids=["above", "straddling"])
@pytest.mark.parametrize("name", ["far", "near", "very near", "needle"])
def test_random_lights_have_the_irradiance_of_their_rim(name, straddling):
    """Chords and the closed form against the contour integral, on both sides of the horizon."""
    assert name in CLASSES
    lights = make_lights(name, 6, straddling)
    for i in range(6):
        u, w, _, c = lights.to_world[:3, :, i].T
        ta = oracle.cone(u, w, c)[1]
        for side, expected in zip((1, -1), lights.irradiance[:, i], strict=True):
            got = oracle.irradiance(u, w, c, side * lights.normal[:, i])
            # The sum along a contour of length ta cancels where a thin part is left: 500 roundings
            # of it, measured 110.
            assert got == pytest.approx(expected, rel=1e-6, abs=1e-13 * ta)
