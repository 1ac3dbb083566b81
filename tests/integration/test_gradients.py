"""Gradients of the radiance and of the lamp's transform.

Directions are drawn detached from the geometry, as everywhere in Mitsuba's `prb` integrators: what
moves is accounted for by the boundaries of the projective integrators.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import floor_and, lamp

from oracles.ellipse import rotation, translation

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

DOWN = rotation([1, 0, 0], 180)
ELLIPSE = translation(0, 0, 1.2) @ DOWN @ np.diag([0.8, 0.4, 1, 1])
# Its principal axes are not unique.
CIRCLE = translation(0, 0, 1.2) @ DOWN @ np.diag([0.6, 0.6, 1, 1])


# ---- Radiance ----


def texture():
    values = np.random.default_rng(2).random((4, 3, 3)).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True}


def radiance_gradient(sampling, radiance, key, integrator, spp=256, seed=0):
    """Of the sum of the picture, in reverse."""
    integrator = {"type": integrator, "max_depth": 3}
    lamps = {"lamp": lamp(ELLIPSE, sampling, radiance)}
    scene = mi.load_dict(floor_and(lamps, 8, integrator=integrator))
    parameters = mi.traverse(scene)
    key = f"lamp.emitter.radiance.{key}"
    dr.enable_grad(parameters[key])
    parameters.update()
    picture = mi.render(scene, parameters, spp=spp, seed=seed)
    dr.backward(dr.sum(picture.array))
    return np.array(dr.grad(parameters[key])).ravel(), np.array(picture)


@pytest.mark.parametrize("name", ["solid_angle", "projected_solid_angle", "rejection"])
@pytest.mark.parametrize("integrator", ["prb", "prb_basic", "prbvolpath"])
def test_gradient_of_the_spectrum(name, integrator):
    """A picture is linear in the radiance: radiance times gradient is the picture itself.

    The second pass draws random numbers of its own.
    """
    colour = np.array([3, 1, 0.5])
    radiance = {"type": "rgb", "value": colour.tolist()}
    gradients = []
    pictures = []
    for seed in range(8):
        gradient, picture = radiance_gradient(
            name, radiance, "value", integrator, 4096 if integrator == "prb_basic" else 256, seed
        )
        gradients.append(gradient * colour)
        pictures.append(picture.sum((0, 1)))
    got, expected = np.array(gradients), np.array(pictures)
    error = np.sqrt((got.var(0, ddof=1) + expected.var(0, ddof=1)) / 8)
    assert (error < 0.02 * expected.mean(0)).all()
    # Student's t with 14 degrees of freedom: 8 is passed once in a million
    assert (np.abs(got.mean(0) - expected.mean(0)) < 8 * error + 1e-4 * expected.mean(0)).all()


@pytest.mark.parametrize("name", ["solid_angle", "projected_solid_angle"])
def test_gradient_through_a_draw(name):
    """Of the emitter's own method, which is traced again for it: also linear in the radiance."""
    colour = np.array([4, 3, 2])
    radiance = {"type": "rgb", "value": colour.tolist()}
    scene = mi.load_dict({"type": "scene", "lamp": lamp(ELLIPSE, name, radiance)})
    parameters = mi.traverse(scene)
    dr.enable_grad(parameters["lamp.emitter.radiance.value"])
    parameters.update()
    it = dr.zeros(mi.SurfaceInteraction3f, 4)
    it.p, it.n = mi.Point3f([0, 0.1, 0.2, 0.3], 0, 0), mi.Normal3f(0, 0, 1)
    u = mi.Point2f([0.3, 0.4, 0.5, 0.6], [0.5, 0.6, 0.7, 0.8])
    _, weight = scene.emitters()[0].sample_direction(it, u)
    it.p += 1  # No longer of any interest to the draw
    dr.backward(weight)
    weight, slope = dr.detach(weight), dr.grad(parameters["lamp.emitter.radiance.value"])
    dr.eval(weight, slope)  # Both traces in one kernel
    assert weight.numpy().min() > 1
    # Some sums of single precision
    np.testing.assert_allclose(np.ravel(slope) * colour, weight.numpy().sum(1), rtol=1e-5)


