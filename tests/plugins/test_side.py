"""The side of a lamp is decided once: whatever is drawn has a density, from its own plane too."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import lamp
from mi_ellipse.sampling import STRATEGIES

from oracles.ellipse import rotation, translation

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

# A turned lamp far from the origin: coordinates in its plane are rounded to either side of it.
LAMP = translation(300, -200, 100) @ rotation([1, 2, -0.7], 71) @ np.diag([1.5, 0.4, 1, 1])


def points_in_the_plane(count: int) -> np.ndarray:
    """Points beside the lamp in its plane, as single precision leaves them."""
    rng = np.random.default_rng(5)
    turn, radius = rng.uniform(0, 2 * np.pi, count), rng.uniform(1.5, 6, count)
    local = np.stack([radius * np.cos(turn), 4 * radius * np.sin(turn)])
    return np.float32(LAMP[:3, :2] @ local + LAMP[:3, 3:])


@pytest.mark.parametrize("name", STRATEGIES)
def test_a_direction_that_is_drawn_has_a_density(name):
    scene = mi.load_dict({"type": "scene", "lamp": lamp(LAMP, name)})
    emitter = scene.emitters()[0]
    points = points_in_the_plane(20_000)
    it = dr.zeros(mi.Interaction3f, points.shape[1])
    it.p, it.n = mi.Point3f(points), mi.Normal3f(0, 0, 1)
    u = mi.Point2f(np.random.default_rng(6).random((2, points.shape[1]), dtype=np.float32))
    ds, _ = emitter.sample_direction(it, u)
    drawn = ds.pdf.numpy() > 0
    density = emitter.pdf_direction(it, ds).numpy()
    # About half of the points are on the emitting side.
    assert drawn.mean() > (0.1 if name == "rejection" else 0.4)
    assert (density[drawn] > 0).all()
    # And there is a case in which the single-precision cosine has the other sign.
    assert (dr.dot(ds.d, ds.n).numpy()[drawn] >= 0).any()
