"""Direct irradiance with shadows, beside quadrature and closed forms."""

import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from conftest import lamp
from mi_ellipse import direct_irradiance, group_lamps
from scipy import stats

from oracles import ellipse as oracle
from oracles.ellipse import rotation, translation

UP = np.array([0.0, 0, 1])
DOWN = rotation([1, 0, 0], 180)

# Of a whole test: a right estimate fails one such test in a thousand.
SIGNIFICANCE = 1e-3


def assert_right(found, truth):
    """Errors over standard errors are those of Student's distribution of 15 degrees."""
    value, error = (np.asarray(v, float).ravel() for v in found)
    limit = stats.t.isf(SIGNIFICANCE / 2 / value.size, df=15)
    # Single precision alone makes differences of some roundings.
    assert (np.abs(value - np.ravel(truth)) <= limit * error + 1e-5 * np.abs(np.ravel(truth))).all()


# ---- Lamps without anything in the way ----

# All at one height, so that none hides another one from a point below
LAMPS = [
    translation(0, 0, 1.2) @ DOWN @ np.diag([0.8, 0.3, 1, 1]),
    translation(1.5, 0.5, 1.2) @ DOWN @ np.diag([0.5, 0.5, 1, 1]),
    translation(-1, -1, 1.2) @ rotation([0, 0, 1], 30) @ DOWN @ np.diag([0.1, 0.9, 1, 1]),
]
# Near the floor, and cut by the horizon of many points
STANDING = translation(1.5, 0.5, 0.4) @ rotation([0, 1, 0], -100) @ np.diag([0.6, 0.5, 1, 1])
GRID = np.stack(np.meshgrid(np.linspace(-2, 2, 7), np.linspace(-2, 2, 5), [0.0]), -1).reshape(-1, 3)


def scene_of_lamps(**others):
    lamps = {f"lamp_{i}": lamp(m, "solid_angle", float(i + 1)) for i, m in enumerate(LAMPS)}
    return mi.load_dict({"type": "scene", **lamps, **others})


def truth_of_lamps(points, normal=UP):
    """Each lamp shines to its own side, with the radiance that it has in the scene."""
    total = np.zeros(len(points))
    for i, matrix in enumerate(LAMPS):
        for k, point in enumerate(points):
            u, w, c = oracle.seen_from(matrix, point)
            if np.cross(u, w) @ c < 0:
                total[k] += (i + 1) * oracle.irradiance(u, w, c, normal, 2000)
    return total


@pytest.mark.usefixtures("llvm_ad_rgb")
@pytest.mark.parametrize("grouped", [False, True])
def test_lamps(grouped):
    scene = scene_of_lamps()
    if grouped:
        assert group_lamps(scene) is not None
    found = direct_irradiance(scene, GRID, UP, 512, seed=1, luminance=True)
    assert_right(found, truth_of_lamps(GRID))
    assert found.standard_error.mean() < 0.05 * found.value.mean()
    colours = direct_irradiance(scene, GRID, UP, 512, seed=1)
    assert colours.value.shape == (len(GRID), 3)
    np.testing.assert_allclose(colours.value, found.value[:, None] * np.ones(3), rtol=1e-6)


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_closed_form_of_the_package():
    scene = mi.load_dict({"type": "scene", "lamp": lamp(STANDING, "projected_solid_angle")})
    found = direct_irradiance(scene, GRID, UP, 4096, seed=2, luminance=True)
    truth = mi_ellipse.irradiance(STANDING, GRID, UP)
    truth[(GRID - STANDING[:3, 3]) @ STANDING[:3, 2] < 0] = 0  # The function takes both sides.
    assert 0 < np.count_nonzero(truth) < len(GRID)
    assert_right(found, truth)


def test_every_variant(variant):
    scene = mi.load_dict({"type": "scene", "lamp": lamp(LAMPS[0], "solid_angle")})
    points = np.array([[[0, 0, 0], [1, 0.5, 0.2]]])
    found = direct_irradiance(scene, points, UP, 256, seed=3)
    truth = mi_ellipse.irradiance(LAMPS[0], points, UP)
    assert found.value.shape == found.standard_error.shape == (1, 2, 3)
    assert_right(found, np.repeat(truth[..., None], 3, -1))

    one = direct_irradiance(scene, mi.Point3f(0), mi.Normal3f(0, 0, 1), 256, 3, luminance=True)
    assert np.shape(one.value) == (() if variant.startswith("scalar") else (1,))
    assert_right(one, truth[0, :1])
    colour = direct_irradiance(scene, mi.Point3f(0), mi.Normal3f(0, 0, 1), 256, 3)
    assert isinstance(colour.value, mi.Color3f)


def test_monochrome_polarized():
    mi.set_variant("llvm_ad_mono_polarized")
    scene = mi.load_dict({"type": "scene", "lamp": lamp(LAMPS[0], "solid_angle")})
    found = direct_irradiance(scene, GRID[:4], UP, 256, seed=4)
    assert found.value.shape == (4, 1)
    assert_right(found, mi_ellipse.irradiance(LAMPS[0], GRID[:4], UP))
    assert isinstance(direct_irradiance(scene, mi.Point3f(0), UP).value, mi.Color1f)


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_luminance_of_a_colour():
    radiance = {"type": "rgb", "value": [3, 2, 1]}
    scene = mi.load_dict({"type": "scene", "lamp": lamp(LAMPS[0], "solid_angle", radiance)})
    colour = direct_irradiance(scene, GRID, UP, 64).value
    grey = direct_irradiance(scene, GRID, UP, 64, luminance=True).value
    np.testing.assert_allclose(colour / colour[:, 2:], np.broadcast_to([3, 2, 1], colour.shape))
    np.testing.assert_allclose(grey, colour @ [0.2126, 0.7152, 0.0722])


