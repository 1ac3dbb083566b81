"""The shape `ellipsoid`, and `ellipticalarea` in a `sphere`, against Mitsuba's shapes + `area`."""

import gc
from functools import cache

import drjit as dr
import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from conftest import floor_and, lamp
from mi_ellipse.geometry import ellipsoid
from mi_ellipse.geometry.ellipsoid import StoredEllipsoid
from mi_ellipse.geometry.sphere import StoredSphere
from mi_ellipse.sampling import STRATEGIES
from mi_ellipse.system.messages import innermost_cause

from oracles.ellipse import MIRROR, SHEAR, rotation, translation
from oracles.pictures import assert_same_expectation, render

BULB = translation(0.2, 0.1, 0.7) @ rotation([1, 2, 0.5], 40) @ SHEAR @ np.diag([0.6, 0.3, 0.15, 1])
OTHER_BULB = translation(-0.3, 0.2, 0.9) @ rotation([1, 0, 0], 30) @ np.diag([0.2, 0.5, 0.3, 1])
BALL = translation(0.2, 0.1, 0.6) @ rotation([1, 2, 0.5], 40) @ np.diag([0.3, 0.3, 0.3, 1])
OTHER_BALL = translation(-0.3, 0.2, 0.9) @ np.diag([0.4, 0.4, 0.4, 1])
FOR_SOLIDS = [name for name, entry in STRATEGIES.items() if not entry.planar]

jit = pytest.mark.usefixtures("llvm_ad_rgb")


def bulb(matrix, sampling="solid_angle", **parameters):
    return lamp(matrix, sampling, shape="ellipsoid", **parameters)


def below(lamps, **options):
    """The floor under lamps, seen from beside them: no lamp is in the picture."""
    scene = floor_and(lamps, **options)
    place = mi.ScalarTransform4f().look_at([0, -2, 0.3], [0, 0.1, 0], [0, 0, 1])
    scene["sensor"] |= {"to_world": place, "fov": 20}
    return mi.load_dict(scene)


def mesh_lamp(matrix):
    """What a user of Mitsuba alone takes: triangles, and an emitter that samples their area."""
    props = mi.Properties()
    props["emitter"] = mi.load_dict({"type": "area"})
    return mi_ellipse.tessellate(mi_ellipse.Ellipsoid(matrix), 160, props)


def picture(scene, spp=64, seed=3):
    return np.array(mi.render(scene, spp=spp, seed=seed))


def message_of(make):
    with pytest.raises(Exception) as error:  # noqa: PT011
        make()
    return innermost_cause(error.value)


# ---- Pictures ----

WAYS = {
    "light": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
    "mis": {"type": "path", "max_depth": 2},
}


@cache
def built_in(kind):
    """Pictures of Mitsuba's `sphere`, or of a fine mesh, whose area draws are noisy."""
    builtin = lamp(BALL) | {"type": "sphere"} if kind == "sphere" else mesh_lamp(BULB)
    return render(below({"lamp": builtin}), 256 if kind == "sphere" else 4096)


@jit
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", FOR_SOLIDS)
@pytest.mark.parametrize("kind", ["sphere", "bulb"])
def test_picture_is_that_of_area(kind, name, way):
    """Light samples alone, and with those of the BSDF."""
    own = lamp(BALL, name, shape="sphere") if kind == "sphere" else bulb(BULB, name)
    got = render(below({"lamp": own}, integrator=WAYS[way]), 256)
    # The draws of an area miss more often.
    assert_same_expectation(got, built_in(kind), 0.2 if name == "area" else 0.05)


@jit
def test_lamp_in_the_picture():
    """Its own surface, seen by the camera and by rays from surfaces, in both kinds of shapes."""
    for own, builtin in (
        (lamp(BALL, "solid_angle", shape="sphere"), lamp(BALL) | {"type": "sphere"}),
        (bulb(BULB), mesh_lamp(BULB)),
    ):
        scenes = [mi.load_dict(floor_and({"lamp": each}, depth=1)) for each in (own, builtin)]
        # Rays alone, which meet the same shape. Where the interpolated normals of a mesh face away,
        # Mitsuba's `area` is dark: in one sample of 65 536.
        np.testing.assert_allclose(*(picture(scene, 256) for scene in scenes), atol=2 / 256)
        bsdf = {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}
        scenes = [below({"lamp": each}, integrator=bsdf) for each in (own, builtin)]
        got, expected = (picture(scene, 256) for scene in scenes)
        assert got.mean() == pytest.approx(expected.mean(), rel=2e-3)


