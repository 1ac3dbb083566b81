"""`mi-ellipse render`: render a scene to a picture that says how it was made."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import mitsuba as mi
import typer
from rich.console import Console

from ..files import atomic, images
from ..rendering import division, provenance
from ..rendering.executor import JobExecutor, LocalExecutor
from ..rendering.job import Plan, Rendering, RenderJob
from ..rendering.scene import parse_scene
from .options import (
    DEFAULT_VARIANT,
    ConvertLamps,
    Definitions,
    Grouping,
    Integrator,
    Resolution,
    SceneFile,
    Scheduler,
    Seed,
    Variant,
    Workers,
    parse_changes,
    parse_definitions,
)
from .places import interruptible, place
from .process import one_line_errors
from .progress import passes_bar

ALL = "all"  # Instead of the id of a sensor


def run(
    scene_file: SceneFile,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="OpenEXR file; by default SCENE.exr, right here."),
    ] = None,
    spp: Annotated[
        int | None, typer.Option(min=1, help="Samples per pixel; by default the scene's.")
    ] = None,
    sampling: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Sampling strategy of every `ellipticalarea`, or ID=NAME,… for single ones by"
            " their ids. The names stand below.",
        ),
    ] = None,
    variant: Variant = DEFAULT_VARIANT,
    seed: Seed = 0,
    half: Annotated[
        bool, typer.Option("--half", help="Store half instead of single precision.")
    ] = False,
    grouping: Grouping = True,
    pass_spp: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Samples per pixel of a pass. By default there are as few passes as possible, and"
            f" on a cluster passes of {division.SAMPLES_PER_PASS / 1e6:.0f} million samples.",
        ),
    ] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    convert_lamps: ConvertLamps = False,
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Sensor by its id or its number, from 0, or `all`: a picture for each, with the"
            " sensor in its name. By default the first.",
        ),
    ] = None,
    integrator: Integrator = None,
    resolution: Resolution = None,
    definitions: Definitions = None,
) -> None:
    """Render a scene to an OpenEXR file, and a PNG beside it for a quick look."""
    parameters = parse_definitions(definitions)
    changes = parse_changes(convert_lamps, sensor, integrator, resolution)
    exr = output or Path(scene_file.with_suffix(".exr").name)

    with one_line_errors():
        if exr.suffix.lower() != ".exr":
            raise ValueError(f"{exr}: the output is an OpenEXR file, and its name ends in .exr")
        job = RenderJob(
            scene_file,
            parameters,
            variant,
            sampling,
            spp,
            seed,
            grouping=grouping,
            changes=changes,
            pass_spp=pass_spp,
        )
        jobs = _for_each_sensor(job, exr) if sensor == ALL else {exr: job}
        for file in jobs:
            _check_writable(file)
            _check_writable(file.with_suffix(".png"))
        with place(scheduler, workers, Console(stderr=True)) as executor:
            for file, one in jobs.items():
                if pass_spp is None:
                    one = division.with_passes(one, executor)
                _make_picture(one, file, half, executor)


def _for_each_sensor(job: RenderJob, exr: Path) -> dict[Path, RenderJob]:
    """Return a job for each sensor of a scene, and where its picture goes."""
    mi.set_variant(job.variant)
    jobs = {}
    for number, name in enumerate(parse_scene(job.scene, job.parameters).sensors()):
        # An id can hold characters that no file name may.
        file = exr.with_name(f"{exr.stem}_{quote(name, safe='')}{exr.suffix}")
        if file in jobs:  # The id of one sensor is the number of another one.
            file = exr.with_name(f"{exr.stem}_number_{number}{exr.suffix}")
        changes = dataclasses.replace(job.changes, sensor=str(number))
        jobs[file] = dataclasses.replace(job, changes=changes)
    if not jobs:
        raise ValueError(f"{job.scene}: the scene has no sensor")
    return jobs


def _make_picture(job: RenderJob, exr: Path, half: bool, executor: JobExecutor) -> None:
    """Render, write the OpenEXR file and the PNG, and say so."""
    png = exr.with_suffix(".png")
    with interruptible(executor):
        rendering = _render(job, executor)

    exposure = images.choose_exposure(rendering.image)
    settings: images.Metadata = {
        **provenance.describe(job, rendering),
        "png_exposure_stops": exposure,
    }
    if half and not images.fits_half(rendering.image):
        # After hours of rendering, an error would come too late.
        print("Stored in single precision: half precision ends at 65504.", file=sys.stderr)
        half = False
    images.write_exr(exr, rendering.image, settings, rendering.channels, half)
    images.write_png(png, rendering.image, exposure)
    print(
        f"{exr} and {png} ({exposure:+g} stops): {rendering.spp} spp,"
        f" {_count(rendering.passes, 'pass', 'passes')}, {rendering.seconds:.1f} s"
    )


def _render(job: RenderJob, executor: JobExecutor) -> Rendering:
    """Render with a progress bar, and say what the user would not expect."""
    console = Console(stderr=True)
    plan = executor.submit(job.plan).result()
    _announce(job, plan, console)
    with passes_bar(console, len(plan.sizes)) as progress:
        if isinstance(executor, LocalExecutor):
            rendering = executor.submit(job.run, progress).result()
        else:
            rendering = division.render(job, plan.sizes, executor, progress)

    if rendering.invalid_pixels:
        console.print(
            f"WARNING: {_count(rendering.invalid_pixels, 'pixel is', 'pixels are')} NaN or infinite"
            " (black in the PNG).",
            style="bold red",
        )
    return rendering


def _announce(job: RenderJob, plan: Plan, console: Console) -> None:
    if plan.conversion is not None:
        console.print(str(plan.conversion), markup=False, highlight=False, soft_wrap=True)
    if job.changes.sensor is None and len(plan.sensors) > 1:
        console.print(
            f"The scene has {len(plan.sensors)} sensors ({', '.join(plan.sensors)}), and the first"
            " is rendered: --sensor chooses another one, or all.",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    if job.spp is not None and plan.spp != job.spp:
        console.print(f"The scene's sampler makes {plan.spp} samples per pixel of {job.spp}.")
    if plan.loses_stratification:
        console.print(
            f"Rendering in {len(plan.sizes)} passes: its samples are less evenly spread, and the"
            " picture a little noisier, than in a single one."
        )


def _check_writable(path: Path) -> None:
    try:
        atomic.check_writable(path)
    except OSError as error:
        raise ValueError(f"cannot write {path}: {error.strerror or error}") from None


def _count(number: int, singular: str, plural: str) -> str:
    return f"{number} {singular if number == 1 else plural}"
