"""The scenes of the benchmarks are those of the study, and loading them leaves nothing behind."""

import mitsuba as mi
import numpy as np
import pytest

from benchmarks.scenes import BUILT_IN, MESH, RECTANGLE, SCENES, SOLIDS, scene_file

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.mark.parametrize("kind", [BUILT_IN, MESH, RECTANGLE])
def test_other_lamps_give_about_the_same_light(kind):
    """The mean of a picture; a rectangle of the same area and a prism differ by a few per cent."""
    pictures = [
        np.array(mi.render(scene_file("lamp", each, resx=32, resy=24), spp=256, seed=1))
        for each in (kind, "solid_angle")
    ]
    assert pictures[0].mean() == pytest.approx(pictures[1].mean(), rel=0.1)


def test_other_spheres_and_ellipsoids_give_the_same_light():
    """Samples of the BSDF alone, which meet the same shapes."""
    integrator = mi.load_dict({"type": "direct", "emitter_samples": 0, "bsdf_samples": 1})
    pictures = []
    for kind in (SOLIDS, "solid_angle"):
        scene = scene_file("bulbs", kind, resx=32, resy=24)
        pictures.append(np.array(mi.render(scene, integrator=integrator, spp=256, seed=1)))
    # A mesh's interpolated normals face away in a few samples near its silhouette.
    assert pictures[0].mean() == pytest.approx(pictures[1].mean(), rel=2e-3)


@pytest.mark.parametrize("kind", [BUILT_IN, "solid_angle"])
def test_file_resolver_is_as_before(kind):
    before = list(map(str, mi.file_resolver()))
    scene_file("lamp", kind, resx=16, resy=12)
    assert list(map(str, mi.file_resolver())) == before
    assert str(SCENES) not in before