@pytest.mark.parametrize("name", ["solid_angle", "area"])
def test_gradient_of_a_texture_is_that_of_the_built_in(name):
    """Texel by texel."""

    def gradients(sampling):
        g = [radiance_gradient(sampling, texture(), "data", "prb", 1024, s)[0] for s in range(8)]
        return np.array(g).reshape(8, 4, 3, 3).repeat(1, 0)

    got, expected = gradients(name), gradients(None)
    assert (expected.mean(0) > 0).all()
    error = np.sqrt((got.var(0, ddof=1) + expected.var(0, ddof=1)) / 8)
    assert np.median(error / expected.mean(0)) < 0.02
    # Student's t with 14 degrees of freedom, 36 texels: 8 is passed once in some 20 000 runs
    np.testing.assert_array_less(np.abs(got.mean(0) - expected.mean(0)), 8 * error)


def test_gradient_of_a_texture_against_finite_differences():
    """The same random numbers: the picture is linear in the texels where the draws are as well."""
    key = "lamp.emitter.radiance.data"

    def total(step):
        lamps = {"lamp": lamp(ELLIPSE, "solid_angle", texture())}
        scene = mi.load_dict(floor_and(lamps, 8, integrator={"type": "prb", "max_depth": 3}))
        parameters = mi.traverse(scene)
        data = np.array(parameters[key])
        data[1, 2] += step
        parameters[key] = mi.TensorXf(data)
        parameters.update()
        return float(np.array(mi.render(scene, spp=1 << 14, seed=1)).sum())

    expected = (total(0.3) - total(-0.3)) / 0.6
    gradient = radiance_gradient("solid_angle", texture(), "data", "prb", 1 << 14)[0]
    got = gradient.reshape(4, 3, 3)[1, 2].sum()
    assert got == pytest.approx(expected, rel=0.05)


# ---- Transform ----

VIEWS = {
    # What the lamp lights and shades, of a sky that is as bright as its reflection
    "floor": ({"fov": 100.0}, ([0, 0, 0.9], [0, 0, 0], [0, 1, 0])),
    # The lamp itself
    "lamp": ({"fov": 90.0}, ([0, 0, 0.05], [0, 0, 1.2], [0, 1, 0])),
}
MOTIONS = ("shift", "size", "turn")
# Guiding by an octree takes minutes for a small picture on a CPU.
PROJECTIVE = {
    "direct_projective": {"type": "direct_projective", "sppi": 1024, "guiding": "none"},
    "prb_projective": {"type": "prb_projective", "max_depth": 2, "sppi": 1024, "guiding": "none"},
}


def scene_of(matrix, sampling, integrator, view):
    lamps = {
        "lamp": lamp(matrix, sampling),
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.2}},
    }
    scene = floor_and(lamps, 8, integrator=integrator)
    options, look = VIEWS[view]
    scene["sensor"] |= options | {"to_world": mi.ScalarTransform4f().look_at(*look)}
    scene["sensor"]["film"]["sample_border"] = True
    return mi.load_dict(scene)


def moved(matrix, motion, t):
    """The transform, and how it depends on the parameter."""
    base = mi.Transform4f(mi.Matrix4f(np.float32(matrix)))
    if motion == "shift":
        return mi.Transform4f().translate([t, 0, 0]) @ base
    if motion == "size":
        return base @ mi.Transform4f().scale([1 + t, 1, 1])
    return mi.Transform4f().rotate([0, 0, 1], t * (180 / np.pi)) @ base


def gradient(matrix, motion, sampling, integrator, view, seed):
    """Of the picture, forward."""
    scene = scene_of(matrix, sampling, PROJECTIVE[integrator], view)
    parameters = mi.traverse(scene)
    t = mi.Float(0)
    dr.enable_grad(t)
    parameters["lamp.to_world"] = moved(matrix, motion, t)
    parameters.update()
    picture = mi.render(scene, parameters, spp=256, seed=seed)
    dr.forward(t)
    return np.array(dr.grad(picture))


def difference(matrix, motion, view, seed, step=0.02):
    """The same of the built-in pair by a central difference, with noise of its own."""
    pictures = []
    for sign in (1, -1):
        matrix_there = moved(matrix, motion, mi.Float(sign * step)).matrix.numpy()
        there = np.reshape(matrix_there, (4, 4))
        scene = scene_of(there, None, {"type": "path", "max_depth": 2}, view)
        pictures.append(np.array(mi.render(scene, spp=1 << 12, seed=seed)))
    return (pictures[0] - pictures[1]) / (2 * step)


