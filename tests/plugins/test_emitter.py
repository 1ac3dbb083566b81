"""The plugins in scenes, against Mitsuba's `disk` + `area`."""

import contextlib
import gc
import subprocess
import sys
import weakref
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import floor_and, kernels_of, lamp
from mi_ellipse.geometry import ellipse
from mi_ellipse.sampling import STRATEGIES
from scipy import stats

from oracles.ellipse import MIRROR, SHEAR, rotation, translation
from oracles.pictures import assert_same_picture as same_picture

DOWN = rotation([1, 0, 0], 180)
LAMP = translation(0, 0, 0.8) @ rotation([0.3, 1, 0], 25) @ DOWN @ SHEAR @ np.diag([0.8, 0.3, 1, 1])
OTHER_LAMP = translation(0.5, 0.2, 1.2) @ DOWN @ np.diag([0.2, 0.7, 1, 1])

jit = pytest.mark.usefixtures("llvm_ad_rgb")


def picture(scene, **options):
    return np.array(mi.render(scene, **({"spp": 64, "seed": 3} | options)))


def all_messages(error):
    """The text of an exception and of everything that it came from."""
    text = ""
    while error is not None:
        text += f"{error}\n"
        error = error.__cause__ or error.__context__
    return text


# ---- Registration ----

CHECK = """
import collections
import mitsuba as mi
counts = collections.Counter()
def watch():
    from mi_ellipse.plugins import emitter
    define = emitter.define
    def counted(variant):
        counts[variant] += 1
        return define(variant)
    emitter.define = counted
def check(variant, times=1):
    lamp = {"type": "ellipse", "emitter": {"type": "ellipticalarea"}}
    mi.set_variant(variant)
    assert mi.load_dict(lamp).is_emitter()
    assert counts[variant] == times, counts
"""


