"""What a group gathers of its lamps, in NumPy, and the arrays that it makes of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry.light import StoredLight, field_values
from ..geometry.tracing import table
from ..sampling.strategy import Strategy
from .estimate import proportions
from .lamp import Lamp
from .tree import Lights


@dataclass(frozen=True)
class Row:
    """What a group needs of a lamp."""

    stored: StoredLight
    fields: dict[str, np.ndarray]  # Of the stored light, in NumPy
    planar: bool
    brightness: float  # Mean of the radiance
    colour: mi.UnpolarizedSpectrum | None  # Radiance, if it is one colour, and no spectrum
    values: list[Any]  # What the colour follows from, which derivatives may follow

    @classmethod
    def of(cls, lamp: Lamp) -> Row:
        values = field_values(lamp.stored)
        fields = {name: np.array(value).reshape(-1) for name, value in values.items()}
        emission = lamp.emission
        if mi.is_spectral or emission.is_spatially_varying():
            mean = float(np.array(dr.detach(lamp.of_emission(emission.mean()))).ravel()[0])
            return cls(lamp.stored, fields, lamp.planar, mean, None, [])
        colour = lamp.radiance(dr.zeros(mi.SurfaceInteraction3f), mi.Mask(True))
        mean = float(np.mean(np.array(dr.detach(colour), dtype=float)))
        parameters = [value for _, value in mi.traverse(emission)] + [lamp.radiance_per_power]
        return cls(lamp.stored, fields, lamp.planar, mean, colour, parameters)


def stacks(rows: Sequence[Row]) -> dict[str, Any]:
    """For each kind of light one record of arrays, by the kind's name.

    A slot of another kind has the numbers of some light of this kind. Scalar variants get lists of
    records.
    """
    result: dict[str, Any] = {}
    for kind in {type(row.stored): None for row in rows}:
        if not dr.is_jit_v(mi.Float):
            result[kind.__name__] = [row.stored for row in rows]
            continue
        some = next(row for row in rows if type(row.stored) is kind)
        result[kind.__name__] = _stack(
            kind, [row if type(row.stored) is kind else some for row in rows]
        )
    return result


def _stack(kind: type, rows: Sequence[Row]) -> StoredLight:
    """One record of arrays out of many records."""
    arrays = {}
    for name, value in field_values(rows[0].stored).items():
        column = np.stack([row.fields[name] for row in rows], axis=-1)
        arrays[name] = table(type(value), column[0] if len(column) == 1 else column)
    return kind(**arrays)


def lights(rows: Sequence[Row], power: np.ndarray) -> Lights:
    """Places, directions, sizes and powers of lamps. A solid shines all around.

    Parameters
    ----------
    rows
        The lamps.
    power
        Their radiances times sampling weights.
    """
    centre, ex, ey = (
        np.array([row.fields[name] for row in rows], dtype=float) for name in ("centre", "ex", "ey")
    )
    radius, ratio, _ = np.array([proportions(row.fields) for row in rows]).T
    # What a solid shows of itself is about as large as its largest cross section.
    return Lights(
        centre=centre,
        normal=np.cross(ex, ey),
        all_around=np.array([not row.planar for row in rows]),
        radius=radius,
        power=power * np.pi * radius**2 * ratio,
    )


def behaviours(lamps: Sequence[Lamp]) -> tuple[list[tuple[type, Strategy]], np.ndarray]:
    """Kinds of lights with strategies, each pair once, and the place of each lamp's in the list."""
    pairs: dict[Any, tuple[type, Strategy]] = {}
    keys = []
    for lamp in lamps:
        kind = type(lamp.stored)
        keys.append((kind, lamp.strategy if lamp.follows_texture else lamp.sampling))
        pairs.setdefault(keys[-1], (kind, lamp.strategy))
    places = {key: place for place, key in enumerate(pairs)}
    return list(pairs.values()), np.array([places[key] for key in keys], dtype=np.uint32)
