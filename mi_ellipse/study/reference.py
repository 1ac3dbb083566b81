"""Render a reference in two independent halves, pass by pass, so that it can be interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import mitsuba as mi
import numpy as np

from ..files import atomic, images
from ..rendering.executor import LocalExecutor
from ..rendering.job import RenderJob
from .metrics import flip, reference_errors
from .pictures import colour, read_exr, settings

SEED = 20170419  # the halves' passes take their seeds from it

# Some seconds on a few processor cores: no more is lost in an interruption.
SAMPLES_PER_PASS = 2**24


@dataclass(frozen=True)
class Reference:
    """A reference on disk."""

    file: Path
    spp: int  # of both halves together
    errors: dict[str, float]  # its own, see `metrics.reference_errors`
    flip_between_halves: float  # each of which is noisier than the reference


@dataclass
class _Half:
    """Sum of the passes so far."""

    file: Path
    settings: str
    total: np.ndarray  # (height, width, 3), float64, each pass times its samples per pixel
    spp: int = 0
    passes: int = 0

    @classmethod
    def open(cls, file: Path, settings: Mapping[str, str]) -> _Half:
        """Continue the half on disk, or start one."""
        text = json.dumps(dict(settings), sort_keys=True)
        if not file.exists():
            return cls(file, text, np.zeros(()))

        with np.load(file) as saved:
            half = cls(
                file,
                str(saved["settings"]),
                saved["total"],
                int(saved["spp"]),
                int(saved["passes"]),
            )
        if half.settings != text:
            before = json.loads(half.settings)
            changed = sorted(name for name in settings if before.get(name) != settings[name])
            raise ValueError(
                f"{file.parent} holds a reference made with other settings ({', '.join(changed)});"
                " remove it or choose another output folder"
            )
        return half

    def save(self) -> None:
        with atomic.replacement(self.file) as temporary:
            np.savez(
                temporary,
                settings=self.settings,
                total=self.total,
                spp=self.spp,
                passes=self.passes,
            )

    @property
    def image(self) -> np.ndarray:
        return np.float32(self.total / self.spp)


def render_reference(
    folder: Path,
    scene_file: Path,
    parameters: Mapping[str, str],
    spp: int,
    progress: Callable[[int, int], None],
    say: Callable[[str], None],
    samples_per_pass: int = SAMPLES_PER_PASS,
) -> Reference:
    """
    Render the reference of a scene, or what is missing of it, as the scene's integrator says.

    Parameters
    ----------
    folder
        Where it lies. The state after each pass is kept, so that an interrupted run goes on, and
        one with a larger `spp` adds to what is there.
    scene_file, parameters
        The scene, with its own sampling strategy.
    spp
        Samples per pixel of both halves together.
    progress
        Called with the samples per pixel done and their total.
    say
        Called with sentences for the user.

    Raises
    ------
    ValueError
        If the folder holds a reference with other settings, or a pass has invalid pixels.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shared = settings(scene_file, parameters)
    halves = [
        _Half.open(folder / f"half_{i}.npz", shared | {"seed": f"{SEED}, {i}"}) for i in (1, 2)
    ]
    target = (spp + 1) // 2
    done = sum(half.spp for half in halves)
    if all(half.spp >= target for half in halves):
        say(f"Reference: reused, {done} spp")
    else:
        if done:
            say(f"Reference: continued from {done} of {2 * target} spp")
        _add_passes(halves, scene_file, parameters, target, samples_per_pass, progress)
    return _write(folder, halves, shared, scene_file, parameters)


def _add_passes(
    halves: list[_Half],
    scene_file: Path,
    parameters: Mapping[str, str],
    target: int,
    samples_per_pass: int,
    progress: Callable[[int, int], None],
) -> None:
    """Render passes, the halves in turn, until each has `target` samples per pixel."""
    job = RenderJob(scene_file, parameters, mi.variant())
    progress(sum(half.spp for half in halves), 2 * target)
    with LocalExecutor() as executor:
        width, height = executor.submit(job.plan).result().film_size
        size = max(1, samples_per_pass // (width * height))
        while any(half.spp < target for half in halves):
            index, half = min(enumerate(halves), key=lambda pair: pair[1].spp)
            # The same words come first however many are generated: a seed belongs to its pass.
            seeds = np.random.SeedSequence([SEED, index]).generate_state(half.passes + 1)
            a_pass = replace(job, spp=min(size, target - half.spp), seed=int(seeds[-1]))
            rendering = executor.submit(a_pass.run).result()
            image = colour(rendering, f"pass {half.passes} of the reference's half {index + 1}")
            half.total = half.total + rendering.spp * image.astype(np.float64)
            half.spp += rendering.spp
            half.passes += 1
            half.save()
            progress(sum(half.spp for half in halves), 2 * target)


def _write(
    folder: Path,
    halves: list[_Half],
    shared: dict[str, str],
    scene_file: Path,
    parameters: Mapping[str, str],
) -> Reference:
    """Write the halves and their mean as pictures, unless they are there already."""
    spp = sum(half.spp for half in halves)
    image = sum(half.image for half in halves) / np.float32(2)
    if not image.any():
        raise ValueError("the reference is black: there is nothing to compare")

    file = folder / "reference.exr"
    if not file.exists() or not np.array_equal(read_exr(file), image):
        description = shared | {
            "scene": str(scene_file),
            "parameters": json.dumps(dict(parameters)),
            "sampling": "as in the scene",
        }
        for i, half in enumerate(halves, start=1):
            settings_of_half = {"spp": str(half.spp), "seed": f"{SEED}, half {i}"}
            images.write_exr(folder / f"half_{i}.exr", half.image, description | settings_of_half)
        images.write_exr(file, image, description | {"spp": str(spp), "seed": str(SEED)})
        images.write_png(file.with_suffix(".png"), image, images.choose_exposure(image))
    first, second = (half.image for half in halves)
    return Reference(file, spp, reference_errors(first, second), flip(first, second))
