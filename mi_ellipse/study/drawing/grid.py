"""Draw grids of pictures: the reference, each strategy, their differences, enlarged regions."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from ...files.images import Image, to_srgb
from ..results import Comparison, Measurement
from .insets import DIFFERENCE_GAIN, INSET_COLOURS, Inset, magnitude
from .style import PAGE_WIDTH, TEXT, label_of, scientific, seconds, thousands, wrap_lines

# (height, width, 3), from 0 to 1, for the screen
Pixels = NDArray[np.float64]


def picture_grid(
    comparison: Comparison, kind: str, first_spp: int, insets: Sequence[Inset]
) -> Figure:
    """
    Draw a column for the reference and one for each strategy.

    From top to bottom: the picture, its difference from the reference, enlarged regions of both.

    Parameters
    ----------
    comparison
        Whose pictures to draw.
    kind, first_spp
        Which measurements, see :class:`mi_ellipse.study.results.Measurement`.
    insets
        Regions to enlarge.
    """
    measurements = [comparison.find(kind, name, first_spp) for name in comparison.strategies]
    reference = comparison.reference_image()
    scale = 2.0**comparison.exposure
    titles = [f"reference\n{thousands(comparison.reference.spp)} spp"]
    titles += [f"{label_of(one.sampling)}\n{thousands(one.spp)} spp" for one in measurements]

    with mpl.rc_context(TEXT):
        layout = _Grid(reference.shape, titles, insets)
        layout.add_column(0, to_srgb(reference * scale), None, "trimmed MSE\nrender time")
        for column, one in enumerate(measurements, start=1):
            image = comparison.image(one)
            difference = _difference(image, reference, scale)
            layout.add_column(column, to_srgb(image * scale), difference, _caption(one))
    return layout.figure


def _caption(one: Measurement) -> str:
    return f"{scientific(one.errors['mse_trimmed'].mean)}\n{seconds(one.seconds)}"


def _difference(image: Image, reference: Image, scale: float) -> Pixels:
    """Return the difference of a picture from the reference in false colours."""
    colours: Pixels = mpl.colormaps["magma"](magnitude(image, reference, scale))[..., :3]
    return colours


class _Grid:
    """Rows and columns of pictures at fixed distances, in inches from the top left corner."""

    LINE, GAP, CAPTION = 0.125, 0.05, 0.4

    def __init__(self, shape: tuple[int, ...], titles: Sequence[str], insets: Sequence[Inset]):
        height, width = shape[:2]
        columns = len(titles)
        self.width = (PAGE_WIDTH - (columns - 1) * self.GAP) / columns
        # Few strategies need no page; neither shall pictures be larger than half a column.
        self.width = min(self.width, 1.7)
        self.height = self.width * height / width
        self.inset_width = (self.width - (len(insets) - 1) * self.GAP) / max(len(insets), 1)
        ratios = [inset[3] / inset[2] for inset in insets]
        self.inset_height = self.inset_width * max(ratios, default=0)
        self.titles = [wrap_lines(title, self.width) for title in titles]
        top = self.LINE * (1 + max(title.count("\n") for title in self.titles)) + 0.06
        self.tops = [top, top + self.height + self.GAP]
        self.tops.append(self.tops[1] + self.height + self.CAPTION)
        self.tops.append(self.tops[2] + self.inset_height + self.GAP)
        bottom = self.tops[3] + self.inset_height if insets else self.tops[2]
        self.size = columns * self.width + (columns - 1) * self.GAP, bottom + 0.02
        self.figure = Figure(figsize=self.size)
        self.insets = insets

    def add_column(
        self, column: int, shown: Pixels, difference: Pixels | None, caption: str
    ) -> None:
        """Add a picture with its title, its difference with a caption below, and the insets."""
        axes = self._add_picture(column, 0, shown)
        axes.set_title(self.titles[column], pad=3, linespacing=1.15)
        if difference is None:
            axes = self._add_colour_bar(column)
        else:
            axes = self._add_picture(column, 1, difference)
        axes.set_xlabel(caption, labelpad=3, linespacing=1.25)
        for i, inset in enumerate(self.insets):
            self._add_inset(column, 2, i, shown, inset)
            if difference is not None:
                self._add_inset(column, 3, i, difference, inset)

    def _axes(self, left: float, top: float, width: float, height: float) -> Axes:
        total_width, total_height = self.size
        box = (
            left / total_width,
            1 - (top + height) / total_height,
            width / total_width,
            height / total_height,
        )
        axes = self.figure.add_axes(box, xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        return axes

    def _add_picture(self, column: int, row: int, pixels: Pixels) -> Axes:
        left = column * (self.width + self.GAP)
        axes = self._axes(left, self.tops[row], self.width, self.height)
        axes.imshow(pixels, aspect="auto", interpolation="antialiased")
        for (x, y, width, height), colour in zip(self.insets, INSET_COLOURS, strict=False):
            frame = Rectangle((x - 0.5, y - 0.5), width, height, fill=False, lw=0.8, ec=colour)
            axes.add_patch(frame)
            frame.set_clip_on(False)  # whole at the picture's edge, too
        return axes

    def _add_inset(self, column: int, row: int, i: int, pixels: Pixels, inset: Inset) -> None:
        x, y, width, height = inset
        left = column * (self.width + self.GAP) + i * (self.inset_width + self.GAP)
        axes = self._axes(left, self.tops[row], self.inset_width, self.inset_width * height / width)
        # Pixels stay squares: the noise is what is to be seen.
        axes.imshow(pixels[y : y + height, x : x + width], aspect="auto", interpolation="nearest")
        axes.spines[:].set(visible=True, color=INSET_COLOURS[i], linewidth=1.0)

    def _add_colour_bar(self, column: int) -> Axes:
        """Draw the scale of the differences where the reference's own would be."""
        left = column * (self.width + self.GAP)
        frame = self._axes(left, self.tops[1], self.width, self.height)
        bar_axes = self._axes(
            left + 0.1 * self.width, self.tops[1] + 0.5 * self.height, 0.8 * self.width, 0.09
        )
        mappable = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, 1 / DIFFERENCE_GAIN), "magma")
        bar = self.figure.colorbar(mappable, cax=bar_axes, orientation="horizontal", extend="max")
        limit = 1 / DIFFERENCE_GAIN
        bar.set_ticks([0, limit / 2, limit], labels=["0", f"{limit / 2:g}", f"{limit:g}"])
        bar.ax.tick_params(length=2, width=0.4, pad=1.5)
        bar.outline.set_linewidth(0.4)
        title = f"difference from\nthe reference × {DIFFERENCE_GAIN}"
        bar_axes.set_title(title, pad=4, linespacing=1.2)
        bar_axes.set_xlabel("(1: white)", labelpad=2)
        return frame
