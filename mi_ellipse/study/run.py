"""Run a comparison: render what is missing, measure it, and gather the results."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..files import images
from ..rendering.changes import UNCHANGED, Changes
from ..rendering.executor import JobExecutor
from ..rendering.job import MAX_SPP
from ..rendering.rewrite import check_choice
from ..rendering.scene import parse_scene
from . import results
from .album import Album
from .gallery import Gallery, Task, settings
from .kinds import split
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
    changes
        Of the scene, for all pictures and the reference.
    executor
        Where pictures and reference are rendered; by default in this process. Pictures are timed,
        so they are rendered alone on one machine; only the reference is spread.

    Raises
    ------
    ValueError
        For an unknown strategy, a picture with NaN or infinite pixels, a black reference, or a
        folder that holds a reference with other settings.
    """
    scene_file, folder, parameters = Path(scene_file), Path(folder), dict(parameters or {})
    strategies, spp = tuple(dict.fromkeys(strategies)), tuple(sorted(set(spp)))
    _check(strategies, spp, reference_spp)
    if changes.convert_lamps:
        say(f"{parse_scene(scene_file, parameters).conversion()}")

    # Pictures come first: they show within seconds whether the scene renders at all.
    gallery = Gallery(folder / "pictures", scene_file, parameters, changes, executor)
    grid = [(name, count) for name in strategies for count in spp]
    pictures = _fill(gallery, grid, seeds, EQUAL_SAMPLES, progress, say)
    matches = _match_times(strategies, spp, pictures)
    grid = [key for key in dict.fromkeys(matches.values()) if key not in pictures]
    pictures |= _fill(gallery, grid, seeds, EQUAL_TIME, progress, say)

    album = Album()
    reference = render_reference(
        folder / "reference",
        scene_file,
        parameters,
        reference_spp,
        lambda done, total: progress("reference", done, total),
        say,
        executor=executor,
        album=album,
        changes=changes,
    )
    values = measure(folder, pictures, reference, album, progress)
    measurements: list[Measurement] = []
    for count in spp:
        keys = [(name, count) for name in strategies]
        measurements += summarize(EQUAL_SAMPLES, keys, pictures, values)
    for count in spp:
        keys = [matches[name, count] for name in strategies]
        measurements += summarize(EQUAL_TIME, keys, pictures, values)

    about = settings(scene_file, parameters, changes)
    comparison = Comparison(
        scene_file, parameters, folder, strategies, spp, seeds, about, gallery.machine, reference,
        tuple(measurements), album,
    )  # fmt: skip
    results.write(comparison)
    _write_pngs(comparison)
    _write_parts(comparison)
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


def _check(strategies: Sequence[str], spp: Sequence[int], reference_spp: int) -> None:
    for name in strategies:
        check_choice(split(name)[0])
    if not strategies or not spp:
        raise ValueError("a comparison needs a strategy and a number of samples per pixel")
    for count in (*spp, reference_spp):
        if not 1 <= count <= MAX_SPP:
            raise ValueError(f"spp={count}: samples per pixel are from 1 to {MAX_SPP}")


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
    wanted = [task for group in tasks.values() for task in group]
    found = {task: picture for task in wanted if (picture := gallery.find(task)) is not None}
    missing = [task for task in wanted if task not in found]
    if found:
        say(f"Pictures at {step}: {len(found)} of {len(wanted)} reused")
    if outdated := sum(gallery.holds(task) for task in missing):
        say(f"Pictures at {step}: {outdated} were made with other settings and are replaced")

    done, total = 0, sum(task.spp for task in missing)

    def count(task: Task) -> None:
        nonlocal done
        done += task.spp
        progress(step, done, total)

    if missing:
        progress(step, 0, total)
        found |= gallery.render(missing, count)
    return {key: tuple(found[task] for task in group) for key, group in tasks.items()}


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


def _write_pngs(comparison: Comparison) -> None:
    """Write the pictures of the first seed for the screen, all with the same exposure."""
    shown = {one.pictures[0].file: comparison.image(one) for one in comparison.measurements}
    for file, image in shown.items():
        images.write_png(file.with_suffix(".png"), image, comparison.exposure)


def _write_parts(comparison: Comparison) -> None:
    """
    Write one file a number of samples to step through in a viewer, in half precision.

    Its parts are the reference, the picture of each strategy at equal samples, and the difference
    (picture minus reference) of each.
    """
    reference = comparison.reference_image()
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
