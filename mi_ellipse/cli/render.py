"""The command `mi-ellipse`."""

# Types such as `mi.Scene` exist only once a variant is set.
from __future__ import annotations

import platform
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import drjit as dr
import mitsuba as mi
import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from . import __version__, doctor, llvm, render
from .errors import innermost_cause
from .scene import load_scene

DEFAULT_VARIANT = "llvm_ad_rgb"

app = typer.Typer(
    help="Exact elliptical lights for Mitsuba 3.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the command line."""
    app()


@app.command("render")
def render_command(
    scene_file: Annotated[Path, typer.Argument(metavar="SCENE.xml", help="Scene to render.")],
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
    variant: Annotated[str, typer.Option(help="Mitsuba variant.")] = DEFAULT_VARIANT,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Seed of the samples.")] = 0,
    definitions: Annotated[
        list[str] | None,
        typer.Option("-D", "--define", metavar="NAME=VALUE", help="Value of a scene parameter."),
    ] = None,
) -> None:
    """Render a scene to an OpenEXR file, and a PNG beside it for a quick look."""
    parameters = _parse_definitions(definitions or [])
    exr = output or Path(scene_file.with_suffix(".exr").name)
    png = exr.with_suffix(".png")

    with _one_line_errors():
        if exr.suffix.lower() != ".exr":
            raise ValueError(f"{exr}: the output is an OpenEXR file, and its name ends in .exr")
        for file in (exr, png):
            _check_writable(file)
        with _interrupt_ends_process():
            mi.set_variant(variant)
            scene = load_scene(scene_file, parameters, sampling)
            rendering = _render_with_progress(scene, spp, seed)

        settings = render.describe(scene_file, rendering, seed, sampling, parameters)
        exposure = render.choose_exposure(rendering.image)
        settings["png_exposure_stops"] = str(exposure)
        render.write_exr(exr, rendering.image, settings, rendering.channels)
        render.write_png(png, rendering.image, exposure)

    print(
        f"{exr} and {png} ({exposure:+g} stops): {rendering.spp} spp,"
        f" {_count(rendering.passes, 'pass', 'passes')}, {rendering.seconds:.1f} s"
    )


@app.command("compare")
def compare_command(
    scene_file: Annotated[Path, typer.Argument(metavar="SCENE.xml", help="Scene to render.")],
    sampling: Annotated[
        str,
        typer.Option(metavar="NAME,…", help="Strategies; all are compared with the first."),
    ],
    spp: Annotated[str, typer.Option(metavar="N,…", help="Samples per pixel.")],
    reference_spp: Annotated[int, typer.Option(min=2, help="Samples per pixel of the reference.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for all that is made.")
    ],
    seeds: Annotated[
        int, typer.Option(min=1, help="Pictures of each kind, for the error of the errors.")
    ] = 4,
    variant: Annotated[str, typer.Option(help="Mitsuba variant.")] = DEFAULT_VARIANT,
    insets: Annotated[
        list[str] | None,
        typer.Option(
            "--inset",
            metavar="X,Y,W,H",
            help="Region to enlarge, in pixels; by default where the strategies differ most.",
        ),
    ] = None,
    definitions: Annotated[
        list[str] | None,
        typer.Option("-D", "--define", metavar="NAME=VALUE", help="Value of a scene parameter."),
    ] = None,
) -> None:
    """Compare sampling strategies: errors, times, figures and a report to look at."""
    parameters = _parse_definitions(definitions or [])
    counts = _parse_integers("--spp", spp)
    regions = [tuple(_parse_integers("--inset", inset, 4)) for inset in insets or []] or None

    with _one_line_errors(), _interrupt_ends_process():
        # Not with the other imports: drawing would make every command slow to start.
        from .study import compare, figures, report

        mi.set_variant(variant)
        output.mkdir(parents=True, exist_ok=True)
        console = Console(stderr=True)
        with _steps(console) as progress:
            strategies = [name.strip() for name in sampling.split(",")]
            comparison = compare(
                scene_file,
                output,
                strategies,
                counts,
                reference_spp,
                seeds,
                parameters,
                progress,
                console.print,
            )
        console.print("Drawing the figures and the report")
        figures.write_figures(comparison, regions)
        page = report.write_report(comparison, regions)

    for warning in comparison.warnings():
        console.print(f"WARNING: {warning}", style="bold red")
    print(f"{page}, {output / 'results.csv'}, {output / 'results.json'}, {output / 'figures'}")


@app.command("doctor")
def doctor_command() -> None:
    """Print versions, the LLVM in use and what can run; fail if llvm_ad_rgb cannot."""
    print(f"mi_ellipse  {__version__}")
    print(f"mitsuba     {mi.__version__}")
    print(f"drjit       {dr.__version__}")
    print(f"python      {platform.python_version()}")
    print(f"platform    {platform.platform()}")
    print(f"variants    {', '.join(mi.variants())}")

    trials = {name: doctor.try_variant(name) for name in doctor.representatives(mi.variants())}
    default = trials.get(DEFAULT_VARIANT)
    print(f"LLVM        {default.llvm if default and default.works else _llvm_that_fails()}")
    for trial in trials.values():
        print(f"{trial.variant:<11} {'works' if trial.works else 'fails: ' + trial.message}")

    if default is None or not default.works:
        raise typer.Exit(1)


# ---- Helpers ----


def _render_with_progress(scene: mi.Scene, spp: int | None, seed: int) -> render.Rendering:
    """Render with a progress bar, and say what the user would not expect."""
    console = Console(stderr=True)
    sizes = render.plan_passes(scene, spp)
    if spp is not None and sum(sizes) != spp:
        console.print(f"The scene's sampler makes {sum(sizes)} samples per pixel of {spp}.")
    if render.loses_stratification(scene, len(sizes)):
        console.print(
            f"Rendering in {len(sizes)} passes: its samples are less evenly spread, and the picture"
            " a little noisier, than in a single one."
        )

    with _progress_bar(console, len(sizes)) as report:
        rendering = render.render(scene, spp, seed, report)

    if rendering.invalid_pixels:
        console.print(
            f"WARNING: {_count(rendering.invalid_pixels, 'pixel is', 'pixels are')} NaN or infinite"
            " (black in the PNG).",
            style="bold red",
        )
    return rendering


@contextmanager
def _progress_bar(console: Console, passes: int) -> Iterator[Callable[[int, int], None]]:
    """
    Show a bar with the remaining time, or elapsed time alone where a single pass tells no more.

    Nothing is known about a pass before it ends.
    """
    columns = [SpinnerColumn(), TextColumn("Rendering"), TimeElapsedColumn()]
    if passes > 1:
        columns += [BarColumn(), MofNCompleteColumn(), TextColumn("passes,"), TimeRemainingColumn()]
        columns += [TextColumn("left")]
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        # An interrupt ends the process at once and must not leave a terminal without a cursor.
        console.show_cursor(True)
        task = bar.add_task("", total=passes if passes > 1 else None)
        yield lambda done, total: bar.update(task, completed=done)


@contextmanager
def _steps(console: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar with the remaining time for each step of a longer work."""
    columns = [
        TextColumn("{task.description:<13}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %,"),
    ]
    columns += [TimeRemainingColumn(), TextColumn("left")]
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        console.show_cursor(True)
        tasks = {}

        def report(step: str, done: int, total: int) -> None:
            if step not in tasks:
                tasks[step] = bars.add_task(step, total=total)
            bars.update(tasks[step], completed=done, total=total)

        yield report


@contextmanager
def _interrupt_ends_process() -> Iterator[None]:
    """
    Let Ctrl-C end the process at once.

    Python would notice it only when Mitsuba returns from rendering a pass, which can take hours;
    nothing has been written by then that would need cleaning up.
    """
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _one_line_errors() -> Iterator[None]:
    """Turn an exception into one line on stderr and exit code 1."""
    try:
        yield
    except Exception as error:
        print(f"mi-ellipse: {innermost_cause(error)}", file=sys.stderr)
        raise typer.Exit(1) from error


def _parse_definitions(definitions: list[str]) -> dict[str, str]:
    parameters = {}
    for definition in definitions:
        name, equals, value = definition.partition("=")
        if not name or not equals:
            raise typer.BadParameter(f"-D takes NAME=VALUE, not {definition!r}")
        parameters[name] = value
    return parameters


def _parse_integers(option: str, text: str, length: int | None = None) -> list[int]:
    """Return positive or zero integers from a list with commas."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts) or length not in (None, len(parts)):
        wanted = f"{length} integers" if length else "integers"
        raise typer.BadParameter(f"{option} takes {wanted} with commas between, not {text!r}")
    return [int(part) for part in parts]


def _check_writable(path: Path) -> None:
    try:
        render.check_writable(path)
    except OSError as error:
        raise ValueError(f"cannot write {path}: {error.strerror or error}") from None


def _llvm_that_fails() -> str:
    version = llvm.loaded_version()
    if version is None:
        return "none found"
    return f"{'.'.join(map(str, version))} ({llvm.loaded_library() or 'path unknown'})"


def _count(number: int, singular: str, plural: str) -> str:
    return f"{number} {singular if number == 1 else plural}"
