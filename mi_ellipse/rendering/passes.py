"""Render a scene in passes, which can be stopped and continued, and tell where the time went."""

# Types such as `mi.Scene` exist only once a variant is set.
from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
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

# Twelve days where a pass takes a second; more would fill the memory with plans.
MAX_PASSES = 2**20

# Samples of a pass of about a second: 0.3 to 3 million samples a second and core were measured
# under LLVM. The number does not follow the time that passes take, since a seed shall give the same
# picture on every machine.
SHORT_PASS = {"llvm": 2**22, "cuda": 2**26, "scalar": 2**18}

# Called after each pass with the number of passes done and their total
Progress = Callable[[int, int], None]

# Asked after each pass whether the render shall end there
Stop = Callable[[], bool]


@dataclass(frozen=True)
class Timing:
    """Seconds of one render, `total` = `tracing` + `compilation` + `execution`."""

    total: float
    tracing: float  # Python, and Dr.Jit writing the kernel
    compilation: float  # by LLVM or CUDA; zero where the kernel was known
    execution: float  # of the kernels

    def __add__(self, other: Timing) -> Timing:
        return Timing(
            self.total + other.total,
            self.tracing + other.tracing,
            self.compilation + other.compilation,
            self.execution + other.execution,
        )


NO_TIME = Timing(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Finished:
    """The passes of a render that are finished."""

    total: NDArray[np.float64]  # (height, width, channels), each pass times its samples per pixel
    spp: int = 0
    passes: int = 0
    seconds: float = 0.0  # that they took


NOTHING = Finished(np.zeros(()))


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
    unfinished: Finished | None = None  # where the render was stopped before its end
    seconds_before: float = 0.0  # of the passes that an earlier render had finished
    machine: str = ""  # that rendered a job, or several of them with commas between

    @property
    def seconds(self) -> float:
        """Time of all passes, without that of loading the scene and of a warm-up."""
        return self.seconds_before + self.timing.total

    @property
    def invalid_pixels(self) -> int:
        """Number of pixels with a NaN or an infinity in any channel."""
        return int(np.count_nonzero(~np.isfinite(self.image).all(axis=2)))


def plan_passes(
    scene: mi.Scene,
    spp: int | None = None,
    max_samples: int = MAX_SAMPLES_PER_PASS,
    short: bool = False,
) -> tuple[int, ...]:
    """
    Split a number of samples per pixel into as few passes as possible, or into short ones.

    Parameters
    ----------
    scene
        Its first sensor decides: film size, and the counts that the sampler can do.
    spp
        Wanted samples per pixel; None takes the scene's own number.
    max_samples
        Largest number of samples (pixels × samples per pixel) in one pass.
    short
        Take passes of about a second where that makes no difference to the noise: with the sampler
        ``independent``. Their sizes do not depend on `spp`, but for the last one.

    Returns
    -------
    tuple of int
        Samples per pixel of each pass, all equal but the last. Their sum exceeds `spp` where the
        sampler rounds up, as ``stratified`` does to squares.

    Raises
    ------
    ValueError
        If the film is too large for a pass, or the passes are too many.
    """
    sensor = _sensor(scene)
    sampler = sensor.sampler()
    spp = sampler.sample_count() if spp is None else spp
    pixels = _count_pixels(sensor.film())
    if short and _is_independent(sampler):
        return _short_passes(spp, pixels)
    if not _is_vectorized():
        return (_feasible_count(sampler, spp),)

    limit = max_samples // pixels
    if limit == 0:
        raise ValueError(f"one sample for every pixel is more than {max_samples} samples")

    # The largest pass within the limit; then passes of similar size, the last with what is left.
    counts = range(1, min(spp, limit) + 1)
    largest = bisect_right(counts, limit, key=lambda count: _feasible_count(sampler, count)) or 1
    passes = math.ceil(spp / _feasible_count(sampler, largest))
    size = _feasible_count(sampler, math.ceil(spp / passes))
    passes = math.ceil(spp / size)
    check_pass_count(spp, passes)
    return (size,) * (passes - 1) + (_feasible_count(sampler, spp - size * (passes - 1)),)


def _short_passes(spp: int, pixels: int) -> tuple[int, ...]:
    backend = (mi.variant() or "").partition("_")[0]
    size = repeatable_size(max(1, SHORT_PASS[backend] // pixels))
    full, rest = divmod(spp, size)
    check_pass_count(spp, full + 1)
    return (size,) * full + ((rest,) if rest else ())


def check_pass_count(spp: int, passes: int) -> None:
    """Raise a ValueError for a number of passes that nobody can wait for."""
    if passes > MAX_PASSES:
        raise ValueError(
            f"spp={spp}: so many samples per pixel need {passes} passes, and at most {MAX_PASSES}"
            " are possible; take fewer, or a smaller picture"
        )


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
    return passes > 1 and not _is_independent(_sensor(scene).sampler())


def render(
    scene: mi.Scene,
    spp: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    max_samples: int = MAX_SAMPLES_PER_PASS,
    short: bool = False,
    before: Finished = NOTHING,
    stop: Stop = lambda: False,
    repeatable: bool = False,
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
    spp, max_samples, short
        See :func:`plan_passes`.
    seed
        From 0 to 2³² - 1. Further passes derive theirs from it.
    progress
        Called after each pass with the number of passes done and their total.
    before
        Passes of the same render that are finished already. The picture is the one that a render
        without a break gives, to the bit where Mitsuba adds up the samples in a fixed order.
    stop
        Asked after each pass but the last. If it says yes, the picture holds what is finished.
    repeatable
        Take no more threads for a pass than give the same bits each time, see
        :func:`repeatable_threads`.
    """
    sizes = plan_passes(scene, spp, max_samples, short)
    check_continuation(sizes, before)
    finished, timing = _add_passes(scene, sizes, seed, progress, before, stop, repeatable)
    image = np.asarray(finished.total / finished.spp, dtype=np.float32)
    return Rendering(
        image,
        _channel_names(scene, image.shape[2]),
        finished.spp,
        finished.passes,
        timing,
        unfinished=finished if finished.passes < len(sizes) else None,
        seconds_before=before.seconds,
    )


def check_continuation(sizes: Sequence[int], before: Finished) -> None:
    """Raise a ValueError unless a render in passes of these sizes begins with those before."""
    if before.spp > sum(sizes):
        raise ValueError(
            f"spp={sum(sizes)}: {before.spp} samples per pixel are finished already; take as many,"
            " or more"
        )
    if before.spp != sum(sizes[: before.passes]):
        raise ValueError(
            f"spp={sum(sizes)}: {before.spp} samples per pixel are finished, in passes of another"
            " size; take as many samples as the render that was interrupted"
        )


def _add_passes(
    scene: mi.Scene,
    sizes: Sequence[int],
    seed: int,
    progress: Progress | None,
    before: Finished,
    stop: Stop,
    repeatable: bool,
) -> tuple[Finished, Timing]:
    """Render the passes that are missing, and add them, weighted by their samples."""
    # `dr.freeze` cannot record Mitsuba's spectral variants: they use tables that no argument holds.
    recorded = len(sizes) - before.passes > 1 and _is_vectorized() and not mi.is_spectral
    render_pass = dr.freeze(_render_pass) if recorded else _render_pass

    seeds = pass_seeds(seed, len(sizes))
    total, timing, done = before.total, NO_TIME, before.passes
    for size, pass_seed in islice(zip(sizes, seeds, strict=True), before.passes, None):
        with use_threads(repeatable_threads(scene, size) if repeatable else dr.thread_count()):
            image, seconds = _timed(render_pass, scene, dr.opaque(mi.UInt32, pass_seed), size)
        total = total + size * image.astype(np.float64)
        timing = timing + seconds
        done += 1
        if progress is not None:
            progress(done, len(sizes))
        if done < len(sizes) and stop():
            break
    seconds_of_all = before.seconds + timing.total
    return Finished(total, sum(sizes[:done]), done, seconds_of_all), timing


def _timed(
    render_pass: Callable[[mi.Scene, mi.UInt32, int], mi.TensorXf],
    scene: mi.Scene,
    seed: mi.UInt32,
    spp: int,
) -> tuple[NDArray[np.float32], Timing]:
    """Render a pass, and measure it."""
    # The history of the kernels tells their times. It costs none: interleaved renders of 16 ms took
    # 1.004 times as long with it.
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        start = time.perf_counter()
        image = np.array(render_pass(scene, seed, spp))
        seconds = time.perf_counter() - start
        return image, _split_time(seconds, dr.kernel_history())


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


def _is_independent(sampler: mi.Sampler) -> bool:
    """Tell whether each sample knows nothing of the others, so that passes lose nothing."""
    return bool(sampler.class_name() == "IndependentSampler")


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
