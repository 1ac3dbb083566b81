"""A render as a value: it can be compared, stored, and sent to another process."""

# Types such as `mi.Scene` exist only once a variant is set.
from __future__ import annotations

import dataclasses
import gc
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi

from ..plugins.grouping import group_lamps
from . import passes, provenance
from .changes import UNCHANGED, Changes
from .passes import MAX_SAMPLES_PER_PASS, NOTHING, Finished, Progress, Rendering, Stop, Timing
from .rewrite import Conversion
from .scene import ParsedScene, instantiate, parse_scene, under_variant

__all__ = ["Changes", "Parameters", "Plan", "RenderJob", "Rendering", "Stage", "Timing"]

MAX_SEED = 2**32 - 1
MAX_SPP = 2**32 - 1  # that a sampler of Mitsuba can count


class Parameters(Mapping[str, str]):
    """Values for the parameters of a scene; they cannot change, so a job can be hashed."""

    def __init__(self, values: Mapping[str, str] | None = None):
        self._values = dict(values or {})

    def __getitem__(self, name: str) -> str:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __hash__(self) -> int:
        return hash(frozenset(self._values.items()))

    def __repr__(self) -> str:
        return repr(self._values)


@dataclass(frozen=True)
class Plan:
    """How a job will be rendered."""

    sizes: tuple[int, ...]  # samples per pixel of each pass
    film_size: tuple[int, int]  # width and height in pixels, of the part that is rendered
    loses_stratification: bool  # the passes are noisier together than a single one
    scene_digest: str  # see `provenance.scene_digest`
    conversion: Conversion | None = None  # what became of built-in lamps, where a job converts them
    sensors: tuple[str, ...] = ()  # of the scene, by id or number

    @property
    def spp(self) -> int:
        """Samples per pixel that will be taken."""
        return sum(self.sizes)


@dataclass(frozen=True)
class RenderJob:
    """
    What to render.

    In a :class:`~mi_ellipse.rendering.executor.LocalExecutor`, a job finds the scene that the job
    before has left there, if it needs the same. Elsewhere it loads the scene for itself and frees
    it in the end. Either way, the variant that was set before is set again afterwards.

    Raises
    ------
    ValueError
        If `spp` or `seed` is impossible.
    """

    scene: Path  # XML file
    parameters: Mapping[str, str] = dataclasses.field(default_factory=Parameters)
    variant: str = "llvm_ad_rgb"
    # Of all lamps, or of single ones, see `rewrite.choose_sampling`; None: as the scene says
    sampling: str | None = None
    spp: int | None = None  # samples per pixel; None: the scene's own number
    seed: int = 0
    # Render once beforehand, unless a job has done so since the scene was loaded. It compiles the
    # kernel, which is the same for every number of samples.
    warm_up: bool = False
    grouping: bool = True  # Two or more lamps choose among themselves; False: Mitsuba's choice
    changes: Changes = UNCHANGED  # Of lamps, sensor, integrator and resolution
    short_passes: bool = False  # of about a second each, see `passes.plan_passes`
    repeatable: bool = False  # to the bit, with fewer threads where needed, see `passes.render`

    def __post_init__(self) -> None:
        object.__setattr__(self, "scene", Path(self.scene))
        object.__setattr__(self, "parameters", Parameters(self.parameters))
        if self.spp is not None and not 1 <= self.spp <= MAX_SPP:
            raise ValueError(f"spp={self.spp}: samples per pixel are from 1 to {MAX_SPP}")
        if not 0 <= self.seed <= MAX_SEED:
            raise ValueError(f"seed={self.seed}: a seed lies from 0 to {MAX_SEED}")

    def plan(self) -> Plan:
        """Load the scene, if it is not there yet, and tell how the job will be rendered."""
        with _staged(self) as loaded:
            sizes = passes.plan_passes(loaded.scene, self.spp, short=self.short_passes)
            width, height = loaded.scene.sensors()[0].film().crop_size()
            loses = passes.loses_stratification(loaded.scene, len(sizes))
            size = int(width), int(height)
            return Plan(sizes, size, loses, loaded.digest, loaded.conversion, loaded.sensors)

    def run(
        self,
        progress: Progress | None = None,
        before: Finished = NOTHING,
        stop: Stop = lambda: False,
    ) -> Rendering:
        """
        Render; errors are those of :func:`mi_ellipse.rendering.scene.load_scene` and of Mitsuba.

        Parameters
        ----------
        progress
            Called after each pass with the number of passes done and their total.
        before
            Passes of the same job that are finished already.
        stop
            Asked after each pass whether the render shall end there.

        Raises
        ------
        FileNotFoundError
            If the scene names a file that does not exist.
        """
        with _staged(self) as loaded:
            if self.warm_up and loaded.warm_up is None:
                loaded.warm_up = passes.render(loaded.scene, self.spp, self.seed).timing
            rendering = passes.render(
                loaded.scene,
                self.spp,
                self.seed,
                progress,
                MAX_SAMPLES_PER_PASS,
                self.short_passes,
                before,
                stop,
                self.repeatable,
            )
            return dataclasses.replace(
                rendering,
                warm_up=loaded.warm_up if self.warm_up else None,
                scene_digest=loaded.digest,
                machine=provenance.machine(),
            )


