"""Lamps of a given power: the radiance that it makes, in every form and after every change."""

import drjit as dr
import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from conftest import floor_and
from mi_ellipse.geometry import ellipsoid

from oracles.ellipse import rotation, translation

DOWN = rotation([1, 0, 0], 180)
PLACE = translation(0, 0, 1.5) @ DOWN
SHEAR = np.array([[0.8, 0.3, 0, 0], [0.1, 0.4, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def area_of_ellipsoid(a, b, c):
    """Quadrature over the unit sphere; with 400² points the values below no longer change."""
    z, weight = np.polynomial.legendre.leggauss(400)
    angle = 2 * np.pi * (np.arange(400) + 0.5) / 400
    s = np.sqrt(1 - z**2)[:, None]
    normal = np.stack([s * np.cos(angle) / a, s * np.sin(angle) / b, np.tile(z / c, (400, 1)).T])
    return a * b * c * np.sum(weight[:, None] * np.linalg.norm(normal, axis=0)) * 2 * np.pi / 400


# Shape, and its area
SHAPES = {
    "ellipse": (
        {"type": "ellipse", "semi_axis_x": 0.8, "semi_axis_y": 0.3, "to_world": PLACE},
        np.pi * 0.24,
    ),
    "disk": (
        {"type": "disk", "to_world": PLACE @ SHEAR},
        np.pi * np.linalg.norm(np.cross(SHEAR[:3, 0], SHEAR[:3, 1])),
    ),
    "flipped": ({"type": "disk", "to_world": translation(0, 0, 1), "flip_normals": True}, np.pi),
    "sphere": (
        {"type": "sphere", "to_world": PLACE @ np.diag([0.4, 0.4, 0.4, 1])},
        4 * np.pi * 0.16,
    ),
    "ellipsoid": (
        {"type": "ellipsoid", "to_world": PLACE @ np.diag([0.6, 0.3, 0.1, 1])},
        area_of_ellipsoid(0.6, 0.3, 0.1),
    ),
}


def lamp(shape, emitter):
    shape = dict(shape)
    shape["to_world"] = mi.ScalarAffineTransform4d(np.asarray(shape["to_world"], float))
    return shape | {"emitter": emitter}


def ours(shape, **emission):
    return lamp(shape, {"type": "ellipticalarea", "sampling": "area"} | emission)


def built_in(shape, radiance):
    return lamp(shape, {"type": "area", "radiance": radiance})


def picture(lamps, spp=64):
    return np.array(mi.render(mi.load_dict(floor_and(lamps, 8)), spp=spp, seed=3))


def colour(*values):
    return {"type": "rgb", "value": list(values)}


@pytest.mark.parametrize("shape", sorted(SHAPES))
@pytest.mark.parametrize("mode", ["llvm_ad_rgb", "scalar_rgb", "llvm_ad_spectral"])
def test_a_power_is_pi_times_area_times_radiance(shape, mode):
    """With the area by hand, and against Mitsuba's own emitter on its own shapes."""
    mi.set_variant(mode)
    shape, area = SHAPES[shape]
    got = picture({"lamp": ours(shape, power=colour(6, 5, 4))})
    radiance = colour(*(np.array([6, 5, 4]) / (np.pi * area)))
    # Rounding of the transform, and of the mesh of the ellipsoid from which its light is fitted
    same = picture({"lamp": ours(shape, radiance=radiance)})
    np.testing.assert_allclose(got, same, rtol=2e-5, atol=1e-7)
    assert got.mean() > 0.01
    if shape["type"] in ("disk", "sphere") and mode == "llvm_ad_rgb":
        # Two seeds of either differ by less than 0.5 % in the mean of 64 pixels at 1024 samples.
        got = picture({"lamp": ours(shape, power=colour(6, 5, 4))}, 1024)
        expected = picture({"lamp": built_in(shape, radiance)}, 1024)
        assert got.mean() == pytest.approx(expected.mean(), rel=0.02)


@pytest.mark.parametrize("shape", sorted(SHAPES))
@pytest.mark.usefixtures("llvm_ad_rgb")
def test_rays_of_a_lamp_carry_its_power(shape):
    shape, _ = SHAPES[shape]
    scene = mi.load_dict({"type": "scene", "lamp": ours(shape, power=colour(6, 6, 6))})
    u = mi.Float(np.random.default_rng(1).random((5, 1 << 14)).astype(np.float32).ravel())
    u = [dr.gather(mi.Float, u, dr.arange(mi.UInt32, 1 << 14) + (k << 14)) for k in range(5)]
    _, weight = scene.emitters()[0].sample_ray(0, u[0], mi.Point2f(u[1:3]), mi.Point2f(u[3:]))
    carried = np.array(weight)[0]
    # Weights are all alike but for ellipsoids, which are drawn on the unit sphere: five deviations.
    error = 5 * carried.std() / np.sqrt(carried.size) + 1e-5
    assert error < 0.1
    assert carried.mean() == pytest.approx(6, abs=error)


@pytest.mark.parametrize("mode", ["llvm_ad_rgb", "llvm_ad_spectral"])
@pytest.mark.parametrize(
    ("xml", "scaled"),
    [
        ('<float name="{}" value="{}"/>', (5,)),
        ('<integer name="{}" value="{}"/>', (5,)),
        ('<rgb name="{}" value="{}, {}, {}"/>', (6, 5, 1)),
        ('<spectrum name="{}" value="{}"/>', (2,)),
        ('<spectrum name="{}" value="400:{}, 500:{}, 700:{}"/>', (1, 3, 2)),
    ],
)
def test_forms_of_a_power(mode, xml, scaled):
    mi.set_variant(mode)
    pictures = []
    for name, factor in (("power", 1), ("radiance", 1 / (np.pi * 4 * np.pi))):
        value = xml.format(name, *(v * factor for v in scaled))
        if factor != 1:
            value = value.replace("integer", "float")
        scene = mi.load_string(
            '<scene version="3.0.0"><shape type="sphere">'
            f'<emitter type="ellipticalarea">{value}</emitter></shape></scene>'
        )
        it = dr.zeros(mi.Interaction3f, 1)
        it.p = mi.Point3f(0, 0, 4)
        it.wavelengths = mi.Color0f() if not mi.is_spectral else mi.Spectrum(420, 500, 550, 650)
        _, weight = scene.emitters()[0].sample_direction(it, mi.Point2f(0.4, 0.6))
        pictures.append(np.array(weight))
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-5)
    assert pictures[0].max() > 0


# ---- Changes ----


def scaled(scene, factor, to_world):
    parameters = mi.traverse(scene)
    matrix = np.asarray(to_world, float) @ np.diag([factor, factor, factor, 1])
    parameters["lamp.to_world"] = mi.Transform4f(mi.Matrix4f(np.float32(matrix)))
    parameters.update()
    return scene


@pytest.mark.parametrize("shape", ["ellipse", "disk", "sphere"])
@pytest.mark.parametrize("frozen", [False, True])
@pytest.mark.usefixtures("llvm_ad_rgb")
def test_the_power_stays_when_the_lamp_is_scaled(shape, frozen):
    def render(scene):
        return mi.render(scene, spp=64, seed=3)

    shape, area = SHAPES[shape]
    start = np.array(shape["to_world"], float)
    if shape["type"] == "ellipse":
        start = start @ np.diag([0.8, 0.3, 1, 1])
    draw = dr.freeze(render) if frozen else render
    scene = mi.load_dict(floor_and({"lamp": ours(shape, power=colour(6, 5, 4))}, 8))
    for factor in (1, 0.5, 1.5, 2):
        got = np.array(draw(scaled(scene, factor, start)))
        radiance = colour(*(np.array([6, 5, 4]) / (np.pi * area * factor**2)))
        kind = {"type": "sphere" if shape["type"] == "sphere" else "disk"}
        there = kind | {"to_world": start @ np.diag([factor] * 3 + [1])}
        expected = picture({"lamp": ours(there, radiance=radiance)})
        np.testing.assert_allclose(got, expected, rtol=2e-5, atol=1e-7)
    if frozen:
        assert draw.n_recordings < 4


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_the_power_stays_when_the_vertices_of_an_ellipsoid_move():
    matrix = np.asarray(PLACE @ np.diag([0.6, 0.3, 0.1, 1]), float)
    scene = mi.load_dict(floor_and({"lamp": ours(SHAPES["ellipsoid"][0], power=2.0)}, 8))
    matrix = matrix @ np.diag([1.5, 1, 2, 1])
    light = mi_ellipse.Ellipsoid(mi.ScalarAffineTransform4d(matrix))
    moved = mi.traverse(mi_ellipse.tessellate(light, 160))
    parameters = mi.traverse(scene)
    for name in ("vertex_positions", "vertex_normals"):
        parameters[f"lamp.{name}"] = moved[name]
    parameters.update()
    got = np.array(mi.render(scene, spp=64, seed=3))
    radiance = 2 / (np.pi * area_of_ellipsoid(0.9, 0.3, 0.2))
    there = {"type": "ellipsoid", "to_world": matrix}
    np.testing.assert_allclose(
        got, picture({"lamp": ours(there, radiance=radiance)}), rtol=1e-4, atol=1e-6
    )


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_update_of_the_power_alone_and_in_a_group():
    """A group keeps the radiances of its members."""
    shape, area = SHAPES["ellipse"]
    bulb, area_of_bulb = SHAPES["sphere"]
    bulb = bulb | {"to_world": translation(1, 0, 1) @ np.diag([0.1, 0.1, 0.1, 1])}
    scenes = []
    for powers in ((1.0, 1.0), (8.0, 3.0)):
        lamps = {"a": ours(shape, power=powers[0]), "b": ours(bulb, power=powers[1])}
        scene = mi.load_dict(floor_and(lamps, 8))
        assert mi_ellipse.group_lamps(scene)
        scenes.append(scene)
    parameters = mi.traverse(scenes[0])
    parameters["a.emitter.power.value"], parameters["b.emitter.power.value"] = 8.0, 3.0
    parameters.update()
    got, expected = (np.array(mi.render(scene, spp=64, seed=3)) for scene in scenes)
    np.testing.assert_allclose(got, expected, rtol=1e-5)
    # And a group of the same radiances
    radiances = 8 / (np.pi * area), 3 / (np.pi * area_of_bulb / 16)
    lamps = {"a": ours(shape, radiance=radiances[0]), "b": ours(bulb, radiance=radiances[1])}
    scene = mi.load_dict(floor_and(lamps, 8))
    mi_ellipse.group_lamps(scene)
    np.testing.assert_allclose(got, np.array(mi.render(scene, spp=64, seed=3)), rtol=1e-4)


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_a_lamp_that_is_only_seen_has_its_radiance():
    """No light sample is drawn, so a plain disk is asked for nothing but its radiance."""
    disk = {"type": "disk", "to_world": DOWN @ np.diag([3, 3, 1, 1])}
    sensor = mi.ScalarTransform4f().look_at([0, 0, -1], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 1},
        "sensor": {"type": "perspective", "to_world": sensor, "film": film},
        "lamp": ours(disk, power=9.0),
    })  # fmt: skip
    expected = 9 / (np.pi * 9 * np.pi)
    np.testing.assert_allclose(np.array(mi.render(scene, spp=4)), expected, rtol=1e-5)


