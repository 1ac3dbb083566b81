"""What a group gathers of its lamps, in NumPy, and the arrays that it makes of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..geometry.light import field_values
from ..geometry.tracing import table
from ..sampling.strategy import Strategy
from .lamp import Lamp


@dataclass
class Shapes:
    """Places, directions and sizes of lights of any kind, in NumPy and world space, a row each."""

    centre: np.ndarray  # (n, 3)
    ex: np.ndarray  # (n, 3), direction of the longest
    ey: np.ndarray  # (n, 3), and of the middle semi-axis
    lx: np.ndarray  # (n,), longest semi-axis
    ratio: np.ndarray  # (n,), middle semi-axis over lx
    flatness: np.ndarray  # (n,), shortest semi-axis over lx; 0 for an ellipse

    def __getitem__(self, places: np.ndarray) -> Shapes:
        return Shapes(**{name: value[places] for name, value in vars(self).items()})

    @property
    def normal(self) -> np.ndarray:
        """Direction of the shortest semi-axis: for an ellipse, that of emission."""
        return np.cross(self.ex, self.ey)


@dataclass
class Kind:
    """The stored lights of one kind."""

    type: type
    place: np.ndarray  # Of each among the lamps, rising
    types: dict[str, type]  # Of the fields
    fields: dict[str, np.ndarray]  # (lights, components)

    @classmethod
    def of(cls, kind: type, place: np.ndarray, lamps: Sequence[Lamp]) -> Kind:
        """Read the lights of lamps."""
        records = [field_values(lamp.stored) for lamp in lamps]
        types = {name: type(value) for name, value in records[0].items()}
        fields = {name: np.array([_numbers(record[name]) for record in records]) for name in types}
        return cls(kind, place, types, fields)

    def update(self, row: int, lamp: Lamp) -> None:
        """Read the light of one lamp anew."""
        for name, value in field_values(lamp.stored).items():
            self.fields[name][row] = _numbers(value)

    def stack(self, places: np.ndarray) -> Any:
        """One record of arrays, with the light at each place among the lamps.

        A place of another kind has the numbers of some light of this kind.
        """
        row = np.zeros(max(places.max(), self.place.max()) + 1, dtype=int)
        row[self.place] = np.arange(len(self.place))
        rows = row[places]
        arrays = {}
        for name, values in self.fields.items():
            columns = values[rows].T
            arrays[name] = table(self.types[name], columns if len(columns) > 1 else columns[0])
        return self.type(**arrays)


class Records:
    """The lamps of a group as rows of numbers."""

    def __init__(self, lamps: Sequence[Lamp]):
        self.lamps = list(lamps)
        self._read()

    def _read(self) -> None:
        kinds: dict[type, list[int]] = {}
        for place, lamp in enumerate(self.lamps):
            kinds.setdefault(type(lamp.stored), []).append(place)
        self.kinds = [
            Kind.of(kind, np.array(places), [self.lamps[k] for k in places])
            for kind, places in kinds.items()
        ]
        self.colours = [_colour(lamp) for lamp in self.lamps]

    def update(self, place: int) -> None:
        """Follow a change of the lamp at this place."""
        lamp = self.lamps[place]
        kind = next(kind for kind in self.kinds if place in kind.place)
        if kind.type is type(lamp.stored):
            kind.update(int(np.searchsorted(kind.place, place)), lamp)
            self.colours[place] = _colour(lamp)
        else:
            self._read()  # It has become a light of another kind

    @property
    def brightness(self) -> np.ndarray:
        """Mean radiance of each lamp."""
        return np.array([colour.mean for colour in self.colours])

    @property
    def planar(self) -> np.ndarray:
        """True for a lamp that shines to one side."""
        return np.array([lamp.planar for lamp in self.lamps])

    def shapes(self) -> Shapes:
        """The lights of all kinds. A sphere has one length, an ellipse no third one."""
        count = len(self.lamps)
        shapes = Shapes(*np.zeros((3, count, 3)), *np.ones((3, count)))
        for kind in self.kinds:
            values = {name: kind.fields.get(name) for name in vars(shapes)}
            for name, value in values.items():
                target = getattr(shapes, name)
                if value is not None:
                    target[kind.place] = value if target.ndim > 1 else value[:, 0]
                elif name == "flatness" and values["ratio"] is not None:
                    target[kind.place] = 0
        return shapes

    def stacks(self, places: np.ndarray) -> dict[str, Any]:
        """For each kind of light a record of arrays, by the kind's name.

        Scalar variants get lists of records.
        """
        if dr.is_jit_v(mi.Float):
            return {kind.type.__name__: kind.stack(places) for kind in self.kinds}
        stored = [self.lamps[k].stored for k in places]
        return {kind.type.__name__: stored for kind in self.kinds}

    def behaviours(self) -> tuple[list[tuple[type, Strategy]], np.ndarray]:
        """Kinds of lights with strategies, each pair once, and the place of each lamp's there."""
        pairs: dict[Any, tuple[type, Strategy]] = {}
        keys = []
        for lamp in self.lamps:
            kind = type(lamp.stored)
            keys.append((kind, lamp.strategy if lamp.follows_texture else lamp.sampling))
            pairs.setdefault(keys[-1], (kind, lamp.strategy))
        places = {key: place for place, key in enumerate(pairs)}
        return list(pairs.values()), np.array([places[key] for key in keys], dtype=np.uint32)


@dataclass(frozen=True)
class Colour:
    """The radiance of a lamp."""

    mean: float
    value: np.ndarray | None  # If it is one colour, and no spectrum
    parameters: list[Any]  # What it follows from: derivatives may follow them too


def _colour(lamp: Lamp) -> Colour:
    emission = lamp.emission
    if mi.is_spectral or emission.is_spatially_varying():
        mean = lamp.of_emission(emission.mean())
        return Colour(float(np.array(dr.detach(mean)).ravel()[0]), None, [])
    value = lamp.radiance(dr.zeros(mi.SurfaceInteraction3f), mi.Mask(True))
    value = np.array(_numbers(dr.detach(value)))
    parameters = [parameter for _, parameter in mi.traverse(emission)]
    return Colour(float(value.mean()), value, [*parameters, lamp.radiance_per_power])


def _numbers(value: Any) -> list[float]:
    """Components of a number or vector. To read them one by one is faster than `numpy.array`."""
    if not dr.is_jit_v(mi.Float):
        return np.array(value).reshape(-1).tolist()
    if dr.depth_v(value) == 1:
        return [value[0]]
    return [value[k][0] for k in range(len(value))]
