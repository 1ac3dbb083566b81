"""Draw grids of pictures: the reference, each strategy, their differences, enlarged regions."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import PIL.Image
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from ...files.images import Image, to_srgb
from ..results import Comparison, Measurement
from .insets import DIFFERENCE_GAIN, INSET_COLOURS, Inset, magnitude
from .style import (
    DPI,
    PAGE_WIDTH,
    label_of,
    scientific,
    seconds,
    shorten,
    text,
    thousands,
    wrap_lines,
)

# (height, width, 3), 8 bits a channel, for the screen
Pixels = NDArray[np.uint8]


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

    with mpl.rc_context(text()):
        layout = _Grid(reference.shape, titles, insets, comparison.scene_file.stem)
        layout.add_column(0, _shown(reference, scale), None, "trimmed MSE\nrender time")
        for column, one in enumerate(measurements, start=1):
            image = comparison.image(one)
            difference = _difference(image, reference, scale)
            layout.add_column(column, _shown(image, scale), difference, _caption(one))
    return layout.figure


def _shown(image: Image, scale: float) -> Pixels:
    """Return a picture for the screen."""
    shown: Pixels = np.rint(255 * to_srgb(image * scale)).astype(np.uint8)
    return shown


def _caption(one: Measurement) -> str:
    return f"{scientific(one.errors['mse_trimmed'].mean)}\n{seconds(one.seconds.median)}"


def _difference(image: Image, reference: Image, scale: float) -> Pixels:
    """Return the difference of a picture from the reference in false colours."""
    return _false_colours(magnitude(image, reference, scale))


def _false_colours(values: NDArray[np.float64]) -> Pixels:
    colours: Pixels = mpl.colormaps["magma"](values, bytes=True)[..., :3]
    return colours


def _fit(pixels: Pixels, width: float, height: float) -> Pixels:
    """
    Return a picture with as many pixels as fit into a place of some inches.

    One whose pixels can be seen stays as it is: they remain squares in every format, and a PDF
    holds no more than them.
    """
    size = round(DPI * width), round(DPI * height)
    if size[0] >= 3 * pixels.shape[1]:
        return pixels
    fitted: Pixels = np.asarray(
        PIL.Image.fromarray(pixels).resize(size, PIL.Image.Resampling.HAMMING)
    )
    return fitted


class _Grid:
    """
    Rows and columns of pictures at fixed distances, in inches from the top left corner.

    All lie in one system of axes over the whole figure: a system for each picture takes most of
    the time of drawing.
    """

    LINE, GAP, CAPTION = 0.125, 0.05, 0.4

    def __init__(
        self, shape: tuple[int, ...], titles: Sequence[str], insets: Sequence[Inset], name: str
    ):
        self.pixels = shape[:2]
        height, width = self.pixels
        columns = len(titles)
        self.width = (PAGE_WIDTH - (columns - 1) * self.GAP) / columns
        # Few strategies need no page; neither shall pictures be larger than half a column.
        self.width = min(self.width, 1.7)
        self.height = self.width * height / width
        self.inset_width = (self.width - (len(insets) - 1) * self.GAP) / max(len(insets), 1)
        ratios = [inset[3] / inset[2] for inset in insets]
        self.inset_height = self.inset_width * max(ratios, default=0)
        self.titles = [wrap_lines(title, self.width) for title in titles]
        # The first line of all is the name of the scene.
        top = self.LINE * (2.2 + max(title.count("\n") for title in self.titles)) + 0.06
        self.tops = [top, top + self.height + self.GAP]
        self.tops.append(self.tops[1] + self.height + self.CAPTION)
        self.tops.append(self.tops[2] + self.inset_height + self.GAP)
        bottom = self.tops[3] + self.inset_height if insets else self.tops[2]
        size = columns * self.width + (columns - 1) * self.GAP, bottom + 0.02
        self.figure = Figure(figsize=size)
        self.axes = self.figure.add_axes((0, 0, 1, 1), xlim=(0, size[0]), ylim=(size[1], 0))
        self.axes.set_axis_off()
        self.axes.set_autoscale_on(False)
        self.axes.text(0, 0.02, shorten(name, size[0]), va="top", color="#666666")
        self.insets = insets

    def add_column(
        self, column: int, shown: Pixels, difference: Pixels | None, caption: str
    ) -> None:
        """Add a picture with its title, its difference with a caption below, and the insets."""
        left = column * (self.width + self.GAP)
        centre = left + self.width / 2
        self.axes.text(
            centre, self.tops[0] - 0.04, self.titles[column],
            ha="center", va="bottom", linespacing=1.15,
        )  # fmt: skip
        self._add_picture(left, 0, shown)
        if difference is None:
            self._add_colour_bar(left)
        else:
            self._add_picture(left, 1, difference)
        below = self.tops[1] + self.height + 0.05
        self.axes.text(centre, below, caption, ha="center", va="top", linespacing=1.25)
        for i, inset in enumerate(self.insets):
            self._add_inset(left, 2, i, shown, inset)
            if difference is not None:
                self._add_inset(left, 3, i, difference, inset)

    def _show(self, pixels: Pixels, left: float, top: float, width: float, height: float) -> None:
        box = (left, left + width, top + height, top)
        # With an alpha of its own, a picture is drawn in single instead of double precision.
        shown = np.pad(_fit(pixels, width, height), ((0, 0), (0, 0), (0, 1)), constant_values=255)
        self.axes.imshow(shown, extent=box, aspect="auto", interpolation="none")

    def _frame(
        self, left: float, top: float, width: float, height: float, colour: str, line: float
    ) -> None:
        # Whole at the figure's edge, too.
        self.axes.add_patch(
            Rectangle((left, top), width, height, fill=False, lw=line, ec=colour, clip_on=False)
        )

    def _add_picture(self, left: float, row: int, pixels: Pixels) -> None:
        self._show(pixels, left, self.tops[row], self.width, self.height)
        inch = self.width / self.pixels[1]  # of a pixel
        for (x, y, width, height), colour in zip(self.insets, INSET_COLOURS, strict=False):
            corner = left + x * inch, self.tops[row] + y * inch
            self._frame(*corner, width * inch, height * inch, colour, 0.8)

    def _add_inset(self, left: float, row: int, i: int, pixels: Pixels, inset: Inset) -> None:
        x, y, width, height = inset
        left += i * (self.inset_width + self.GAP)
        box = left, self.tops[row], self.inset_width, self.inset_width * height / width
        # Pixels stay squares: the noise is what is to be seen.
        self._show(pixels[y : y + height, x : x + width], *box)
        self._frame(*box, INSET_COLOURS[i], 1.0)

    def _add_colour_bar(self, left: float) -> None:
        """Draw the scale of the differences where the reference's own would be."""
        box = left + 0.1 * self.width, self.tops[1] + 0.5 * self.height, 0.8 * self.width, 0.09
        self._show(_false_colours(np.linspace(0, 1, 256)[np.newaxis]), *box)
        self._frame(*box, "black", 0.4)
        limit = 1 / DIFFERENCE_GAIN
        for share, label in ((0, "0"), (0.5, f"{limit / 2:g}"), (1, f"≥ {limit:g}")):
            place = box[0] + share * box[2], box[1] + box[3] + 0.03
            self.axes.text(*place, label, ha="center", va="top")
        centre = left + self.width / 2
        title = f"difference from\nthe reference × {DIFFERENCE_GAIN}"
        self.axes.text(centre, box[1] - 0.05, title, ha="center", va="bottom", linespacing=1.2)
        self.axes.text(centre, box[1] + box[3] + 0.16, "(1: white)", ha="center", va="top")
