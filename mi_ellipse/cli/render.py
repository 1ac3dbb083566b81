"""`mi-ellipse render`: render a scene to a picture that says how it was made."""

from __future__ import annotations

import dataclasses
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer
from rich.console import Console

from ..files import images
from ..rendering import division, partial, provenance
from ..rendering.executor import JobExecutor, LocalExecutor
from ..rendering.job import Plan, Rendering, RenderJob
from ..rendering.passes import Finished, Stop
from ..rendering.scene import check_scene_file, parse_scene, set_variant
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
    check_output,
    parse_changes,
    parse_definitions,
)
from .places import interruptible, place
from .process import INTERRUPTED, interrupt_ends_pass, one_line_errors
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
    keep_partial: Annotated[
        bool,
        typer.Option(
            "--keep-partial",
            help="Let Ctrl-C end the render after a pass and write what is finished. The same"
            " command continues it.",
        ),
    ] = False,
    scheduler: Scheduler = None,
    workers: Workers = None,
    definitions: Definitions = None,
) -> None:
    """Render a scene to an OpenEXR file, and a PNG beside it for a quick look."""
    parameters = parse_definitions(definitions)
    changes = parse_changes(convert_lamps, sensor, integrator, resolution)

    with one_line_errors():
        check_scene_file(scene_file)
        exr = output or Path(f"{scene_file.stem}.exr")
        check_output(exr, ".exr", "an OpenEXR file")
        job = RenderJob(
            scene_file,
            parameters,
            variant,
            sampling,
            spp,
            seed,
            short_passes=True,
            grouping=grouping,
            changes=changes,
        )
        jobs = _for_each_sensor(job, exr) if sensor == ALL else {exr: job}
        for file in jobs:
            check_output(file, ".exr", "an OpenEXR file")
            check_output(file.with_suffix(".png"), ".png", "a PNG")
        with place(scheduler, workers, Console(stderr=True)) as executor:
            for file, one in jobs.items():
                _make_picture(one, file, half, keep_partial, executor)


def _for_each_sensor(job: RenderJob, exr: Path) -> dict[Path, RenderJob]:
    """Return a job for each sensor of a scene, and where its picture goes."""
    set_variant(job.variant)
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


def _make_picture(
    job: RenderJob, exr: Path, half: bool, keep_partial: bool, executor: JobExecutor
) -> None:
    """Render, write the OpenEXR file and the PNG, and say so."""
    png = exr.with_suffix(".png")
    plan, rendering = _render(job, exr, keep_partial, executor)
    exposure = images.choose_exposure(rendering.image)
    if rendering.unfinished is not None:
        partial.write(exr, job, plan, rendering)
    else:
        _write_exr(exr, job, rendering, exposure, half)
    images.write_png(png, rendering.image, exposure)
    print(
        f"{exr} and {png} ({exposure:+g} stops): {rendering.spp} spp,"
        f" {_count(rendering.passes, 'pass', 'passes')}, {rendering.seconds:.1f} s"
    )
    if rendering.unfinished is not None:
        print(
            f"Interrupted: {rendering.spp} of {plan.spp} samples per pixel are in the file. The"
            " same command continues from there.",
            file=sys.stderr,
        )
        raise typer.Exit(INTERRUPTED)


def _write_exr(
    exr: Path, job: RenderJob, rendering: Rendering, exposure: float, half: bool
) -> None:
    settings: images.Metadata = {
        **provenance.describe(job, rendering),
        "png_exposure_stops": exposure,
    }
    if half and not images.fits_half(rendering.image):
        # After hours of rendering, an error would come too late.
        print("Stored in single precision: half precision ends at 65504.", file=sys.stderr)
        half = False
    images.write_exr(exr, rendering.image, settings, rendering.channels, half)


def _render(
    job: RenderJob, exr: Path, keep_partial: bool, executor: JobExecutor
) -> tuple[Plan, Rendering]:
    """Render what the file does not hold yet, and say what the user would not expect."""
    console = Console(stderr=True)
    with ExitStack() as stack:
        stack.enter_context(interruptible(executor))
        plan = executor.submit(job.plan).result()
        before = partial.read(exr, job, plan)
        _announce(job, plan, before, executor, console)
        stop: Stop = lambda: False  # noqa: E731
        if keep_partial and len(plan.sizes) > 1:
            stop = stack.enter_context(interrupt_ends_pass(console.print))
        elif keep_partial:
            console.print("Rendering in one pass: Ctrl-C ends at once and keeps nothing.")
        progress = stack.enter_context(passes_bar(console, len(plan.sizes), before.passes))
        if isinstance(executor, LocalExecutor):
            rendering = executor.submit(job.run, progress, before, stop).result()
        else:
            rendering = division.render(job, plan.sizes, executor, progress, before, stop)

    if rendering.invalid_pixels:
        console.print(
            f"WARNING: {_count(rendering.invalid_pixels, 'pixel is', 'pixels are')} NaN or infinite"
            " (black in the PNG).",
            style="bold red",
        )
    return plan, rendering


def _announce(
    job: RenderJob, plan: Plan, before: Finished, executor: JobExecutor, console: Console
) -> None:
    if before.passes:
        console.print(f"Continued from {before.spp} of {plan.spp} samples per pixel.")
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
    if len(plan.sizes) == 1 and not isinstance(executor, LocalExecutor):
        console.print("Rendering in one pass, which one worker renders.")
    if plan.loses_stratification:
        console.print(
            f"Rendering in {len(plan.sizes)} passes: its samples are less evenly spread, and the"
            " picture a little noisier, than in a single one."
        )


def _count(number: int, singular: str, plural: str) -> str:
    return f"{number} {singular if number == 1 else plural}"
