"""Options that several commands share, and how their texts are read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..files import atomic
from ..rendering.job import MAX_SEED, Changes
from ..rendering.rewrite import BUILT_IN
from ..sampling import STRATEGIES

# Below the options, because a column of the table is too narrow for the longest names
STRATEGIES_HELP = f"Strategies: {', '.join([*STRATEGIES, BUILT_IN])}. The last is Mitsuba's `area`."
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
Sensor = Annotated[
    str | None,
    typer.Option(metavar="ID", help="Sensor by its id or its number, from 0."),
]
Integrator = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Integrator instead of the scene's: path, prb, volpath, …"),
]
Resolution = Annotated[
    str | None,
    typer.Option(metavar="WxH", help="Width and height of the film in pixels, such as 640x480."),
]
ConvertLamps = Annotated[
    bool,
    typer.Option(
        "--convert-lamps",
        help="Turn each `area` on a `disk` or `sphere` into an `ellipticalarea`; the file stays.",
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


def parse_changes(
    convert_lamps: bool, sensor: str | None, integrator: str | None, resolution: str | None
) -> Changes:
    """Return what shall change in the scene."""
    if resolution is None:
        return Changes(convert_lamps, sensor, integrator)
    size = parse_size("--resolution", resolution)
    try:
        return Changes(convert_lamps, sensor, integrator, size)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None


def parse_size(option: str, text: str) -> tuple[int, int]:
    """Return two integers with an x between them."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isascii() and part.isdecimal() for part in parts):
        raise typer.BadParameter(f"{option} takes WxH, such as 640x480, not {text!r}")
    return int(parts[0]), int(parts[1])


def check_output(path: Path, suffix: str, what: str) -> None:
    """Raise a ValueError unless a file of this kind can be written."""
    if path.suffix.lower() != suffix:
        raise ValueError(f"{path}: the output is {what}, and its name ends in {suffix}")
    try:
        atomic.check_writable(path)
    except OSError as error:
        raise ValueError(f"cannot write {path}: {error.strerror or error}") from None


def parse_integers(option: str, text: str, length: int | None = None) -> list[int]:
    """Return positive or zero integers from a list with commas."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts) or length not in (None, len(parts)):
        wanted = f"{length} integers" if length else "integers"
        raise typer.BadParameter(f"{option} takes {wanted} with commas between, not {text!r}")
    return [int(part) for part in parts]
