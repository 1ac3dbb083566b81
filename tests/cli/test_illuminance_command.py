"""`mi-ellipse illuminance` end to end."""

import csv

import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from commands import files, invoke, read

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


def table(path):
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    columns = [[float(row[name]) for name in "xyz"] for row in rows]
    return np.array(columns), *(
        np.array([float(row[name]) for row in rows]) for name in ("illuminance", "standard_error")
    )


def test_table_plot_and_summary(scene_file):
    """The lamp is a disk of radius 1, 2 above the floor, which is 6 wide."""
    arguments = ["illuminance", scene_file, "--plane", "z=0", "--grid", "6x4", "-o", "lux.csv"]
    result = invoke(*arguments)
    assert result.exit_code == 0, result.output
    assert files(scene_file.parent) == ["lux.csv", "lux.png", "scene.xml"]
    assert read("lux.png").shape[1] > 500

    points, values, errors = table("lux.csv")
    np.testing.assert_allclose(points[:2], [[-2.5, -2.25, 0], [-1.5, -2.25, 0]])
    T = mi.ScalarTransform4f
    disk = T().translate([0, 0, 2]).rotate([1, 0, 0], 180)
    truth = mi_ellipse.irradiance(disk, points, np.array([0.0, 0, 1]))
    # 24 points with 15 degrees of freedom: beyond 6 once in some thousand seeds; six digits
    assert (np.abs(values - truth) < 6 * errors + 1e-5 * truth).all()
    assert f"{values.min() / values.mean():.2f} (minimum / mean)" in result.stdout
    assert "6 x 6, 6 x 4 points, normal 0, 0, 1" in result.stdout

    lumens = invoke(*arguments, "--efficacy", 179, "--no-grouping", "--samples", 64)
    assert lumens.exit_code == 0, lumens.output
    np.testing.assert_allclose(table("lux.csv")[1], 179 * truth, rtol=0.02)
    assert invoke(*arguments, "--flip").exit_code == 0
    assert not table("lux.csv")[1].any()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--plane", "height"], ["plane=height", "z=HEIGHT"]),
        (["--grid", "0x4"], ["grid=0x4"]),
        (["-o", "lux.txt"], ["lux.txt", ".csv"]),
        (["-o", ""], [".csv"]),
        (["-o", "nowhere/lux.csv"], ["cannot write nowhere/lux.csv"]),
        (["-D", "width=3"], ["width=3", "known are"]),
    ],
)
def test_wrong_options(scene_file, options, words):
    given = {"--plane": "z=0", "--grid": "2x2", "-o": "lux.csv"} | dict([options])
    result = invoke("illuminance", scene_file, *(part for pair in given.items() for part in pair))
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("mi-ellipse: ")
    for word in words:
        assert word in result.stderr
    assert files(scene_file.parent) == ["scene.xml"]


def test_grid_that_is_none(scene_file):
    result = invoke("illuminance", scene_file, "--plane", "z=0", "--grid", "5", "-o", "lux.csv")
    assert result.exit_code == 2
    assert "--grid" in result.stderr


def test_lamps_of_mitsuba_are_converted(scene_file):
    text = scene_file.read_text().replace("ellipticalarea", "area")
    scene_file.write_text(text.replace('<string name="sampling" value="$sampling"/>', ""))
    arguments = ["illuminance", scene_file, "--plane", "z=0", "--grid", "2x2", "-o", "lux.csv"]
    plain = invoke(*arguments)
    assert plain.exit_code == 0, plain.output
    _, values, errors = table("lux.csv")
    converted = invoke(*arguments, "--convert-lamps")
    assert "1 lamp" in " ".join(converted.stderr.split())
    _, better, smaller = table("lux.csv")
    # Four points, two estimates
    assert (np.abs(values - better) < 6 * np.hypot(errors, smaller)).all()
    assert not np.array_equal(values, better)
