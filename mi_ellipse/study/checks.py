"""Check what is asked of a comparison before anything is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..rendering.executor import LocalExecutor
from ..rendering.job import Plan, RenderJob
from ..sampling import find
from .drawing.insets import Inset, check_inside
from .gallery import variant
from .kinds import split


@dataclass(frozen=True)
class Request:
    """What is asked of a comparison, see :func:`mi_ellipse.study.compare`."""

    scene_file: Path
    folder: Path
    strategies: tuple[str, ...]
    spp: tuple[int, ...]  # from few to many
    reference_spp: int
    seeds: int
    parameters: dict[str, str]
    insets: Sequence[Inset] | None = None


def check(request: Request) -> None:
    """
    Raise an error for what cannot be compared. The scene is loaded, and nothing is rendered.

    Raises
    ------
    ValueError
        For strategies, counts or insets that are impossible, a scene without a lamp, or an output
        folder that is a file.
    RuntimeError
        From Mitsuba, if the scene is wrong.
    """
    _check_numbers(request)
    if request.folder.exists() and not request.folder.is_dir():
        raise ValueError(f"{request.folder} is a file: the output needs a folder")
    plans = _plan(request)
    width, height = plans[0].film_size
    if request.insets is not None:
        check_inside(request.insets, (height, width))
    taken = [plan.spp for plan in plans]
    for i in range(1, len(taken)):
        if taken[i] == taken[i - 1]:
            raise ValueError(
                f"spp={request.spp[i - 1]} and spp={request.spp[i]}: the scene's sampler takes"
                f" {taken[i]} samples per pixel for both; leave one of them out"
            )


def _check_numbers(request: Request) -> None:
    for name in request.strategies:
        find(split(name)[0])
    if not request.strategies or not request.spp or request.spp[0] < 1:
        raise ValueError("a comparison needs a strategy and numbers of samples of at least 1")
    if request.seeds < 1:
        raise ValueError(f"seeds={request.seeds}: a comparison needs at least 1 seed")
    if request.reference_spp < 2:
        raise ValueError(
            f"reference_spp={request.reference_spp}: each half of a reference needs at least 1"
            " sample per pixel"
        )


def _plan(request: Request) -> list[Plan]:
    """Return how the pictures of the first strategy will be rendered, from few samples to many."""
    strategy, grouping = split(request.strategies[0])
    job = RenderJob(request.scene_file, request.parameters, variant(), strategy, grouping=grouping)
    with LocalExecutor() as executor:
        jobs = [replace(job, spp=spp) for spp in request.spp]
        return list(executor.map(RenderJob.plan, jobs))