@jit
@pytest.mark.parametrize("name", FOR_SOLIDS)
def test_no_drawn_point_is_hidden_by_the_mesh(name):
    """Shadow rays from everywhere around, some close to the surface, reach all that is drawn."""
    scene = mi.load_dict({"type": "scene", "lamp": bulb(BULB, name)})
    rng = np.random.default_rng(1)
    q = rng.normal(size=(100_000, 3))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    scale = 1 + 10 ** rng.uniform(-2, 1, (len(q), 1))
    si = dr.zeros(mi.SurfaceInteraction3f, len(q))
    si.p = mi.Point3f((scale * q @ BULB[:3, :3].T + BULB[:3, 3]).T)
    si.n = mi.Normal3f(q.T)
    u = mi.Point2f(rng.random((2, len(q)), dtype=np.float32))
    ds, weight = scene.emitters()[0].sample_direction(si, u)
    lit = weight[0] > 0
    hidden = scene.ray_test(si.spawn_ray_to(ds.p), lit)
    assert dr.count(lit)[0] > (0.1 if name == "area" else 0.999) * len(q)
    assert dr.count(hidden)[0] == 0


@jit
def test_rays_along_drawn_directions_meet_the_mesh():
    """What the mesh is smaller by: at most 7.7 / segments², 0.03 %, of the draws miss it."""
    scene = mi.load_dict({"type": "scene", "lamp": bulb(BULB)})
    count = 500_000
    rng = np.random.default_rng(2)
    q = rng.normal(size=(count, 3))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    scale = rng.uniform(1.5, 10, (count, 1))
    it = dr.zeros(mi.Interaction3f, count)
    it.p = mi.Point3f((scale * q @ BULB[:3, :3].T + BULB[:3, 3]).T)
    u = mi.Point2f(rng.random((2, count), dtype=np.float32))
    ds, _ = scene.emitters()[0].sample_direction(it, u)
    missed = 1 - dr.count(scene.ray_test(mi.Ray3f(it.p, ds.d)))[0] / count
    # Five standard errors of a count of some 150
    assert missed < 7.7 / 160**2 + 5 * np.sqrt(3e-4 / count)
    si = scene.ray_intersect(mi.Ray3f(it.p, ds.d))
    valid = si.is_valid().numpy()
    error = np.abs(si.t.numpy() / ds.dist.numpy() - 1)[valid]
    assert np.quantile(error, 0.99) < 1e-2  # Deep only where a ray grazes


# ---- The shapes ----


@jit
def test_ellipsoid_of_equal_axes_is_a_sphere():
    """Also where semi-axes and transform only together make one, turned and mirrored."""
    turn = rotation([1, 2, 0.5], 40)
    for matrix, axes in (
        (np.diag([2.0, 4, 1, 1]), (0.5, 0.25, 1)),
        (translation(1, 2, 3) @ turn, (0.3, 0.3, 0.3)),
        (MIRROR @ turn, (1, 1, 1)),
    ):
        names = ("semi_axis_x", "semi_axis_y", "semi_axis_z")
        shape = mi.load_dict(bulb(matrix, **dict(zip(names, axes, strict=True))))
        assert shape.class_name() == "Sphere"
        linear = matrix[:3, :3] @ np.diag(axes)
        radius = np.linalg.norm(linear[:, 0])
        assert shape.surface_area()[0] == pytest.approx(4 * np.pi * radius**2, rel=1e-6)


@jit
@pytest.mark.parametrize("optimize", [True, False])
def test_id_and_parameters(optimize):
    scene = mi.load_dict(floor_and({"lamp": bulb(BULB), "ball": bulb(BALL)}), optimize=optimize)
    params = mi.traverse(scene)
    for name in (
        "lamp.vertex_positions",
        "lamp.bsdf.reflectance.value",
        "lamp.emitter.radiance.value",
        "lamp.emitter.sampling_weight",
        "ball.to_world",
        "ball.emitter.radiance.value",
    ):
        assert name in params


