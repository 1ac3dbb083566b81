"""Draw a comparison for a paper: grids of pictures, and curves of time and error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure

from ...files import atomic
from ..measuring import Progress
from ..results import EQUAL_SAMPLES, EQUAL_TIME, Comparison
from ..tidying import put_away
from .curves import curve_names, draw_curve
from .grid import picture_grid
from .insets import Inset, check_inside, choose_insets
from .style import DPI, style_of, text

__all__ = ["Figures", "Inset", "choose_insets", "picture_grid", "style_of", "write_figures"]


@dataclass(frozen=True)
class Figures:
    """The figures of a comparison on disk; each lies there as PDF and PNG, a curve as SVG, too."""

    grids: dict[tuple[str, int], Path]  # PNG, by kind and samples per pixel of the first strategy
    curves: dict[str, Path]  # SVG, by name


def write_figures(
    comparison: Comparison,
    insets: Sequence[Inset] | None = None,
    progress: Progress = lambda step, done, total: None,
) -> Figures:
    """
    Draw all figures of a comparison, and write them to ``figures/`` in its folder.

    Figures of earlier runs that this one does not draw are put away.

    Parameters
    ----------
    comparison
        What to draw.
    insets
        Regions to enlarge, up to four; by default two where the strategies differ most.
    progress
        Called with the number of files done and their total.

    Raises
    ------
    ValueError
        For a region outside the picture, or more than four.
    """
    folder = comparison.folder / "figures"
    folder.mkdir(exist_ok=True)
    insets = choose_insets(comparison) if insets is None else list(insets)
    check_inside(insets, comparison.reference_image().shape)

    grids = {
        (kind, spp): folder / f"pictures_{kind.replace(' ', '_')}_{spp}spp.png"
        for kind in (EQUAL_SAMPLES, EQUAL_TIME)
        for spp in comparison.spp
    }
    curves = {name: folder / f"{name}.svg" for name in curve_names(comparison)}
    drawings = [
        _Drawing(partial(picture_grid, comparison, *key, insets), file, (".png", ".pdf"))
        for key, file in grids.items()
    ] + [
        _Drawing(partial(draw_curve, comparison, name), file, (".svg", ".png", ".pdf"))
        for name, file in curves.items()
    ]
    put_away(folder, _write(drawings, progress))
    return Figures(grids, curves)


class _Drawing(NamedTuple):
    """A figure that is to be drawn, and the files that it goes to."""

    draw: Callable[[], Figure]
    file: Path
    suffixes: tuple[str, ...]


def _write(drawings: Sequence[_Drawing], progress: Progress) -> list[Path]:
    """Draw figures one after the other, and return their files."""
    total = sum(len(one.suffixes) for one in drawings)
    written: list[Path] = []
    for one in drawings:
        figure = one.draw()
        for suffix in one.suffixes:
            written.append(_save(figure, one.file.with_suffix(suffix)))
            progress("figures", len(written), total)
    return written


def _save(figure: Figure, file: Path) -> Path:
    # Each SVG has its own salt: names of clip paths must differ within a page.
    style = text() | {"svg.hashsalt": file.stem}
    about: dict[str, Any] = {"metadata": {"Date": None}} if file.suffix == ".svg" else {}
    if file.suffix == ".png":
        about = {"pil_kwargs": {"compress_level": 2}}  # a fifth larger, in two thirds of the time
    with mpl.rc_context(style), atomic.replacement(file) as temporary:
        figure.savefig(temporary, dpi=DPI, **about)
    return file
