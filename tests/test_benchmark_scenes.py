"""The scenes of the benchmarks are those of the study, and loading them leaves nothing behind."""

import mitsuba as mi
import numpy as np
import pytest

from benchmarks.scenes import BUILT_IN, MESH, RECTANGLE, SCENES, scene_file

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.mark.parametrize("kind", [BUILT_IN, MESH, RECTANGLE])
def test_other_lamps_give_about_the_same_light(kind):
    """The mean of a picture; a rectangle of the same area and a prism differ by a few per cent."""
    pictures = [
        np.array(mi.render(scene_file("lamp", each, resx=32, resy=24), spp=256, seed=1))
        for each in (kind, "solid_angle")
    ]
    assert pictures[0].mean() == pytest.approx(pictures[1].mean(), rel=0.1)


@pytest.mark.parametrize("kind", [BUILT_IN, "solid_angle"])
def test_file_resolver_is_as_before(kind):
    before = list(map(str, mi.file_resolver()))
    scene_file("lamp", kind, resx=16, resy=12)
    assert list(map(str, mi.file_resolver())) == before
    assert str(SCENES) not in before
