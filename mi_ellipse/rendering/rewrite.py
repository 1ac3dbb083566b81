"""Rewrite a parsed scene: choose how its lamps are sampled, take over built-in lamps, and back."""

# Types such as `mi.Properties` exist only once a variant is set.
from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from .. import sampling as strategies
from ..plugins.names import (
    AREA,
    DISK,
    ELLIPSE,
    ELLIPSOID,
    ELLIPTICAL_AREA,
    POWER,
    RADIANCE,
    SPHERE,
)
from ..plugins.shape import as_disk

# Instead of the name of a strategy: Mitsuba's own emitter
BUILT_IN = "built-in"

SHAPES = (DISK, SPHERE, ELLIPSE, ELLIPSOID)


@dataclass(frozen=True)
class Conversion:
    """What became of the `area` emitters of a scene on shapes that could be lamps."""

    converted: tuple[str, ...]  # Ids of the lamps, and places of those without
    left: tuple[str, ...] = ()  # Spheres and ellipsoids that shine inwards

    def __str__(self) -> str:
        lamps = "lamp" if len(self.converted) == 1 else "lamps"
        names = f": {', '.join(self.converted)}" if self.converted else ""
        text = f'{len(self.converted)} {lamps} converted to "{ELLIPTICAL_AREA}"{names}'
        if self.left:
            text += f"; left as they are, because they shine inwards: {', '.join(self.left)}"
        return text


@dataclass(frozen=True)
class Pair:
    """A shape and its emitter in a parsed scene whose references are resolved."""

    shape: mi.parser.SceneNode
    emitter: mi.parser.SceneNode
    index: int  # Of the emitter
    name: str  # Id of the shape or of the emitter, or else the place in the file

    @property
    def ids(self) -> list[str]:
        """Ids by which a user can name the lamp."""
        return [node.props.id() for node in (self.shape, self.emitter) if node.props.id()]


def pairs(state: mi.parser.ParserState) -> Iterator[Pair]:
    """Yield each shape of a resolved scene with its emitter, in the order of the file."""
    for shape in state.nodes:
        if shape.type != mi.ObjectType.Shape:
            continue
        for _, value in shape.props.items():
            if isinstance(value, mi.Properties.ResolvedReference):
                emitter = state.nodes[value.index()]
                if emitter.type == mi.ObjectType.Emitter:
                    place = mi.parser.file_location(state, shape)
                    name = shape.props.id() or emitter.props.id() or place
                    yield Pair(shape, emitter, value.index(), name)


# ---- Built-in lamps ----


def convertible(state: mi.parser.ParserState) -> tuple[list[Pair], list[Pair]]:
    """Return the lamps that :func:`convert_lamps` converts, and those that shine inwards."""
    outwards: list[Pair] = []
    inwards: list[Pair] = []
    for pair in pairs(state):
        props = pair.shape.props
        if pair.emitter.props.plugin_name() == AREA and props.plugin_name() in SHAPES:
            (inwards if _shines_inwards(props) else outwards).append(pair)
    return outwards, inwards


def convert_lamps(state: mi.parser.ParserState) -> Conversion:
    """
    Turn every `area` on a `disk`, `sphere`, `ellipse` or `ellipsoid` into an `ellipticalarea`.

    A sphere that shines inwards stays as it is: no strategy samples its inside.

    Parameters
    ----------
    state
        Parsed scene, upgraded and resolved. It is changed.
    """
    outwards, inwards = convertible(state)
    for pair in outwards:
        pair.emitter.props.set_plugin_name(ELLIPTICAL_AREA)
    return Conversion(tuple(pair.name for pair in outwards), tuple(pair.name for pair in inwards))


def _shines_inwards(props: mi.Properties) -> bool:
    """Tell whether the normals of a closed shape point inwards, as Mitsuba decides it."""
    flipped = bool(props.get("flip_normals", False))
    if props.plugin_name() == SPHERE:
        to_world: Any = props.get("to_world", mi.ScalarAffineTransform4d())
        linear = np.asarray(to_world.matrix, dtype=np.float64).reshape(4, 4)[:3, :3]
        return flipped != bool(np.linalg.det(linear) < 0)
    return flipped and props.plugin_name() == ELLIPSOID


# ---- The choice of a strategy ----


def check_choice(sampling: str) -> None:
    """Raise a ValueError unless a choice of strategies, see :func:`choose_sampling`, is one."""
    _parse_choice(sampling)


