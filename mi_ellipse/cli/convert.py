"""`mi-ellipse convert`: write a scene file anew, with its built-in lamps converted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..files import atomic
from ..rendering.converted_file import write_converted
from ..rendering.scene import set_variant
from .options import DEFAULT_VARIANT, Definitions, Variant, parse_definitions
from .process import one_line_errors


def run(
    scene_file: Annotated[
        Path, typer.Argument(metavar="SCENE.xml", help="Scene; it stays as it is.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="NEW.xml", help="New scene.")],
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a file that exists.")
    ] = False,
    variant: Variant = DEFAULT_VARIANT,
    definitions: Definitions = None,
) -> None:
    """Turn each `area` on a `disk` or `sphere` into an `ellipticalarea`, in a new scene file."""
    parameters = parse_definitions(definitions)
    with one_line_errors():
        set_variant(variant)
        try:
            atomic.check_writable(output)
        except OSError as error:
            raise ValueError(f"cannot write {output}: {error.strerror or error}") from None
        conversion = write_converted(scene_file, output, parameters, overwrite)
    print(f"{output}: {conversion}")