# Pairwise: lamp, motion, strategy, integrator, view
PAIRWISE = [
    ("ellipse", "shift", "solid_angle", "direct_projective", "floor"),
    ("ellipse", "size", "projected_solid_angle", "prb_projective", "lamp"),
    ("ellipse", "shift", "rejection", "prb_projective", "lamp"),
    ("circle", "shift", "projected_solid_angle", "prb_projective", "floor"),
    ("circle", "size", "solid_angle", "direct_projective", "lamp"),
    ("circle", "size", "rejection", "direct_projective", "floor"),
    ("ellipse", "turn", "projected_solid_angle", "direct_projective", "lamp"),
]
LAMPS = {"ellipse": ELLIPSE, "circle": CIRCLE}


@pytest.mark.parametrize("row", PAIRWISE, ids=["-".join(row) for row in PAIRWISE])
def test_gradient_of_the_transform(row):
    shape, motion, name, integrator, view = row
    matrix = LAMPS[shape]
    got = np.array([gradient(matrix, motion, name, integrator, view, s) for s in range(4)])
    built_in = np.array([gradient(matrix, motion, None, integrator, view, s) for s in range(4)])
    expected = np.array([difference(matrix, motion, view, s) for s in range(4)])
    assert np.isfinite(got).all()

    size = np.abs(expected.mean(0)).max()
    assert size > 0.02
    # Boundaries know nothing of the strategy: with the same random numbers both lamps agree.
    noise = got.std(0).mean() + 1e-4
    assert np.abs(got.mean(0) - built_in.mean(0)).max() < 5 * noise
    # And with the difference. On the floor the estimate is noisy: per pixel a third of the largest.
    correlation = np.corrcoef(got.mean(0).ravel(), expected.mean(0).ravel())[0, 1]
    slope = np.sum(got.mean(0) * expected.mean(0)) / np.sum(expected.mean(0) ** 2)
    assert correlation > {"floor": 0.9, "lamp": 0.995}[view]
    assert slope == pytest.approx(1, abs={"floor": 0.15, "lamp": 0.03}[view])


def test_turning_a_circle_changes_nothing():
    """Its axes jump under the slightest turn; the picture and its gradient do not."""
    for view in VIEWS:
        got = gradient(CIRCLE, "turn", "solid_angle", "prb_projective", view, 0)
        shift = gradient(CIRCLE, "shift", "solid_angle", "prb_projective", view, 0)
        # The numerical noise of a boundary that moves along itself
        assert np.abs(got).max() < 1e-3 * np.abs(shift).max()


# ---- Place and size of solids ----

CENTRE, ALBEDO = np.array([0.2, 0.1, 0.6]), 0.5
SKY = 0.2  # Radiance behind the lamp
SOLIDS = {
    "sphere": np.diag([0.3, 0.3, 0.3]),
    "bulb": rotation([1, 2, 0.5], 40)[:3, :3] @ np.diag([0.4, 0.3, 0.2]),
}
SOLID_VIEWS = {
    # The floor under the lamp, from below it
    "floor": (140.0, [0.45, 0.1, 0.28], [0.45, 0.1, 0]),
    # The lamp alone, from below its middle
    "lamp": (90.0, [0.2, 0.1, 0.001], [0.2, 0.1, 1]),
}


def solid_scene(solid, sampling, integrator, view):
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = SOLIDS[solid], CENTRE
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": SKY}}
    lamps = {"lamp": lamp(to_world, sampling, shape="ellipsoid", segments=40), "sky": sky}
    scene = floor_and(lamps, 4, integrator=PROJECTIVE[integrator])
    fov, *points = SOLID_VIEWS[view]
    look = mi.ScalarTransform4f().look_at(*points, [0, 1, 0])
    scene["sensor"] |= {"fov": fov, "to_world": look}
    scene["sensor"]["film"]["sample_border"] = True
    return mi.load_dict(scene)


