"""`mi-ellipse report`: draw the figures and the report of a comparison again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from ..files.lock import only_one
from .options import Insets, parse_insets
from .process import interrupt_ends_process, one_line_errors
from .progress import step_bars
from .summary import print_summary

if TYPE_CHECKING:
    from ..study.results import Comparison


def run(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a finished comparison.")],
    insets: Insets = None,
) -> None:
    """Make the figures and the report of a finished comparison, without rendering."""
    regions = parse_insets(insets)
    with one_line_errors(), interrupt_ends_process():
        # Not with the other imports: drawing would make every command slow to start.
        from ..study import results

        comparison = results.read(folder)
        console = Console(stderr=True)
        with only_one(folder), step_bars(console) as progress:
            draw(comparison, regions, console, progress)
    print(f"{folder / 'report.html'}, {folder / 'figures'}")


def draw(
    comparison: Comparison,
    insets: list[tuple[int, int, int, int]] | None,
    console: Console,
    progress: Callable[[str, int, int], None],
) -> None:
    """Write the figures and the report of a comparison, and print its numbers and warnings."""
    from ..study import drawing, report

    figures = drawing.write_figures(comparison, insets, progress)
    report.write_report(comparison, insets, figures)
    print_summary(comparison, console)
    for warning in comparison.warnings():
        console.print(f"WARNING: {warning}", style="bold red")
