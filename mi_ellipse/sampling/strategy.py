"""The interface of a sampling strategy, and the registry of all strategies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeVar

import mitsuba as mi

from ..geometry.light import View

Record = TypeVar("Record")


class Strategy(Protocol[Record]):
    """How two random numbers become a direction towards a light.

    Directions are in the light's own frame: ``(ex, ey, normal)`` for an ellipse. No strategy asks
    which light it sees. A strategy for planar lights alone says so in its entry. `sample` and `pdf`
    take the density from one function, so they cannot disagree.

    Give a name to each value that is used twice, and to each literal in code that every path runs.
    The reason is that Dr.Jit merges no equal operations while it traces a strategy
    (`geometry.tracing.lookup`).
    """

    def prepare(self, view: View, normal: mi.Normal3f) -> Record:
        """Compute once per reference point what sample and density need.

        Parameters
        ----------
        view
            The light as it is seen from the reference point.
        normal
            World-space normal of the surface there; zero in media.
        """

    def sample(self, record: Record, u: mi.Point2f) -> tuple[mi.Vector3f, mi.Float, mi.Mask]:
        """Draw a direction.

        Returns
        -------
        direction
            Unit vector.
        pdf
            Density per solid angle.
        valid
            False for a draw that has a density and carries no light.
        """

    def pdf(self, record: Record, direction: mi.Vector3f) -> mi.Float:
        """Return exactly the density from which `sample` draws.

        It must not test whether the direction meets the light. In single precision such a test can
        be wrong; the ray decides what is hit.
        """


@dataclass(frozen=True)
class Entry:
    """A strategy in the registry, with what scenes, commands, figures and pages say of it."""

    name: str  # In scene files
    label: str  # In figures
    colour: str  # In figures, of the palette of M. Okabe and K. Ito, "Color universal design", 2008
    mark: str  # In figures, a marker of matplotlib
    sentence: str  # In the documentation
    make: Callable[[], Strategy[Any]]
    planar: bool = False  # For planar lights alone


STRATEGIES: dict[str, Entry] = {}
DEFAULT = "solid_angle"


def register(
    name: str, colour: str, mark: str, sentence: str, planar: bool = False, **options: Any
) -> Callable:
    """Enter a class under a name. Its constructor gets `options`."""

    def enter(cls: type) -> type:
        label = name.replace("_", " ")
        make = partial(cls, **options)
        STRATEGIES[name] = Entry(name, label, colour, mark, sentence, make, planar)
        return cls

    return enter


def find(name: str) -> Entry:
    """Return a strategy by its name.

    Raises
    ------
    ValueError
        For an unknown name. The message lists the known names.
    """
    if name not in STRATEGIES:
        known = ", ".join(STRATEGIES)
        raise ValueError(f'unknown sampling strategy "{name}"; known are: {known}')
    return STRATEGIES[name]
