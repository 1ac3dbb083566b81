"""Render a scene in as few passes as possible, and tell where the time went."""

# Types such as `mi.Scene` exist only once a variant is set.
from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..system.threads import use_threads

# Mitsuba numbers the samples of a pass with 32 bits. Memory sets no tighter limit: `path`, `prb`
# and `volpath` run as one kernel that keeps nothing per sample (under LLVM, peak memory grew by
# less than 2 MiB from 4 to 34 million samples). The film, 12 bytes a pixel, cannot be split.
MAX_SAMPLES_PER_PASS = 2**32 - 1

# Samples of a kernel that Dr.Jit gives to one thread, where there are enough
# (`LLVMThreadState::launch` in drjit-core)
BLOCK = 2**14


# Called after each pass with the number of passes done and their total
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Timing:
    """Seconds of one render, `total` = `tracing` + `compilation` + `execution`."""

    total: float
    tracing: float  # Python, and Dr.Jit writing the kernel
    compilation: float  # by LLVM or CUDA; zero where the kernel was known
    execution: float  # of the kernels


@dataclass(frozen=True)
class Rendering:
    """A rendered picture and how it came about."""

    image: NDArray[np.float32]  # (height, width, channels), linear
    channels: tuple[str, ...]  # one name a channel: "R", "G", "B", …
    spp: int  # samples per pixel that were really taken
    passes: int
    timing: Timing
    warm_up: Timing | None = None  # of the render beforehand, where a job asked for one
    scene_digest: str = ""  # of the scene that was loaded for a job
    machine: str = ""  # that rendered a job, or several of them with commas between

    @property
    def seconds(self) -> float:
        """Time of the render, without that of loading the scene and of a warm-up."""
        return self.timing.total

    @property
    def invalid_pixels(self) -> int:
        """Number of pixels with a NaN or an infinity in any channel."""
        return int(np.count_nonzero(~np.isfinite(self.image).all(axis=2)))


class Average:
    """Mean of passes, weighted by their samples; its digits depend on their order alone."""

    def __init__(self) -> None:
        self._total: Any = 0.0
        self._spp = 0

    def add(self, image: Any, spp: int) -> None:
        """Add a picture, of whatever type NumPy can read, that was made with so many samples."""
        self._total = self._total + spp * np.array(image, dtype=np.float64)
        self._spp += spp

    def image(self) -> NDArray[np.float32]:
        """Return the mean of what was added."""
        return np.asarray(self._total / self._spp, dtype=np.float32)


def plan_passes(
    scene: mi.Scene,
    spp: int | None = None,
    max_samples: int = MAX_SAMPLES_PER_PASS,
    pass_spp: int | None = None,
) -> tuple[int, ...]:
    """
    Split a number of samples per pixel into passes.

    Parameters
    ----------
    scene
        Its first sensor decides: film size, and the counts that the sampler can do.
    spp
        Wanted samples per pixel; None takes the scene's own number.
    max_samples
        Largest number of samples (pixels × samples per pixel) in one pass; scalar variants have no
        limit.
    pass_spp
        Wanted samples per pixel of a pass; None makes as few passes as possible.

    Returns
    -------
    tuple of int
        Samples per pixel of each pass, all equal but the last. Their sum exceeds `spp` where the
        sampler rounds up, as ``stratified`` does to squares.
    """
    sensor = _sensor(scene)
    sampler = sensor.sampler()
    spp = sampler.sample_count() if spp is None else spp
    limit = max_samples // _count_pixels(sensor.film()) if _is_vectorized() else spp**2
    if limit == 0:
        raise ValueError(f"one sample for every pixel is more than {max_samples} samples")

    # The largest pass within the limit; then passes of similar size, the last with what is left.
    counts = range(1, min(spp, limit) + 1)
    largest = bisect_right(counts, limit, key=lambda count: _feasible_count(sampler, count)) or 1
    passes = math.ceil(spp / _feasible_count(sampler, largest))
    wanted = math.ceil(spp / passes) if pass_spp is None else min(pass_spp, largest, spp)
    size = _feasible_count(sampler, wanted)
    passes = math.ceil(spp / size)
    return (size,) * (passes - 1) + (_feasible_count(sampler, spp - size * (passes - 1)),)


def repeatable_size(spp: int) -> int:
    """Return the largest size of a pass, not above `spp`, that several threads can repeat."""
    return min(BLOCK, 1 << (spp.bit_length() - 1))


def repeatable_threads(scene: mi.Scene, spp: int) -> int:
    """
    Return the threads with which a pass is the same each time, bit for bit, as far as there are.

    Several threads add up the samples of a pixel in changing order, unless one of them has them
    all. Dr.Jit gives each thread blocks of :data:`BLOCK` samples, or smaller ones where those would
    be less than two a thread. With another filter than the box filter, pixels share samples; this
    function then returns all threads.
    """
    threads, film = dr.thread_count(), _sensor(scene).film()
    whole = BLOCK % spp == 0 and spp * _count_pixels(film) > 2 * threads * BLOCK
    return threads if whole or film.rfilter().class_name() != "BoxFilter" else 1


