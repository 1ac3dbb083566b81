"""From which distance on a lamp could be drawn by area, and how rare that is in the fog."""

import mi_ellipse  # noqa: F401
import mitsuba as mi
import numpy as np
import pytest
from mi_ellipse.rendering.scene import load_scene
from scipy.integrate import dblquad

from derivations import far_lamps


@pytest.mark.parametrize("centre", [(0, 0, 1.5), (2, 1, -1), (0.5, -3, 0.2), (20, 0, 5)])
@pytest.mark.parametrize("ratio", [1.0, 0.3])
def test_variance_is_that_of_an_adaptive_rule(centre, ratio):
    """An integral over the points of the lamp, with the weight as the renderer has it."""
    x, y, z = centre

    def moment(power):
        def integrand(b, a):
            offset = np.array([x + a, y + ratio * b, z])
            far = np.linalg.norm(offset)
            return (abs(offset[2]) / far / far**2) ** power

        edge = lambda a: np.sqrt(1 - a * a)  # noqa: E731
        # The adaptive rule stops at 1e-9 of the moments, whose ratio less one is at least 0.003.
        return dblquad(integrand, -1, 1, lambda a: -edge(a), edge, epsabs=0, epsrel=1e-9)[0]

    expected = moment(2) * np.pi / moment(1) ** 2 - 1
    assert far_lamps.variance(np.array(centre, float), ratio) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("polar", [20, 50, 90])
@pytest.mark.parametrize("ratio", [1.0, 0.3])
def test_first_order(polar, ratio):
    # The next order is smaller by some 1 / d².
    centre = 100 * far_lamps.direction(polar)
    exact = far_lamps.variance(centre, ratio)
    assert far_lamps.first_order(centre, ratio) == pytest.approx(exact, rel=2e-3)


def test_on_the_axis():
    # The weight (1 + q²/d²)^-1.5 with q² uniform in [0, 1], whose variance is 1/12
    d = 50
    on_axis = far_lamps.variance(np.array([0, 0, d]))
    assert on_axis == pytest.approx(2.25 / 12 / d**4, rel=2e-3)


def test_distances():
    limit = far_lamps.LEAST_VARIANCE
    assert far_lamps.distance(90) == pytest.approx((2.25 / limit) ** 0.5, rel=2e-3)
    d = (1.5 / limit) ** 0.5  # The mean of sin² over the sphere is 2/3
    assert far_lamps.mean_variance(d) == pytest.approx(limit, rel=2e-3)
    # As docs/limits.md has them
    assert far_lamps.distance(90) == pytest.approx(47, abs=0.5)
    assert far_lamps.distance(0) == pytest.approx(3.6, abs=0.05)
    assert far_lamps.mean_variance(39) < limit < far_lamps.mean_variance(38)


def test_light_samples_are_counted(llvm_ad_rgb):
    """Against the points of a floor that a camera sees, tested one by one in NumPy."""
    ratio, limit = 0.4, 0.02
    camera = mi.ScalarTransform4f().look_at([0, -9, 6], [0, 0, 0], [0, 0, 1])
    description = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "to_world": camera,
            "film": {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}},
        },
        "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(40)},
        "lamp": {
            "type": "ellipse",
            "semi_axis_x": 0.5,
            "semi_axis_y": 0.5 * ratio,
            "to_world": mi.ScalarTransform4f().translate([0, 0, 2]).rotate([1, 0, 0], 180),
            "emitter": {"type": "ellipticalarea"},
        },
    }
    light_samples = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}
    found = far_lamps.shares(mi.load_dict(description | {"i": light_samples}), limit, spp=1)

    positions = {"type": "aov", "aovs": "p:position"}
    pixels = np.array(mi.render(mi.load_dict(description | {"i": positions}), spp=1, seed=0))
    points = pixels[..., -3:].reshape(-1, 3).astype(float)
    points = points[np.any(points != 0, axis=1)]  # Of the floor, and some of the lamp's back
    x, y, z = (np.array([0, 0, 2]) - points).T / 0.5
    far2 = x * x + y * y + z * z
    by_variance = np.mean(
        [far_lamps.first_order(c, ratio) < limit for c in np.transpose([x, y, z])]
    )
    by_distance = np.mean(far2 > far_lamps.distance(90, limit) ** 2)
    assert 0.1 < by_distance < by_variance < 0.9
    # Points on the border fall to either side in single precision: one of 2 304
    assert found == pytest.approx((by_distance, by_variance), abs=1e-3)


def test_a_branch_would_not_help_in_the_fog(llvm_ad_rgb):
    scene = load_scene(far_lamps.FOG, {"resx": "80", "resy": "60"})
    found = far_lamps.shares(scene)
    # Some 100 000 samples: the standard error of either share is below 0.2 %
    assert 0.005 < found.by_distance < 0.02
    assert 0.12 < found.by_variance < 0.17
    assert 0.5 < far_lamps.shares(scene, 10 * far_lamps.LEAST_VARIANCE).by_variance < 0.65
