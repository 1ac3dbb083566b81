"""Check what is asked of a comparison before anything is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..rendering.changes import UNCHANGED, Changes
from ..rendering.executor import LocalExecutor
from ..rendering.job import MAX_SPP, Plan, RenderJob
from ..rendering.rewrite import check_choice
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
    changes: Changes = UNCHANGED


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
        check_choice(split(name)[0])
    if not request.strategies or not request.spp:
        raise ValueError("a comparison needs a strategy and a number of samples per pixel")
    for count in (*request.spp, request.reference_spp):
        if not 1 <= count <= MAX_SPP:
            raise ValueError(f"spp={count}: samples per pixel are from 1 to {MAX_SPP}")
    if request.seeds < 1:
        raise ValueError(f"seeds={request.seeds}: a comparison needs at least 1 seed")
    if request.reference_spp < 2:
        raise ValueError(
            f"reference_spp={request.reference_spp}: each half of a reference needs at least 1"
            " sample per pixel"
        )


def _plan(request: Request) -> list[Plan]:
    """Return how the pictures of the first strategy will be rendered, from few samples to many."""
    jobs = [_job(request, request.strategies[0], spp) for spp in request.spp]
    # Whether there is a lamp of an id shows when the scene is loaded.
    jobs += [_job(request, name, request.spp[0]) for name in request.strategies[1:] if "=" in name]
    with LocalExecutor() as executor:
        return list(executor.map(RenderJob.plan, jobs))[: len(request.spp)]


def _job(request: Request, sampling: str, spp: int) -> RenderJob:
    strategy, grouping = split(sampling)
    return RenderJob(
        request.scene_file,
        request.parameters,
        variant(),
        strategy,
        spp,
        grouping=grouping,
        changes=request.changes,
    )