# ---- Gradients ----


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_gradient_of_the_power():
    """A picture is linear in the power, and one draw is as well."""
    scene = mi.load_dict({"type": "scene", "lamp": ours(SHAPES["ellipse"][0], power=2.0)})
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters["lamp.emitter.power.value"])
    parameters.update()
    it = dr.zeros(mi.SurfaceInteraction3f, 1)
    it.p, it.n = mi.Point3f(0.2, 0, 0), mi.Normal3f(0, 0, 1)
    _, weight = scene.emitters()[0].sample_direction(it, mi.Point2f(0.3, 0.6))
    dr.backward(weight)
    slope = np.ravel(dr.grad(parameters["lamp.emitter.power.value"]))
    np.testing.assert_allclose(2 * slope, np.ravel(dr.detach(weight)), rtol=1e-5)


@pytest.mark.parametrize("shape", ["disk", "sphere"])
@pytest.mark.usefixtures("llvm_ad_rgb")
def test_gradient_of_the_size_at_the_lamp_itself(shape):
    """Of the radiance, by a scale of the lamp: minus twice the radiance."""
    shape, _ = SHAPES[shape]
    scene = mi.load_dict({"type": "scene", "lamp": ours(shape, power=2.0)})
    parameters = mi.traverse(scene)
    t = mi.Float(1)
    dr.enable_grad(t)
    start = mi.Transform4f(mi.Matrix4f(np.float32(shape["to_world"])))
    parameters["lamp.to_world"] = start @ mi.Transform4f().scale(mi.Vector3f(t))
    parameters.update()
    si = dr.zeros(mi.SurfaceInteraction3f, 1)
    si.wi, si.n = mi.Vector3f(0, 0, 1), mi.Normal3f(0, 0, 1)
    radiance = scene.emitters()[0].eval(si)
    dr.backward(radiance.x)
    assert dr.grad(t)[0] == pytest.approx(-2 * dr.detach(radiance.x)[0], rel=1e-5)


