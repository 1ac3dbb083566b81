"""Where single precision ends: lights inside are right, and what is refused would be wrong."""

import drjit as dr
import mitsuba as mi
import mpmath
import numpy as np
import pytest
from commands import write_scene
from conftest import floor_and
from mi_ellipse.geometry import limits
from mi_ellipse.rendering.scene import load_scene
from mi_ellipse.system.messages import innermost_cause

from oracles.ellipse import solid_angle

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

GRID = (np.arange(128, dtype=np.float32) + 0.5) / 128


def exact_solid_angle(a, b, x, y, h):
    """Of an ellipse over a point, from the eigenvalues of its dual cone in 90 digits."""
    with mpmath.workdps(90):
        c = mpmath.matrix([mpmath.mpf(float(-np.float32(v))) for v in (x, y, -h)])
        squares = mpmath.diag([mpmath.mpf(float(np.float32(v))) ** 2 for v in (a, b, 0)])
        low, middle, high = sorted(mpmath.eigsy(c * c.T - squares, eigvals_only=True))
        return float(solid_angle(*(float(mpmath.sqrt(-v / high)) for v in (low, middle))))


def sampled_solid_angle(a, b, points, h, sampling="solid_angle"):
    """Mean weight of the draws from points below the ellipse, which faces down at z = h."""
    matrix = np.diag([a, -b, -1.0, 1.0])
    matrix[2, 3] = h
    to_world = mi.ScalarAffineTransform4d(matrix)
    emitter = {"type": "ellipticalarea", "sampling": sampling}
    lamp = {"type": "ellipse", "to_world": to_world, "emitter": emitter}
    scene = mi.load_dict({"type": "scene", "lamp": lamp})
    it = dr.zeros(mi.SurfaceInteraction3f, len(points) * GRID.size**2)
    x, y = np.repeat(np.float32(points), GRID.size**2, axis=0).T
    it.p, it.n = mi.Point3f(x, y, 0), mi.Normal3f(0, 0, 1)
    u = np.tile(np.repeat(GRID, GRID.size), len(points))
    v = np.tile(GRID, GRID.size * len(points))
    _, weight = scene.emitters()[0].sample_direction(it, mi.Point2f(u, v))
    return np.array(weight)[0].reshape(len(points), -1).mean(1)


def errors(a, b, h, sampling="solid_angle"):
    points = [(0, y * b) for y in (0, 0.5, 0.99, 1.01, 2, 10)]
    exact = np.array([exact_solid_angle(a, b, *point, h) for point in points])
    return np.abs(sampled_solid_angle(a, b, points, h, sampling) / exact - 1)


# Semi-axes at the limit or inside, and the heights from which they are seen
INSIDE = [
    (1e5, 1, (1e-3, 1)),
    (4e7, 1, (2e-4, 1e-2, 1, 100)),
    (2.8e10, 1e3, (0.1, 1e3)),
    (2.8e4, 1e-6, (1e-4, 1)),
    (8.9e7, 1e-7, (1e-4, 1)),
    (1, 1e-18, (1e-3, 1)),
    (1e-18, 1e-18, (1,)),
    (4e16, 4e16, (4e16,)),
]


@pytest.mark.parametrize(("a", "b", "heights"), INSIDE)
def test_lights_inside_the_limits_are_right(a, b, heights):
    """By 4e-5 with this grid of random numbers and 16 times as much with a quarter of it."""
    for h in heights:
        assert errors(a, b, h).max() < 1e-4


# Semi-axes, a height from which they are wrong, words of the error
OUTSIDE = [
    (1e10, 1, 1, ["1e+10 and 1", "too long for its width", "at most 3.9e+07"]),
    (1e9, 1, 0.1, ["1e+09 and 1", "too long for its width", "at most 3.9e+07"]),
    (1e13, 1, 1, ["too long for its width"]),
    (1, 1e-19, 1, ["1 and 1e-19", "too narrow", "1e-18"]),
    (1e-19, 1e-19, 1, ["too small", "1e-18"]),
]


@pytest.mark.parametrize(("a", "b", "h", "words"), OUTSIDE)
def test_what_is_refused_would_be_wrong(a, b, h, words, monkeypatch):
    with pytest.raises(Exception, match="ellipticalarea") as error:
        errors(a, b, h)
    assert [word for word in words if word not in str(error.value)] == []
    monkeypatch.setattr(limits, "check_ellipse", lambda to_world: None)
    assert errors(a, b, h).max() > 0.05


@pytest.mark.parametrize("shape", ["disk", "sphere"])
@pytest.mark.parametrize("size", [1e16, 1e18, 1e20])
def test_rays_of_mitsuba_meet_what_is_accepted(shape, size):
    """From three sizes away."""
    matrix = np.diag([size, size, size, 1.0])
    matrix[2, 3] = 3 * size
    bare = {"type": shape, "to_world": mi.ScalarAffineTransform4d(matrix)}
    scene = mi.load_dict({"type": "scene", "shape": bare})
    met = scene.ray_intersect(mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 1))).is_valid()
    check = limits.check_ellipse if shape == "disk" else limits.check_solid
    if size <= limits.LARGEST / 4:
        assert met[0]
        check(matrix)
    else:
        assert not met[0]
        with pytest.raises(ValueError, match="too large or too far"):
            check(matrix)


LAMP = """<shape type="{}"><transform name="to_world"><scale x="{}" y="{}" z="1"/></transform>
    <emitter type="ellipticalarea"/></shape>"""


@pytest.mark.parametrize("shape", ["ellipse", "disk"])
@pytest.mark.parametrize(("a", "b"), [(1e10, 1), (1e20, 1e20), (1e30, 1)])
def test_files_with_such_lamps_are_refused(scene_file, shape, a, b):
    write_scene(scene_file, LAMP.format(shape, a, b))
    with pytest.raises(Exception, match=r"ellipticalarea: .*(too long|too large)"):
        load_scene(scene_file)
    write_scene(scene_file, LAMP.format(shape, 1e5, 1))
    load_scene(scene_file)


@pytest.mark.parametrize("shape", ["ellipse", "disk"])
def test_updates_to_such_lamps_are_refused(scene_file, shape):
    write_scene(scene_file, LAMP.format(shape, 1, 1).replace("<shape", '<shape id="lamp"'))
    parameters = mi.traverse(load_scene(scene_file))
    parameters["lamp.to_world"] = mi.Transform4f().scale([1e10, 1, 1])
    with pytest.raises(ValueError, match=r"ellipticalarea: .*1e\+10 and 1 is too long"):
        parameters.update()


@pytest.mark.parametrize("shape", ["disk", "sphere"])
@pytest.mark.parametrize("size", [1, 1e20])
def test_a_lamp_that_waits_for_its_first_use_is_refused_then(shape, size):
    """Also while Dr.Jit records, when no kernel can run."""
    lamp = {"type": shape, "to_world": mi.ScalarTransform4f().translate([0, 0, 3]).scale(size)}
    scene = mi.load_dict(floor_and({"lamp": lamp | {"emitter": {"type": "ellipticalarea"}}}, 4))
    frozen = dr.freeze(lambda scene: mi.render(scene, spp=1))
    if size == 1:
        assert np.isfinite(np.array(frozen(scene))).all()
    else:
        with pytest.raises(RuntimeError) as error:
            frozen(scene)
        assert "too large or too far" in innermost_cause(error.value)
