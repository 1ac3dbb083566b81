"""Variants in one process, and the GPU where there is one."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import VARIANTS, floor_and, lamp
from mi_ellipse.sampling import STRATEGIES

from oracles.ellipse import rotation, translation
from oracles.pictures import assert_same_expectation, render

LAMP = translation(0, 0, 1) @ rotation([1, 0, 0], 180) @ np.diag([0.8, 0.4, 1, 1])


def scene(sampling, radiance=1.0):
    return mi.load_dict(floor_and({"lamp": lamp(LAMP, sampling, radiance)}, 8))


def picture():
    return np.array(mi.render(scene("solid_angle"), spp=16, seed=5))


def test_switching_and_back():
    """Every variant twice, the second time after all the others: the same picture."""
    first = {}
    for variant in VARIANTS:
        mi.set_variant(variant)
        first[variant] = picture()
        assert np.isfinite(first[variant]).all()
        # Single lamps of grey: the same mean in all, up to noise of 1024 samples
        assert first[variant].mean() == pytest.approx(first["llvm_ad_rgb"].mean(), rel=0.1)
    for variant in reversed(VARIANTS):
        mi.set_variant(variant)
        np.testing.assert_allclose(picture(), first[variant], rtol=1e-5, atol=1e-7)


def test_scene_of_another_variant_still_renders():
    """It was loaded under one variant; another was set, and the first again."""
    mi.set_variant("llvm_ad_rgb")
    kept = scene("solid_angle")
    expected = np.array(mi.render(kept, spp=16, seed=5))
    mi.set_variant("llvm_ad_spectral")
    picture()
    mi.set_variant("llvm_ad_rgb")
    np.testing.assert_allclose(np.array(mi.render(kept, spp=16, seed=5)), expected, rtol=1e-5)


@pytest.mark.parametrize("variant", ["llvm_ad_spectral", "scalar_spectral"])
@pytest.mark.parametrize("kind", ["spectrum", "bitmap"])
def test_spectra_and_textures(variant, kind):
    """Radiance that is a spectrum, or a picture that is made one."""
    mi.set_variant(variant)
    image = np.random.default_rng(1).random((6, 4, 3)).astype(np.float32)

    def radiance():
        # A bitmap of its own for each: Mitsuba converts the one that it is given in place.
        bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(image.copy())}
        return {"type": "d65", "scale": 2.0} if kind == "spectrum" else bitmap

    spp = 16 if "scalar" in variant else 1024
    got, expected = (render(scene(s, radiance()), spp) for s in ("solid_angle", None))
    # A colour per pixel and a wavelength per sample: noisy
    within = 1 if "scalar" in variant else 0.1 if kind == "spectrum" else 0.15
    assert_same_expectation(got, expected, within)


@pytest.mark.parametrize("name", STRATEGIES)
def test_cuda(name):
    if not dr.has_backend(dr.JitBackend.CUDA):
        pytest.skip("no GPU: cuda_ad_rgb is not tested here")
    mi.set_variant("cuda_ad_rgb")
    got = render(scene(name), 256)
    expected = render(scene(None), 256)
    mi.set_variant("llvm_ad_rgb")
    on_the_cpu = render(scene(name), 256)
    assert_same_expectation(got, expected, within=0.1)
    assert_same_expectation(got, on_the_cpu, within=0.1)
