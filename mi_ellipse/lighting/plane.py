"""A measuring plane, and how its text on the command line is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

AXES = "xyz"


@dataclass(frozen=True)
class Plane:
    """
    A parallelogram on which illuminance is measured; its normal is ``first × second``.

    Raises
    ------
    ValueError
        If a number is not finite, or the edges span no area.
    """

    origin: tuple[float, float, float]  # A corner, in world space
    first: tuple[float, float, float]  # Edge from there; columns of the grid follow it
    second: tuple[float, float, float]  # The other edge from there; rows of the grid follow it
    is_flipped: bool = False  # Measures on the other side

    def __post_init__(self) -> None:
        if not np.isfinite([self.origin, self.first, self.second]).all():
            raise ValueError(f"plane: its numbers must be finite, and they are {self}")
        lengths = [float(np.linalg.norm(edge)) for edge in (self.first, self.second)]
        if not np.linalg.norm(np.cross(self.first, self.second)) > 1e-6 * lengths[0] * lengths[1]:
            raise ValueError(f"plane: the edges {self.first} and {self.second} span no area")

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit normal of the side that is measured."""
        normal: NDArray[np.float64] = np.cross(self.first, self.second).astype(float)
        normal /= np.linalg.norm(normal) * (-1 if self.is_flipped else 1)
        return normal

    def points(self, columns: int, rows: int) -> NDArray[np.float64]:
        """Return the centres of the cells of a grid, of shape (rows, columns, 3)."""
        along = (np.arange(columns) + 0.5)[None, :, None] / columns
        up = (np.arange(rows) + 0.5)[:, None, None] / rows
        first, second = np.array(self.first), np.array(self.second)
        points: NDArray[np.float64] = np.array(self.origin) + along * first + up * second
        return points

    def flipped(self) -> Plane:
        """Return the plane that measures on the other side."""
        return replace(self, is_flipped=not self.is_flipped)


def read_plane(text: str, least: Sequence[float], greatest: Sequence[float]) -> Plane:
    """
    Read a plane as the command line has it.

    Parameters
    ----------
    text
        ``z=0.85``, and the same with x and y: perpendicular to an axis, as wide as the scene, with
        the normal along the axis. Or nine numbers with commas: a corner and the two edges from it.
    least, greatest
        Corners of the scene's bounding box.

    Raises
    ------
    ValueError
        If the text is none of both, or if the plane has no area.
    """
    axis, equals, place = text.partition("=")
    try:
        if equals and len(axis.strip()) == 1 and axis.strip() in AXES:
            return _across(AXES.index(axis.strip()), float(place), least, greatest)
        x, y, z, ux, uy, uz, vx, vy, vz = (float(number) for number in text.split(","))
    except ValueError as error:
        if str(error).startswith("plane"):
            raise
        raise ValueError(
            f"plane={text}: write z=HEIGHT (or x, y), or nine numbers with commas, a corner and the"
            " two edges from it, such as 0,0,0.85,4,0,0,0,3,0"
        ) from None
    return Plane((x, y, z), (ux, uy, uz), (vx, vy, vz))


def _across(axis: int, place: float, least: Sequence[float], greatest: Sequence[float]) -> Plane:
    """Return a plane perpendicular to an axis, with the bounds of the scene."""
    if not all(a <= b for a, b in zip(least, greatest, strict=True)):
        raise ValueError(
            "plane: the scene has no shapes whose bounds it could have; give the edges"
        )
    origin = [float(value) for value in least]
    origin[axis] = place
    edges = []
    for k in ((axis + 1) % 3, (axis + 2) % 3):
        edge = [0.0, 0.0, 0.0]
        edge[k] = float(greatest[k]) - float(least[k])
        edges.append(edge)
    x, y, z = origin
    (ux, uy, uz), (vx, vy, vz) = edges
    return Plane((x, y, z), (ux, uy, uz), (vx, vy, vz))
