"""Options that several commands share, and how their texts are read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..rendering.job import MAX_SEED

DEFAULT_VARIANT = "llvm_ad_rgb"
CLUSTER = "Beyond one process (needs mi_ellipse[cluster])"

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE.xml", help="Scene to render.")]
Variant = Annotated[str, typer.Option(help="Mitsuba variant.")]
Seed = Annotated[int, typer.Option(min=0, max=MAX_SEED, help="Seed of the samples.")]
Grouping = Annotated[
    bool,
    typer.Option(
        "--grouping/--no-grouping",
        help="Two or more lamps choose among themselves, or leave the choice to Mitsuba.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="tcp://HOST:PORT",
        help="Run on the Dask cluster of this scheduler.",
        rich_help_panel=CLUSTER,
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Run on N single-threaded processes of this machine.",
        rich_help_panel=CLUSTER,
    ),
]
Definitions = Annotated[
    list[str] | None,
    typer.Option("-D", "--define", metavar="NAME=VALUE", help="Value of a scene parameter."),
]
Insets = Annotated[
    list[str] | None,
    typer.Option(
        "--inset",
        metavar="X,Y,W,H",
        help="Region to enlarge, in pixels; by default where the strategies differ most.",
    ),
]


def parse_definitions(definitions: list[str] | None) -> dict[str, str]:
    """Return the values of scene parameters by their names."""
    parameters = {}
    for definition in definitions or []:
        name, equals, value = definition.partition("=")
        if not name or not equals:
            raise typer.BadParameter(f"-D takes NAME=VALUE, not {definition!r}")
        parameters[name] = value
    return parameters


def parse_insets(insets: list[str] | None) -> list[tuple[int, int, int, int]] | None:
    """Return the regions as left, top, width and height; None if the command shall choose."""
    regions = []
    for inset in insets or []:
        left, top, width, height = parse_integers("--inset", inset, 4)
        regions.append((left, top, width, height))
    return regions or None


def parse_integers(option: str, text: str, length: int | None = None) -> list[int]:
    """Return positive or zero integers from a list with commas."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts) or length not in (None, len(parts)):
        wanted = f"{length} integers" if length else "integers"
        raise typer.BadParameter(f"{option} takes {wanted} with commas between, not {text!r}")
    return [int(part) for part in parts]