def move_solid(parameters, solid, motion, t):
    """Let the transform of the sphere, or the vertices of the mesh, depend on the parameter."""
    step = [0, 0, t]
    if solid == "sphere":
        base = mi.Transform4f(parameters["lamp.to_world"])
        grown = base @ mi.Transform4f().scale(1 + t)
        moved = grown if motion == "size" else mi.Transform4f().translate(step) @ base
        parameters["lamp.to_world"] = moved
    else:
        base = dr.unravel(mi.Point3f, parameters["lamp.vertex_positions"])
        centre = mi.Point3f(*CENTRE.tolist())
        moved = (base - centre) * (1 + t) + centre if motion == "size" else base + mi.Point3f(step)
        parameters["lamp.vertex_positions"] = dr.ravel(moved)
    parameters.update()


def mean_of_picture(solid, view, centre, scale):
    """By oracles: the irradiance from a solid above the horizon, or the part of the film."""
    fov, camera, _ = SOLID_VIEWS[view]
    half = np.tan(np.radians(fov / 2))
    axes = scale * SOLIDS[solid]
    if view == "lamp":
        # The dual cone, cut by the film: the outline is an ellipse
        c = centre - camera
        dual = axes @ axes.T - np.outer(c, c)
        middle = dual[:2, 2] / dual[2, 2]
        area = np.pi * np.sqrt(np.linalg.det(dual[:2, :2] / -dual[2, 2] + np.outer(middle, middle)))
        return SKY + (1 - SKY) * area / (2 * half) ** 2
    line = (np.arange(32) + 0.5) / 16 - 1
    total = 0
    for x in camera[0] + camera[2] * half * line:
        for y in camera[1] + camera[2] * half * line:
            # π sin α sin β cos θ for the cone of the dual matrix, without its frame
            c = centre - [x, y, 0]
            values, vectors = np.linalg.eigh(axes @ axes.T - np.outer(c, c))
            tangents2 = values[1:] / -values[0]
            cosine = abs(vectors[2, 0])
            total += np.pi * cosine * np.sqrt(np.prod(tangents2 / (1 + tangents2)))
    return ALBEDO * (SKY + (1 - SKY) * total / len(line) ** 2 / np.pi)


def slope_of_the_mean(solid, view, motion, step=1e-4):
    means = []
    for t in (step, -step):
        shift, scale = ([0, 0, 0], 1 + t) if motion == "size" else ([0, 0, t], 1)
        means.append(mean_of_picture(solid, view, CENTRE + shift, scale))
    return (means[0] - means[1]) / (2 * step)


# Pairwise, as above
SOLID_ROWS = [
    ("sphere", "floor", "height", "solid_angle", "direct_projective"),
    ("sphere", "floor", "size", "projected_solid_angle", "prb_projective"),
    ("sphere", "lamp", "size", "projected_solid_angle", "direct_projective"),
    ("bulb", "floor", "size", "projected_solid_angle", "direct_projective"),
    ("bulb", "lamp", "height", "solid_angle", "prb_projective"),
]


@pytest.mark.parametrize("row", SOLID_ROWS, ids=["-".join(row) for row in SOLID_ROWS])
def test_gradient_of_a_solid(row):
    """Of the mean of the picture."""
    solid, view, motion, name, integrator = row
    gradients, means = [], []
    for seed in range(4):
        scene = solid_scene(solid, name, integrator, view)
        parameters = mi.traverse(scene)
        t = mi.Float(0)
        dr.enable_grad(t)
        move_solid(parameters, solid, motion, t)
        picture = mi.render(scene, parameters, spp=256, seed=seed)
        means.append(np.array(picture).mean())
        dr.forward(t)
        gradients.append(np.array(dr.grad(picture)).mean())
    # 4 · 4² pixels of 256 samples know the part that a disk covers to 0.5 %. The mesh is inside the
    # ellipsoid by at most 7.3 / 40², 0.5 % of its radius.
    mesh_error = 0 if solid == "sphere" else 0.01
    expected = mean_of_picture(solid, view, CENTRE, 1)
    assert np.mean(means) == pytest.approx(expected, rel=0.02 + mesh_error)
    expected = slope_of_the_mean(solid, view, motion)
    error = np.std(gradients, ddof=1) / np.sqrt(4)
    assert error < 0.05 * abs(expected)
    # Student's t with 3 degrees of freedom: 20 is passed in 3 of 10 000 runs
    assert abs(np.mean(gradients) - expected) < 20 * error + (0.002 + mesh_error) * abs(expected)
