"""What a sampling strategy is, and the registry in which each one says its name."""

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

    Directions are given along the light's own frame, for an ellipse ``(ex, ey, normal)``. No
    strategy asks which light it sees; one for planar lights alone says so in its entry. `sample`
    and `pdf` take the density from one function, so that they cannot disagree.

    Dr.Jit merges no equal operations while it traces a strategy (`mi_ellipse.lamps.lamp`). So what
    is used twice has a name, and so has a literal in the code that every path runs.
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
            False for a draw that carries its density and no light.
        """

    def pdf(self, record: Record, direction: mi.Vector3f) -> mi.Float:
        """Return exactly the density from which `sample` draws.

        It does not test whether the direction meets the light, and in single precision it must not:
        the ray decides what is hit.
        """


@dataclass(frozen=True)
class Entry:
    """A strategy in the registry: what scenes, command line, figures and pages say of it."""

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
    """Enter a class under a name; `options` go to its constructor."""

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
        For an unknown name; the message lists the known ones.
    """
    if name not in STRATEGIES:
        known = ", ".join(STRATEGIES)
        raise ValueError(f'unknown sampling strategy "{name}"; known are: {known}')
    return STRATEGIES[name]
