"""The command `mi-ellipse`, a file for each of its commands."""

from __future__ import annotations

from typing import Annotated

import typer

from .. import __version__
from . import compare, convert, doctor, illuminance, render, report
from .options import STRATEGIES_HELP
from .process import plain_log

app = typer.Typer(
    help="Exact elliptical lights for Mitsuba 3.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("render", epilog=STRATEGIES_HELP)(render.run)
app.command("compare", epilog=STRATEGIES_HELP)(compare.run)
app.command("illuminance")(illuminance.run)
app.command("convert")(convert.run)
app.command("report")(report.run)
app.command("doctor")(doctor.run)


def main() -> None:
    """Run the command line."""
    app()


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"mi-ellipse {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and stop."
        ),
    ] = False,
) -> None:
    """Take the options that stand before a command, and set up what all commands share."""
    context.with_resource(plain_log())
