"""Scene files, as they are parsed and loaded."""

import mitsuba as mi
import numpy as np
import pytest
from mi_ellipse.rendering.scene import load_scene
from mi_ellipse.sampling import STRATEGIES

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.mark.parametrize("name", sorted(STRATEGIES))
def test_sampling_is_the_parameter_of_the_scene(scene_file, name):
    chosen = mi.render(load_scene(scene_file, sampling=name), spp=4).numpy()
    written = mi.render(load_scene(scene_file, {"sampling": name}), spp=4).numpy()
    np.testing.assert_allclose(chosen, written, rtol=1e-5)