def choose_sampling(state: mi.parser.ParserState, sampling: str) -> None:
    """
    Give the lamps of a scene other strategies.

    Parameters
    ----------
    state
        Parsed scene, upgraded and resolved. It is changed.
    sampling
        Name of a strategy for every `ellipticalarea`, or ``ID=NAME`` for one lamp, or several of
        them with commas between, such as ``ceiling=projected_solid_angle,solid_angle``. The id is
        that of the shape or of the emitter. Lamps without a name keep what the scene says. The name
        ``built-in`` turns the lamp into one of Mitsuba's own.

    Raises
    ------
    ValueError
        For an unknown strategy or id, for lamps that have no counterpart among Mitsuba's own, or if
        a strategy is given but there is no lamp.
    """
    everyone, single = _parse_choice(sampling)
    lamps = [pair for pair in pairs(state) if pair.emitter.props.plugin_name() == ELLIPTICAL_AREA]
    known = [lamp_id for lamp in lamps for lamp_id in lamp.ids]
    for lamp_id in single:
        if lamp_id not in known:
            names = f"known are: {', '.join(known)}" if known else "none of its lamps has an id"
            raise ValueError(
                f'sampling="{sampling}": the scene has no "{ELLIPTICAL_AREA}" with the id'
                f' "{lamp_id}"; {names}'
            )
    if not lamps and everyone not in (None, BUILT_IN):
        raise ValueError(_no_lamps(state, sampling))
    for lamp in lamps:
        named = [single[lamp_id] for lamp_id in lamp.ids if lamp_id in single]
        name = named[0] if named else everyone
        if name == BUILT_IN:
            _make_built_in(lamp)
        elif name is not None:
            lamp.emitter.props["sampling"] = name


def _parse_choice(sampling: str) -> tuple[str | None, dict[str, str]]:
    """Return the strategy of every lamp that is not named, and those of lamps by their ids."""
    everyone: str | None = None
    single: dict[str, str] = {}
    for part in sampling.split(","):
        lamp, equals, name = (text.strip() for text in part.rpartition("="))
        if name != BUILT_IN:
            strategies.find(name)
        if equals:
            if lamp in single:
                raise ValueError(f'sampling="{sampling}": the lamp "{lamp}" is named twice')
            single[lamp] = name
        elif everyone is None:
            everyone = name
        else:
            raise ValueError(
                f'sampling="{sampling}" has two strategies for all lamps, "{everyone}" and'
                f' "{name}"; write ID=NAME for a single lamp'
            )
    return everyone, single


def _no_lamps(state: mi.parser.ParserState, sampling: str) -> str:
    """Return the error for a strategy without a lamp, with what could be one."""
    text = f'a sampling strategy ("{sampling}") is given, but the scene has no "{ELLIPTICAL_AREA}"'
    could_be, _ = convertible(state)
    if could_be:
        names = ", ".join(pair.name for pair in could_be)
        text += f'; convert_lamps, or --convert-lamps, makes one of each "{AREA}" of {names}'
    return text


def _make_built_in(lamp: Pair) -> None:
    """Turn a lamp into Mitsuba's own `area` on a `disk` or `sphere`."""
    if lamp.shape.props.plugin_name() == ELLIPSOID:
        raise ValueError(
            f'{lamp.name}: sampling="{BUILT_IN}" is not possible for an "{ELLIPSOID}", because'
            " Mitsuba has no such shape; choose another strategy for it"
        )
    if lamp.shape.props.plugin_name() == ELLIPSE:
        lamp.shape.props = as_disk(lamp.shape.props)
    if POWER in lamp.emitter.props:
        lamp.emitter.props[RADIANCE] = _radiance(lamp)
        del lamp.emitter.props[POWER]
    lamp.emitter.props.set_plugin_name(AREA)
    if "sampling" in lamp.emitter.props:
        del lamp.emitter.props["sampling"]


def _radiance(lamp: Pair) -> Any:
    """Return the radiance of a lamp with a power, on a shape of Mitsuba's own: power / (π area)."""
    shape = mi.Properties(lamp.shape.props)
    for name, value in lamp.shape.props.items():
        if isinstance(value, mi.Properties.ResolvedReference):
            del shape[name]
    built: Any = mi.PluginManager.instance().create_object(shape)
    factor = 1 / (np.pi * float(np.ravel(np.array(built.surface_area()))[0]))
    power = lamp.emitter.props[POWER]
    if isinstance(power, float | int):
        return power * factor
    if isinstance(power, mi.ScalarColor3d):
        return power * factor
    if hasattr(power, "wavelengths"):
        values = [value * factor for value in power.values]
        uniform = power.is_uniform()
        return type(power)(*values) if uniform else type(power)(power.wavelengths, values)
    raise ValueError(
        f'{lamp.name}: sampling="{BUILT_IN}" is not possible for a {POWER} that a plugin gives;'
        f" write it as <float>, <rgb> or <spectrum>, or give the {RADIANCE}"
    )
