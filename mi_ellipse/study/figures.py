"""Draw a comparison for a paper: grids of pictures, and curves of time and error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

from ..files import atomic
from .metrics import LABELS, fit_slope
from .results import EQUAL_SAMPLES, EQUAL_TIME, Comparison

# The palette of M. Okabe and K. Ito, "Color universal design", 2008; each strategy keeps its colour
# and its mark in every figure.
STYLES = {
    "area": ("#E69F00", "o"),
    "rejection": ("#CC79A7", "s"),
    "solid_angle": ("#0072B2", "^"),
    "projected_solid_angle": ("#D55E00", "v"),
    "projected_solid_angle_one_sided": ("#8C510A", "<"),
    "tangent_disk": ("#009E73", "D"),
    "concentric": ("#56B4E9", "p"),
}
OTHER_STYLE = ("#555555", "X")

COLUMN_WIDTH = 3.4  # inches, of a page with two columns
PAGE_WIDTH = 7.1
TEXT = {
    "font.size": 7.5,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.linewidth": 0.6,
    "pdf.fonttype": 42,  # text stays text
    "svg.hashsalt": "mi_ellipse",
}

DIFFERENCE_GAIN = 5  # of the false-colour pictures
INSET_COLOURS = ("#00E5FF", "#FFE600", "#FF4FD8", "#7CFF4F")
INSET_SIZE = 0.16  # of the smaller side of the picture

# Left, top, width and height in pixels.
Inset = tuple[int, int, int, int]


def write_figures(comparison: Comparison, insets: Sequence[Inset] | None = None) -> list[Path]:
    """
    Write all figures of a comparison as PDF and PNG to ``figures/`` in its folder.

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
    _check_inside(insets, comparison.reference_image().shape)
    figures = {
        f"pictures_{kind.replace(' ', '_')}_{spp}spp": picture_grid(comparison, kind, spp, insets)
        for kind in (EQUAL_SAMPLES, EQUAL_TIME)
        for spp in comparison.spp
    }
    figures |= curves(comparison)
    files = []
    for name, figure in figures.items():
        for suffix in (".pdf", ".png"):
            file = folder / f"{name}{suffix}"
            with mpl.rc_context(TEXT), atomic.replacement(file) as temporary:
                figure.savefig(temporary, dpi=300)
            files.append(file)
    return files


def style_of(sampling: str) -> tuple[str, str]:
    """Return the colour and the mark of a strategy."""
    return STYLES.get(sampling, OTHER_STYLE)


def curves(comparison: Comparison) -> dict[str, Figure]:
    """Return the curves of time and error by name; none for a single number of samples."""
    if len(comparison.spp) == 1:
        return {}
    figures = {"time": time_curve(comparison)}
    for metric in ("mse", "mse_trimmed", "relative_mse_trimmed", "flip"):
        for against in ("samples", "time"):
            figures[f"{metric}_against_{against}"] = error_curve(comparison, metric, against)
    return figures


