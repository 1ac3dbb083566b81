"""Render the pictures of a comparison, and keep them for the next run."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

import mitsuba as mi
import numpy as np

from ..files import images
from ..files.images import Image
from ..rendering import provenance
from ..rendering.changes import UNCHANGED, Changes
from ..rendering.executor import JobExecutor, LocalExecutor
from ..rendering.job import Rendering, RenderJob
from . import tidying
from .album import Album
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


@dataclass
class Stock:
    """What a gallery has of the pictures that are asked for."""

    pictures: dict[Task, Picture] = field(default_factory=dict)
    outdated: list[Task] = field(default_factory=list)  # made with other settings
    damaged: list[Task] = field(default_factory=list)
    missing: list[Task] = field(default_factory=list)

    @property
    def wanted(self) -> list[Task]:
        """Pictures that need to be rendered."""
        return [*self.outdated, *self.damaged, *self.missing]


class Gallery:
    """
    The pictures of one scene in one folder.

    A picture counts as there if it was made with the same settings: scene and the files it names,
    parameters, variant, samples, seed, strategy, grouping, versions and the package's own rendering
    code. Pictures of earlier runs, which were put away, count as well.
    """

    def __init__(
        self,
        folder: Path,
        scene_file: Path,
        parameters: Mapping[str, str],
        album: Album | None = None,
        changes: Changes = UNCHANGED,
        executor: JobExecutor | None = None,  # by default one in this process
    ):
        self.folder = folder
        self.scene_file = scene_file
        self.parameters = dict(parameters)
        self.changes = changes
        self._album = album or Album()
        self._executor = executor
        self.machine = (executor or LocalExecutor()).machine()  # that renders, alone
        self.settings = settings(scene_file, parameters, changes)
        self.settings |= {"picture_digest": provenance.picture_digest()}

    def take_stock(self, tasks: Sequence[Task]) -> Stock:
        """Read the pictures that are there, and tell which of them can be used."""
        stock = Stock()
        for task in tasks:
            file = self._file(task)
            tidying.fetch(file)
            try:
                image, found = images.read_picture(file)
                picture = self._picture(task, found)
            except FileNotFoundError:
                stock.missing.append(task)
            except ValueError:
                stock.damaged.append(task)
            else:
                if picture is None:
                    stock.outdated.append(task)
                else:
                    stock.pictures[task] = picture
                    self._album.keep_if_small(file, image)
        return stock

    def _picture(self, task: Task, found: Mapping[str, str]) -> Picture | None:
        """Return what a file says of its picture, or None if it was made with other settings."""
        wanted = self.settings | _settings_of(task)
        if any(found.get(name) != value for name, value in wanted.items()):
            return None
        return Picture(self._file(task), task, int(found["spp"]))

    def render(
        self, tasks: Sequence[Task], progress: Callable[[Task], None]
    ) -> dict[Task, Picture]:
        """Render pictures whose times are not asked for, and write them."""
        tasks = sorted(tasks)
        pictures = {}
        jobs = [self.job(task) for task in tasks]
        renderings = self._executor.map(RenderJob.run, jobs) if self._executor else self.run(jobs)
        for task, rendering in zip(tasks, renderings, strict=True):
            pictures[task] = self.keep(task, rendering)
            progress(task)
        return pictures

    def run(self, jobs: Sequence[RenderJob]) -> Generator[Rendering, None, None]:
        """Yield the renderings of jobs, rendered one at a time on one machine, in their order."""
        with ExitStack() as stack:
            executor = self._executor or stack.enter_context(LocalExecutor())
            yield from stack.enter_context(executor.alone()).map(RenderJob.run, jobs)

    def job(self, task: Task, warm_up: bool = False) -> RenderJob:
        """Return the job of a picture; with a `warm_up` where its time is asked for."""
        strategy, grouping = split(task.sampling)
        return RenderJob(
            self.scene_file,
            self.parameters,
            variant(),
            strategy,
            task.spp,
            task.seed,
            warm_up=warm_up,
            grouping=grouping,
            changes=self.changes,
        )

    def keep(self, task: Task, rendering: Rendering) -> Picture:
        """
        Write a picture with its settings.

        Raises
        ------
        ValueError
            If it has no colour, or pixels that are not finite, see :func:`colour`.
        """
        image = colour(rendering, f"{task.sampling} at {task.spp} spp, seed {task.seed}")
        description = provenance.describe(self.job(task), rendering)
        description |= self.settings | _settings_of(task)
        file = self._file(task)
        file.parent.mkdir(parents=True, exist_ok=True)
        images.write_exr(file, image, description)
        self._album.keep_if_small(file, image)
        return Picture(file, task, rendering.spp)

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