# ---- Areas and errors ----


@pytest.mark.usefixtures("llvm_ad_rgb")
def test_area_of_ellipsoids():
    """Spheres, needles and pancakes, against quadrature in double precision."""
    for axes in ((1, 1, 1), (2, 0.5, 0.5), (3, 3, 0.2), (1, 0.7, 0.4), (5, 0.3, 1)):
        light = ellipsoid.from_transform(mi.ScalarAffineTransform4d(np.diag([*axes, 1.0])))
        assert light.area[0] == pytest.approx(area_of_ellipsoid(*axes), rel=1e-6)


@pytest.mark.parametrize("mode", ["llvm_ad_rgb", "scalar_rgb"])
@pytest.mark.parametrize(
    ("emission", "words"),
    [
        (
            {"power": 1.0, "radiance": 1.0},
            ["radiance and power are both given", "power / (π area)"],
        ),
        ({"power": -2.0}, ["power=-2 must be finite and not negative"]),
        ({"power": {"type": "rgb", "value": [1, float("nan"), 1]}}, ["power=1, nan, 1"]),
        (
            {"power": {"type": "checkerboard", "color0": 0.1, "color1": 0.3}},
            ["power must be a number, an RGB colour or a spectrum", "as radiance"],
        ),
    ],
)
def test_bad_powers(mode, emission, words):
    mi.set_variant(mode)
    with pytest.raises(Exception) as error:  # noqa: PT011
        mi.load_dict(ours({"type": "disk", "to_world": np.eye(4)}, **emission))
    assert [word for word in ["ellipticalarea", *words] if word not in str(error.value)] == []
