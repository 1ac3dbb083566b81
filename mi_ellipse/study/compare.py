"""Run a comparison: render what is missing, measure it, and gather the results."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..files import atomic, images
from ..rendering.provenance import machine
from ..sampling import STRATEGIES
from .metrics import METRICS, errors, estimate, flip
from .pictures import Gallery, Picture, Task, read_exr, settings
from .reference import Reference, render_reference
from .results import EQUAL_SAMPLES, EQUAL_TIME, Comparison, Measurement, write_tables

EFFICIENCY_METRICS = ("mse", "mse_trimmed")

# Called with a step of the work, and how much of how much is done.
Progress = Callable[[str, int, int], None]


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

    Raises
    ------
    ValueError
        For an unknown strategy, a picture with NaN or infinite pixels, a black reference, or a
        folder that holds a reference with other settings.
    """
    scene_file, folder = Path(scene_file), Path(folder)
    strategies, spp = tuple(dict.fromkeys(strategies)), tuple(sorted(set(spp)))
    parameters = dict(parameters or {})
    _check(strategies, spp)

    # Pictures come first: they show within seconds whether the scene renders at all.
    gallery = Gallery(folder / "pictures", scene_file, parameters)
    grid = [(sampling, count) for sampling in strategies for count in spp]
    equal_samples = _fill(gallery, grid, seeds, EQUAL_SAMPLES, progress, say)
    matches = _match_times(strategies, spp, equal_samples)
    matching = dict.fromkeys((sampling, count) for (sampling, _), count in matches.items())
    grid = [key for key in matching if key not in equal_samples]
    equal_time = _fill(gallery, grid, seeds, EQUAL_TIME, progress, say)

    reference = render_reference(
        folder / "reference",
        scene_file,
        parameters,
        reference_spp,
        lambda done, total: progress("reference", done, total),
        say,
    )

    pictures = equal_samples | equal_time
    values = _measure(folder, pictures, reference, progress)
    measurements = [
        _summarize(kind, first_spp, pictures, values, key, (strategies[0], first_spp))
        for kind in (EQUAL_SAMPLES, EQUAL_TIME)
        for first_spp in spp
        for sampling in strategies
        for key in [
            (sampling, first_spp if kind == EQUAL_SAMPLES else matches[sampling, first_spp])
        ]
    ]
    comparison = Comparison(
        scene_file,
        parameters,
        folder,
        strategies,
        spp,
        seeds,
        settings(scene_file, parameters),
        machine(),
        reference,
        tuple(measurements),
    )
    write_tables(comparison)
    _write_pngs(comparison)
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
    spp, measured = np.array(spp, dtype=float), np.array(measured, dtype=float)
    slope, offset = measured[-1] / spp[-1], 0.0
    if len(spp) > 1:
        fitted = np.polyfit(spp, measured, 1, w=1 / measured)
        if fitted[0] > 0:  # not so where the samples take no time worth mentioning
            slope, offset = fitted
    return max(1, round((seconds - offset) / slope))


def _check(strategies: Sequence[str], spp: Sequence[int]) -> None:
    for sampling in strategies:
        if sampling not in STRATEGIES:
            known = ", ".join(STRATEGIES)
            raise ValueError(f'unknown sampling strategy "{sampling}"; known are: {known}')
    if not strategies or not spp or min(spp) < 1:
        raise ValueError("a comparison needs a strategy and numbers of samples of at least 1")


# ---- Pictures ----

# Strategy and samples per pixel, and one picture a seed.
Pictures = dict[tuple[str, int], tuple[Picture, ...]]


