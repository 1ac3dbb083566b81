"""Divide a render into jobs of one pass each, and average what they return."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import closing

import numpy as np

from . import passes
from .job import RenderJob
from .passes import NO_TIME, NOTHING, Finished, Progress, Rendering, Stop

# Of a pass of a reference: some seconds on a few processor cores. No more is lost when a worker
# dies or a run is interrupted.
SAMPLES_PER_PASS = 2**24


def pass_size(pixels: int, samples: int = SAMPLES_PER_PASS) -> int:
    """Return samples per pixel of a pass with so many samples, or less, that can be repeated."""
    return passes.repeatable_size(max(1, samples // pixels))


def divide(job: RenderJob, sizes: Sequence[int]) -> list[RenderJob]:
    """
    Return a job for each pass of a render.

    Parameters
    ----------
    job
        The render.
    sizes
        Samples per pixel of its passes, as its plan has them.
    """
    seeds = passes.pass_seeds(job.seed, len(sizes))
    return [
        dataclasses.replace(
            job, spp=size, seed=seed, warm_up=False, short_passes=False, repeatable=True
        )
        for size, seed in zip(sizes, seeds, strict=True)
    ]


def render(
    job: RenderJob,
    sizes: Sequence[int],
    executor: Executor,
    progress: Progress | None = None,
    before: Finished = NOTHING,
    stop: Stop = lambda: False,
) -> Rendering:
    """
    Render the passes of a job as jobs of their own.

    The picture is that of ``job.run()`` bit for bit, wherever the passes are rendered and whichever
    ends first, where each pass has the same bits everywhere, see
    :func:`mi_ellipse.rendering.passes.repeatable_threads`.

    Parameters
    ----------
    job, progress, before, stop
        See :meth:`RenderJob.run`.
    sizes
        See :func:`divide`.
    executor
        Where the passes are rendered.

    Returns
    -------
    Rendering
        Its times are sums over the passes, and its machines those that rendered one.

    Raises
    ------
    ValueError
        If nothing is left to render.
    """
    passes.check_continuation(sizes, before)
    jobs = divide(job, sizes)[before.passes :]
    if not jobs:
        raise ValueError(f"spp={before.spp}: all samples per pixel are finished already")
    total, timing, done, machines = before.total, NO_TIME, before.passes, set()
    with closing(executor.map(RenderJob.run, jobs)) as parts:  # type: ignore[type-var]
        for part in parts:
            total = total + part.spp * part.image.astype(np.float64)
            timing = timing + part.timing
            machines.add(part.machine)
            done += 1
            if progress is not None:
                progress(done, len(sizes))
            if done < len(sizes) and stop():
                break
    finished = Finished(total, sum(sizes[:done]), done, before.seconds + timing.total)
    return dataclasses.replace(
        part,
        image=np.asarray(total / finished.spp, dtype=np.float32),
        spp=finished.spp,
        passes=done,
        timing=timing,
        machine=", ".join(sorted(machines)),
        unfinished=finished if done < len(sizes) else None,
        seconds_before=before.seconds,
    )
