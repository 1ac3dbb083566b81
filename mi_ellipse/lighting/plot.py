"""False colours with isolines: illuminance on a plane as a picture."""

from __future__ import annotations

import io
from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..files import atomic
from .plane import AXES
from .report import Illuminance, number

WIDTH = 6.4  # inches of the plot
DPI = 150
MOST_LINES = 9


def write_plot(path: str | PathLike[str], found: Illuminance) -> None:
    """Write the plot of a plane as PNG; an older file stays until then."""
    buffer = io.BytesIO()
    draw(found).savefig(buffer, format="png", dpi=DPI)
    atomic.write_bytes(path, buffer.getvalue())


def draw(found: Illuminance) -> Figure:
    """Return a figure: a cell of colour for each point, isolines, and the numbers of a report."""
    (label, left, right), (label_up, low, high) = (
        _axis(found.plane.origin, edge) for edge in (found.plane.first, found.plane.second)
    )
    ratio = (high - low) / (right - left)
    figure = Figure((WIDTH, min(max(WIDTH * 0.8 * ratio + 1.1, 2.5), 12)), layout="constrained")
    axes = figure.add_subplot()
    shown = axes.imshow(
        found.values,
        cmap="inferno",
        vmin=0,
        origin="lower",
        extent=(left, right, low, high),
        aspect="equal",
    )
    figure.colorbar(shown, ax=axes, label="lx", shrink=0.9)
    _draw_isolines(axes, found, (left, right), (low, high))
    axes.set_xlabel(label)
    axes.set_ylabel(label_up)
    axes.set_title(
        f"Direct illuminance: mean {number(found.mean)} lx, minimum {number(found.minimum)} lx,\n"
        f"maximum {number(found.maximum)} lx, uniformity {found.uniformity:.2f}",
        fontsize="medium",
    )
    return figure


def _draw_isolines(
    axes: Any, found: Illuminance, across: Sequence[float], up: Sequence[float]
) -> None:
    rows, columns = found.values.shape
    if min(rows, columns) < 2 or not found.minimum < found.maximum:
        return
    levels = MaxNLocator(MOST_LINES).tick_values(found.minimum, found.maximum)
    x, y = (
        low + (high - low) * (np.arange(count) + 0.5) / count
        for (low, high), count in ((across, columns), (up, rows))
    )
    lines = axes.contour(x, y, found.values, levels=levels, colors="white", linewidths=0.8)
    axes.clabel(lines, fontsize="small", fmt=lambda level: f"{level:g}")


def _axis(origin: Sequence[float], edge: Sequence[float]) -> tuple[str, float, float]:
    """Return the label of an edge and where it starts and ends: coordinates, or lengths."""
    along = [k for k in range(3) if edge[k]]
    if len(along) == 1 and edge[along[0]] > 0:
        k = along[0]
        return AXES[k], origin[k], origin[k] + edge[k]
    return "length along the edge", 0.0, float(np.linalg.norm(edge))
