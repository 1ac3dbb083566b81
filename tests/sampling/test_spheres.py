"""What `projected_solid_angle` promises for spheres: exact above the horizon, bounded at it."""

import mitsuba as mi
import numpy as np
import pytest
from conftest import spheres
from mi_ellipse.sampling import STRATEGIES
from mi_ellipse.sampling.projected_solid_angle import LEAST_DENSITY

from oracles import ellipse as oracle

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

COUNT, DRAWS = 200, 512


class Views:
    """Spheres of radius 1 above the horizon: the lowest direction has the elevation `clearance`.

    A view looks from the origin, at a random distance, along a random normal; half of them from
    behind.
    """

    def __init__(self, clearance, seed=1, name="projected_solid_angle"):
        rng = np.random.default_rng(seed)
        self.half_angle = np.arcsin(1 / (1 + 10 ** rng.uniform(-2, 2, COUNT)))
        elevation = np.minimum(self.half_angle + clearance, np.pi / 2)
        turn = np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0]
        n, across = turn[:, :, 0], turn[:, :, 1]
        z = np.sin(elevation)[:, None] * n + np.cos(elevation)[:, None] * across
        self.centre = np.float32(z / np.sin(self.half_angle)[:, None]).astype(float)
        self.normal = np.float32(n * np.where(np.arange(COUNT) % 2, 1, -1)[:, None]).astype(float)
        self.rng, self.strategy = rng, STRATEGIES[name].make()

    def record(self, repeat):
        centre, normal = (np.repeat(v, repeat, 0) for v in (self.centre, self.normal))
        axes = np.broadcast_to(np.eye(3), (len(centre), 3, 3))
        view = spheres(axes, centre).seen_from(mi.Point3f(0, 0, 0))
        return self.strategy.prepare(view, mi.Normal3f(normal.T))

    def weights(self):
        """Cosine over density of random draws, a row a view."""
        u = mi.Point2f(self.rng.random((2, COUNT * DRAWS), dtype=np.float32))
        d, pdf, valid = self.strategy.sample(self.record(DRAWS), u)
        assert np.all(valid.numpy())
        cosine = np.abs(np.sum(d.numpy().T * np.repeat(self.normal, DRAWS, 0), 1))
        return (cosine / pdf.numpy()).reshape(COUNT, DRAWS)

    def irradiance(self):
        """π sin² α |n·z|, from whatever side."""
        distance2 = np.sum(self.centre**2, 1)
        return np.pi * np.abs(np.sum(self.centre * self.normal, 1)) / distance2**1.5


@pytest.mark.parametrize("name", ["projected_solid_angle", "projected_solid_angle_one_sided"])
def test_every_estimate_is_the_irradiance_above_the_horizon(name):
    """The density is the cosine over the irradiance, so there is no variance."""
    views = Views(clearance=0.3, name=name)  # The least cosine is far above `LEAST_DENSITY`
    expected = views.irradiance()[:, None]
    np.testing.assert_allclose(views.weights() / expected, 1, rtol=1e-5)


def test_variance_at_the_horizon_is_bounded():
    """Relative, of all spheres that the horizon touches: at most what `derivations.cap` finds."""
    views = Views(clearance=1e-4)
    relative = views.weights() / views.irradiance()[:, None]
    # Six standard errors of the mean; 512 draws know a variance of 0.0064 to 20 %
    assert np.abs(relative.mean(1) - 1).max() < 6 * np.sqrt(0.0064 / DRAWS)
    assert relative.var(1).max() < 0.0064 * 1.5
    assert relative.var(1).max() > 1e-3


@pytest.mark.parametrize("clearance", [1e-4, 0.01, 0.1])
def test_density_is_bounded_from_below(clearance):
    """At the lowest direction too, where the cosine is next to nothing."""
    views = Views(clearance)
    record, least = views.record(64), []
    for height in (0.999, 0.5):
        d = np.concatenate(
            [
                _around(centre, angle, height)
                for centre, angle in zip(views.centre, views.half_angle, strict=True)
            ]
        )
        pdf = views.strategy.pdf(record, mi.Vector3f(d.T)).numpy().reshape(COUNT, 64)
        tangent = np.tan(views.half_angle)
        least.append((pdf * oracle.solid_angle(tangent, tangent)[:, None]).min())
    # Single precision knows Ω and the cosines to 1e-6, and those of the farthest spheres to 1e-4.
    assert least[0] > LEAST_DENSITY * (1 - 1e-3)
    assert least[1] > least[0]


def _around(centre, half_angle, part):
    """64 directions around the axis of a cap, at this part of its half-angle."""
    z = centre / np.linalg.norm(centre)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    turn = 2 * np.pi * np.arange(64)[:, None] / 64
    across = np.cos(turn) * x + np.sin(turn) * np.cross(z, x)
    return np.cos(part * half_angle) * z + np.sin(part * half_angle) * across
