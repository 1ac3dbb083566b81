"""Run a comparison: render what is missing, measure it, and gather the results."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..files import images
from ..files.lock import only_one
from ..rendering.provenance import machine
from . import origin, results, tidying
from .album import Album
from .checks import Request, check
from .drawing.insets import Inset
from .gallery import Gallery, Stock, Task, settings
from .measuring import Key, Pictures, Progress, measure, median, summarize
from .reference import render_reference
from .results import EQUAL_SAMPLES, EQUAL_TIME, Comparison, Measurement

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
        Lamps choose among themselves, unless ``+ungrouped`` follows the name. The reference does
        not depend on it.
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
    )
    check(request)
    request.folder.mkdir(parents=True, exist_ok=True)
    with only_one(request.folder):
        tidying.remove_remains(request.folder)
        for name in origin.claim(request.folder, request.scene_file, request.parameters):
            say(f"{name} was damaged and is made again")
        comparison = _run(request, progress, say)
        finish(comparison)
    return comparison


def _run(request: Request, progress: Progress, say: Callable[[str], None]) -> Comparison:
    """Render and measure what was asked for, and write the results."""
    scene_file, parameters, folder = request.scene_file, request.parameters, request.folder
    strategies, spp, seeds = request.strategies, request.spp, request.seeds
    # Pictures come first: they show within seconds whether the scene renders at all.
    album = Album()
    gallery = Gallery(folder / "pictures", scene_file, parameters, album)
    grid = [(name, count) for name in strategies for count in spp]
    pictures = _fill(gallery, grid, seeds, EQUAL_SAMPLES, progress, say)
    matches = _match_times(strategies, spp, pictures)
    grid = [key for key in dict.fromkeys(matches.values()) if key not in pictures]
    pictures |= _fill(gallery, grid, seeds, EQUAL_TIME, progress, say)

    reference = render_reference(
        folder / "reference",
        scene_file,
        parameters,
        request.reference_spp,
        lambda done, total: progress("reference", done, total),
        say,
        album=album,
    )
    values = measure(folder, pictures, reference, album, progress, say)
    measurements: list[Measurement] = []
    for count in spp:
        keys = [(name, count) for name in strategies]
        measurements += summarize(EQUAL_SAMPLES, keys, pictures, values)
    for count in spp:
        keys = [matches[name, count] for name in strategies]
        measurements += summarize(EQUAL_TIME, keys, pictures, values)

    about = settings(scene_file, parameters)
    comparison = Comparison(
        scene_file, parameters, folder, strategies, spp, seeds, about, machine(), reference,
        tuple(measurements), album,
    )  # fmt: skip
    results.write(comparison)
    kept = [picture.file for group in pictures.values() for picture in group]
    kept += _write_pngs(comparison)
    kept += _write_parts(comparison)
    if moved := tidying.put_away(gallery.folder, kept):
        say(f"Pictures of earlier runs: {moved} files were moved to {tidying.EARLIER}/pictures")
    return comparison


def match_samples(seconds: float, spp: Sequence[int], measured: Sequence[float]) -> int:
    """
    Return the samples per pixel that take `seconds`.

    Parameters
    ----------
    seconds
        The time to match.
    spp, measured
        Samples per pixel and the seconds that they took. A line is fitted to them: part of the
        time is the same for any number of samples. From a single pair, time is proportional.
    """
    slope, offset = measured[-1] / spp[-1], 0.0
    if len(spp) > 1:
        fitted = np.polyfit(spp, measured, 1, w=1 / np.array(measured))
        if fitted[0] > 0:  # not so where the samples take no time worth mentioning
            slope, offset = fitted
    return max(1, round((seconds - offset) / slope))


# ---- Pictures ----


def _fill(
    gallery: Gallery,
    grid: Sequence[Key],
    seeds: int,
    step: str,
    progress: Progress,
    say: Callable[[str], None],
) -> Pictures:
    """Render the pictures that are missing, and return all of them."""
    tasks = {key: [Task(seed, *key) for seed in range(1, seeds + 1)] for key in grid}
    stock = gallery.take_stock([task for group in tasks.values() for task in group])
    _report_stock(stock, step, say)

    done, total = 0, sum(task.spp for task in stock.wanted)

    def count(task: Task) -> None:
        nonlocal done
        done += task.spp
        progress(step, done, total)

    found = stock.pictures
    if stock.wanted:
        progress(step, 0, total)
        found = found | gallery.render(stock.wanted, count)
    return {key: tuple(found[task] for task in group) for key, group in tasks.items()}


def _report_stock(stock: Stock, step: str, say: Callable[[str], None]) -> None:
    """Say which pictures are used again and which are not."""
    reused, total = len(stock.pictures), len(stock.pictures) + len(stock.wanted)
    if reused:
        say(f"Pictures at {step}: {reused} of {total} reused")
    if stock.outdated:
        count = len(stock.outdated)
        say(f"Pictures at {step}: {count} were made with other settings and are replaced")
    for task in stock.damaged:
        say(f"pictures/{task.name}.exr was damaged and is rendered again")
    # Where most of the pictures are missing, the run before was interrupted.
    if len(stock.missing) < reused:
        for task in stock.missing:
            say(f"pictures/{task.name}.exr is missing and is rendered")


def _match_times(
    strategies: Sequence[str], spp: Sequence[int], pictures: Pictures
) -> dict[Key, Key]:
    """Return, for each strategy and number of samples of the first one, those of equal time."""
    medians = {key: median(found, "total") for key, found in pictures.items()}
    first = strategies[0]
    matches = {(first, count): (first, count) for count in spp}
    for name in strategies[1:]:
        measured = [medians[name, count] for count in spp]
        for count in spp:
            matched = match_samples(medians[first, count], spp, measured)
            matches[name, count] = name, matched
    return matches


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