# ---- Pictures ----


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
    images = [reference, *(comparison.image(one) for one in measurements)]
    scale = 2.0**comparison.exposure
    differences = [None, *(_difference(image, reference, scale) for image in images[1:])]
    titles = [f"reference\n{_thousands(comparison.reference.spp)} spp"]
    captions = ["trimmed MSE\nrender time"]
    for one in measurements:
        titles.append(f"{_label(one.sampling)}\n{_thousands(one.spp)} spp")
        error = one.errors["mse_trimmed"].mean
        captions.append(f"{_scientific(error)}\n{_seconds(one.seconds)}")

    with mpl.rc_context(TEXT):
        layout = _Grid(reference.shape, titles, insets)
        for column, (image, difference) in enumerate(zip(images, differences, strict=True)):
            shown = _to_screen(image * scale)
            axes = layout.add_picture(column, 0, shown)
            axes.set_title(layout.titles[column], pad=3, linespacing=1.15)
            if difference is None:
                axes = layout.add_colour_bar(column)
            else:
                axes = layout.add_picture(column, 1, difference)
            axes.set_xlabel(captions[column], labelpad=3, linespacing=1.25)
            for i, inset in enumerate(insets):
                layout.add_inset(column, 2, i, shown, inset)
                if difference is not None:
                    layout.add_inset(column, 3, i, difference, inset)
    return layout.figure


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
        self.titles = [_wrap(title, self.width) for title in titles]
        top = self.LINE * (1 + max(title.count("\n") for title in self.titles)) + 0.06
        self.tops = [top, top + self.height + self.GAP]
        self.tops.append(self.tops[1] + self.height + self.CAPTION)
        self.tops.append(self.tops[2] + self.inset_height + self.GAP)
        bottom = self.tops[3] + self.inset_height if insets else self.tops[2]
        self.size = columns * self.width + (columns - 1) * self.GAP, bottom + 0.02
        self.figure = Figure(figsize=self.size)
        self.insets = insets

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

    def add_picture(self, column: int, row: int, pixels: np.ndarray) -> Axes:
        left = column * (self.width + self.GAP)
        axes = self._axes(left, self.tops[row], self.width, self.height)
        axes.imshow(pixels, aspect="auto", interpolation="antialiased")
        for (x, y, width, height), colour in zip(self.insets, INSET_COLOURS, strict=False):
            frame = Rectangle((x - 0.5, y - 0.5), width, height, fill=False, lw=0.8, ec=colour)
            axes.add_patch(frame)
            frame.set_clip_on(False)  # whole at the picture's edge, too
        return axes

    def add_inset(self, column: int, row: int, i: int, pixels: np.ndarray, inset: Inset) -> None:
        x, y, width, height = inset
        left = column * (self.width + self.GAP) + i * (self.inset_width + self.GAP)
        axes = self._axes(left, self.tops[row], self.inset_width, self.inset_width * height / width)
        # Pixels stay squares: the noise is what is to be seen.
        axes.imshow(pixels[y : y + height, x : x + width], aspect="auto", interpolation="nearest")
        axes.spines[:].set(visible=True, color=INSET_COLOURS[i], linewidth=1.0)

    def add_colour_bar(self, column: int) -> Axes:
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


def choose_insets(comparison: Comparison, count: int = 2) -> list[Inset]:
    """
    Return the square regions of a picture where the strategies differ most.

    What counts is the mean of the false-colour differences as they are shown, clipped at white, so
    that single bright pixels do not draw attention: the largest of all strategies minus the
    smallest, over all numbers of samples.
    """
    reference = comparison.reference_image()
    scale = 2.0**comparison.exposure
    shown = [
        np.mean(
            [
                _magnitude(comparison.image(one), reference, scale)
                for one in comparison.series(name)
            ],
            axis=0,
        )
        for name in comparison.strategies
    ]
    height, width = reference.shape[:2]
    size = max(4, round(INSET_SIZE * min(height, width)))
    means = np.array([_box_means(one, size) for one in shown])
    # With a single strategy, the places where it errs most.
    interest = means.max(axis=0) - (means.min(axis=0) if len(means) > 1 else 0)

    insets = []
    for _ in range(count):
        y, x = np.unravel_index(np.argmax(interest), interest.shape)
        insets.append((int(x), int(y), size, size))
        # The next one shall show something else.
        interest[max(y - 2 * size, 0) : y + 2 * size, max(x - 2 * size, 0) : x + 2 * size] = -1
    return sorted(insets)


def _check_inside(insets: Sequence[Inset], shape: tuple[int, ...]) -> None:
    height, width = shape[:2]
    if len(insets) > len(INSET_COLOURS):
        raise ValueError(f"{len(insets)} insets are more than the {len(INSET_COLOURS)} that fit")
    for x, y, w, h in insets:
        if w < 1 or h < 1 or x + w > width or y + h > height:
            raise ValueError(
                f"the inset {x},{y},{w},{h} is not inside the picture of {width} × {height} pixels"
            )