def test_xml(variant):
    scene = mi.load_string(
        '<scene version="3.0.0"><shape type="ellipsoid" id="my_lamp">'
        '<float name="semi_axis_x" value="2"/><float name="semi_axis_z" value="0.5"/>'
        '<integer name="segments" value="40"/><bsdf type="diffuse"/>'
        '<emitter type="ellipticalarea"><string name="sampling" value="projected_solid_angle"/>'
        "</emitter></shape></scene>"
    )
    (shape,) = scene.shapes()
    assert shape.id() == "my_lamp"
    assert shape.face_count() == 20 * 8**2
    box = shape.bbox()
    np.testing.assert_allclose([box.min, box.max], [[-2, -1, -0.5], [2, 1, 0.5]], rtol=1e-3)
    it = dr.zeros(mi.Interaction3f) if dr.is_jit_v(mi.Float) else mi.Interaction3f()
    it.p, it.n = mi.Point3f(0.5, 0.3, 2), mi.Normal3f(0, 0, -1)
    if mi.is_spectral:
        it.wavelengths = mi.UnpolarizedSpectrum(550)
    emitter = scene.emitters()[0]
    for u in ((0.2, 0.3), (0.7, 0.1), (0.4, 0.9)):
        ds, weight = emitter.sample_direction(it, mi.Point2f(u))
        assert np.all(np.array(weight) > 0)
        pdf = emitter.pdf_direction(it, ds)
        np.testing.assert_allclose(np.array(pdf), np.array(ds.pdf), rtol=1e-4)
        q = np.array(ds.p).reshape(3) / [2, 1, 0.5]
        assert np.linalg.norm(q) == pytest.approx(1, abs=1e-5)
        there = np.array(it.p).reshape(3) + np.array(ds.d).reshape(3) * np.array(ds.dist)
        np.testing.assert_allclose(there, np.array(ds.p).reshape(3), atol=1e-5)
    # Inside
    it.p = mi.Point3f(0.5, 0.3, 0)
    ds, weight = emitter.sample_direction(it, mi.Point2f(0.3, 0.6))
    assert np.all(np.array(weight) == 0)
    assert np.all(np.array(emitter.pdf_direction(it, ds)) == 0)


def test_scalar_picture():
    """The same mean as in the parallel variant, up to the noise of 16 000 samples."""
    means = []
    for variant in ("scalar_rgb", "llvm_ad_rgb"):
        mi.set_variant(variant)
        means.append(picture(below({"lamp": bulb(BULB)}, size=8), 256).mean())
    assert means[0] == pytest.approx(means[1], rel=0.02)


@jit
def test_texture_of_a_sphere():
    """By the uv of Mitsuba's sphere: the picture of a bitmap is that of `area`."""
    image = np.random.default_rng(1).random((6, 4, 3)).astype(np.float32)

    def textured(sampling):
        texture = {"type": "bitmap", "bitmap": mi.Bitmap(image.copy()), "raw": True}
        return lamp(BALL, sampling, texture) | {"type": "sphere"}

    got, expected = (render(below({"lamp": textured(s)}), 256) for s in ("solid_angle", None))
    assert_same_expectation(got, expected, 0.05)


@jit
def test_positions_and_rays_of_the_emitter():
    """`ptracer` follows them: the flux that it brings to the floor is that of the path tracer."""
    scene = below({"lamp": bulb(BULB)}, integrator={"type": "ptracer", "max_depth": 2})
    got = render(scene, 512)
    expected = render(below({"lamp": bulb(BULB)}), 256)
    assert got.mean() == pytest.approx(expected.mean(), rel=0.03)


# ---- Spheres have a light of their own ----


@jit
def test_light_of_a_sphere():
    """Decided when the lamp is loaded: a plain sphere, and an ellipsoid of equal semi-axes."""
    for own, kind in (
        (lamp(BALL, "solid_angle", shape="sphere"), StoredSphere),
        (bulb(BALL), StoredSphere),
        (bulb(np.diag([2.0, 4, 1, 1]), semi_axis_x=0.5, semi_axis_y=0.25), StoredSphere),
        (bulb(BULB), StoredEllipsoid),
    ):
        scene = below({"lamp": own}, size=4)
        picture(scene, 1)
        assert type(scene.emitters()[0].lamp.stored) is kind


@jit
def test_update_of_a_mesh_to_a_sphere_and_back():
    scene = below({"lamp": bulb(BULB)}, integrator=WAYS["light"])
    params = mi.traverse(scene)
    for matrix, kind in ((BALL, StoredSphere), (BULB, StoredEllipsoid), (BALL, StoredSphere)):
        mesh = mi.traverse(mi_ellipse.tessellate(mi_ellipse.Ellipsoid(matrix), 160))
        for name in ("vertex_positions", "vertex_normals"):
            params[f"lamp.{name}"] = mesh[name]
        params.update()
        expected = picture(below({"lamp": bulb(matrix)}, integrator=WAYS["light"]))
        np.testing.assert_allclose(picture(scene), expected, rtol=2e-4, atol=1e-5)
        assert type(scene.emitters()[0].lamp.stored) is kind


