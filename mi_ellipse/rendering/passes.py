"""Render a scene in as few passes as possible, and write pictures that replace older ones whole."""

# Types such as `mi.Scene` exist only once a variant is set.
from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from . import __version__

# Mitsuba numbers the samples of a pass with 32 bits. Memory sets no tighter limit: `path`, `prb`
# and `volpath` run as one kernel that keeps nothing per sample (under LLVM, peak memory grew by
# less than 2 MiB from 4 to 34 million samples). The film, 12 bytes a pixel, cannot be split.
MAX_SAMPLES_PER_PASS = 2**32 - 1


@dataclass(frozen=True)
class Rendering:
    """A rendered picture and how it came about."""

    image: np.ndarray  # (height, width, channels), float32, linear
    channels: tuple[str, ...]  # one name a channel: "R", "G", "B", …
    spp: int  # samples per pixel that were really taken
    passes: int
    seconds: float

    @property
    def invalid_pixels(self) -> int:
        """Number of pixels with a NaN or an infinity in any channel."""
        return int(np.count_nonzero(~np.isfinite(self.image).all(axis=2)))


# ---- Rendering ----


def plan_passes(
    scene: mi.Scene, spp: int | None = None, max_samples: int = MAX_SAMPLES_PER_PASS
) -> tuple[int, ...]:
    """
    Split a number of samples per pixel into as few passes as possible.

    Parameters
    ----------
    scene
        Its first sensor decides: film size, and the counts that the sampler can do.
    spp
        Wanted samples per pixel; None takes the scene's own number.
    max_samples
        Largest number of samples (pixels × samples per pixel) in one pass.

    Returns
    -------
    tuple of int
        Samples per pixel of each pass, all equal but the last. Their sum exceeds `spp` where the
        sampler rounds up, as ``stratified`` does to squares.
    """
    sensor = _sensor(scene)
    sampler = sensor.sampler()
    spp = sampler.sample_count() if spp is None else spp
    if not _is_vectorized():
        return (_feasible_count(sampler, spp),)

    limit = max_samples // _count_pixels(sensor.film())
    if limit == 0:
        raise ValueError(f"one sample for every pixel is more than {max_samples} samples")

    # The largest pass within the limit; then passes of similar size, the last with what is left.
    counts = range(1, min(spp, limit) + 1)
    largest = bisect_right(counts, limit, key=lambda count: _feasible_count(sampler, count)) or 1
    passes = math.ceil(spp / _feasible_count(sampler, largest))
    size = _feasible_count(sampler, math.ceil(spp / passes))
    passes = math.ceil(spp / size)
    return (size,) * (passes - 1) + (_feasible_count(sampler, spp - size * (passes - 1)),)


def loses_stratification(scene: mi.Scene, passes: int) -> bool:
    """Tell whether rendering in `passes` passes is noisier than in one, for the scene's sampler."""
    return passes > 1 and _sensor(scene).sampler().class_name() != "IndependentSampler"


