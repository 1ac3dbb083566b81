"""Lamps of a scene that choose among themselves, against the same lamps that do not."""

import contextlib
import gc
import weakref
from functools import partial

import drjit as dr
import mi_ellipse
import mitsuba as mi
import numpy as np
import pytest
from conftest import floor_and, kernels_of, lamp
from lamp_groups import (
    LEFT,
    LIGHT_ONLY,
    PATH,
    RED,
    facing_away,
    flipped_floor,
    fog,
    half_dark,
    load,
    others,
    ring,
    solids,
    textured,
    two,
    weighted,
)
from mi_ellipse.lamps.group import Group

from oracles.ellipse import translation
from oracles.pictures import assert_same_expectation, render
from oracles.pictures import assert_same_picture as same_picture

jit = pytest.mark.usefixtures("llvm_ad_rgb")


# ---- Pictures ----


def picture(scene, **options):
    return np.array(mi.render(scene, **({"spp": 16, "seed": 3} | options)))


# Of what, variant, integrator
CASES = {
    "two": (two, "llvm_ad_rgb", PATH),
    "light samples": (two, "llvm_ad_rgb", LIGHT_ONLY),
    "tree": (ring, "llvm_ad_rgb", LIGHT_ONLY),
    "tree with MIS": (lambda: ring(9, "projected_solid_angle"), "llvm_ad_rgb", PATH),
    "tree of two steps": (lambda: ring(17), "llvm_ad_rgb", LIGHT_ONLY),
    "half dark tree": (half_dark, "llvm_ad_rgb", PATH),
    "strategies": (lambda: two("projected_solid_angle", "area"), "llvm_ad_rgb", {"type": "direct"}),
    "textured": (textured, "llvm_ad_rgb", {"type": "prb", "max_depth": 3}),
    "solids": (solids, "llvm_ad_rgb", LIGHT_ONLY),
    "other emitters": (others, "llvm_ad_rgb", PATH),
    "weights": (weighted, "llvm_ad_rgb", LIGHT_ONLY),
    "weights with MIS": (weighted, "llvm_ad_rgb", PATH),
    "facing away": (facing_away, "llvm_ad_rgb", LIGHT_ONLY),
    "flipped floor": (flipped_floor, "llvm_ad_rgb", LIGHT_ONLY),
    "fog": (fog, "llvm_ad_rgb", {"type": "volpath", "max_depth": 4}),
    "fog with spectral MIS": (fog, "llvm_ad_rgb", {"type": "volpathmis", "max_depth": 4}),
    "spectral": (two, "llvm_ad_spectral", PATH),
    "polarized": (two, "llvm_ad_mono_polarized", PATH),
}


@pytest.mark.parametrize("case", CASES, ids=[name.replace(" ", "-") for name in CASES])
def test_same_picture_as_ungrouped(case):
    """Welch's test of each block, 1e-5 a case."""
    lamps, variant, integrator = CASES[case]
    mi.set_variant(variant)
    got, expected = (
        render(load(lamps(), grouped, integrator=integrator), 1024) for grouped in (True, False)
    )
    # A lamp that answers without its part of the weights is off by a tenth at least. Fog and
    # wavelengths are noisier, and Mitsuba picks dark lamps as often as others.
    noisy = "fog" in case or case in ("spectral", "polarized")
    assert_same_expectation(got, expected, within=0.3 if noisy else 0.1 if "dark" in case else 0.07)


@jit
def test_noise_of_picking_a_lamp_is_gone():
    """Most of the variance, with light samples alone."""
    variances = []
    for grouped in (True, False):
        scene = load(two(), grouped, integrator=LIGHT_ONLY)
        variances.append(render(scene, 16, 16).var(0).mean())
    assert variances[0] < variances[1] / 3


@jit
@pytest.mark.parametrize("lamps", [two, ring])
def test_evaluated_calls_give_the_same_picture(lamps):
    """With the same random numbers."""
    scene = load(lamps(), True)
    symbolic = picture(scene)
    flags = dr.JitFlag.SymbolicCalls, dr.JitFlag.SymbolicLoops, dr.JitFlag.SymbolicConditionals
    for count in (1, 3):
        with contextlib.ExitStack() as stack:
            for flag in flags[:count]:
                stack.enter_context(dr.scoped_set_flag(flag, False))
            # Other kernels round differently.
            np.testing.assert_allclose(picture(scene), symbolic, rtol=2e-3)