# ---- Standard errors ----


@pytest.mark.usefixtures("llvm_ad_rgb")
@pytest.mark.parametrize("samples", [16, 256])
def test_standard_errors_are_the_scatter_over_seeds(samples):
    scene = scene_of_lamps()
    found = [direct_irradiance(scene, GRID, UP, samples, s, luminance=True) for s in range(200)]
    values, errors = (np.array(field) for field in zip(*found, strict=True))
    scatter, said = values.var(axis=0, ddof=1), (errors**2).mean(axis=0)
    # The variance of 200 values is known to 10 %; 35 points of similar weight make it 2 %.
    assert scatter.sum() == pytest.approx(said.sum(), rel=0.1)
    # Means of 200 seeds, of which each point has its own error
    assert_right((values.mean(axis=0), np.sqrt(said / 200)), truth_of_lamps(GRID))


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_even_spreading_gains():
    """256 samples in 16 sequences have less than 1/16 of the variance of 16 samples."""
    scene = mi.load_dict({"type": "scene", "lamp": lamp(LAMPS[0], "solid_angle")})
    few, many = (direct_irradiance(scene, GRID, UP, n, 5, True).standard_error for n in (16, 256))
    # Without spreading the ratio would be 1/16 in each, to the 18 % of 35 points: 3 %.
    assert np.sum(many**2) < 0.5 * np.sum(few**2) / 16


# ---- Shadows and other emitters ----


def shadow_truth(points, half):
    """Irradiance from a disk of radius 0.5, 2 above, past a square at height 1, by quadrature."""
    r = 0.5 * np.sqrt((np.arange(1000) + 0.5) / 1000)
    t = 2 * np.pi * (np.arange(2000) + 0.5) / 2000
    x, y = (r[:, None] * np.cos(t)).ravel(), (r[:, None] * np.sin(t)).ravel()
    result = []
    for px, py, _ in points:
        r2 = (x - px) ** 2 + (y - py) ** 2 + 4
        seen = np.maximum(np.abs(x + px), np.abs(y + py)) > 2 * half  # half way to the lamp
        result.append(np.pi * 0.25 * np.mean(seen * 4 / r2**2))
    return np.array(result)


@pytest.mark.usefixtures("llvm_ad_rgb")
@pytest.mark.parametrize("sampling", ["solid_angle", "projected_solid_angle", "area", None])
def test_shadow(sampling):
    """`None` is Mitsuba's own emitter."""
    matrix = translation(0, 0, 2) @ DOWN @ np.diag([0.5, 0.5, 1, 1])
    half = 0.3
    plate = mi.ScalarTransform4f().translate([0, 0, 1]).scale(half)
    scene = mi.load_dict(
        {
            "type": "scene",
            "lamp": lamp(matrix, sampling),
            "plate": {"type": "rectangle", "to_world": plate},
            "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(3)},
        }
    )
    points = np.array(
        [[0, 0, 0], [0.2, 0.1, 0], [0.6, 0, 0], [0.6, 0.7, 0], [1, 0.3, 0], [2, 2, 0]]
    )
    truth = shadow_truth(points, half)
    assert truth[0] == 0  # all of the lamp is hidden
    assert np.ptp(truth) > 0.1
    found = direct_irradiance(scene, points, UP, 2**14, seed=6, luminance=True)
    # The quadrature misses the outline of the shadow by parts of its cells.
    assert_right((found.value, found.standard_error + 1e-5), truth)
    assert found.standard_error.max() < 1e-3


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_emitters_of_other_kinds():
    point = {"type": "point", "position": [0.5, 0, 1], "intensity": 2.0}
    sun = {"type": "directional", "direction": [0, 1, -1], "irradiance": 3.0}
    scene = scene_of_lamps(point=point, sun=sun)
    group_lamps(scene)
    # No point of the grid is in the shadow of a lamp.
    points = np.array([[1.0, -2, 0], [-2, -2, 0]])
    to_light = np.array([0.5, 0, 1]) - points
    truth = truth_of_lamps(points) + 3 / np.sqrt(2)
    truth += 2 * to_light[:, 2] / np.linalg.norm(to_light, axis=1) ** 3
    assert_right(direct_irradiance(scene, points, UP, 4096, 7, luminance=True), truth)


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_sky_and_no_light_at_all():
    sky = mi.load_dict({"type": "scene", "sky": {"type": "constant", "radiance": 2.0}})
    assert_right(
        direct_irradiance(sky, GRID, UP, 1024, luminance=True), np.full(len(GRID), 2 * np.pi)
    )
    dark = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    found = direct_irradiance(dark, GRID, UP)
    assert not found.value.any()
    assert not found.standard_error.any()


def test_no_points(variant):
    scene = mi.load_dict({"type": "scene"})
    assert direct_irradiance(scene, np.zeros((0, 3)), UP).value.shape == (0, 3)
    assert direct_irradiance(scene, np.zeros((0, 3)), UP, luminance=True).value.shape == (0,)


# ---- Bad input ----


@pytest.mark.usefixtures("llvm_ad_rgb")
@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        (GRID, {"samples": 0}, "samples=0"),
        (GRID, {"seed": -1}, "seed=-1"),
        (GRID[:, :2], {}, r"points: .* \(…, 3\).* \(35, 2\)"),
    ],
)
def test_impossible_input(points, options, message):
    with pytest.raises(ValueError, match=message):
        direct_irradiance(mi.load_dict({"type": "scene"}), points, UP, **options)
