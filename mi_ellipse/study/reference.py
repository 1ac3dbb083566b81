"""Render a reference in two independent halves, pass by pass, so that it can be interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..files import atomic, images
from ..files.images import Image
from ..rendering.changes import UNCHANGED, Changes
from ..rendering.division import SAMPLES_PER_PASS, pass_size
from ..rendering.executor import LocalExecutor
from ..rendering.job import RenderJob
from ..rendering.passes import check_pass_count
from .album import Album
from .gallery import colour, settings, variant
from .metrics import flip, reference_errors

SEED = 20170419  # the halves' passes take their seeds from it


@dataclass(frozen=True)
class Reference:
    """A reference on disk."""

    file: Path
    spp: int  # of both halves together
    errors: dict[str, float]  # its own, see `metrics.reference_errors`
    flip_between_halves: float  # each of which is noisier than the reference


@dataclass
class Half:
    """Sum of the passes so far."""

    file: Path
    settings: str
    total: NDArray[np.float64]  # (height, width, 3), each pass times its samples per pixel
    spp: int = 0
    passes: int = 0

    @classmethod
    def read(cls, file: Path) -> Half:
        """
        Return the half on disk.

        Raises
        ------
        ValueError
            If the file is damaged; NumPy's files carry checksums.
        FileNotFoundError
            If there is none.
        """
        try:
            with np.load(file) as saved:
                settings, total = str(saved["settings"]), saved["total"]
                return cls(file, settings, total, int(saved["spp"]), int(saved["passes"]))
        except FileNotFoundError:
            raise
        except Exception as error:  # Zip files, headers and entries fail in a dozen ways.
            raise ValueError(f"{file} is damaged: {error}") from None

    @classmethod
    def open(cls, file: Path, settings: Mapping[str, str], say: Callable[[str], None]) -> Half:
        """Continue the half on disk, or start one."""
        text = json.dumps(dict(settings), sort_keys=True)
        try:
            half = cls.read(file)
        except FileNotFoundError:
            return cls(file, text, np.zeros(()))
        except ValueError:
            say(f"{file.parent.name}/{file.name} was damaged and is rendered again")
            return cls(file, text, np.zeros(()))
        if half.settings != text:
            before = json.loads(half.settings)
            changed = sorted(name for name in settings if before.get(name) != settings[name])
            raise ValueError(
                f"{file.parent} holds a reference made with other settings ({', '.join(changed)});"
                " remove it or choose another output folder"
            )
        return half

    def add(self, image: Image, spp: int) -> None:
        """Add a pass, and keep the sum on disk."""
        self.total = self.total + spp * image.astype(np.float64)
        self.spp += spp
        self.passes += 1
        with atomic.replacement(self.file) as temporary:
            np.savez(
                temporary,
                settings=self.settings,
                total=self.total,
                spp=self.spp,
                passes=self.passes,
            )

    @property
    def image(self) -> Image:
        return np.asarray(self.total / self.spp, dtype=np.float32)


def render_reference(
    folder: Path,
    scene_file: Path,
    parameters: Mapping[str, str],
    spp: int,
    progress: Callable[[int, int], None],
    say: Callable[[str], None],
    samples_per_pass: int = SAMPLES_PER_PASS,
    executor: Executor | None = None,
    album: Album | None = None,
    changes: Changes = UNCHANGED,
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
    samples_per_pass
        Pixels times samples per pixel of one pass, at most.
    executor
        Where the passes are rendered; by default in this process. Sums do not depend on it.
    album
        Takes the reference, so that it is not read again.
    changes
        Of the scene, see `RenderJob`.

    Raises
    ------
    ValueError
        If the folder holds a reference with other settings, or a pass has invalid pixels.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shared = settings(scene_file, parameters, changes)
    halves = [
        Half.open(folder / f"half_{i}.npz", shared | {"seed": f"{SEED}, {i}"}, say) for i in (1, 2)
    ]
    target = (spp + 1) // 2
    done = sum(half.spp for half in halves)
    grown = any(half.spp < target for half in halves)
    if not grown:
        say(f"Reference: reused, {done} spp")
    else:
        if done:
            say(f"Reference: continued from {done} of {2 * target} spp")
        progress(done, 2 * target)
        job = RenderJob(scene_file, parameters, variant(), changes=changes)
        with LocalExecutor() as local:
            where = executor or local
            passes = list(_plan(halves, job, target, samples_per_pass, where))
            _add(halves, passes, where, lambda done: progress(done, 2 * target))
    about = shared | {
        "scene": str(scene_file),
        "parameters": json.dumps(dict(parameters)),
        "sampling": "as in the scene",
    }
    return _write(folder, halves, about, album or Album(), None if grown else say)


# A half, by its index, and a job that adds to it
_Pass = tuple[int, RenderJob]


def _plan(
    halves: Sequence[Half], job: RenderJob, target: int, samples_per_pass: int, executor: Executor
) -> Iterator[_Pass]:
    """Yield the missing passes, the halves in turn, until each has `target` samples per pixel."""
    width, height = executor.submit(job.plan).result().film_size
    size = pass_size(width * height, samples_per_pass)
    check_pass_count(2 * target, 2 * (target // size))
    taken: dict[int, int] = {}  # by the samples per pixel asked for; some samplers round up
    spp, numbers = [half.spp for half in halves], [half.passes for half in halves]
    while min(spp) < target:
        index = spp.index(min(spp))
        asked = min(size, target - spp[index])
        # The same words come first however many are generated: a seed belongs to its pass.
        seeds = np.random.SeedSequence([SEED, index]).generate_state(numbers[index] + 1)
        a_pass = replace(job, spp=asked, seed=int(seeds[-1]), repeatable=True)
        yield index, a_pass
        if asked not in taken:
            taken[asked] = executor.submit(a_pass.plan).result().spp
        spp[index] += taken[asked]
        numbers[index] += 1


def _add(
    halves: Sequence[Half],
    passes: Sequence[_Pass],
    executor: Executor,
    progress: Callable[[int], None],
) -> None:
    """Render passes and add them in their order, whichever ends first."""
    renderings = executor.map(RenderJob.run, [job for _, job in passes])
    for (index, _), rendering in zip(passes, renderings, strict=True):
        half = halves[index]
        image = colour(rendering, f"pass {half.passes} of the reference's half {index + 1}")
        half.add(image, rendering.spp)
        progress(sum(half.spp for half in halves))


def _write(
    folder: Path,
    halves: Sequence[Half],
    about: Mapping[str, str],
    album: Album,
    say: Callable[[str], None] | None,
) -> Reference:
    """Write the halves and their mean as pictures; `say` names files that should be there."""
    spp = sum(half.spp for half in halves)
    first, second = (half.image for half in halves)
    image: Image = (first + second) / np.float32(2)
    if not image.any():
        raise ValueError("the reference is black: there is nothing to compare")

    file = folder / "reference.exr"
    for i, (picture, half) in enumerate(zip((first, second), halves, strict=True), start=1):
        own = {"spp": str(half.spp), "seed": f"{SEED}, half {i}"}
        _write_picture(folder / f"half_{i}.exr", picture, {**about, **own}, say)
    _write_picture(file, image, {**about, "spp": str(spp), "seed": str(SEED)}, say)
    images.write_png(file.with_suffix(".png"), image, images.choose_exposure(image))
    album.keep(file, image)
    return Reference(file, spp, reference_errors(first, second), flip(first, second))


def _write_picture(
    file: Path, image: Image, about: Mapping[str, str], say: Callable[[str], None] | None
) -> None:
    """Write a picture, unless it is there as it should be."""
    if say is not None:
        state = "was outdated"
        try:
            found, metadata = images.read_picture(file)
            if np.array_equal(found, image) and metadata.get("spp") == about["spp"]:
                return
        except FileNotFoundError:
            state = "was missing"
        except ValueError:
            state = "was damaged"
        say(f"{file.parent.name}/{file.name} {state} and is written again")
    images.write_exr(file, image, about)