# ---- Draws ----


def places(count=4096):
    """Points on the floor and above it."""
    rng = np.random.default_rng(1)
    it = dr.zeros(mi.SurfaceInteraction3f, count)
    it.p = mi.Point3f(*np.float32(rng.uniform([-2, -2, 0], [2, 2, 0.3], (count, 3))).T)
    it.n = mi.Normal3f(0, 0, 1)
    return it, mi.Point2f(rng.random((2, count), dtype=np.float32))


@jit
@pytest.mark.parametrize(
    "lamps",
    [two, weighted, ring, partial(ring, 17), half_dark, solids],
    ids=["two", "weighted", "tree", "tree-of-two-steps", "half-dark", "solids"],
)
def test_density_of_the_scene_is_that_of_its_draw(lamps):
    scene = load(lamps(), True)
    it, u = places()
    ds, _ = scene.sample_emitter_direction(it, u, test_visibility=False)
    again = scene.pdf_emitter_direction(it, ds)
    assert np.isfinite(again.numpy()).all()
    drawn = ds.pdf.numpy() > 0
    assert drawn.mean() > 0.5
    # Single precision; near the horizon of the surface and at the rims it loses digits.
    error = np.abs(again.numpy()[drawn] / ds.pdf.numpy()[drawn] - 1)
    assert np.quantile(error, 0.99) < 1e-4
    assert error.max() < 0.05


@jit
@pytest.mark.parametrize("lamps", [weighted, ring])
def test_lamp_that_is_asked_directly(lamps):
    """Without a call around it, as with one: same draws, weights and densities."""
    scene = load(lamps(), True)
    it, u = places(256)
    for emitter in scene.emitters()[:2]:
        alone, weight = emitter.sample_direction(it, u)
        called, expected = mi.EmitterPtr(emitter).sample_direction(it, u)
        np.testing.assert_allclose(weight.numpy(), expected.numpy(), rtol=1e-4)
        np.testing.assert_allclose(alone.pdf.numpy(), called.pdf.numpy(), rtol=1e-4)
        assert dr.all((alone.emitter == called.emitter) | (alone.pdf == 0))
        got, called = (
            e.pdf_direction(it, alone).numpy() for e in (emitter, mi.EmitterPtr(emitter))
        )
        np.testing.assert_allclose(got, called, rtol=1e-4)


@jit
def test_density_of_a_dark_lamp_is_a_number():
    """Its node of the tree has no power."""
    scene = load(half_dark(), True)
    it, _ = places(256)
    (dark,) = (one for one in scene.emitters() if one.get_shape().id() == "lamp9")
    ds = dr.zeros(mi.DirectionSample3f, 256)
    ds.p = mi.traverse(dark.get_shape())["to_world"] @ mi.Point3f(0)
    ds.d = dr.normalize(ds.p - it.p)
    ds.dist = dr.norm(ds.p - it.p)
    ds.emitter = mi.EmitterPtr(dark)
    density = dark.pdf_direction(it, ds).numpy()
    assert np.isfinite(density).all()
    assert (density >= 0).all()


# ---- Parameters ----


def changed(scene, **values):
    params = mi.traverse(scene)
    for name, value in values.items():
        params[name.replace("__", ".")] = value
    params.update()
    return scene


assert_same_picture = partial(same_picture, rtol=1e-3)


@jit
@pytest.mark.parametrize("lamps", [two, lambda: two() | ring(10)], ids=["two", "tree"])
def test_updates_are_those_of_a_new_scene(lamps):
    moved = translation(0.3, 0.2, 0.4) @ LEFT
    scene = load(lamps(), True)
    before = picture(scene)
    expected = lamps()
    expected["left"] = lamp(moved, "solid_angle", RED)
    changed(scene, left__to_world=mi.AffineTransform4f(moved))
    assert_same_picture(picture(scene), picture(load(expected, True)))

    bright = {"type": "rgb", "value": [0.5, 8.0, 4.0]}
    expected["right"]["emitter"]["radiance"] = bright
    changed(scene, right__emitter__radiance__value=mi.Color3f(0.5, 8, 4))
    assert_same_picture(picture(scene), picture(load(expected, True)))

    expected["right"]["emitter"]["sampling_weight"] = 3.0
    changed(scene, right__emitter__sampling_weight=3.0)
    after = picture(scene)
    assert_same_picture(after, picture(load(expected, True)))
    assert np.abs(after - before).max() > 0.05


