"""Run a comparison: render what is missing, measure it, and gather the results."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..files import images
from ..files.lock import only_one
from ..rendering.changes import UNCHANGED, Changes
from ..rendering.executor import JobExecutor
from ..rendering.scene import parse_scene
from . import origin, results, tidying
from .album import Album
from .checks import Request, check
from .drawing.insets import Inset
from .gallery import Gallery, Stock, Task, settings
from .measuring import Pictures, Progress, measure, summarize
from .reference import render_reference
from .results import EQUAL_SAMPLES, EQUAL_TIME, Comparison
from .statistics import Spread
from .timing import FILE as TIMES
from .timing import (
    Key,
    TimedPair,
    Times,
    match_samples,
    overhead_in_samples,
    plan_turns,
    take_turns,
)

# Strategies and samples that are compared with each other, by their kind and the samples of the
# first one
Groups = dict[tuple[str, int], list[Key]]

LARGEST_HALF = 65504.0  # that half precision holds


def compare(
    scene_file: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    strategies: Sequence[str],
    spp: Sequence[int],
    reference_spp: int,
    seeds: int = 4,
    parameters: Mapping[str, str] | None = None,
    progress: Progress = lambda step, done, total: None,
    say: Callable[[str], None] = print,
    insets: Sequence[Inset] | None = None,
    finish: Callable[[Comparison], None] = lambda comparison: None,
    changes: Changes = UNCHANGED,
    executor: JobExecutor | None = None,
) -> Comparison:
    """
    Compare sampling strategies in a scene with a reference, at equal samples and at equal time.

    Pictures, the reference and the tables ``results.csv`` and ``results.json`` go to `folder`.
    What lies there already and was made with the same settings is not rendered again.

    Parameters
    ----------
    scene_file
        XML scene, rendered in the current variant with its own integrator.
    folder
        Output folder, made if needed.
    strategies
        Names for every ``ellipticalarea`` of the scene. The others are compared with the first.
        Lamps choose among themselves, unless ``+ungrouped`` follows the name. ``built-in`` is
        Mitsuba's own `area`, and ``ceiling=area+solid_angle`` chooses for the lamp of the id
        "ceiling" and for all others. The reference does not depend on it.
    spp
        Samples per pixel. At equal time, each strategy takes as many as take the time that the
        first strategy needs for these.
    reference_spp
        Samples per pixel of the reference, see :func:`mi_ellipse.study.reference.render_reference`.
    seeds
        Number of independent pictures of each kind.
    parameters
        Values for the scene's ``<default>`` parameters.
    progress, say
        Called with the progress of a step, and with sentences for the user.
    insets
        Regions that figures will enlarge. They are checked here, before hours of rendering.
    finish
        Called with the comparison while no other process can work in the folder.
    changes
        Of the scene, for all pictures and the reference.
    executor
        Where pictures and reference are rendered; by default in this process. Pictures are timed,
        so they are rendered alone on one machine; only the reference is spread.

    Raises
    ------
    ValueError
        For an unknown strategy, impossible counts or insets, a folder that another process works
        in or that was made from another scene; nothing is written then. For a picture with NaN or
        infinite pixels, or a black reference.
    """
    request = Request(
        Path(scene_file),
        Path(folder),
        tuple(dict.fromkeys(strategies)),
        tuple(sorted(set(spp))),
        reference_spp,
        seeds,
        dict(parameters or {}),
        insets,
        changes,
    )
    check(request)
    if changes.convert_lamps:
        say(f"{parse_scene(request.scene_file, request.parameters).conversion()}")
    request.folder.mkdir(parents=True, exist_ok=True)
    with only_one(request.folder):
        tidying.remove_remains(request.folder)
        for name in origin.claim(request.folder, origin.Origin.of(request)):
            say(f"{name} was damaged and is made again")
        comparison = _run(request, progress, say, executor)
        finish(comparison)
    return comparison


def _run(
    request: Request,
    progress: Progress,
    say: Callable[[str], None],
    executor: JobExecutor | None,
) -> Comparison:
    """Render and measure what was asked for, and write the results."""
    scene_file, parameters, folder = request.scene_file, request.parameters, request.folder
    strategies, spp = request.strategies, request.spp
    album = Album()
    gallery = Gallery(folder / "pictures", scene_file, parameters, album, request.changes, executor)
    times = Times(folder / TIMES, gallery.settings | {"machine": gallery.machine}, say)

    # Pictures come first: they show within seconds whether the scene renders at all.
    groups = {(EQUAL_SAMPLES, n): [(name, n) for name in strategies] for n in spp}
    pictures: Pictures = {}
    _fill(pictures, gallery, groups, request.seeds, times, progress, say)
    equal_time = {(EQUAL_TIME, n): _match(request, n, times) for n in spp}
    _fill(pictures, gallery, equal_time, request.seeds, times, progress, say)
    groups |= equal_time

    reference = render_reference(
        folder / "reference",
        scene_file,
        parameters,
        request.reference_spp,
        lambda done, total: progress("reference", done, total),
        say,
        executor=executor,
        album=album,
        changes=request.changes,
    )
    values = measure(folder, pictures, reference, album, progress, say)
    measurements = [
        one
        for (kind, _), keys in groups.items()
        for one in summarize(kind, keys, pictures, values, times)
    ]
    about = settings(scene_file, parameters, request.changes)
    comparison = Comparison(
        scene_file, parameters, folder, strategies, spp, request.seeds, about, gallery.machine,
        reference, tuple(measurements), album,
    )  # fmt: skip
    _write(comparison, say)
    return comparison


def _write(comparison: Comparison, say: Callable[[str], None]) -> None:
    """Write the results and the pictures to look at; put away the pictures of earlier runs."""
    results.write(comparison)
    kept = [picture.file for one in comparison.measurements for picture in one.pictures]
    kept += _write_pngs(comparison)
    kept += _write_parts(comparison)
    if moved := tidying.put_away(comparison.folder / "pictures", kept):
        say(f"Pictures of earlier runs: {moved} files were moved to {tidying.EARLIER}/pictures")


# ---- Pictures ----


def _fill(
    pictures: Pictures,
    gallery: Gallery,
    groups: Groups,
    seeds: int,
    times: Times,
    progress: Progress,
    say: Callable[[str], None],
) -> None:
    """Render the pictures and take the times that are missing; `pictures` gets the new ones."""
    step = next(iter(groups))[0]
    keys = {key for group in groups.values() for key in group} - set(pictures)
    tasks = {key: [Task(seed, *key) for seed in range(1, seeds + 1)] for key in sorted(keys)}
    stock = gallery.take_stock([task for group in tasks.values() for task in group])
    pairs = [
        TimedPair(kind, group[0], key, seed)
        for (kind, _), group in groups.items()
        for key in group
        for seed in range(1, seeds + 1)
    ]
    turns = list(plan_turns(pair for pair in pairs if pair not in times))
    timed = [task for turn in turns for task in turn.tasks]
    untimed = [task for task in stock.wanted if task not in set(timed)]
    _report(stock, untimed, step, say)
    done, total = 0, sum(task.spp for task in [*timed, *untimed])

    def count(task: Task) -> None:
        nonlocal done
        done += task.spp
        progress(step, done, total)

    if total:
        progress(step, 0, total)
    found = stock.pictures | take_turns(gallery, turns, times, stock.wanted, count)
    found |= gallery.render(untimed, count)
    pictures |= {key: tuple(found[task] for task in group) for key, group in tasks.items()}


def _report(stock: Stock, untimed: Sequence[Task], step: str, say: Callable[[str], None]) -> None:
    """Say which pictures are used again and which are not."""
    reused, total = len(stock.pictures), len(stock.pictures) + len(stock.wanted)
    if reused:
        say(f"Pictures at {step}: {reused} of {total} reused")
    if stock.outdated:
        count = len(stock.outdated)
        say(f"Pictures at {step}: {count} were made with other settings and are replaced")
    for task in stock.damaged:
        say(f"pictures/{task.name}.exr was damaged and is rendered again")
    # A picture whose time is known has been there; the others are new.
    for task in untimed:
        if task in stock.missing:
            say(f"pictures/{task.name}.exr was missing and is rendered again")


def _match(request: Request, count: int, times: Times) -> list[Key]:
    """Return each strategy with the samples that take as long as `count` ones of the first."""
    first = request.strategies[0]
    keys = [(first, count)]
    for name in request.strategies[1:]:
        paired = {
            n: [
                times[TimedPair(EQUAL_SAMPLES, (first, n), (name, n), seed)]
                for seed in range(1, request.seeds + 1)
            ]
            for n in request.spp
        }
        ratio = Spread.of([time.ratio for time in paired[count]]).median
        seconds = [Spread.of([time.timing.total for time in paired[n]]).median for n in paired]
        overhead = overhead_in_samples(request.spp, seconds)
        keys.append((name, match_samples(count, ratio, overhead)))
    return keys


def _write_pngs(comparison: Comparison) -> list[Path]:
    """Write the pictures of the first seed for the screen, all with the same exposure."""
    shown = {
        one.pictures[0].file.with_suffix(".png"): comparison.image(one)
        for one in comparison.measurements
    }
    for file, image in shown.items():
        images.write_png(file, image, comparison.exposure)
    return list(shown)


def _write_parts(comparison: Comparison) -> list[Path]:
    """
    Write one file a number of samples to step through in a viewer, in half precision.

    Its parts are the reference, the picture of each strategy at equal samples, and the difference
    (picture minus reference) of each.
    """
    reference = comparison.reference_image()
    files = []
    for spp in comparison.spp:
        shown = [comparison.find(EQUAL_SAMPLES, name, spp) for name in comparison.strategies]
        pictures = {one.sampling: comparison.image(one) for one in shown}
        differences = {f"{name}_difference": one - reference for name, one in pictures.items()}
        parts = {"reference": reference} | pictures | differences
        about = comparison.settings | {
            "scene": str(comparison.scene_file),
            "parameters": json.dumps(comparison.parameters),
            "spp": str(spp),
            "seed": str(shown[0].pictures[0].task.seed),
            "reference_spp": str(comparison.reference.spp),
        }
        # A lamp that is seen directly can be brighter than half precision reaches.
        half = all(np.abs(part).max() <= LARGEST_HALF for part in parts.values())
        file = comparison.folder / "pictures" / f"all_{spp}spp.exr"
        images.write_parts(file, parts, about, half=half)
        files.append(file)
    return files
