"""Draw curves: the time of a render and its errors against samples and against time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import NDArray

from ..metrics import METRICS
from ..results import Comparison
from ..statistics import fit_slope
from .style import (
    COLUMN_WIDTH,
    label_of,
    plain,
    power_of_ten,
    shorten,
    style_of,
    text,
    thousands,
)

Places = NDArray[np.float64]

AGAINST = ("samples", "time")


def curve_names(comparison: Comparison) -> list[str]:
    """Return the names of the curves of time and error; none for a single number of samples."""
    if len(comparison.spp) == 1:
        return []
    drawn = [metric.name for metric in METRICS.values() if metric.drawn]
    return ["time", *(f"{name}_against_{what}" for name in drawn for what in AGAINST)]


def draw_curve(comparison: Comparison, name: str) -> Figure:
    """Draw one of :func:`curve_names`."""
    if name == "time":
        return time_curve(comparison)
    metric, _, against = name.rpartition("_against_")
    return error_curve(comparison, metric, against)


def time_curve(comparison: Comparison) -> Figure:
    """Draw the time of a render against its samples per pixel."""
    with mpl.rc_context(text()):
        figure, axes = _log_log(comparison, "samples per pixel", "seconds a render")
        axes.yaxis.set_major_formatter(plain)
        labels = []
        for sampling in comparison.strategies:
            series = comparison.series(sampling)
            x, y = [one.spp for one in series], [one.seconds.median for one in series]
            _plot(axes, sampling, x, y)
            labels.append((x[-1], y[-1], sampling, _slope(x, y)))
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
    with mpl.rc_context(text()):
        x_label = "samples per pixel" if against == "samples" else "seconds a render"
        values = [one.errors[metric].mean for one in comparison.measurements]
        exponent = math.floor(math.log10(min(values)))
        exponent = exponent if exponent < -1 else 0  # 0.2 is easier to read than 2 · 10⁻¹
        unit = f" ({power_of_ten(exponent)})" if exponent else ""
        figure, axes = _log_log(comparison, x_label, METRICS[metric].label + unit)
        axes.yaxis.set_major_formatter(lambda y, _: plain(y / 10.0**exponent))
        labels = []
        for sampling in comparison.strategies:
            series = comparison.series(sampling)
            x = [one.spp if against == "samples" else one.seconds.median for one in series]
            y = [one.errors[metric].mean for one in series]
            bars = [one.errors[metric].standard_error for one in series]
            _plot(axes, sampling, x, y, np.nan_to_num(bars).tolist())
            labels.append((x[-1], y[-1], sampling, _slope(x, y)))
        _mark_reference(axes, comparison.reference.errors.get(metric))
        _label_lines(axes, labels)
        if against == "samples":
            _mark_samples(axes, comparison.spp)
        else:
            axes.xaxis.set_major_formatter(plain)
    return figure


def _log_log(comparison: Comparison, x_label: str, y_label: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(COLUMN_WIDTH, 2.3))
    name = shorten(comparison.scene_file.stem, COLUMN_WIDTH / 2)
    figure.text(0.99, 0.985, name, ha="right", va="top", color="#666666")
    # The right third is for the labels of the lines.
    axes = figure.add_axes((0.12, 0.155, 0.52, 0.755))
    axes.set(xscale="log", yscale="log", xlabel=x_label)
    # Above the axis, horizontal: quicker to read than along it. Where `y` is given, matplotlib does
    # not search for a free place, which takes a quarter of the time of drawing.
    axes.set_title(y_label, loc="left", x=-0.2, y=1, pad=5)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_minor_locator(NullLocator())
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
        label=label_of(sampling),
    )


def _label_lines(axes: Axes, labels: Sequence[tuple[float, float, str, str]]) -> None:
    """
    Write each line's name beside its end, moved apart where names would overlap.

    `labels` holds the place of the end, the strategy, and what to add to its name.
    """
    labels = sorted(labels, key=lambda label: label[1])
    ends = np.array([_fractions(axes, x, y) for x, y, _, _ in labels])
    places = _spread(ends[:, 1], distance=0.14, low=0.04, high=0.96)
    for (_, _, sampling, addition), end, place in zip(labels, ends, places, strict=True):
        colour, _ = style_of(sampling)
        inside = {"transform": axes.transAxes, "color": colour, "clip_on": False}
        axes.plot((end[0] + 0.02, 1.075), (end[1], place), linewidth=0.5, **inside)
        axes.text(
            1.09,
            place,
            f"{label_of(sampling)}\n{addition}".rstrip(),
            fontsize=6.8,
            linespacing=1.05,
            va="center",
            **inside,
        )


def _fractions(axes: Axes, x: float, y: float) -> tuple[float, float]:
    """Return a place in the data as fractions of logarithmic axes."""
    fractions = [
        (np.log(value) - np.log(low)) / (np.log(high) - np.log(low))
        for value, (low, high) in ((x, axes.get_xlim()), (y, axes.get_ylim()))
    ]
    return fractions[0], fractions[1]


def _spread(places: Places, distance: float, low: float, high: float) -> Places:
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
    axes.set_xticks(spp, [thousands(count) for count in spp])


def _slope(x: Sequence[float], y: Sequence[float]) -> str:
    """Return what to say of the slope: nothing of two points, through which any line goes."""
    if len(x) < 3:
        return ""
    return f"slope {fit_slope(x, y):.2f}".replace("-", "−")