@jit
def test_all_lamps_without_radiance():
    scene = load(two(), True)
    changed(scene, left__emitter__radiance__value=0.0, right__emitter__radiance__value=0.0)
    assert not picture(scene).any()
    it, u = places(64)
    for emitter in scene.emitters():
        ds, weight = emitter.sample_direction(it, u)
        for values in (ds.d, ds.p, ds.dist, ds.pdf, weight, emitter.pdf_direction(it, ds)):
            assert np.isfinite(values.numpy()).all()


@jit
@pytest.mark.parametrize("lamps", [two, lambda: two() | ring(10)], ids=["two", "tree"])
def test_updates_under_freeze(lamps):
    """A replay follows its lamps. The first change may record anew, as Mitsuba's transforms do."""

    @dr.freeze
    def frozen(scene):
        return mi.render(scene, spp=16, seed=3)

    scene = load(lamps(), True)
    for k in range(6):
        matrix = translation(0.1 * k, 0, 0.1 * k) @ LEFT
        changed(
            scene,
            left__to_world=mi.AffineTransform4f(matrix),
            right__emitter__radiance__value=mi.Color3f(1 + k, 2, 3),
        )
        assert_same_picture(np.array(frozen(scene)), picture(scene))
    assert frozen.n_recordings <= 2


@jit
def test_frozen_scenes_in_turns():
    @dr.freeze
    def frozen(scene):
        return mi.render(scene, spp=16, seed=3)

    scenes = load(two(), True), load(ring(), True), load(two("area", "area"), False)
    for scene in (*scenes, *scenes):
        assert_same_picture(np.array(frozen(scene)), picture(scene))


# ---- Scenes side by side, and what is left of them ----


@jit
def test_two_scenes_in_turns():
    scenes = load(two(), True), load(ring(), True), load(two("area", "area"), False)
    first = [picture(scene) for scene in scenes]
    again = [picture(scene) for scene in reversed(scenes)]
    for a, b in zip(first, reversed(again), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4)
    alone = []
    del scenes
    for lamps, grouped in ((two(), True), (ring(), True), (two("area", "area"), False)):
        gc.collect()
        alone.append(picture(load(lamps, grouped)))
    for a, b in zip(first, alone, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-3)


@jit
def test_grouped_lamps_die_with_their_scene():
    native = mi.load_dict(floor_and({"lamp": lamp(LEFT)}, 8))
    gc.collect()
    before = kernels_of(native)
    scene = load(two(), True)
    picture(scene)
    picture(changed(scene, left__to_world=mi.AffineTransform4f(translation(0, 0, 0.2) @ LEFT)))
    assert kernels_of(native) != before  # The lamps are in there while they live
    alive = [weakref.ref(emitter) for emitter in scene.emitters()]
    alive.append(weakref.ref(scene.emitters()[0].group))
    assert all(reference() is not None for reference in alive)
    del scene
    gc.collect()
    assert not any(reference() is not None for reference in alive)
    assert kernels_of(native) == before


@jit
@pytest.mark.parametrize("integrator", [PATH, LIGHT_ONLY], ids=["path", "light-samples"])
def test_members_share_one_trace(integrator, monkeypatch):
    """The body is traced as often for twelve lamps as for nine."""

    def traces(count):
        traced = []
        for name in ("_draw", "_density"):
            method = getattr(Group, name)
            monkeypatch.setattr(Group, name, lambda *a, m=method: traced.append(0) or m(*a))
        picture(load(ring(count), True, integrator=integrator))
        monkeypatch.undo()
        return len(traced)

    assert traces(12) == traces(9) > 0


@jit
def test_kernels_do_not_grow_with_the_number_of_lamps():
    def kernels(count):
        scene = load(ring(count), True)
        result = kernels_of(scene)
        del scene
        gc.collect()
        return result

    operations, callables = kernels(9)
    # One step down the tree
    more_operations, more_callables = kernels(16)
    assert more_operations <= operations + 5
    assert more_callables <= callables
    # Two steps are a loop, in the draw and in the density.
    two_operations, two_callables = kernels(17)
    assert two_operations < 1.5 * operations
    assert two_callables <= callables + 1
    more_operations, more_callables = kernels(128)
    assert more_operations <= two_operations + 5
    assert more_callables <= two_callables