def _box_means(values: np.ndarray, size: int) -> np.ndarray:
    """Return the mean of every square of `size` pixels, by its top left corner."""
    sums = np.pad(values, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    squares = sums[size:, size:] - sums[:-size, size:] - sums[size:, :-size] + sums[:-size, :-size]
    return squares / size**2


def _magnitude(image: np.ndarray, reference: np.ndarray, scale: float) -> np.ndarray:
    """Return the mean absolute difference of the channels × 5, clipped at the picture's white."""
    difference = np.abs(image.astype(np.float64) - reference).mean(axis=2)
    return np.minimum(DIFFERENCE_GAIN * scale * difference, 1)


def _difference(image: np.ndarray, reference: np.ndarray, scale: float) -> np.ndarray:
    return mpl.colormaps["magma"](_magnitude(image, reference, scale))[..., :3]


def _to_screen(image: np.ndarray) -> np.ndarray:
    """Return sRGB values from 0 to 1 (IEC 61966-2-1)."""
    image = np.clip(image, 0, 1)
    return np.where(image <= 0.0031308, 12.92 * image, 1.055 * image ** (1 / 2.4) - 0.055)


# ---- Curves ----


def time_curve(comparison: Comparison) -> Figure:
    """Draw the time of a render against its samples per pixel."""
    with mpl.rc_context(TEXT):
        figure, axes = _log_log("samples per pixel", "seconds a render")
        axes.yaxis.set_major_formatter(_plain)
        labels = []
        for sampling in comparison.strategies:
            series = comparison.series(sampling)
            x, y = [one.spp for one in series], [one.seconds for one in series]
            _plot(axes, sampling, x, y)
            labels.append((x[-1], y[-1], sampling, f"slope {_slope(x, y)}"))
        _label_lines(axes, labels)
        _mark_samples(axes, comparison.spp)
    return figure


def error_curve(comparison: Comparison, metric: str, against: str) -> Figure:
    """
    Draw an error against the samples per pixel or against the time of a render.

    Parameters
    ----------
    comparison
        What to draw; the bars are standard errors over the seeds.
    metric
        One of :data:`mi_ellipse.study.metrics.METRICS`.
    against
        "samples" or "time".
    """
    with mpl.rc_context(TEXT):
        x_label = "samples per pixel" if against == "samples" else "seconds a render"
        values = [one.errors[metric].mean for one in comparison.measurements]
        exponent = math.floor(math.log10(min(values)))
        exponent = exponent if exponent < -1 else 0  # 0.2 is easier to read than 2 · 10⁻¹
        unit = f" ($10^{{{exponent}}}$)" if exponent else ""
        figure, axes = _log_log(x_label, LABELS[metric] + unit)
        axes.yaxis.set_major_formatter(lambda y, _: _plain(y / 10.0**exponent))
        labels = []
        for sampling in comparison.strategies:
            series = comparison.series(sampling)
            x = [one.spp if against == "samples" else one.seconds for one in series]
            y = [one.errors[metric].mean for one in series]
            bars = [one.errors[metric].standard_error for one in series]
            _plot(axes, sampling, x, y, np.nan_to_num(bars))
            labels.append((x[-1], y[-1], sampling, f"slope {_slope(x, y)}"))
        _mark_reference(axes, comparison.reference.errors.get(metric))
        _label_lines(axes, labels)
        if against == "samples":
            _mark_samples(axes, comparison.spp)
        else:
            axes.xaxis.set_major_formatter(_plain)
    return figure


def _log_log(x_label: str, y_label: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(COLUMN_WIDTH, 2.3))
    # The right third is for the labels of the lines.
    axes = figure.add_axes((0.12, 0.155, 0.52, 0.755))
    axes.set(xscale="log", yscale="log", xlabel=x_label)
    # Above the axis, horizontal: quicker to read than along it.
    axes.set_title(y_label, loc="left", x=-0.2, pad=5)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_minor_formatter(NullFormatter())
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(which="major", color="#DDDDDD", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.tick_params(which="both", width=0.5)
    return figure, axes


def _plot(
    axes: Axes,
    sampling: str,
    x: Sequence[float],
    y: Sequence[float],
    bars: Sequence[float] | None = None,
) -> None:
    colour, marker = style_of(sampling)
    axes.errorbar(
        x,
        y,
        yerr=bars,
        color=colour,
        marker=marker,
        markersize=3.2,
        markeredgecolor="white",
        markeredgewidth=0.4,
        linewidth=1.1,
        elinewidth=0.8,
        label=_label(sampling),
    )


def _label_lines(axes: Axes, labels: list[tuple[float, float, str, str]]) -> None:
    """
    Write each line's name beside its end, moved apart where names would overlap.

    `labels` holds the place of the end, the strategy, and what to add to its name.
    """
    low, high = np.log(axes.get_ylim())
    labels = sorted(labels, key=lambda label: label[1])
    ends = np.array([(np.log(y) - low) / (high - low) for _, y, _, _ in labels])
    places = _spread(ends, distance=0.14, low=0.04, high=0.96)
    for (x, y, sampling, addition), place in zip(labels, places, strict=True):
        colour, _ = style_of(sampling)
        line = {"arrowstyle": "-", "color": colour, "lw": 0.5, "shrinkA": 0, "shrinkB": 3}
        axes.annotate(
            f"{_label(sampling)}\n{addition}",
            xy=(x, y),
            xytext=(1.09, place),
            textcoords="axes fraction",
            color=colour,
            fontsize=6.8,
            linespacing=1.05,
            va="center",
            arrowprops=line | {"relpos": (0, 0.5)},
        )


def _spread(places: np.ndarray, distance: float, low: float, high: float) -> np.ndarray:
    """Return sorted places moved as little as possible so that they are `distance` apart."""
    # A block of labels that touch is centred on where they want to be; blocks that meet are merged.
    blocks: list[list[float]] = []
    for place in places:
        blocks.append([place])
        while len(blocks) > 1 and _block_start(blocks[-1], distance) < (
            _block_start(blocks[-2], distance) + len(blocks[-2]) * distance
        ):
            last = blocks.pop()
            blocks[-1] += last
    spread = np.concatenate(
        [_block_start(block, distance) + distance * np.arange(len(block)) for block in blocks]
    )
    # Then inside the axes, as far as there is room.
    for i in range(len(spread)):
        spread[i] = max(spread[i], low + i * distance)
    for i in reversed(range(len(spread))):
        spread[i] = min(spread[i], high - (len(spread) - 1 - i) * distance)
    return spread


def _block_start(block: Sequence[float], distance: float) -> float:
    return float(np.mean(block)) - distance * (len(block) - 1) / 2


def _mark_reference(axes: Axes, own: float | None) -> None:
    """Draw the reference's own error, if it is near the measured ones at all."""
    if own is None or own < 0.1 * axes.get_ylim()[0]:
        return
    axes.axhline(own, color="#888888", linewidth=0.8, linestyle=(0, (4, 3)))
    axes.annotate(
        "the reference's own",
        xy=(0.02, own),
        xycoords=("axes fraction", "data"),
        xytext=(0, 2),
        textcoords="offset points",
        color="#666666",
        fontsize=6.5,
    )


def _mark_samples(axes: Axes, spp: Sequence[int]) -> None:
    axes.set_xticks(spp, [_thousands(count) for count in spp])
    axes.xaxis.set_minor_locator(NullLocator())


def _slope(x: Sequence[float], y: Sequence[float]) -> str:
    return f"{fit_slope(x, y):.2f}".replace("-", "−")


# ---- Words and numbers ----


def _label(sampling: str) -> str:
    return sampling.replace("_", " ")


def _wrap(title: str, inches: float) -> str:
    """Break the lines of a title that are wider than its column."""
    characters = round(inches / 0.065)  # at the size of titles
    return "\n".join(part for line in title.split("\n") for part in wrap(line, characters))


def _plain(value: float, _position: int | None = None) -> str:
    return f"{value:g}"


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "\u2009") if count >= 10_000 else str(count)


def _scientific(value: float) -> str:
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}·$10^{{{int(exponent)}}}$"


def _seconds(value: float) -> str:
    return f"{value:.2f} s" if value >= 1 else f"{1000 * value:.0f} ms"
