"""Random lights, and what a strategy's variance over them is with a constant replaced."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import mi_ellipse  # noqa: F401
import mitsuba as mi
import numpy as np
from mi_ellipse.geometry.cone import Cone
from mi_ellipse.sampling import projected_solid_angle as psa

SIDE = 32  # Random numbers of a light: the middles of SIDE × SIDE squares

# Least and largest distance in longer semi-axes, least aspect ratio, largest elevation of the point
# over the light's plane as a sine
CLASSES = {
    "far": (5, 50, 0.1, 1),
    "near": (0.8, 5, 0.1, 1),
    "very near": (0.05, 0.8, 0.1, 1),
    "needle": (0.3, 5, 0.001, 1),
    "in the plane": (1.1, 5, 0.1, 0.02),
    "fills the view": (0.001, 0.05, 0.1, 1),
}


class Lights(NamedTuple):
    """Cones of lights and a surface normal for each, in the frame of the cone."""

    kind: np.ndarray  # Index of the class
    ta: np.ndarray
    tb: np.ndarray
    normal: np.ndarray  # (lights, 3)

    def __getitem__(self, chosen) -> Lights:
        return Lights(*(field[chosen] for field in self))

    @property
    def divided(self) -> np.ndarray:
        """Whether the horizon divides the cone."""
        x, y, z = self.normal.T
        return np.hypot(self.ta * x, self.tb * y) > np.abs(z)

    def cone(self) -> Cone:
        """The cones for the package, in a frame that is the world's."""
        axes = (mi.Vector3f(*row) for row in np.eye(3).tolist())
        return Cone(*axes, *(mi.Float(v) for v in (self.ta**2, self.tb**2, self.ta**-2)))

    def normals(self) -> mi.Vector3f:
        """The normals for the package."""
        return mi.Vector3f(np.ascontiguousarray(self.normal.T))


def random_lights(count: int, seed: int = 8) -> Lights:
    """Lights of every class, seen from above their rim's box, under normals in all directions."""
    rng = np.random.default_rng(seed)
    lights = []
    for kind, (near, far, aspect, elevation) in enumerate(CLASSES.values()):
        distance = np.exp(rng.uniform(np.log(near), np.log(far), count))
        ratio = np.exp(rng.uniform(np.log(aspect), 0, count))
        azimuth = rng.uniform(0, 2 * np.pi, count)
        z = distance * rng.uniform(1e-3, elevation, count)
        r = np.sqrt(distance**2 - z**2)
        # The dual cone matrix U Uᵀ + W Wᵀ - C Cᵀ in the frame of the light
        centre = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=1)
        dual = -centre[:, :, None] * centre[:, None, :]
        dual[:, 0, 0] += 1
        dual[:, 1, 1] += ratio**2
        values = np.linalg.eigvalsh(dual)
        tangents = np.sqrt(np.maximum(values[:, [2, 1]], 1e-30) / -values[:, :1])
        normal = rng.normal(size=(count, 3))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        lights.append(Lights(np.full(count, kind), *tangents.T, normal))
    return Lights(*map(np.concatenate, zip(*lights, strict=True)))


@contextmanager
def replaced(**constants) -> Iterator[None]:
    """Run with other values of constants of `projected_solid_angle`."""
    before = {name: getattr(psa, name) for name in constants}
    try:
        for name, value in constants.items():
            setattr(psa, name, value)
        psa._nodes.cache_clear()
        yield
    finally:
        for name, value in before.items():
            setattr(psa, name, value)
        psa._nodes.cache_clear()


class Draws(NamedTuple):
    """Directions drawn for each light, in the frame of its cone."""

    d: np.ndarray  # (3, lights, draws)
    pdf: np.ndarray  # (lights, draws)


def draw(lights: Lights, sliced: bool = True, side: int = SIDE) -> Draws:
    """Draw with the package's own code, by slices or uniformly in solid angle."""
    u = (np.arange(side) + 0.5) / side
    grid = np.stack(np.meshgrid(u, u), axis=-1).reshape(-1, 2)
    count, draws = len(lights.ta), len(grid)
    numbers = mi.Point2f(np.ascontiguousarray(np.tile(grid, (count, 1)).T))
    repeated = lights[np.repeat(np.arange(count), draws)]
    record = psa.Record(repeated.cone(), repeated.normals())
    strategy = psa.ProjectedSolidAngle()
    d, pdf = (strategy._sample_slices if sliced else strategy._sample_whole)(record, numbers)
    return Draws(np.array(d).reshape(3, count, draws), np.array(pdf).reshape(count, draws))


def relative_variances(
    lights: Lights, draws: Draws, normal: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Relative variance of the irradiance on either side of a surface, and the irradiances.

    Each side counts alone: the variance of the draws that fall on it, as if all did. So the share
    of the draws for a side does not matter. The result has shape (2, lights), NaN for a side
    without light. `normal` is that of the shading, if it is another one than the surface's.
    """
    surface = np.einsum("kj,jkn->kn", lights.normal, draws.d.astype(float))
    shading = surface if normal is None else np.einsum("kj,jkn->kn", normal, draws.d.astype(float))
    variances, irradiances = [], []
    for sign in (1, -1):
        on_side = sign * surface > 0
        share = on_side.mean(axis=1)
        estimate = np.where(on_side, np.maximum(sign * shading, 0) / draws.pdf, 0)
        mean = estimate.mean(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            relative = share * (estimate**2).mean(axis=1) / mean**2 - 1
        variances.append(np.where(share > 4 / SIDE, relative, np.nan))
        irradiances.append(mean)
    return np.array(variances), np.array(irradiances)
