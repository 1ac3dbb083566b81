"""`mi-ellipse compare`: compare sampling strategies in a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..rendering.scene import set_variant
from .options import (
    DEFAULT_VARIANT,
    ConvertLamps,
    Definitions,
    Grouping,
    Insets,
    Integrator,
    Resolution,
    SceneFile,
    Scheduler,
    Sensor,
    Variant,
    Workers,
    parse_changes,
    parse_definitions,
    parse_insets,
    parse_integers,
)
from .places import interruptible, place
from .process import one_line_errors
from .progress import step_bars
from .report import draw


def run(
    scene_file: SceneFile,
    sampling: Annotated[
        str,
        typer.Option(
            metavar="NAME,…",
            help="Strategies; all are compared with the first. `ID=NAME+NAME` chooses for the lamp"
            " of an id and for the others. `NAME+ungrouped` leaves the choice of the lamp to"
            " Mitsuba. The names stand below.",
        ),
    ],
    spp: Annotated[str, typer.Option(metavar="N,…", help="Samples per pixel.")],
    reference_spp: Annotated[int, typer.Option(min=2, help="Samples per pixel of the reference.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for all that is made.")
    ],
    seeds: Annotated[
        int, typer.Option(min=1, help="Pictures of each kind, for the error of the errors.")
    ] = 4,
    variant: Variant = DEFAULT_VARIANT,
    grouping: Grouping = True,
    convert_lamps: ConvertLamps = False,
    sensor: Sensor = None,
    integrator: Integrator = None,
    resolution: Resolution = None,
    insets: Insets = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    definitions: Definitions = None,
) -> None:
    """Compare sampling strategies: errors, times, figures and a report to look at."""
    parameters = parse_definitions(definitions)
    changes = parse_changes(convert_lamps, sensor, integrator, resolution)
    counts = parse_integers("--spp", spp)
    regions = parse_insets(insets)
    strategies = [name.strip() for name in sampling.split(",")]

    console = Console(stderr=True)
    with one_line_errors(), place(scheduler, workers, console) as executor, interruptible(executor):
        # Not with the other imports: drawing would make every command slow to start.
        from ..study import compare
        from ..study.kinds import ungrouped

        if not grouping:
            strategies = [ungrouped(name) for name in strategies]
        set_variant(variant)
        with step_bars(console) as progress:
            compare(
                scene_file,
                output,
                strategies,
                counts,
                reference_spp,
                seeds,
                parameters,
                progress,
                lambda text: console.print(text, markup=False, highlight=False, soft_wrap=True),
                regions,
                lambda comparison: draw(comparison, regions, console, progress),
                changes,
                executor,
            )
    names = ("report.html", "results.csv", "results.json", "figures")
    print(", ".join(str(output / name) for name in names))
