"""Renders in one pass and in several."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from commands import samples
from mi_ellipse.rendering import passes
from mi_ellipse.rendering.scene import load_scene

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.mark.parametrize(
    ("sampler", "spp", "limit", "expected"),
    [
        ("independent", 4096, passes.MAX_SAMPLES_PER_PASS, (4096,)),
        ("independent", 100, samples(100), (100,)),
        ("independent", 101, samples(100), (51, 50)),
        ("independent", 7, samples(2) + 1, (2, 2, 2, 1)),
        ("independent", None, samples(3), (2, 2)),
        ("stratified", 5, samples(100), (9,)),
        ("stratified", 50, samples(30), (25, 25)),
    ],
)
def test_plan_passes(scene_file, sampler, spp, limit, expected):
    scene = load_scene(scene_file, {"sampler": sampler})
    assert passes.plan_passes(scene, spp, limit) == expected


@pytest.mark.parametrize(
    ("sampler", "spp", "expected"),
    [
        ("independent", 3, (3,)),
        ("independent", 8, (4, 4)),
        ("independent", 15, (4, 4, 4, 3)),
        ("multijitter", 16, (16,)),
    ],
)
def test_short_passes(scene_file, monkeypatch, sampler, spp, expected):
    monkeypatch.setitem(passes.SHORT_PASS, "llvm", samples(4))
    scene = load_scene(scene_file, {"sampler": sampler})
    assert passes.plan_passes(scene, spp, short=True) == expected
    assert passes.plan_passes(scene, spp) == (spp,)


def test_short_pass_has_a_sample_for_each_pixel(scene_file, monkeypatch):
    monkeypatch.setitem(passes.SHORT_PASS, "llvm", 1)
    assert passes.plan_passes(load_scene(scene_file), 2, short=True) == (1, 1)


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_spectral", "scalar_rgb"])
def test_continued_render_is_the_uninterrupted_one_to_the_bit(scene_file, monkeypatch, variant):
    mi.set_variant(variant)
    monkeypatch.setitem(passes.SHORT_PASS, variant.partition("_")[0], samples(4))
    threads = dr.thread_count()
    dr.set_thread_count(1)  # More of them add up samples in an order of chance.
    try:
        scene = load_scene(scene_file)
        whole = passes.render(scene, 15, 5, short=True)
        asked = iter([False, True])
        first = passes.render(scene, 15, 5, short=True, stop=lambda: next(asked))
        second = passes.render(scene, 15, 5, short=True, before=first.unfinished)
        more = passes.render(scene, 20, 5, short=True, before=first.unfinished)
        all_of_more = passes.render(scene, 20, 5, short=True)
    finally:
        dr.set_thread_count(threads)

    assert (first.spp, first.passes, first.unfinished.spp) == (8, 2, 8)
    assert (second.spp, second.passes, second.unfinished) == (15, 4, None)
    assert second.seconds > first.seconds > 0
    assert np.array_equal(second.image, whole.image)
    assert np.array_equal(more.image, all_of_more.image)
    assert not np.array_equal(first.image, whole.image)


def test_render_goes_on_only_from_its_own_passes(scene_file, monkeypatch):
    monkeypatch.setitem(passes.SHORT_PASS, "llvm", samples(4))
    scene = load_scene(scene_file)
    finished = passes.render(scene, 12, short=True, stop=lambda: True).unfinished
    with pytest.raises(ValueError, match="spp=3: 4 samples per pixel are finished already"):
        passes.render(scene, 3, short=True, before=finished)
    with pytest.raises(ValueError, match="passes of another size"):
        passes.render(scene, 12, before=finished)


def test_plan_passes_refuses_a_film_beyond_the_limit(scene_file):
    with pytest.raises(ValueError, match="more than 191 samples"):
        passes.plan_passes(load_scene(scene_file), 1, samples(1) - 1)


def test_passes_average_to_renders_of_mitsuba_and_are_recorded_once(scene_file, monkeypatch):
    frozen = []
    freeze = dr.freeze
    monkeypatch.setattr(dr, "freeze", lambda f: frozen.append(freeze(f)) or frozen[-1])
    scene = load_scene(scene_file)
    calls = []
    rendering = passes.render(scene, 15, 5, lambda *call: calls.append(call), samples(4))

    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert (rendering.spp, rendering.passes) == (15, 4)
    # One for 4, 4, 4, a second one where a lamp met its shape in the first, one for the 3.
    assert frozen[0].n_recordings <= 3

    seeds = passes.pass_seeds(5, 4)
    assert len(set(seeds)) == 4
    expected = np.average(
        [mi.render(scene, spp=n, seed=s).numpy() for n, s in zip((4, 4, 4, 3), seeds, strict=True)],
        axis=0,
        weights=(4, 4, 4, 3),
    )
    np.testing.assert_allclose(rendering.image, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("variant", ["llvm_ad_spectral", "llvm_ad_mono"])
def test_passes_in_other_variants(scene_file, variant):
    mi.set_variant(variant)
    scene = load_scene(scene_file)
    rendering = passes.render(scene, 256, max_samples=samples(64))
    assert rendering.passes == 4
    whole = mi.render(scene, spp=256).numpy()
    assert rendering.image.mean() == pytest.approx(whole.mean(), rel=0.02)


def test_single_pass_is_not_recorded(scene_file, monkeypatch):
    monkeypatch.setattr(dr, "freeze", lambda _: pytest.fail("recorded a single pass"))
    assert passes.render(load_scene(scene_file), 4).passes == 1


# ---- Passes that can be repeated ----


@pytest.fixture
def threads():
    """Set the number of threads; the number of before returns in the end."""
    before = dr.thread_count()
    yield dr.set_thread_count
    dr.set_thread_count(before)


@pytest.mark.parametrize("spp", [3, 32, 1000, 20000])
def test_repeatable_passes_are_the_same_with_any_number_of_threads(small_scene, threads, spp):
    """A film of 24 × 16 pixels, so that blocks of samples end within pixels."""
    scene = load_scene(small_scene)
    images = []
    for count in (1, 2, 5, 5):
        threads(count)
        images.append(passes.render(scene, spp, 1, repeatable=True).image)
        assert dr.thread_count() == count
    for image in images[1:]:
        np.testing.assert_array_equal(image, images[0])


def test_threads_of_repeatable_passes(small_scene, threads):
    text = small_scene.read_text().replace('value="24"', 'value="1024"')
    small_scene.write_text(text)
    scene = load_scene(small_scene)
    threads(4)
    assert passes.repeatable_threads(scene, 2**14) == 4
    assert passes.repeatable_threads(scene, 2**14 - 1) == 1
    assert passes.repeatable_threads(scene, 2) == 1
    small_scene.write_text(text.replace('"box"', '"gaussian"'))
    assert passes.repeatable_threads(load_scene(small_scene), 3) == 4
    assert [passes.repeatable_size(spp) for spp in (1, 5, 64, 10**6)] == [1, 4, 64, 2**14]