# ---- The loaded scene ----


@dataclass
class _Loaded:
    """A scene in memory."""

    key: tuple[object, ...]
    stamps: dict[Path, tuple[int, int]]  # time of the last change and size of its files
    digest: str
    scene: mi.Scene
    conversion: Conversion | None
    sensors: tuple[str, ...]
    warm_up: Timing | None = None


class Stage:
    """
    Hold the scene of the last job for the next one.

    There is one scene at a time: every living lamp is part of every render, and slows it down. The
    old scene is freed before the next one is loaded. A scene whose files have changed is loaded
    anew.
    """

    def __init__(self) -> None:
        self._loaded: _Loaded | None = None

    @contextmanager
    def open(self) -> Iterator[None]:
        """Make the jobs of this thread use this stage; the scene stays after the block."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    def clear(self) -> None:
        """Free the scene."""
        if self._loaded is not None:
            del self._loaded.scene  # The job that is about to end may hold the rest.
            self._loaded = None
            gc.collect()

    def load(self, job: RenderJob) -> _Loaded:
        """Return the scene of a job, under the variant that is set."""
        key = (
            job.scene.resolve(),
            job.parameters,
            job.variant,
            job.sampling,
            job.grouping,
            job.changes,
        )
        loaded = self._loaded
        if loaded is None or loaded.key != key or loaded.stamps != stamps_of(loaded.stamps):
            loaded = None
            self.clear()
            parsed = parse_scene(job.scene, job.parameters)
            stamps = stamps_of(_files(parsed))
            digest = provenance.parsed_digest(parsed)
            conversion = parsed.conversion() if job.changes.convert_lamps else None
            scene = instantiate(parsed, job.sampling, job.changes)
            if job.grouping:
                group_lamps(scene)
            loaded = _Loaded(key, stamps, digest, scene, conversion, parsed.sensors())
            self._loaded = loaded
        return loaded


_current: ContextVar[Stage | None] = ContextVar("stage", default=None)


@contextmanager
def _staged(job: RenderJob) -> Iterator[_Loaded]:
    """Give the loaded scene of a job, and set its variant meanwhile."""
    stage = _current.get()
    with under_variant(job.variant):
        if stage is not None:
            yield stage.load(job)
        else:
            own = Stage()
            try:
                yield own.load(job)
            finally:
                own.clear()


def _files(parsed: ParsedScene) -> list[Path]:
    return [*parsed.scene_files, *(file for _, file in parsed.named_files())]


def stamps_of(files: Iterable[Path]) -> dict[Path, tuple[int, int]]:
    """Return when files were last changed, and their sizes; a missing file has neither."""
    stamps = {}
    for file in files:
        status = file.stat() if file.exists() else None
        stamps[file] = (status.st_mtime_ns, status.st_size) if status else (0, 0)
    return stamps
