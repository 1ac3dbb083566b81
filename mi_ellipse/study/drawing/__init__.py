"""Draw a comparison for a paper: grids of pictures, and curves of time and error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from ...files import atomic
from ..results import EQUAL_SAMPLES, EQUAL_TIME, Comparison
from ..tidying import put_away
from .curves import draw_curves
from .grid import picture_grid
from .insets import Inset, check_inside, choose_insets
from .style import TEXT, style_of

__all__ = ["Figures", "Inset", "choose_insets", "picture_grid", "style_of", "write_figures"]


@dataclass(frozen=True)
class Figures:
    """The figures of a comparison on disk; each lies there as PDF and PNG, a curve as SVG, too."""

    grids: dict[tuple[str, int], Path]  # PNG, by kind and samples per pixel of the first strategy
    curves: dict[str, Path]  # SVG, by name


def write_figures(comparison: Comparison, insets: Sequence[Inset] | None = None) -> Figures:
    """
    Draw all figures of a comparison, and write them to ``figures/`` in its folder.

    Figures of earlier runs that this one does not draw are put away.

    Parameters
    ----------
    comparison
        What to draw.
    insets
        Regions to enlarge, up to four; by default two where the strategies differ most.

    Raises
    ------
    ValueError
        For a region outside the picture, or more than four.
    """
    folder = comparison.folder / "figures"
    folder.mkdir(exist_ok=True)
    insets = choose_insets(comparison) if insets is None else list(insets)
    check_inside(insets, comparison.reference_image().shape)

    grids, lines = {}, {}
    files: list[Path] = []
    for kind in (EQUAL_SAMPLES, EQUAL_TIME):
        for spp in comparison.spp:
            file = folder / f"pictures_{kind.replace(' ', '_')}_{spp}spp.png"
            figure = picture_grid(comparison, kind, spp, insets)
            files += _save(figure, file, file.with_suffix(".pdf"))
            grids[kind, spp] = file
    for name, figure in draw_curves(comparison).items():
        file = folder / f"{name}.svg"
        files += _save(figure, file, file.with_suffix(".png"), file.with_suffix(".pdf"))
        lines[name] = file
    put_away(folder, files)
    return Figures(grids, lines)


def _save(figure: Figure, *files: Path) -> tuple[Path, ...]:
    for file in files:
        # Each SVG has its own salt: names of clip paths must differ within a page.
        style = TEXT | {"svg.hashsalt": file.stem}
        about: dict[str, Any] = {"metadata": {"Date": None}} if file.suffix == ".svg" else {}
        with mpl.rc_context(style), atomic.replacement(file) as temporary:
            figure.savefig(temporary, dpi=300, **about)
    return files
