"""Random lights by class, each with a surface normal, their solid angle and irradiance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .ellipse import cone, irradiance_by_chords, solid_angle, whole_irradiance

SEED = 2017


# ---- Classes ----
# The longer semi-axis is 1. A class gives the shorter one, and the light's centre in the light's
# own frame relative to the reference point. `make_lights` turns all that and adds the normal.

# Of a generator and a count: the shorter semi-axes, shape (n), and the centres, shape (3, n)
Draw = Callable[[np.random.Generator, int], tuple[np.ndarray, np.ndarray]]


def _log_uniform(rng: np.random.Generator, low: float, high: float, n: int) -> np.ndarray:
    return np.exp(rng.uniform(np.log(low), np.log(high), n))


def _in_direction(rng: np.random.Generator, distance: np.ndarray) -> np.ndarray:
    """Centres at these distances, directions uniform on the hemisphere before the light."""
    z, azimuth = rng.uniform(0, 1, distance.size), rng.uniform(0, 2 * np.pi, distance.size)
    r = np.sqrt(1 - z * z)
    return distance * np.array([r * np.cos(azimuth), r * np.sin(azimuth), z])


def _above_light(rng: np.random.Generator, ratio: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Centres seen from points at these heights, uniform over the light's surface."""
    r, azimuth = np.sqrt(rng.uniform(0, 1, height.size)), rng.uniform(0, 2 * np.pi, height.size)
    return np.array([r * np.cos(azimuth), ratio * r * np.sin(azimuth), height])


def far(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """10 to 1000 semi-axes away."""
    return _log_uniform(rng, 0.1, 1, n), _in_direction(rng, _log_uniform(rng, 10, 1e3, n))


def near(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """0.5 to 5 semi-axes away."""
    return _log_uniform(rng, 0.1, 1, n), _in_direction(rng, _log_uniform(rng, 0.5, 5, n))


def very_near(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """0.01 to 0.3 shorter semi-axes above the surface."""
    ratio = _log_uniform(rng, 0.1, 1, n)
    return ratio, _above_light(rng, ratio, ratio * _log_uniform(rng, 1e-2, 0.3, n))


def needle(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """100 to 10 000 times as long as wide, 0.5 to 10 semi-axes away."""
    return _log_uniform(rng, 1e-4, 1e-2, n), _in_direction(rng, _log_uniform(rng, 0.5, 10, n))


def near_needle(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """The same, 0.05 to 0.5 semi-axes away."""
    return _log_uniform(rng, 1e-4, 1e-2, n), _in_direction(rng, _log_uniform(rng, 0.05, 0.5, n))


def in_plane(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Edge-on: 1.1 to 10 semi-axes from the centre, 1e-6 to 1e-2 above the light's plane."""
    azimuth, distance = rng.uniform(0, 2 * np.pi, n), _log_uniform(rng, 1.1, 10, n)
    height = _log_uniform(rng, 1e-6, 1e-2, n)
    centre = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    return _log_uniform(rng, 0.1, 1, n), centre


def fills_hemisphere(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """1e-4 to 0.01 shorter semi-axes above the surface."""
    ratio = _log_uniform(rng, 0.1, 1, n)
    return ratio, _above_light(rng, ratio, ratio * _log_uniform(rng, 1e-4, 1e-2, n))


CLASSES: dict[str, Draw] = {
    "far": far,
    "near": near,
    "very near": very_near,
    "needle": needle,
    "in plane": in_plane,
    "fills hemisphere": fills_hemisphere,
    "near needle": near_needle,
}
STRADDLING = "straddling"  # Normals whose horizon divides the light; otherwise it is wholly above
STRADDLING_CLASSES = ("far", "near", "needle", "in plane")  # The row that pools these
THINNEST_PART = 1e-2  # of the solid angle, on either side of that horizon


@dataclass(frozen=True)
class Lights:
    """Lights seen from the origin, each with a surface normal, and the truth about them."""

    to_world: np.ndarray  # 4×4×n
    normal: np.ndarray  # 3×n, the surface's
    solid_angle: np.ndarray
    irradiance: np.ndarray  # 2×n: above and below the horizon of the normal


# ---- Normals, in the frame of a cone ----


def _normal_above(rng: np.random.Generator, tangents: np.ndarray) -> np.ndarray:
    """Cosine-distributed about the cone's axis over all normals with the light wholly above.

    Those normals form the dual cone, whose orthographic semi-axes are the half-angles' cosines.
    """
    r, azimuth = np.sqrt(rng.uniform(0, 0.999)), rng.uniform(0, 2 * np.pi)
    xy = r * np.array([np.cos(azimuth), np.sin(azimuth)]) / np.sqrt(1 + tangents**2)
    return np.array([*xy, np.sqrt(1 - xy @ xy)])


def _normal_straddling(rng: np.random.Generator, tangents: np.ndarray) -> np.ndarray:
    """Perpendicular to a direction that is uniform on the tangent ellipse."""
    while True:
        r, azimuth = np.sqrt(rng.uniform(0, 1)), rng.uniform(0, 2 * np.pi)
        d = np.array([*(tangents * r * [np.cos(azimuth), np.sin(azimuth)]), 1])
        normal = np.cross(d, rng.normal(size=3))
        normal /= np.linalg.norm(normal)
        # The part above, by directions even on the sphere of the orthographic ellipse
        i = np.arange(4096) + 0.5
        r, azimuth = np.sqrt(i / 4096), i * np.pi * (3 - np.sqrt(5))
        xy = (tangents / np.sqrt(1 + tangents**2))[:, None] * r * [np.cos(azimuth), np.sin(azimuth)]
        z = np.sqrt(1 - (xy**2).sum(0))
        above = np.average(normal @ [*xy, z] > 0, weights=1 / z)
        if THINNEST_PART < above < 1 - THINNEST_PART:
            return normal


# ---- Lights ----


def make_lights(name: str, n: int, straddling: bool) -> Lights:
    """Random lights of a class; each class and kind of normal has its own published seed.

    Parameters
    ----------
    name
        One of `CLASSES`.
    n
        How many.
    straddling
        The horizon of each normal divides its light. Otherwise the light is wholly above.
    """
    rng = np.random.default_rng([SEED, list(CLASSES).index(name), straddling])
    ratios, centres = CLASSES[name](rng, n)
    to_world, normals, irradiances = np.zeros((4, 4, n)), np.zeros((3, n)), np.zeros((2, n))
    solid_angles = np.zeros(n)
    for i in range(n):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        c, u, w = turn @ centres[:, i], turn[:, 0], ratios[i] * turn[:, 1]
        frame, ta, tb = cone(u, w, c)
        local = (_normal_straddling if straddling else _normal_above)(rng, np.array([ta, tb]))
        # The package sees this normal and point in single precision.
        normal = (local @ frame).astype(np.float32).astype(float)

        local = frame @ normal
        if straddling:
            irradiances[:, i] = [irradiance_by_chords(ta, tb, side * local) for side in (1, -1)]
        else:
            irradiances[0, i] = whole_irradiance(ta, tb) * local[2]
        solid_angles[i] = solid_angle(ta, tb)
        normals[:, i] = normal
        to_world[:3, :, i] = np.stack([u, w, turn[:, 2], c], axis=1)
        to_world[3, 3, i] = 1
    return Lights(to_world, normals, solid_angles, irradiances)