def _fill(
    gallery: Gallery,
    grid: Sequence[tuple[str, int]],
    seeds: int,
    step: str,
    progress: Progress,
    say: Callable[[str], None],
) -> Pictures:
    """Render the pictures that are missing, and return all of them."""
    tasks = [Task(seed, sampling, spp) for sampling, spp in grid for seed in range(1, seeds + 1)]
    missing = [task for task in tasks if gallery.find(task) is None]
    if len(missing) < len(tasks):
        say(f"Pictures at {step}: {len(tasks) - len(missing)} of {len(tasks)} reused")
    if outdated := sum(gallery.holds(task) for task in missing):
        say(f"Pictures at {step}: {outdated} were made with other settings and are replaced")

    done, total = 0, sum(task.spp for task in missing)

    def count(task: Task) -> None:
        nonlocal done
        done += task.spp
        progress(step, done, total)

    if missing:
        progress(step, 0, total)
        gallery.render(missing, count)
    return {
        (sampling, spp): tuple(
            gallery.find(Task(seed, sampling, spp)) for seed in range(1, seeds + 1)
        )
        for sampling, spp in grid
    }


def _match_times(
    strategies: Sequence[str], spp: Sequence[int], pictures: Pictures
) -> dict[tuple[str, int], int]:
    """Return, for each strategy and number of samples of the first one, those of equal time."""
    medians = {key: _median(found, "total") for key, found in pictures.items()}
    first = strategies[0]
    matches = {(first, count): count for count in spp}
    for sampling in strategies[1:]:
        measured = [medians[sampling, count] for count in spp]
        for count in spp:
            matches[sampling, count] = match_samples(medians[first, count], spp, measured)
    return matches


def _median(pictures: Sequence[Picture], part: str) -> float:
    return float(np.median([getattr(picture.timing, part) for picture in pictures]))


def _write_pngs(comparison: Comparison) -> None:
    """Write the pictures of the first seed for the screen, all with the same exposure."""
    exposure = comparison.exposure
    for measurement in comparison.measurements:
        file = measurement.pictures[0].file
        images.write_png(file.with_suffix(".png"), comparison.image(measurement), exposure)


# ---- Measurements ----

# Metric and its values, one a seed.
Values = dict[str, tuple[float, ...]]


def _measure(
    folder: Path, pictures: Pictures, reference: Reference, progress: Progress
) -> dict[tuple[str, int], Values]:
    """Measure all pictures; HDR-FLIP, which takes seconds a picture, only where it is not known."""
    truth = read_exr(reference.file)
    known_file = folder / "flip.json"
    known = json.loads(known_file.read_text()) if known_file.exists() else {}
    reference_bytes = reference.file.read_bytes()

    total = sum(len(group) for group in pictures.values())
    done, result = 0, {}
    for key, group in pictures.items():
        measured = []
        for picture in group:
            image = read_exr(picture.file)
            digest = hashlib.sha256(reference_bytes + picture.file.read_bytes()).hexdigest()
            if digest not in known:
                known[digest] = flip(image, truth)
            measured.append(errors(image, truth) | {"flip": known[digest]})
            done += 1
            progress("metrics", done, total)
        result[key] = {metric: tuple(one[metric] for one in measured) for metric in METRICS}
        with atomic.replacement(known_file) as temporary:
            temporary.write_text(json.dumps(known))
    return result


def _summarize(
    kind: str,
    first_spp: int,
    pictures: Pictures,
    values: Mapping[tuple[str, int], Values],
    key: tuple[str, int],
    first: tuple[str, int],
) -> Measurement:
    """Gather what is known of the strategy and samples `key`, compared with those of `first`."""
    group, first_group = pictures[key], pictures[first]
    means = {metric: estimate(values[key][metric]) for metric in METRICS}
    seconds, first_seconds = _median(group, "total"), _median(first_group, "total")
    efficiency = {}
    for metric in EFFICIENCY_METRICS:
        first_error = estimate(values[first][metric]).mean
        efficiency[metric] = first_error * first_seconds / (means[metric].mean * seconds)
    return Measurement(
        kind=kind,
        sampling=key[0],
        spp=key[1],
        first_spp=first_spp,
        pictures=group,
        values=values[key],
        errors=means,
        seconds=seconds,
        tracing_seconds=_median(group, "tracing"),
        execution_seconds=_median(group, "execution"),
        compilation_seconds=max(one.warm_up.compilation for one in group),
        efficiency=efficiency,
    )
