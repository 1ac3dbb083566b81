"""Numbers, tables and plots of a plane."""

import csv

import matplotlib.image
import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from conftest import lamp
from mi_ellipse.lighting import plot, report
from mi_ellipse.lighting.plane import Plane
from mi_ellipse.lighting.report import Illuminance

from oracles.ellipse import rotation, translation

PLANE = Plane((0, 0, 0.5), (2, 0, 0), (0, 1, 0))


def illuminance(values, errors=0.1):
    values = np.array(values, float)
    points = PLANE.points(values.shape[1], values.shape[0])
    return Illuminance(PLANE, points, values, np.full(values.shape, errors))


def test_numbers_of_a_report():
    found = illuminance([[100, 200, 300], [400, 500, 600]])
    assert (found.minimum, found.mean, found.maximum) == (100, 350, 600)
    assert found.uniformity == pytest.approx(100 / 350)
    assert found.diversity == pytest.approx(100 / 600)
    assert found.mean_error == pytest.approx(0.1 / np.sqrt(6))
    text = report.summary(found)
    for words in ("2 x 1, 3 x 2 points", "350 lx", "100 lx at 0.333, 0.25, 0.5", "0.29", "0.17"):
        assert words in text


def test_darkness_has_no_uniformity():
    found = illuminance(np.zeros((2, 2)), 0)
    assert np.isnan(found.uniformity)
    assert np.isnan(found.diversity)
    assert "nan" in report.summary(found)
    plot.draw(found)


def test_table(tmp_path):
    found = illuminance([[100, 200.125, 300], [400, 500, 1234567]], 0.123)
    report.write_csv(tmp_path / "lux.csv", found)
    with open(tmp_path / "lux.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["column"], row["row"]) for row in rows[:4]] == [
        ("0", "0"), ("1", "0"), ("2", "0"), ("0", "1")
    ]  # fmt: skip
    values = np.array([float(row["illuminance"]) for row in rows])
    np.testing.assert_allclose(values, found.values.ravel(), rtol=1e-5)  # six digits
    assert {row["standard_error"] for row in rows} == {"0.12"}
    places = [[float(row[axis]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(places, found.points.reshape(-1, 3), rtol=1e-5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (4, 6)])
def test_plot(tmp_path, shape):
    found = illuminance(np.arange(np.prod(shape)).reshape(shape) + 1)
    plot.write_plot(tmp_path / "lux.png", found)
    assert np.ptp(matplotlib.image.imread(tmp_path / "lux.png")) > 0.5
    axes = plot.draw(found).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x", "y")
    assert (axes.get_xlim(), axes.get_ylim()) == ((0, 2), (0, 1))


@pytest.mark.usefixtures("llvm_ad_rgb")
@pytest.mark.parametrize("steps", [1, 4])
def test_measured_in_steps(monkeypatch, steps):
    monkeypatch.setattr(report, "SAMPLES_AT_A_TIME", 12 * 1024 // steps)
    matrix = translation(1, 0.5, 2) @ rotation([1, 0, 0], 180)
    scene = mi.load_dict({"type": "scene", "lamp": lamp(matrix, "solid_angle")})
    told = []
    found = report.measure(
        scene, PLANE, 4, 3, efficacy=100, progress=lambda *call: told.append(call)
    )
    assert told == [(k + 1, steps) for k in range(steps)]
    truth = 100 * mi_ellipse.irradiance(matrix, found.points, np.array([0.0, 0, 1]))
    # Twelve points with 15 degrees of freedom: beyond 6 once in some thousand seeds
    assert (np.abs(found.values - truth) < 6 * found.errors).all()
    assert 0 < found.errors.max() < 0.01 * found.mean
    dark = report.measure(scene, PLANE.flipped(), 4, 3)
    assert dark.maximum == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [({"columns": 0}, "grid=0x3"), ({"efficacy": 0}, "efficacy=0"), ({"efficacy": -1}, "positive")],
)
def test_impossible_measurements(options, message):
    with pytest.raises(ValueError, match=message):
        report.measure(None, PLANE, **{"columns": 4, "rows": 3} | options)