def loses_stratification(scene: mi.Scene, passes: int) -> bool:
    """Tell whether rendering in `passes` passes is noisier than in one, for the scene's sampler."""
    return passes > 1 and _sensor(scene).sampler().class_name() != "IndependentSampler"


def render(
    scene: mi.Scene,
    spp: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    max_samples: int = MAX_SAMPLES_PER_PASS,
    pass_spp: int | None = None,
) -> Rendering:
    """
    Render the first sensor of a scene and average the passes.

    A render in one pass is the picture of ``mi.render`` with the same `spp` and `seed`. Several
    passes are recorded with ``dr.freeze`` and replayed, so that Python emitters are not traced anew
    for each; a smaller last pass needs a recording of its own. Spectral variants are not recorded.

    Parameters
    ----------
    scene
        Loaded scene with a sensor and an integrator.
    spp, max_samples, pass_spp
        See :func:`plan_passes`. With `pass_spp`, passes have as many threads as give the same
        bits each time, see :func:`repeatable_threads`.
    seed
        From 0 to 2³² - 1. Further passes derive theirs from it.
    progress
        Called after each pass with the number of passes done and their total.
    """
    sizes = plan_passes(scene, spp, max_samples, pass_spp)
    # The history of the kernels tells their times. It costs none: interleaved renders of 16 ms took
    # 1.004 times as long with it.
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        start = time.perf_counter()
        image = _average(scene, sizes, seed, progress, pass_spp is not None)
        seconds = time.perf_counter() - start
        timing = _split_time(seconds, dr.kernel_history())
    return Rendering(image, _channel_names(scene, image.shape[2]), sum(sizes), len(sizes), timing)


def _average(
    scene: mi.Scene, sizes: Sequence[int], seed: int, progress: Progress | None, repeatable: bool
) -> NDArray[np.float32]:
    """Render a pass of each size, and average them weighted by their samples."""
    # `dr.freeze` cannot record Mitsuba's spectral variants: they use tables that no argument holds.
    recorded = len(sizes) > 1 and not mi.is_spectral
    render_pass = dr.freeze(_render_pass) if recorded else _render_pass

    average = Average()
    seeds = pass_seeds(seed, len(sizes))
    for done, (size, pass_seed) in enumerate(zip(sizes, seeds, strict=True), start=1):
        threads = repeatable_threads(scene, size) if repeatable else dr.thread_count()
        with use_threads(threads):
            image = render_pass(scene, dr.opaque(mi.UInt32, pass_seed), size)
            average.add(image, size)
        if progress is not None:
            progress(done, len(sizes))
    return average.image()


def _split_time(seconds: float, history: Sequence[Mapping[str, Any]]) -> Timing:
    """Split the time of a render by the kernels that it launched."""
    if not history:  # scalar variants have no kernels
        return Timing(seconds, 0.0, 0.0, seconds)
    execution = sum(kernel["execution_time"] for kernel in history) / 1000
    compilation = sum(kernel.get("backend_time", 0.0) for kernel in history) / 1000
    return Timing(seconds, seconds - execution - compilation, compilation, execution)


def _sensor(scene: mi.Scene) -> mi.Sensor:
    if not scene.sensors():
        raise ValueError("the scene has no sensor")
    sensor: mi.Sensor = scene.sensors()[0]
    return sensor


def _render_pass(scene: mi.Scene, seed: mi.UInt32, spp: int) -> mi.TensorXf:
    image: mi.TensorXf = mi.render(scene, seed=seed, spp=spp)
    return image


def pass_seeds(seed: int, count: int) -> list[int]:
    """Return the seed itself and `count` - 1 that no other `seed` is likely to have as well."""
    return [seed, *np.random.SeedSequence(seed).generate_state(count - 1).tolist()]


def _feasible_count(sampler: mi.Sampler, spp: int) -> int:
    """Return the count that the sampler makes of `spp`, without its warning: callers report it."""
    level = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        sampler.set_sample_count(spp)
    finally:
        mi.set_log_level(level)
    return sampler.sample_count()


def _count_pixels(film: mi.Film) -> int:
    border = 2 * film.rfilter().border_size() if film.sample_border() else 0
    width, height = film.crop_size()
    return (int(width) + border) * (int(height) + border)


def _is_vectorized() -> bool:
    return not (mi.variant() or "").startswith("scalar")


def _channel_names(scene: mi.Scene, count: int) -> tuple[str, ...]:
    """Return the names of the `count` channels that ``mi.render`` delivers."""
    film = _sensor(scene).film()
    film.prepare(scene.integrator().aov_names())
    bitmap: Any = film.bitmap()  # `struct_` is missing in Mitsuba's stubs.
    names = tuple(str(field.name) for field in bitmap.struct_())
    if len(names) == count:
        return names

    # `aov` delivers the colour of an integrator inside it, but not the copy of that among its own
    # channels, which ends in an alpha; without an integrator inside it delivers no colour.
    colour = tuple(name for name in names if "." not in name)
    if not any(name.endswith(".A") for name in names):
        return names[-count:]
    return colour + names[len(colour) - count :]
