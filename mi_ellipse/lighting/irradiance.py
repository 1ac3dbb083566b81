"""Direct irradiance at points of a scene, with shadows, and how sure each number is."""

# Types such as `mi.Scene` exist only once a variant is set.
from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..files.images import LUMINANCE

# Independent estimates of a point. Their scatter gives the standard error, which is itself known
# to 1/√(2·15) = 18 %. The error over it has Student's distribution of 15 degrees of freedom.
REPLICATES = 16

# Few points are divided among more lanes of the kernel, but not into parts of fewer samples.
ENOUGH_LANES = 2**14
FEWEST_SAMPLES = 64

# Of the hash TEA. After 4, as is Mitsuba's default, neighbouring sequences correlate by 0.45, and
# the errors are up to four times the standard errors; after 5 no correlation is seen.
ROUNDS = 8

# By the number of random numbers of a sample: the root g of g^(d+1) = g + 1. Multiples of its
# inverse powers are spread evenly (M. Roberts, "The unreasonable effectiveness of quasirandom
# sequences", 2018).
ROOTS = {2: 1.32471795724474602596, 3: 1.22074408460575947536}


class DirectIrradiance(NamedTuple):
    """Irradiance at points, and how sure it is."""

    value: Any  # Irradiance, in each channel
    standard_error: Any  # Standard deviation that `value` has over all seeds, estimated


def direct_irradiance(
    scene: mi.Scene,
    points: Any,
    normals: Any,
    samples: int = 1024,
    seed: int = 0,
    luminance: bool = False,
) -> DirectIrradiance:
    """Irradiance at points of a scene from all its emitters, with shadows.

    Light that arrives straight from an emitter counts, whatever the emitter is and however it is
    sampled. Every surface on the way hides it, also a transparent one. Media and reflected light
    are left out.

    A point has 16 sequences of evenly spread samples, each shifted at random. So the estimate is
    unbiased, and the standard error, which comes from the scatter of the 16 means, holds for what
    the even spreading gains. It knows nothing of light that no sample met.

    Parameters
    ----------
    scene
        The scene. Its lamps may be grouped, see `group_lamps`.
    points
        World-space points: an array of shape (…, 3), or Mitsuba's type.
    normals
        World-space unit normals of the surface there, as many or a single one.
    samples
        Light samples of a point, rounded up to a multiple of 16 or, for few points, of more.
    seed
        Of the shifts, from 0 to 2³² - 1.
    luminance
        Return a number instead of a colour: the luminance of RGB (ITU-R BT.709), or what a
        monochrome variant has.

    Returns
    -------
    DirectIrradiance
        `value` and `standard_error`: arrays of shape (…, channels), or (…) with `luminance`; for
        points of Mitsuba's type colours or numbers of Mitsuba's type. Channels are RGB, in spectral
        variants as well, or one in monochrome variants. The unit is that of the radiance times
        steradian, such as W/m² or lx. Both have no gradients.

    Raises
    ------
    ValueError
        If `samples` or `seed` is impossible, or an array has another shape.

    Notes
    -----
    The even spreading is that of M. Roberts, *The Unreasonable Effectiveness of Quasirandom
    Sequences* (2018).
    """
    if samples < 1:
        raise ValueError(f"samples={samples}: a point needs at least 1")
    if not 0 <= seed < 2**32:
        raise ValueError(f"seed={seed}: a seed lies from 0 to {2**32 - 1}")
    own_types = dr.is_array_v(points)
    if own_types:
        points, normals = mi.Point3f(points), mi.Normal3f(normals)
        rows = [np.moveaxis(np.array(v, dtype=float), 0, -1) for v in (points, normals)]
    else:
        rows = [_rows("points", points), _rows("normals", normals)]
    p, n = np.broadcast_arrays(*rows)
    shape = p.shape[:-1]
    means = _means(scene, p.reshape(-1, 3), n.reshape(-1, 3), samples, seed)
    if luminance:
        means = means @ LUMINANCE if means.shape[-1] == 3 else means[..., 0]
    found = means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(REPLICATES)
    if own_types:
        return DirectIrradiance(*(_to_mitsuba(values, luminance) for values in found))
    return DirectIrradiance(*(values.reshape(*shape, *values.shape[1:]) for values in found))


def _rows(name: str, values: Any) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=float)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(
            f"{name}: an array of shape (…, 3) is needed, and its shape is {array.shape}"
        )
    return array


def _to_mitsuba(values: NDArray[np.float64], is_number: bool) -> Any:
    """Return numbers of shape (n), or colours of shape (n, channels), as Mitsuba's types."""
    columns = [values] if is_number else list(values.T)
    if dr.is_jit_v(mi.Float):
        entries = [mi.Float(np.ascontiguousarray(c, dtype=np.float32)) for c in columns]
    else:
        entries = [float(c[0]) for c in columns]
    if is_number:
        return entries[0]
    return mi.Color3f(*entries) if len(entries) == 3 else mi.Color1f(*entries)


