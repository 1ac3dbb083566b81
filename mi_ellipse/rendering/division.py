"""Divide a render into jobs of one pass each, and average what they return."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import Executor

from . import passes
from .executor import JobExecutor, LocalExecutor
from .job import RenderJob
from .passes import Average, Progress, Rendering, Timing

# Of a pass, where passes are jobs: some seconds on a few processor cores. No more is lost when a
# worker dies or a run is interrupted.
SAMPLES_PER_PASS = 2**24


def with_passes(job: RenderJob, executor: JobExecutor) -> RenderJob:
    """
    Return a job with passes of :data:`SAMPLES_PER_PASS` samples or less.

    Their size depends on the picture alone, so that all clusters give the same one. This process
    needs no more passes than the job has.
    """
    if isinstance(executor, LocalExecutor):
        return job
    width, height = executor.submit(job.plan).result().film_size
    return dataclasses.replace(job, pass_spp=pass_size(width * height))


def pass_size(pixels: int, samples: int | None = None) -> int:
    """Return samples per pixel of a pass with :data:`SAMPLES_PER_PASS`, or `samples`, at most."""
    return passes.repeatable_size(max(1, (samples or SAMPLES_PER_PASS) // pixels))


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
        dataclasses.replace(job, spp=size, seed=seed, pass_spp=size, warm_up=False)
        for size, seed in zip(sizes, seeds, strict=True)
    ]


def render(
    job: RenderJob, sizes: Sequence[int], executor: Executor, progress: Progress | None = None
) -> Rendering:
    """
    Render the passes of a job as jobs of their own.

    The picture is that of ``job.run()`` bit for bit, wherever the passes are rendered and whichever
    ends first, where each pass has the same bits everywhere: the job has a `pass_spp`, and the film
    a box filter or each process one thread.

    Parameters
    ----------
    job, sizes, progress
        See :func:`divide` and :meth:`RenderJob.run`.
    executor
        Where the passes are rendered.

    Returns
    -------
    Rendering
        Its times are sums over the passes, and its machines those that rendered one.
    """
    average, parts = Average(), []
    jobs = divide(job, sizes)
    for done, part in enumerate(executor.map(RenderJob.run, jobs), start=1):
        average.add(part.image, part.spp)
        # Pictures would fill the memory.
        parts.append(dataclasses.replace(part, image=part.image[:0]))
        if progress is not None:
            progress(done, len(jobs))
    return dataclasses.replace(
        parts[0],
        image=average.image(),
        spp=sum(part.spp for part in parts),
        passes=sum(part.passes for part in parts),
        timing=_sum([part.timing for part in parts]),
        machine=", ".join(sorted({part.machine for part in parts})),
    )


def _sum(timings: Sequence[Timing]) -> Timing:
    rows = [dataclasses.astuple(timing) for timing in timings]
    return Timing(*(sum(column) for column in zip(*rows, strict=True)))