@pytest.mark.parametrize(
    "code",
    [
        "import mi_ellipse; watch(); check('llvm_ad_rgb')",
        "mi.set_variant('llvm_ad_rgb'); import mi_ellipse; watch(); check('llvm_ad_rgb', 0)",
        "mi.set_variant('scalar_rgb'); import mi_ellipse; watch(); check('scalar_rgb', 0)\n"
        "check('llvm_ad_rgb'); check('scalar_rgb', 0); import mi_ellipse; check('llvm_ad_rgb')",
        "import mi_ellipse; watch()\n"
        "for v in mi.variants():\n"
        "    if v.startswith(('scalar', 'llvm')): check(v)",
    ],
    ids=["before", "after", "back and forth", "every CPU variant"],
)
def test_registration(code):
    """Once for each variant, whichever is set before or after the import."""
    process = subprocess.run([sys.executable, "-c", CHECK + code], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr


TYPES = """
import mi_ellipse
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
manager = mi.PluginManager.instance()
assert manager.plugin_type("ellipse") == mi.ObjectType.Shape
assert manager.plugin_type("ellipticalarea") == mi.ObjectType.Emitter
assert mi.variant() == "llvm_ad_rgb"
shapes = {f"{kind}{k}": {"type": kind, "emitter": {"type": "ellipticalarea"}}
          for kind in ("ellipse", "disk") for k in range(2)}
scene = mi.load_dict({"type": "scene"} | shapes)
assert len({shape.id() for shape in scene.shapes()}) == len(scene.emitters()) == 4
assert all(f"{name}.to_world" in mi.traverse(scene) for name in shapes)
config = mi.parser.ParserConfig(mi.variant())
text = mi.parser.write_string(mi.parser.parse_dict(config, {"type": "scene"} | shapes))
assert len(mi.load_string(text).emitters()) == 4
"""


def test_types_are_known_when_one_variant_is_set():
    """Equal lamps of a dictionary stay apart, and it can be written as XML."""
    process = subprocess.run([sys.executable, "-c", TYPES], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr


# ---- Names and parameters ----


@jit
@pytest.mark.parametrize("optimize", [True, False])
def test_id_and_parameters(optimize):
    scene = mi.load_dict(floor_and({"lamp": lamp(LAMP, "area")}), optimize=optimize)
    params = mi.traverse(scene)
    for name in ("to_world", "emitter.radiance.value", "emitter.sampling_weight"):
        assert f"lamp.{name}" in params
    np.testing.assert_allclose(np.array(params["lamp.to_world"].matrix)[..., 0], LAMP, atol=1e-6)


@jit
def test_id_in_xml():
    scene = mi.load_string(
        '<scene version="3.0.0"><shape type="ellipse" id="my_lamp">'
        '<float name="semi_axis_x" value="2"/><float name="semi_axis_y" value="0.5"/>'
        '<emitter type="ellipticalarea" id="my_emitter"/></shape></scene>'
    )
    assert [shape.id() for shape in scene.shapes()] == ["my_lamp"]
    matrix = np.array(mi.traverse(scene)["my_lamp.to_world"].matrix)[..., 0]
    np.testing.assert_array_equal(matrix, np.diag([2, 0.5, 1, 1]))


@jit
def test_semi_axes_are_composed_into_the_transform():
    composed = lamp(LAMP @ np.diag([1.5, 0.4, 1, 1]), "solid_angle")
    given = lamp(LAMP, "solid_angle", semi_axis_x=1.5, semi_axis_y=0.4)
    pictures = [picture(mi.load_dict(floor_and({"lamp": each}))) for each in (composed, given)]
    np.testing.assert_array_equal(*pictures)


def test_text_names_strategy_and_radiance(llvm_ad_rgb):
    light = mi.load_dict({"type": "scene", "lamp": lamp(LAMP, "rejection")}).emitters()[0]
    assert "sampling = rejection" in str(light)
    assert "radiance" in str(light)


# ---- Endpoint interface ----


def batches(numbers):
    """Rows of random numbers, all at once or, in scalar variants, one by one."""
    if dr.is_jit_v(mi.Float):
        return [[mi.Float(column) for column in np.float32(numbers).T]]
    return [[float(value) for value in row] for row in np.float32(numbers)]


def plain(value, count):
    """Components of a Dr.Jit or scalar value as the rows of an array with `count` columns."""
    array = np.array(value, dtype=float)
    rows = array.reshape(-1, 1) if count == 1 else np.atleast_2d(array)
    return np.broadcast_to(rows, (len(rows), count))


def endpoint(light):
    """Everything an endpoint answers, but for the directions that it draws."""
    scene = mi.load_dict({"type": "scene", "lamp": light})
    emitter = scene.emitters()[0]
    shape = emitter.get_shape()
    rng = np.random.default_rng(5)
    numbers = rng.random((200 if dr.is_jit_v(mi.Float) else 12, 6))
    answers = []
    for a, b, c, d, e, f in batches(numbers):
        count = len(numbers) if dr.is_jit_v(mi.Float) else 1
        position, weight = emitter.sample_position(0.25, mi.Point2f(a, b))
        ray, ray_weight = emitter.sample_ray(0.25, c, mi.Point2f(a, b), mi.Point2f(d, e))

        # Looking at the point from both sides
        offset = 2 * mi.warp.square_to_uniform_sphere(mi.Point2f(d, f))
        it = mi.Interaction3f()
        it.p = position.p + offset
        it.wavelengths = ray.wavelengths
        it.n = mi.Normal3f(0, 0, 1)
        si = scene.ray_intersect(mi.Ray3f(it.p, -dr.normalize(offset), 0, ray.wavelengths))
        ds = mi.DirectionSample3f(scene, si, it)
        spectrum, spectrum_weight = emitter.sample_wavelengths(si, c)
        values = {
            "sample_position.p": position.p,
            "sample_position.n": position.n,
            "sample_position.uv": position.uv,
            "sample_position.pdf": position.pdf,
            "sample_position weight": weight,
            "sample_ray.o": ray.o,
            "sample_ray.d": ray.d,
            "sample_ray.wavelengths": ray.wavelengths,
            "sample_ray weight": ray_weight,
            "eval": emitter.eval(si),
            "eval_direction": emitter.eval_direction(it, ds),
            "sample_wavelengths": spectrum,
            "sample_wavelengths weight": spectrum_weight,
        }
        # Mitsuba's `area` does not answer for its positions; the shape does.
        ours = "EllipticalArea" in str(emitter)
        values["pdf_position"] = (emitter if ours else shape).pdf_position(position)
        values["pdf_direction"] = emitter.pdf_direction(it, ds)
        if ours and mi.is_spectral:  # Neither for its wavelengths
            pdf = emitter.pdf_wavelengths(spectrum)
            si.wavelengths = spectrum
            emitted = plain(emitter.eval(si), count)
            ratio = emitted / (plain(pdf, count) * plain(spectrum_weight, count))
            np.testing.assert_allclose(ratio[emitted > 0], 1, rtol=1e-5)
        answers.append({k: plain(v, count) for k, v in values.items() if np.size(v)})
    result = {k: np.concatenate([each[k] for each in answers], 1) for k in answers[0]}
    box = emitter.bbox()
    result["bbox"] = np.array([box.min, box.max], dtype=float)
    result["flags"] = np.array([int(emitter.flags()), shape.is_emitter()], dtype=float)
    return result


@pytest.mark.parametrize(
    ("matrix", "options"),
    [
        (LAMP, {}),
        (MIRROR @ LAMP, {}),
        (LAMP, {"flip_normals": True}),
        (translation(1, 2, 3) @ SHEAR @ MIRROR, {"flip_normals": True}),
    ],
    ids=["sheared", "mirrored", "flipped", "all of it"],
)
def test_endpoint_is_that_of_area_and_disk(variant, matrix, options):
    radiance = {"type": "rgb", "value": [4.0, 3.0, 2.0]}
    ours = endpoint(lamp(matrix, "area", radiance, **options))
    builtin = endpoint(lamp(matrix, None, radiance, **options))
    assert ours.keys() == builtin.keys()
    # The light is not black, and seen from its dark side it is
    assert (builtin["eval"] > 0).any()
    assert (builtin["eval"] == 0).any()
    for name, expected in builtin.items():
        # Both are single-precision; the density has the cosine at the light thrice.
        tolerance = 1e-3 if name == "pdf_direction" else 1e-5
        np.testing.assert_allclose(ours[name], expected, rtol=tolerance, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("name", STRATEGIES)
def test_sampled_direction_is_consistent(variant, name):
    """Position, distance, direction, weight and density of a draw belong together."""
    radiance = {"type": "rgb", "value": [4.0, 3.0, 2.0]}
    scene = mi.load_dict({"type": "scene", "lamp": lamp(LAMP, name, radiance)})
    emitter = scene.emitters()[0]
    it = dr.zeros(mi.Interaction3f) if dr.is_jit_v(mi.Float) else mi.Interaction3f()
    it.p, it.n, it.time = mi.Point3f(0.3, -0.4, 0), mi.Normal3f(0, 0, 1), 0
    if mi.is_spectral:
        it.wavelengths = mi.UnpolarizedSpectrum(550)
    numbers = np.random.default_rng(6).random((500 if dr.is_jit_v(mi.Float) else 20, 2))
    lit = 0
    for a, b in batches(numbers):
        count = len(numbers) if dr.is_jit_v(mi.Float) else 1
        ds, weight = emitter.sample_direction(it, mi.Point2f(a, b))
        assert dr.all(
            (ds.emitter == mi.EmitterPtr(emitter))
            if dr.is_jit_v(mi.Float)
            else ds.emitter == emitter
        )
        weight = plain(weight, count)
        chosen = weight[0] > 0
        lit += chosen.sum()
        d, p = plain(ds.d, count), plain(ds.p, count)
        dist, pdf = plain(ds.dist, count), plain(ds.pdf, count)
        there = np.array([[0.3], [-0.4], [0]]) + d * dist
        np.testing.assert_allclose(there[:, chosen], p[:, chosen], atol=2e-6)
        si = scene.ray_intersect(mi.Ray3f(it.p, ds.d))
        np.testing.assert_allclose(plain(si.t, count)[:, chosen], dist[:, chosen], rtol=1e-5)
        np.testing.assert_allclose(
            plain(si.n, count)[:, chosen],
            np.broadcast_to(plain(ds.n, count), p.shape)[:, chosen],
            atol=1e-6,
        )
        uv = (plain(si.uv, count) - plain(ds.uv, count))[:, chosen]
        assert np.abs(uv - np.round(uv)).max(initial=0) < 2e-5
        again = plain(emitter.pdf_direction(it, ds), count)
        np.testing.assert_allclose(again[:, chosen], pdf[:, chosen], rtol=1e-3)
        emitted = plain(emitter.eval_direction(it, ds), count)
        np.testing.assert_allclose((emitted / pdf)[:, chosen], weight[:, chosen], rtol=1e-5)
    assert lit > 0.7 * len(numbers)  # π/4 for `rejection`


@jit
@pytest.mark.parametrize("name", STRATEGIES)
def test_strategy_is_the_one_asked_for(name):
    emitter = mi.load_dict({"type": "scene", "lamp": lamp(LAMP, name)}).emitters()[0]
    it = dr.zeros(mi.Interaction3f)
    it.p, it.n = mi.Point3f(0.3, -0.4, 0), mi.Normal3f(0, 0, 1)
    u = mi.Point2f(np.random.default_rng(7).random((2, 100), dtype=np.float32))
    ds, weight = emitter.sample_direction(it, u)
    strategy = STRATEGIES[name].make()
    light = ellipse.from_transform(mi.AffineTransform4f(LAMP))
    d, pdf, _ = strategy.sample(strategy.prepare(light.seen_from(it.p), it.n), u)
    lit = weight[0].numpy() > 0
    pdf = np.broadcast_to(pdf.numpy(), lit.shape)
    np.testing.assert_allclose(ds.pdf.numpy()[lit], pdf[lit], rtol=1e-4)
    np.testing.assert_allclose(ds.d.numpy(), light.to_world(d).numpy(), atol=1e-5)


@pytest.mark.parametrize("flip", [False, True])
def test_dark_side(variant, flip):
    """Nothing is drawn or counted from behind."""
    scene = mi.load_dict({"type": "scene", "lamp": lamp(LAMP, "solid_angle", flip_normals=flip)})
    emitter = scene.emitters()[0]
    for z, behind in ((0, flip), (2, not flip)):
        it = dr.zeros(mi.Interaction3f) if dr.is_jit_v(mi.Float) else mi.Interaction3f()
        it.p = mi.Point3f(0, 0, z)
        if mi.is_spectral:
            it.wavelengths = mi.UnpolarizedSpectrum(550)
        ds, weight = emitter.sample_direction(it, mi.Point2f(0.4, 0.7))
        pdf = emitter.pdf_direction(it, ds)
        assert np.all((np.array(weight) == 0) == behind)
        assert np.all((np.array(pdf) == 0) == behind)


@jit
def test_plain_disk():
    """An existing scene changes by one word."""
    own = lamp(LAMP, "solid_angle")
    plain_disk = lamp(LAMP, "solid_angle", shape="disk")
    pictures = [picture(mi.load_dict(floor_and({"lamp": each}))) for each in (own, plain_disk)]
    np.testing.assert_array_equal(*pictures)


# ---- Updates ----


def moved(scene, matrix):
    """The scene after an update of the lamp's transform."""
    params = mi.traverse(scene)
    params["lamp.to_world"] = mi.AffineTransform4f(matrix)
    params.update()
    return scene


assert_same_picture = partial(same_picture, rtol=2e-4)


@jit
@pytest.mark.parametrize("shape", ["ellipse", "disk"])
@pytest.mark.parametrize("first", [True, False], ids=["rendered before", "not rendered before"])
def test_update_of_the_transform(shape, first):
    scene = mi.load_dict(floor_and({"lamp": lamp(LAMP, "solid_angle", shape=shape)}))
    before = picture(scene) if first else None
    after = picture(moved(scene, OTHER_LAMP))
    built = mi.load_dict(floor_and({"lamp": lamp(OTHER_LAMP, "solid_angle", shape=shape)}))
    assert_same_picture(after, picture(built))
    if first:
        assert np.abs(after - before).max() > 0.05


@jit
def test_update_of_the_radiance():
    scene = mi.load_dict(floor_and({"lamp": lamp(LAMP, "solid_angle")}))
    before = picture(scene)
    params = mi.traverse(scene)
    params["lamp.emitter.radiance.value"] = 3.0
    params.update()
    assert_same_picture(picture(scene), 3 * before)


@jit
@pytest.mark.parametrize("shape", ["ellipse", "disk"])
def test_update_under_freeze(shape):
    @dr.freeze
    def frozen(scene):
        return mi.render(scene, spp=64, seed=3)

    scene = mi.load_dict(floor_and({"lamp": lamp(LAMP, "solid_angle", shape=shape)}))
    for k in range(4):
        matrix = translation(0.1 * k, 0, 0.1 * k) @ LAMP
        got = np.array(frozen(moved(scene, matrix)))
        built = mi.load_dict(floor_and({"lamp": lamp(matrix, "solid_angle", shape=shape)}))
        assert_same_picture(got, picture(built))
    assert frozen.n_recordings < 4


# ---- Many lamps ----


@jit
@pytest.mark.parametrize("optimize", [True, False])
@pytest.mark.parametrize("count", [2, 3])
def test_lamps_that_differ_in_place_only(optimize, count):
    """Their emitters are equal, and Mitsuba merges equal Python emitters of a dictionary."""
    places = [translation(0.5 * k, 0, 0) @ LAMP for k in range(count)]
    names = "abc"[:count]

    def scene(sampling):
        lamps = {n: lamp(m, sampling) for n, m in zip(names, places, strict=True)}
        return mi.load_dict(floor_and(lamps), optimize=optimize)

    ours = scene("solid_angle")
    assert len({id(e) for e in ours.emitters()}) == count
    params = mi.traverse(ours)
    assert all(f"{n}.emitter.radiance.value" in params for n in names)
    # The mean of 0.3 million samples each; a lamp more or less is 50 %.
    got, expected = (picture(s, spp=1024).mean() for s in (ours, scene(None)))
    assert got == pytest.approx(expected, rel=0.02)


@jit
def test_lamps_equal_in_every_respect():
    lamps = {name: lamp(LAMP, "solid_angle") for name in "ab"}
    pictures = [picture(mi.load_dict(floor_and(lamps), optimize=o)) for o in (True, False)]
    assert pictures[0].mean() == pytest.approx(pictures[1].mean(), rel=0.02)


@jit
@pytest.mark.parametrize("name", STRATEGIES)
def test_kernels_do_not_grow_with_the_number_of_lamps(name):
    def kernels(count):
        places = {f"l{k}": translation(0.01 * k, 0, 0) @ LAMP for k in range(count)}
        return kernels_of(mi.load_dict(floor_and({n: lamp(m, name) for n, m in places.items()})))

    # Choosing one of several lamps is some 15 operations more.
    operations, callables = kernels(2)
    for count in (10, 100):
        more_operations, more_callables = kernels(count)
        assert more_operations <= operations + 5
        assert more_callables <= callables


@jit
@pytest.mark.parametrize("call", ["sample_direction", "pdf_direction"])
@pytest.mark.parametrize("name", STRATEGIES)
def test_calls_for_inactive_paths_branch_before_they_work(name, call):
    """The callable of a light's call jumps before its first division."""
    scene = mi.load_dict(floor_and({"lamp": lamp(LAMP, name)}))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        picture(scene, spp=1)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    code = [part for kernel in kernels for part in kernel["ir"].getvalue().split("define ")]
    # The lights of other tests may be alive, and then they are compiled as well.
    callables = [part for part in code if f"; Call: Emitter::{call}()" in part]
    assert any(0 < part.find("br i1") < part.find("fdiv") for part in callables)


@jit
@pytest.mark.parametrize("shape", ["ellipse", "disk"])
def test_lamps_die_with_their_scene(shape):
    """All living emitters are traced in every render: a leaked lamp slows all later ones."""

    class Marker(mi.BSDF):
        """Lives as long as the shape that owns it."""

        def __init__(self):
            super().__init__(mi.Properties())
            self.m_flags = mi.BSDFFlags.DiffuseReflection
            self.m_components = [self.m_flags]

        def sample(self, ctx, si, sample1, sample2, active=True):
            return dr.zeros(mi.BSDFSample3f), mi.Spectrum(0)

        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return mi.Spectrum(0), mi.Float(0)

    native = mi.load_dict(floor_and({"lamp": lamp(LAMP)}))
    gc.collect()
    before = kernels_of(native)

    scene = mi.load_dict(floor_and({"lamp": lamp(LAMP, "solid_angle", shape=shape, bsdf=Marker())}))
    # Rendered, updated, rendered: what might be kept
    picture(scene)
    picture(moved(scene, OTHER_LAMP))
    assert kernels_of(native) != before  # The lamp is in there while it lives
    emitter = weakref.ref(scene.emitters()[0])
    marker = weakref.ref(next(s.bsdf() for s in scene.shapes() if s.is_emitter()))
    assert emitter() is not None
    assert marker() is not None
    del scene
    gc.collect()
    assert emitter() is None
    assert marker() is None
    assert kernels_of(native) == before


# ---- Pictures ----


@jit
@pytest.mark.parametrize("name", STRATEGIES)
def test_evaluated_calls_and_branches_give_the_same_picture(name):
    """Dr.Jit's other mode, in which each call and branch is a kernel; the same random numbers."""
    scene = mi.load_dict(floor_and({"lamp": lamp(LAMP, name)}))
    symbolic = picture(scene, spp=16)
    flags = dr.JitFlag.SymbolicCalls, dr.JitFlag.SymbolicLoops, dr.JitFlag.SymbolicConditionals
    with contextlib.ExitStack() as stack:
        for flag in flags:
            stack.enter_context(dr.scoped_set_flag(flag, False))
        evaluated = picture(scene, spp=16)
    # Other kernels round differently.
    np.testing.assert_allclose(evaluated, symbolic, rtol=1e-3)


@jit
@pytest.mark.parametrize("name", STRATEGIES)
def test_all_ways_of_sampling_give_the_same_picture(name):
    """Light samples, BSDF samples, MIS; each pixel against `disk` + `area`, 0.1 % for all tests.

    Welch's t-test of the means of 12 renders; the lamp floats above the floor, where all
    variances are finite.
    """
    seeds, size = 12, 6
    ways = {
        "light": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "bsdf": {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1},
        "mis": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 1},
        "path": {"type": "path", "max_depth": 2},
    }

    def renders(sampling, integrator, first_seed):
        scene = mi.load_dict(floor_and({"lamp": lamp(LAMP, sampling)}, size, integrator=integrator))
        seed_range = range(first_seed, first_seed + seeds)
        return np.array([picture(scene, spp=1024, seed=s)[..., 0] for s in seed_range])

    expected = renders(None, ways["path"], 1000)
    tests = len(STRATEGIES) * len(ways) * size**2
    for k, (way, integrator) in enumerate(ways.items()):
        got = renders(name, integrator, 100 * k)
        # Pixels of the lamp itself have no variance; on the darkest, BSDF samples find it too
        # seldom for their mean to be normally distributed.
        noisy = (expected.std(0) > 1e-6) & (expected.mean(0) > 0.01 * expected.mean())
        assert noisy.sum() > size**2 / 2
        p = stats.ttest_ind(got, expected, equal_var=False).pvalue[noisy]
        assert p.min() > 1 - (1 - 0.001) ** (1 / tests), way


# ---- Bad input ----


def broken(**changes):
    """A lamp with something wrong in the shape."""
    return {"type": "ellipse", "emitter": {"type": "ellipticalarea"}} | changes


def with_emitter(**changes):
    return {"type": "ellipse", "emitter": {"type": "ellipticalarea"} | changes}


def transform(matrix):
    return mi.ScalarAffineTransform4d(np.asarray(matrix, float))


BAD = {
    "zero": (lambda: broken(semi_axis_x=0.0), ["ellipse", "semi_axis_x=0", "positive"]),
    "negative": (lambda: broken(semi_axis_y=-1.0), ["ellipse", "semi_axis_y=-1", "positive"]),
    "nan": (lambda: broken(semi_axis_y=float("nan")), ["ellipse", "semi_axis_y=nan", "finite"]),
    "inf": (lambda: broken(semi_axis_x=float("inf")), ["ellipse", "semi_axis_x=inf", "finite"]),
    "singular": (
        lambda: broken(to_world=transform(np.diag([1, 0, 1, 1]))),
        ["ellipse", "to_world", "singular", "invertible"],
    ),
    "flat": (
        lambda: broken(to_world=transform(np.diag([1, 1, 0, 1]))),
        ["ellipse", "to_world", "singular", "invertible"],
    ),
    "not finite": (
        lambda: broken(to_world=transform(translation(float("nan"), 0, 0))),
        ["ellipse", "to_world", "nan", "finite"],
    ),
    "infinite": (
        lambda: broken(to_world=transform(np.diag([float("inf"), 1, 1, 1]))),
        ["ellipse", "to_world", "inf", "finite"],
    ),
    "unknown sampling": (
        lambda: with_emitter(sampling="solid_angel"),
        ["ellipticalarea", "sampling", "solid_angel", *STRATEGIES],
    ),
    "unknown parameter of the shape": (lambda: broken(semi_axis_z=2.0), ["semi_axis_z", "ellipse"]),
    "unknown parameter of the emitter": (
        lambda: with_emitter(samplin="area"),
        ["samplin", "ellipticalarea"],
    ),
    "transform of the emitter": (
        lambda: with_emitter(to_world=transform(np.eye(4))),
        ["ellipticalarea", "to_world", "shape"],
    ),
}


@pytest.mark.parametrize("what", BAD, ids=[name.replace(" ", "-") for name in BAD])
@pytest.mark.parametrize("mode", ["llvm_ad_rgb", "scalar_rgb"])
def test_bad_input(what, mode):
    """Names the plugin, the parameter, its value and what would be right."""
    mi.set_variant(mode)
    make, words = BAD[what]
    with pytest.raises(Exception) as error:  # noqa: PT011
        mi.load_dict(make())
    message = all_messages(error.value)
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize("mode", ["llvm_ad_rgb", "scalar_rgb"])
def test_shape_that_is_no_ellipse(mode):
    """At first use: Mitsuba gives a Python emitter no earlier opportunity."""
    mi.set_variant(mode)
    shape = {"type": "rectangle", "emitter": {"type": "ellipticalarea"}}
    shape["to_world"] = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([1, 0, 0], 180)
    scene = mi.load_dict(floor_and({"lamp": shape}, 2))
    with pytest.raises(Exception) as error:  # noqa: PT011
        picture(scene, spp=1)
    message = all_messages(error.value)
    for word in ("ellipticalarea", "Rectangle", '"ellipse"', '"ellipsoid"', '"disk"', '"sphere"'):
        assert word in message
    # Nor does what is left of it fail the next picture.
    good = mi.load_dict(floor_and({"lamp": lamp(LAMP, "solid_angle")}, 2))
    assert picture(good, spp=1).max() > 0


@pytest.mark.parametrize("mode", ["llvm_ad_rgb", "scalar_rgb"])
def test_smallest_and_largest_semi_axes_are_accepted(mode):
    mi.set_variant(mode)
    for x, y in ((1e-6, 1.0), (1e5, 1e5), (1e-5, 1e-5)):
        assert mi.load_dict(broken(semi_axis_x=x, semi_axis_y=y)).is_emitter()