def render(
    scene: mi.Scene,
    spp: int | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    max_samples: int = MAX_SAMPLES_PER_PASS,
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
    spp, max_samples
        See :func:`plan_passes`.
    seed
        From 0 to 2³² - 1. Further passes derive theirs from it.
    progress
        Called after each pass with the number of passes done and their total.
    """
    sizes = plan_passes(scene, spp, max_samples)
    # `dr.freeze` cannot record Mitsuba's spectral variants: they use tables that no argument holds.
    recorded = len(sizes) > 1 and not mi.is_spectral
    render_pass = dr.freeze(_render_pass) if recorded else _render_pass

    start = time.perf_counter()
    total = 0.0
    seeds = _pass_seeds(seed, len(sizes))
    for done, (size, pass_seed) in enumerate(zip(sizes, seeds, strict=True), start=1):
        image = render_pass(scene, dr.opaque(mi.UInt32, pass_seed), size)
        total = total + size * np.array(image, dtype=np.float64)
        if progress is not None:
            progress(done, len(sizes))
    seconds = time.perf_counter() - start

    image = np.float32(total / sum(sizes))
    channels = _channel_names(scene, image.shape[2])
    return Rendering(image, channels, sum(sizes), len(sizes), seconds)


def _sensor(scene: mi.Scene) -> mi.Sensor:
    if not scene.sensors():
        raise ValueError("the scene has no sensor")
    return scene.sensors()[0]


def _render_pass(scene: mi.Scene, seed: mi.UInt32, spp: int) -> mi.TensorXf:
    return mi.render(scene, seed=seed, spp=spp)


def _pass_seeds(seed: int, count: int) -> list[int]:
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
    return not mi.variant().startswith("scalar")


def _channel_names(scene: mi.Scene, count: int) -> tuple[str, ...]:
    """Return the names of the `count` channels that ``mi.render`` delivers."""
    film = _sensor(scene).film()
    film.prepare(scene.integrator().aov_names())
    names = tuple(field.name for field in film.bitmap().struct_())
    if len(names) == count:
        return names

    # `aov` delivers the colour of an integrator inside it, but not the copy of that among its own
    # channels, which ends in an alpha; without an integrator inside it delivers no colour.
    colour = tuple(name for name in names if "." not in name)
    if not any(name.endswith(".A") for name in names):
        return names[-count:]
    return colour + names[len(colour) - count :]


# ---- Pictures ----


def describe(
    scene_file: str | PathLike[str],
    rendering: Rendering,
    seed: int,
    sampling: str | None = None,
    parameters: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """
    Return the settings that made a picture, as text for the metadata of :func:`write_exr`.

    ``sampling`` reads "as in the scene" where it was not chosen from outside; ``parameters`` is a
    JSON object. The checksum is that of the scene file alone, without the files it refers to.
    """
    return {
        "scene": str(scene_file),
        "scene_sha256": hashlib.sha256(Path(scene_file).read_bytes()).hexdigest(),
        "spp": str(rendering.spp),
        "passes": str(rendering.passes),
        "seed": str(seed),
        "variant": mi.variant(),
        "sampling": sampling or "as in the scene",
        "parameters": json.dumps(dict(parameters or {})),
        "mi_ellipse_version": __version__,
        "mitsuba_version": mi.__version__,
        "drjit_version": dr.__version__,
        "render_seconds": f"{rendering.seconds:.3f}",
    }


def write_exr(
    path: str | PathLike[str],
    image: np.ndarray,
    metadata: Mapping[str, str] | None = None,
    channels: tuple[str, ...] | None = None,
) -> None:
    """
    Write a linear picture as OpenEXR; an older file stays whole until the new one is.

    Parameters
    ----------
    path
        Output file.
    image
        Array of shape (height, width, channels), stored in single precision.
    metadata
        Texts to store in the header; ``mi.Bitmap(path).metadata()`` reads them back.
    channels
        Names of the channels; needed where they are not luminance or RGB, with or without alpha.
    """
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    if channels is None or channels in (("Y",), ("R", "G", "B"), ("R", "G", "B", "A")):
        bitmap = mi.Bitmap(pixels)
    else:
        bitmap = mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, list(channels))
    for name, value in (metadata or {}).items():
        bitmap.metadata()[name] = value
    with replacement(Path(path)) as temporary:
        bitmap.write(str(temporary))


def choose_exposure(image: np.ndarray) -> float:
    """
    Return an exposure in stops that suits a picture: 0 leaves it as it is, 1 doubles it.

    The luminance that 95 % of the pixels stay below becomes 0.8, so that a lamp in the picture may
    burn out and the scene does not. Half stops, so that noise does not change the exposure between
    two renders of a scene.
    """
    luminance = _to_rgb(image) @ np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709
    luminance = luminance[np.isfinite(luminance)]
    bright = np.percentile(luminance, 95) if luminance.size else 0.0
    return round(2 * math.log2(0.8 / bright)) / 2 if bright > 0 else 0.0


def write_png(path: str | PathLike[str], image: np.ndarray, exposure: float = 0.0) -> None:
    """
    Write a picture for the screen: 8 bits a channel, sRGB, clipped at white.

    Parameters
    ----------
    path
        Output file; as with :func:`write_exr`, it is replaced whole.
    image
        Linear array of shape (height, width, channels); channels after RGB are left out, and
        values that are not finite become black.
    exposure
        Stops to brighten by, see :func:`choose_exposure`.
    """
    rgb = np.nan_to_num(_to_rgb(image), nan=0.0, posinf=0.0, neginf=0.0) * 2.0**exposure
    bitmap = mi.Bitmap(np.ascontiguousarray(rgb, dtype=np.float32))
    bitmap = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
    with replacement(Path(path)) as temporary:
        bitmap.write(str(temporary))


def check_writable(path: str | PathLike[str]) -> None:
    """Raise an OSError unless a file can be written at `path`; leave what is there alone."""
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"the folder {path.parent} does not exist")
    with tempfile.TemporaryFile(dir=path.parent):
        pass


def _to_rgb(image: np.ndarray) -> np.ndarray:
    """Return the colour of a picture in double precision, luminance repeated."""
    image = np.asarray(image, dtype=np.float64)
    return image[..., :3] if image.shape[2] >= 3 else image[..., [0, 0, 0]]


@contextmanager
def replacement(path: Path) -> Iterator[Path]:
    """
    Give a temporary path in the folder of `path`, and move it there if all goes well.

    Within one folder the move is atomic: whatever happens, `path` holds the old file or the new.
    """
    path = path.resolve()
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