# ---- Estimates ----


def _means(
    scene: mi.Scene,
    p: NDArray[np.float64],
    n: NDArray[np.float64],
    samples: int,
    seed: int,
) -> NDArray[np.float64]:
    """Return independent estimates, of shape (replicates, points, channels)."""
    if not len(p):
        return np.zeros((REPLICATES, 0, _channels()))
    count = -(-samples // REPLICATES)
    if not dr.is_jit_v(mi.Float):
        of_points = [
            [
                _mean_of_loop(scene, mi.Point3f(a), mi.Normal3f(b), k * REPLICATES + r, count, seed)
                for r in range(REPLICATES)
            ]
            for k, (a, b) in enumerate(zip(p, n, strict=True))
        ]
        return np.moveaxis(np.array(of_points), 0, 1)

    parts = max(1, min(count // FEWEST_SAMPLES, ENOUGH_LANES // (REPLICATES * len(p))))
    count = -(-count // parts)
    with dr.suspend_grad():
        sums = _sums(scene, p, n, parts, count, seed)
    array = np.array([np.array(c) for c in sums]).reshape(-1, len(p), REPLICATES, parts)
    return np.moveaxis(array.sum(axis=3) / (parts * count), (0, 2), (2, 0))


def _mean_of_loop(
    scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, sequence: int, count: int, seed: int
) -> NDArray[np.float64]:
    """Return one estimate of a scalar variant."""
    shifts = _shifts(sequence, seed)
    found = [_sample(scene, p, n, _spread(i, shifts)) for i in range(count)]
    return np.mean(np.array(found, dtype=float), axis=0)


def _sums(
    scene: mi.Scene,
    p: NDArray[np.float64],
    n: NDArray[np.float64],
    parts: int,
    count: int,
    seed: int,
) -> list[mi.Float64]:
    """Return the sums of `count` samples: all parts of a sequence, all sequences of a point."""
    lane = dr.arange(mi.UInt32, len(p) * REPLICATES * parts)
    sequence = lane // parts
    point = sequence // REPLICATES
    at, normal = (
        dr.gather(kind, kind(np.ascontiguousarray(v.T, dtype=np.float32)), point)
        for kind, v in ((mi.Point3f, p), (mi.Normal3f, n))
    )
    shifts = _shifts(sequence, dr.opaque(mi.UInt32, seed))
    first = (lane % parts) * dr.opaque(mi.UInt32, count)
    end = first + dr.opaque(mi.UInt32, count)

    def add(i: mi.UInt32, totals: list[mi.Float64]) -> tuple[mi.UInt32, list[mi.Float64]]:
        found = _sample(scene, at, normal, _spread(i, shifts))
        return i + 1, [total + mi.Float64(c) for total, c in zip(totals, found, strict=True)]

    zero = dr.zeros(mi.Float64, dr.width(lane))
    _, totals = dr.while_loop(
        (first, [mi.Float64(zero) for _ in range(_channels())]), lambda i, _: i < end, add
    )
    dr.eval(totals)
    return list(totals)


def _sample(scene: mi.Scene, p: mi.Point3f, n: mi.Normal3f, u: list[Any]) -> list[Any]:
    """Return the irradiance of a light sample over its density, in each channel."""
    it = dr.zeros(mi.Interaction3f)
    it.p, it.n = p, n
    if mi.is_spectral:
        it.wavelengths, weight = mi.sample_rgb_spectrum(mi.sample_shifted(u[2]))
    ds, light = scene.sample_emitter_direction(it, mi.Point2f(u[0], u[1]), True)
    light = mi.unpolarized_spectrum(light)
    if mi.is_spectral:
        light = mi.spectrum_to_srgb(light * weight, it.wavelengths)
    cosine = dr.select(ds.pdf > 0, dr.maximum(dr.dot(n, ds.d), 0), 0)
    return [channel * cosine for channel in light]


def _channels() -> int:
    return 1 if mi.is_monochromatic else 3


# ---- Evenly spread numbers, in units of 2^-32 ----


def _shifts(sequence: Any, seed: Any) -> list[Any]:
    """Return the shifts of sequences, independent of one another."""
    x, y = mi.sample_tea_32(sequence, seed, ROUNDS)
    z, _ = mi.sample_tea_32(sequence, y, ROUNDS)
    return [x, y, z][: _dimension()]


def _spread(i: Any, shifts: list[Any]) -> list[Any]:
    """Return the numbers of sample i of a sequence, in [0, 1)."""
    root = ROOTS[_dimension()]
    steps = [round(2**32 / root**power) for power in range(1, _dimension() + 1)]
    words = [shift + i * step for shift, step in zip(shifts, steps, strict=True)]
    # A float holds 24 bits; products of 32 bits wrap by themselves, but not those of Python.
    return [mi.Float((word & 0xFFFFFFFF) >> 8) * 2**-24 for word in words]


def _dimension() -> int:
    return 3 if mi.is_spectral else 2
