"""`mi-ellipse illuminance`: direct illuminance on a plane, as a lighting report has it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ..lighting.plane import read_plane
from ..lighting.report import measure, steps, summary, write_csv
from ..plugins.grouping import group_lamps
from ..rendering.changes import Changes
from ..rendering.scene import check_scene_file, instantiate, parse_scene, set_variant
from .options import (
    DEFAULT_VARIANT,
    ConvertLamps,
    Definitions,
    Grouping,
    SceneFile,
    Seed,
    Variant,
    check_output,
    parse_definitions,
    parse_size,
)
from .process import interrupt_ends_process, one_line_errors
from .progress import passes_bar


def run(
    scene_file: SceneFile,
    plane: Annotated[
        str,
        typer.Option(
            metavar="PLANE",
            help="z=HEIGHT (or x, y), as wide as the scene; or nine numbers with commas: a corner"
            " and the two edges from it.",
        ),
    ],
    grid: Annotated[
        str, typer.Option(metavar="NxM", help="Points along the first and the second edge.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="LUX.csv", help="Table; the plot lies beside.")
    ],
    samples: Annotated[int, typer.Option(min=1, help="Light samples of a point.")] = 1024,
    flip: Annotated[
        bool, typer.Option("--flip", help="Measure on the other side of the plane.")
    ] = False,
    efficacy: Annotated[
        float,
        typer.Option(
            metavar="LM/W",
            help="Lumens per watt, where the lamps of the scene are in watts; 1 where they are in"
            " lumens or cd/m².",
        ),
    ] = 1.0,
    variant: Variant = DEFAULT_VARIANT,
    seed: Seed = 0,
    grouping: Grouping = True,
    convert_lamps: ConvertLamps = False,
    definitions: Definitions = None,
) -> None:
    """Measure direct illuminance on a plane: a table, a plot with isolines, and a summary."""
    parameters = parse_definitions(definitions)
    columns, rows = parse_size("--grid", grid)
    plot = output.with_suffix(".png") if output.name else output

    with one_line_errors(), interrupt_ends_process():
        # Not with the other imports: drawing would make every command slow to start.
        from ..lighting.plot import write_plot

        check_scene_file(scene_file)
        check_output(output, ".csv", "a table")
        check_output(plot, ".png", "the plot")
        set_variant(variant)
        parsed = parse_scene(scene_file, parameters)
        console = Console(stderr=True)
        if convert_lamps:
            console.print(str(parsed.conversion()), markup=False, highlight=False, soft_wrap=True)
        scene = instantiate(parsed, changes=Changes(convert_lamps))
        if grouping:
            group_lamps(scene)
        box = scene.bbox()
        where = read_plane(plane, list(box.min), list(box.max))
        with passes_bar(console, steps(columns, rows, samples)) as progress:
            found = measure(
                scene,
                where.flipped() if flip else where,
                columns,
                rows,
                samples,
                seed,
                efficacy,
                progress,
            )
        write_csv(output, found)
        write_plot(plot, found)
    print(summary(found))
    print(f"{output} and {plot}: direct light alone, {samples} samples a point")
