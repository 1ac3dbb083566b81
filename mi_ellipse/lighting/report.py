"""Illuminance on a plane: the numbers of a lighting report, and the table of its points."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..files import atomic
from .irradiance import direct_irradiance
from .plane import Plane

if TYPE_CHECKING:
    import mitsuba as mi

# Samples of a call, after which progress is told: about a second
SAMPLES_AT_A_TIME = 2**22

COLUMNS = ("column", "row", "x", "y", "z", "illuminance", "standard_error")


@dataclass(frozen=True)
class Illuminance:
    """Illuminance at the points of a grid on a plane."""

    plane: Plane
    points: NDArray[np.float64]  # (rows, columns, 3)
    values: NDArray[np.float64]  # (rows, columns)
    errors: NDArray[np.float64]  # Standard error of each value

    @property
    def mean(self) -> float:
        return float(self.values.mean())

    @property
    def mean_error(self) -> float:
        """Standard error of the mean over these points, whose errors are independent."""
        return float(np.sqrt(np.sum(self.errors**2)) / self.errors.size)

    @property
    def minimum(self) -> float:
        return float(self.values.min())

    @property
    def maximum(self) -> float:
        return float(self.values.max())

    @property
    def uniformity(self) -> float:
        """Minimum over mean, U₀ of EN 12464-1; NaN in the dark."""
        return self.minimum / self.mean if self.mean > 0 else float("nan")

    @property
    def diversity(self) -> float:
        """Minimum over maximum; NaN in the dark."""
        return self.minimum / self.maximum if self.maximum > 0 else float("nan")


def measure(
    scene: mi.Scene,
    plane: Plane,
    columns: int,
    rows: int,
    samples: int = 1024,
    seed: int = 0,
    efficacy: float = 1.0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Illuminance:
    """
    Measure the direct illuminance in the middle of each cell of a grid.

    Parameters
    ----------
    scene, samples, seed
        See `direct_irradiance`.
    plane
        Where to measure.
    columns, rows
        Cells along the first and the second edge.
    efficacy
        Factor of all numbers: lumens per watt, if the lamps of the scene are in watts.
    progress
        Called with the steps done and their total.

    Raises
    ------
    ValueError
        If a number is impossible.
    """
    if columns < 1 or rows < 1:
        raise ValueError(f"grid={columns}x{rows}: a grid has at least 1 cell along each edge")
    if not (np.isfinite(efficacy) and efficacy > 0):
        raise ValueError(f"efficacy={efficacy:g}: lumens per watt are a positive number")
    points = plane.points(columns, rows)
    parts = np.array_split(points.reshape(-1, 3), steps(columns, rows, samples))
    found = []
    # Points that share a seed have independent shifts; parts get seeds of their own.
    seeds = np.random.SeedSequence(seed).generate_state(len(parts))
    for done, (part, own) in enumerate(zip(parts, seeds, strict=True), start=1):
        found.append(direct_irradiance(scene, part, plane.normal, samples, int(own), True))
        progress(done, len(parts))
    values, errors = (
        efficacy * np.concatenate(field).reshape(rows, columns)
        for field in zip(*found, strict=True)
    )
    return Illuminance(plane, points, values, errors)


def steps(columns: int, rows: int, samples: int) -> int:
    """Return the number of steps of about a second that `measure` takes."""
    cells = columns * rows
    return max(1, min(cells, -(-cells * samples // SAMPLES_AT_A_TIME)))


def write_csv(path: str | PathLike[str], found: Illuminance) -> None:
    """Write a line for each point: place in the grid, place in the world, value, its error."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row, column in np.ndindex(found.values.shape):
        x, y, z = found.points[row, column]
        value, error = found.values[row, column], found.errors[row, column]
        writer.writerow([column, row, *(f"{v:.6g}" for v in (x, y, z, value)), f"{error:.2g}"])
    atomic.write_text(path, text.getvalue())


def summary(found: Illuminance) -> str:
    """Return the numbers of a report as lines of text."""
    rows, columns = found.values.shape
    lengths = [f"{np.linalg.norm(edge):.4g}" for edge in (found.plane.first, found.plane.second)]
    normal = ", ".join(f"{value + 0.0:.3g}" for value in found.plane.normal)
    lines = [
        ("Plane", f"{' x '.join(lengths)}, {columns} x {rows} points, normal {normal}"),
        ("Mean", f"{number(found.mean)} lx"),
        ("Minimum", f"{number(found.minimum)} lx at {_place(found, int(found.values.argmin()))}"),
        ("Maximum", f"{number(found.maximum)} lx at {_place(found, int(found.values.argmax()))}"),
        ("Uniformity", f"{found.uniformity:.2f} (minimum / mean)"),
        ("Diversity", f"{found.diversity:.2f} (minimum / maximum)"),
        (
            "Error",
            f"{found.errors.max():.2g} lx at the worst point, {found.mean_error:.2g} lx of the mean"
            " (standard errors)",
        ),
    ]
    return "\n".join(f"{name:<11} {text}" for name, text in lines)


def number(value: float) -> str:
    """Return an illuminance with three digits, or all that stand before the point."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _place(found: Illuminance, index: int) -> str:
    return ", ".join(f"{value:.3g}" for value in found.points.reshape(-1, 3)[index])
