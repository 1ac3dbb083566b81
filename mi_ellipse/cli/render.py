"""`mi-ellipse render`: render a scene to a picture that says how it was made."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..files import atomic, images
from ..rendering import division, provenance
from ..rendering.executor import JobExecutor, LocalExecutor
from ..rendering.job import Plan, Rendering, RenderJob
from .options import (
    DEFAULT_VARIANT,
    Definitions,
    Grouping,
    SceneFile,
    Scheduler,
    Seed,
    Variant,
    Workers,
    parse_definitions,
)
from .places import place
from .process import one_line_errors
from .progress import passes_bar


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
        str | None, typer.Option(help="Sampling strategy of every `ellipticalarea`.")
    ] = None,
    variant: Variant = DEFAULT_VARIANT,
    seed: Seed = 0,
    half: Annotated[
        bool, typer.Option("--half", help="Store half instead of single precision.")
    ] = False,
    grouping: Grouping = True,
    passes: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Passes at least; by default as few as possible, on a cluster as many as hold"
            f" {division.SAMPLES_PER_PASS / 1e6:.0f} million samples each.",
        ),
    ] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    definitions: Definitions = None,
) -> None:
    """Render a scene to an OpenEXR file, and a PNG beside it for a quick look."""
    parameters = parse_definitions(definitions)
    exr = output or Path(scene_file.with_suffix(".exr").name)
    png = exr.with_suffix(".png")

    with one_line_errors():
        if exr.suffix.lower() != ".exr":
            raise ValueError(f"{exr}: the output is an OpenEXR file, and its name ends in .exr")
        for file in (exr, png):
            _check_writable(file)
        job = RenderJob(
            scene_file,
            parameters,
            variant,
            sampling,
            spp,
            seed,
            grouping=grouping,
            passes=passes or 1,
        )
        console = Console(stderr=True)
        with place(scheduler, workers, console) as executor:
            rendering = _render(job, executor, passes is None, console)

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


def _render(job: RenderJob, executor: JobExecutor, is_free: bool, console: Console) -> Rendering:
    """Render with a progress bar, and say what the user would not expect."""
    plan = executor.submit(job.plan).result()
    is_local = isinstance(executor, LocalExecutor)
    if is_free and not is_local:
        job = division.with_passes_for_a_cluster(job, plan)
        plan = executor.submit(job.plan).result()
    _announce(job, plan, console)
    with passes_bar(console, len(plan.sizes)) as progress:
        if is_local:
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