# ---- Updates ----


@jit
@pytest.mark.parametrize("first", [True, False], ids=["rendered before", "not rendered before"])
def test_update_of_a_sphere(first):
    scene = below({"lamp": lamp(BALL, "solid_angle", shape="sphere")})
    if first:
        picture(scene)
    params = mi.traverse(scene)
    params["lamp.to_world"] = mi.AffineTransform4f(OTHER_BALL)
    params.update()
    expected = picture(below({"lamp": lamp(OTHER_BALL, "solid_angle", shape="sphere")}))
    np.testing.assert_allclose(picture(scene), expected, rtol=2e-4, atol=1e-5)


@jit
def test_update_of_a_mesh():
    """Moving the vertices moves the light: it is fitted to them."""
    scene = below({"lamp": bulb(BULB)})
    before = picture(scene)
    params = mi.traverse(scene)
    other = mi.traverse(mi_ellipse.tessellate(mi_ellipse.Ellipsoid(OTHER_BULB), 160))
    for name in ("vertex_positions", "vertex_normals"):
        params[f"lamp.{name}"] = other[name]
    params.update()
    expected = picture(below({"lamp": bulb(OTHER_BULB)}))
    got = picture(scene)
    np.testing.assert_allclose(got, expected, rtol=2e-4, atol=1e-5)
    assert np.abs(got - before).max() > 0.01

    light = scene.emitters()[0].lamp.stored.light()
    exact = ellipsoid.from_transform(mi.ScalarAffineTransform4d(OTHER_BULB))
    np.testing.assert_allclose(light.ratio[0], exact.ratio[0], rtol=1e-6)
    np.testing.assert_allclose(light.flatness[0], exact.flatness[0], rtol=1e-6)
    np.testing.assert_allclose(light.centre.numpy(), exact.centre.numpy(), atol=1e-6)


@jit
def test_vertices_that_are_no_ellipsoid_are_refused():
    scene = mi.load_dict(floor_and({"lamp": bulb(BULB)}, 2))
    params = mi.traverse(scene)
    positions = np.array(params["lamp.vertex_positions"])
    positions[:300] += 0.1
    params["lamp.vertex_positions"] = positions
    message = message_of(params.update)
    assert message.startswith("ellipticalarea: the vertex_positions of the mesh")
    # Nor does what is left of it fail the next picture.
    assert picture(below({"lamp": bulb(BULB)}, size=4), 1).max() > 0


@jit
def test_update_under_freeze():
    gc.collect()  # Dr.Jit records the lamps of all living scenes

    @dr.freeze
    def frozen(scene):
        return mi.render(scene, spp=16, seed=3)

    scene = below({"lamp": lamp(BALL, "solid_angle", shape="sphere")})
    params = mi.traverse(scene)
    for k in range(4):
        matrix = translation(0.1 * k, 0, 0.1 * k) @ BALL
        params["lamp.to_world"] = mi.AffineTransform4f(matrix)
        params.update()
        got = np.array(frozen(scene))
        built = below({"lamp": lamp(matrix, "solid_angle", shape="sphere")})
        np.testing.assert_allclose(got, picture(built, 16), rtol=2e-4)
    assert frozen.n_recordings < 4


@jit
def test_gradient_reaches_the_radiance():
    scene = below({"lamp": bulb(BULB)}, size=4, integrator={"type": "prb", "max_depth": 2})
    params = mi.traverse(scene)
    radiance = mi.Float(1)
    dr.enable_grad(radiance)
    params["lamp.emitter.radiance.value"] = radiance
    params.update()
    image = mi.render(scene, params, spp=4096, seed=1)
    dr.backward(dr.mean(image, axis=None))
    # The picture is in proportion to it; the gradient takes other samples.
    assert dr.grad(radiance)[0] == pytest.approx(np.array(image).mean(), rel=2e-2)


# ---- Bad input ----

