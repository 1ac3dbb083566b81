"""Render the pictures of a comparison with their times, and keep them for the next run."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import quote

import mitsuba as mi
import numpy as np

from ..files import images
from ..files.images import Image
from ..rendering import provenance
from ..rendering.changes import UNCHANGED, Changes
from ..rendering.executor import JobExecutor, LocalExecutor
from ..rendering.job import Rendering, RenderJob, Timing
from .kinds import split


@dataclass(frozen=True, order=True)
class Task:
    """A picture to be rendered."""

    seed: int
    sampling: str  # A strategy, with `kinds.UNGROUPED` after it where Mitsuba chooses the lamp
    spp: int  # as asked for

    @property
    def name(self) -> str:
        """Name of its file; the id of a lamp can hold characters that no file name may."""
        return f"{quote(self.sampling, safe='+=')}_{self.spp}spp_seed{self.seed}"


@dataclass(frozen=True)
class Picture:
    """A picture on disk."""

    file: Path
    task: Task
    spp: int  # as taken: some samplers round up
    timing: Timing  # after a warm-up
    warm_up: Timing


class Gallery:
    """
    The pictures of one scene in one folder.

    A picture counts as there if it was made with the same settings: scene and the files it names,
    parameters, variant, samples, seed, strategy, grouping, versions, the package's own rendering
    code, and the machine, since its times are kept with it.
    """

    def __init__(
        self,
        folder: Path,
        scene_file: Path,
        parameters: Mapping[str, str],
        changes: Changes = UNCHANGED,
        executor: JobExecutor | None = None,  # by default one in this process
    ):
        self._executor = executor
        self.machine = (executor or LocalExecutor()).machine()  # that renders, alone
        self.folder = folder
        self.scene_file = scene_file
        self.parameters = dict(parameters)
        self.changes = changes
        self._settings = settings(scene_file, parameters, changes)
        self._settings |= {
            "picture_digest": provenance.picture_digest(),
            "machine": self.machine,
        }

    def find(self, task: Task) -> Picture | None:
        """Return the picture if it is there and fits."""
        file = self._file(task)
        if not file.exists():
            return None
        found = images.read_metadata(file)
        wanted = self._settings | _settings_of(task)
        if any(name not in found or found[name] != value for name, value in wanted.items()):
            return None
        timing, warm_up = (Timing(**json.loads(found[name])) for name in ("timing", "warm_up"))
        return Picture(file, task, int(found["spp"]), timing, warm_up)

    def holds(self, task: Task) -> bool:
        """Tell whether the picture is there, with whatever settings."""
        return self._file(task).exists()

    def render(
        self, tasks: Sequence[Task], progress: Callable[[Task], None]
    ) -> dict[Task, Picture]:
        """
        Render pictures and write them, in an order that is fair to the strategies.

        Strategies take turns, so that a machine that slows down slows all of them. The pictures are
        rendered on one machine, one at a time, since their times are compared.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        jobs = {task: self._job(task) for task in sorted(tasks)}
        pictures = {}
        with ExitStack() as stack:
            executor = self._executor or stack.enter_context(LocalExecutor())
            alone = stack.enter_context(executor.alone())
            renderings = alone.map(RenderJob.run, jobs.values())
            for (task, job), rendering in zip(jobs.items(), renderings, strict=True):
                image = colour(rendering, f"{task.sampling} at {task.spp} spp, seed {task.seed}")
                pictures[task] = self._write(task, job, rendering, image)
                progress(task)
        return pictures

    def _write(self, task: Task, job: RenderJob, rendering: Rendering, image: Image) -> Picture:
        assert rendering.warm_up is not None  # Each job of the gallery asks for it.
        times = {"timing": rendering.timing, "warm_up": rendering.warm_up}
        description = provenance.describe(job, rendering) | self._settings | _settings_of(task)
        description |= {name: json.dumps(asdict(time)) for name, time in times.items()}
        images.write_exr(self._file(task), image, description)
        return Picture(self._file(task), task, rendering.spp, rendering.timing, rendering.warm_up)

    def _job(self, task: Task) -> RenderJob:
        strategy, grouping = split(task.sampling)
        return RenderJob(
            self.scene_file,
            self.parameters,
            variant(),
            strategy,
            task.spp,
            task.seed,
            warm_up=True,
            grouping=grouping,
            changes=self.changes,
        )

    def _file(self, task: Task) -> Path:
        return self.folder / f"{task.name}.exr"


def variant() -> str:
    """Return Mitsuba's variant; a ValueError if none is set."""
    current = mi.variant()
    if current is None:
        raise ValueError("no variant of Mitsuba is set: call mi.set_variant first")
    return str(current)


def settings(
    scene_file: Path, parameters: Mapping[str, str], changes: Changes = UNCHANGED
) -> dict[str, str]:
    """Return what two pictures of a scene must have in common to be compared."""
    return {
        "scene_digest": provenance.scene_digest(scene_file, parameters),
        "variant": variant(),
        **changes.describe(),
        **provenance.versions(),
    }


def colour(rendering: Rendering, what: str) -> Image:
    """
    Return the RGB picture of a rendering, luminance repeated.

    Raises
    ------
    ValueError
        If it has neither, or holds a NaN or an infinity; `what` says which picture it is.
    """
    if rendering.channels[:3] == ("R", "G", "B"):
        image = rendering.image[..., :3]
    elif rendering.channels[:1] == ("Y",):
        image = rendering.image[..., [0, 0, 0]]
    else:
        channels = ", ".join(rendering.channels)
        raise ValueError(f"{what}: the picture has no colour, only the channels {channels}")

    invalid = np.argwhere(~np.isfinite(image).all(axis=2))
    if invalid.size:
        y, x = invalid[0]
        raise ValueError(
            f"{what}: {len(invalid)} pixel(s) are NaN or infinite, the first at x={x}, y={y};"
            " the picture was not kept"
        )
    return image


def _settings_of(task: Task) -> dict[str, str]:
    strategy, grouping = split(task.sampling)
    return {
        "sampling": strategy,
        "grouping": provenance.yes_or_no(grouping),
        "asked_spp": str(task.spp),
        "seed": str(task.seed),
    }