# ---- Gradients ----


def gradients(lamps, grouped, seed):
    """Of the sum of the picture with respect to each radiance."""
    scene = load(lamps, grouped, integrator={"type": "prb", "max_depth": 3})
    params = mi.traverse(scene)
    keys = [key for key in params.keys() if key.endswith("radiance.value")]  # noqa: SIM118
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.sum(mi.render(scene, params, spp=256, seed=seed).array))
    return np.array([np.array(dr.grad(params[key])).ravel() for key in keys])


@jit
def test_gradients_of_the_radiances():
    """Student's t with 10 degrees of freedom, six numbers: 10 is passed once in 100 000."""
    got, expected = (
        np.array([gradients(two(), grouped, seed) for seed in range(6)])
        for grouped in (True, False)
    )
    error = np.sqrt((got.var(0, ddof=1) + expected.var(0, ddof=1)) / 6)
    assert (error < 0.02 * expected.mean(0)).all()
    assert (np.abs(got.mean(0) - expected.mean(0)) < 10 * error + 1e-4 * expected.mean(0)).all()


# ---- Which lamps ----


@jit
def test_second_call_replaces_the_first_group():
    scene = load(ring(4), True, integrator=LIGHT_ONLY)
    emitters = scene.emitters()
    first = emitters[0].group
    second = mi_ellipse.group_lamps(scene, emitters[1:3])
    assert second is not first
    assert [e.group for e in emitters] == [None, second, second, None]
    ungrouped = load(ring(4), False, integrator=LIGHT_ONLY)
    assert_same_expectation(render(scene, 2048), render(ungrouped, 2048), within=0.07)
    assert mi_ellipse.group_lamps(scene, emitters[:1]) is None
    assert [e.group for e in emitters] == [None] * 4


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"], indirect=True)
def test_foreign_emitters_are_refused(variant):
    scene = mi.load_dict(floor_and(others(), 4))
    other = mi.load_dict(floor_and(two(), 4))
    group = mi_ellipse.group_lamps(scene)
    point = next(e for e in scene.emitters() if "Point" in e.class_name())
    own = [e for e in scene.emitters() if getattr(e, "group", None) is not None]
    for foreign in (point, other.emitters()[0]):
        with pytest.raises(ValueError, match=f"{foreign.class_name()}.*ellipticalarea"):
            mi_ellipse.group_lamps(scene, [*own, foreign])
        assert all(e.group is group for e in own)


@jit
def test_fewer_than_two_lamps():
    lamps = two()
    lamps["left"]["emitter"]["sampling_weight"] = 0.0
    scene = mi.load_dict(floor_and(lamps, 4))
    assert mi_ellipse.group_lamps(scene) is None
    assert mi_ellipse.group_lamps(scene, []) is None
    assert mi_ellipse.group_lamps(mi.load_dict(floor_and({}, 4))) is None
    assert mi_ellipse.group_lamps(mi.load_dict(floor_and({"lamp": lamp(LEFT)}, 4))) is None


@pytest.mark.parametrize(
    "radiance",
    [{"type": "blackbody", "temperature": 4000.0}, {"type": "d65", "scale": 2.0}, "spectrum"],
    ids=["blackbody", "d65", "spectrum"],
)
@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_spectral"], indirect=True)
def test_radiances_of_any_plugin(variant, radiance):
    if radiance == "spectrum":
        radiance = {"type": "spectrum", "value": [(400.0, 1.0), (500.0, 3.0), (700.0, 2.0)]}
    lamps = two()
    lamps["left"]["emitter"]["radiance"] = radiance
    try:
        expected = picture(load(lamps, False, 4), spp=4096)
    except RuntimeError as error:
        pytest.skip(f"Mitsuba has no such radiance in {variant}: {error}")
    got = picture(load(lamps, True, 4), spp=4096)
    # 65 000 paths; a lamp without its part of the choice is off by far more.
    np.testing.assert_allclose(got.mean((0, 1)), expected.mean((0, 1)), rtol=0.05)