BAD = {
    "zero": (lambda: bulb(BULB, semi_axis_z=0.0), ["ellipsoid: semi_axis_z=0 must be positive"]),
    "nan": (lambda: bulb(BULB, semi_axis_x=float("nan")), ["ellipsoid: semi_axis_x=nan"]),
    "text": (lambda: bulb(BULB, semi_axis_x="long"), ['semi_axis_x="long" must be a number']),
    "singular": (
        lambda: bulb(np.diag([1.0, 1, 0, 1])),
        ["ellipsoid: to_world is singular, it must be invertible"],
    ),
    "not finite": (
        lambda: bulb(translation(float("inf"), 0, 0)),
        ["ellipsoid: to_world has entries that are not finite"],
    ),
    "too thin": (
        lambda: bulb(rotation([1, 2, 3], 30), semi_axis_z=1e-6),
        ["ellipsoid: the semi-axes 1, 1, 1e-06 are too different", "make it thicker"],
    ),
    "too far away": (
        lambda: bulb(translation(1e5, 0, 0), semi_axis_z=0.5, semi_axis_x=0.3),
        ["ellipsoid: the semi-axes", "too small for the place", "towards the origin"],
    ),
    "few segments": (lambda: bulb(BULB, segments=4), ["ellipsoid: segments=4 must be from 5"]),
    "fractional segments": (lambda: bulb(BULB, segments=4.5), ['segments="4.5" must be an']),
    "misspelt": (lambda: bulb(BULB, semi_axs_x=1.0), ["semi_axs_x"]),
    "strategy": (
        lambda: bulb(BULB, "rejection"),
        ['ellipticalarea: sampling="rejection" is for planar lamps', "choose one of area"],
    ),
    "inside out": (
        lambda: bulb(BULB, flip_normals=True),
        ["ellipticalarea: the ellipsoid around the emitter shines inwards", "flip_normals"],
    ),
}


@pytest.mark.parametrize("what", BAD, ids=[name.replace(" ", "-") for name in BAD])
@pytest.mark.parametrize("mode", ["llvm_ad_rgb", "scalar_rgb"])
def test_bad_input(what, mode):
    """Names the plugin, the parameter, its value and what would be right."""
    mi.set_variant(mode)
    make, words = BAD[what]
    message = message_of(lambda: mi.load_dict(make()))
    assert [word for word in words if word not in message] == []


SPHERES = {
    "strategy": ("rejection", {}, 'sampling="rejection" is for planar lamps'),
    "flipped": ("solid_angle", {"flip_normals": True}, "shines inwards; leave out its flip"),
}


@pytest.mark.parametrize("what", SPHERES)
@pytest.mark.parametrize("mode", ["llvm_ad_rgb", "scalar_rgb"])
def test_sphere_that_cannot_be_sampled(what, mode):
    """At first use, as for every shape of Mitsuba's own; and the next picture is made."""
    mi.set_variant(mode)
    sampling, parameters, words = SPHERES[what]
    scene = below({"lamp": lamp(BALL, sampling, shape="sphere", **parameters)}, size=2)
    message = message_of(lambda: picture(scene, 1))
    assert message.startswith("ellipticalarea: ")
    assert words in message
    assert picture(below({"lamp": lamp(BALL, "area", shape="sphere")}, size=2), 4).max() > 0


@jit
def test_mesh_of_another_kind_is_refused():
    props = mi.Properties()
    props["emitter"] = mi.load_dict({"type": "ellipticalarea"})
    message = message_of(lambda: mi_ellipse.tessellate(BULB, 64, props))
    assert "a mesh that is no ellipsoid of this package" in message


@jit
def test_smallest_and_largest_that_are_accepted():
    """And they shine."""
    for scale in (1e-5, 1e5):
        for axes in ([1, 0.3, 0.2], [1, 1e-3, 1e-3], [1, 1, 1e-3]):
            matrix = rotation([1, 2, 3], 30) @ np.diag([*(scale * np.array(axes)), 1])
            emitter = mi.load_dict({"type": "scene", "lamp": bulb(matrix)}).emitters()[0]
            it = dr.zeros(mi.Interaction3f)
            it.p = mi.Point3f(*(scale * np.array([2.0, 1, 1.5])).tolist())
            u = mi.Point2f(np.random.default_rng(1).random((2, 1000), dtype=np.float32))
            _, weight = emitter.sample_direction(it, u)
            solid_angle = mi_ellipse.solid_angle(mi_ellipse.Ellipsoid(matrix), np.array(it.p).T[0])
            assert weight[0].numpy().mean() == pytest.approx(solid_angle, rel=1e-2)
