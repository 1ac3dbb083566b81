"""What a job changes in a scene on the way in: its lamps, sensor, integrator and resolution."""

# Types such as `mi.Properties` exist only once a variant is set.
from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mitsuba as mi

from .rewrite import convert_lamps

# What a new integrator takes over from the one before, if it knows it
KEPT = ("max_depth", "rr_depth", "hide_emitters")

# For an error; Mitsuba does not list its plugins.
SOME_INTEGRATORS = "path, direct, volpath, volpathmis, ptracer, prb, prbvolpath"

ROOT = 0  # Index of the scene itself
CROP = ("crop_width", "crop_height", "crop_offset_x", "crop_offset_y")
LARGEST_SIDE = 2**16  # Pixels of a film; its memory would be 48 GiB


@dataclass(frozen=True)
class Changes:
    """
    Changes of a scene that are made when it is loaded; its file stays as it is.

    Raises
    ------
    ValueError
        If `resolution` is impossible.
    """

    # Turn each `area` on a `disk` or `sphere` into an `ellipticalarea`, see `rewrite.convert_lamps`
    convert_lamps: bool = False
    sensor: str | None = None  # Id or number, from 0, of the sensor; None: the first one
    integrator: str | None = None  # Its name; the depth of its paths stays; None: the scene's
    resolution: tuple[int, int] | None = None  # Width and height in pixels; None: the film's

    def __post_init__(self) -> None:
        if self.resolution is not None and not all(
            1 <= side <= LARGEST_SIDE for side in self.resolution
        ):
            width, height = self.resolution
            raise ValueError(
                f"resolution={width}x{height}: width and height lie from 1 to {LARGEST_SIDE}"
            )

    def describe(self) -> dict[str, str]:
        """Return the changes as texts for the metadata of a picture."""
        kept = "as in the scene"
        size = "x".join(map(str, self.resolution)) if self.resolution else kept
        return {
            "convert_lamps": "yes" if self.convert_lamps else "no",
            "sensor": self.sensor or "the first",
            "integrator": self.integrator or kept,
            "resolution": size,
        }

    def apply(self, state: mi.parser.ParserState) -> None:
        """
        Change a parsed scene, upgraded and resolved.

        Raises
        ------
        ValueError
            If the scene has no such sensor, or no film whose size could change, or if Mitsuba knows
            no such integrator.
        """
        if self.convert_lamps:
            convert_lamps(state)
        if self.sensor is not None:
            _choose_sensor(state, self.sensor)
        if self.integrator is not None:
            _replace_integrator(state, self.integrator)
        if self.resolution is not None:
            _resize(state, *self.resolution)


UNCHANGED = Changes()


# ---- Sensors ----


def sensor_names(state: mi.parser.ParserState) -> list[str]:
    """Return the ids of the sensors of a resolved scene, and numbers for those without."""
    return [
        state.nodes[index].props.id() or str(number)
        for number, (_, _, index) in enumerate(_sensors(state))
    ]


def _sensors(state: mi.parser.ParserState) -> Iterator[tuple[int, str, int]]:
    """Yield the parent of each sensor, its name there and itself, ordered as in the scene."""
    for name, child in _children(state, ROOT):
        kind = state.nodes[child].type
        if kind == mi.ObjectType.Sensor:
            yield ROOT, name, child
        elif kind == mi.ObjectType.Shape:
            for inner, grandchild in _children(state, child, mi.ObjectType.Sensor):
                yield child, inner, grandchild


def _children(
    state: mi.parser.ParserState, parent: int, kind: mi.ObjectType | None = None
) -> list[tuple[str, int]]:
    """Return names and indices of the objects in another one, or of those of one kind."""
    references = [
        (name, value.index())
        for name, value in state.nodes[parent].props.items()
        if isinstance(value, mi.Properties.ResolvedReference)
    ]
    return [pair for pair in references if kind in (None, state.nodes[pair[1]].type)]


def _choose_sensor(state: mi.parser.ParserState, wanted: str) -> None:
    """Remove all other sensors, so that the wanted one is the first."""
    sensors = list(_sensors(state))
    ids = [state.nodes[index].props.id() for _, _, index in sensors]
    number = int(wanted) if wanted.isdecimal() else -1
    if number not in range(len(sensors)) and wanted in ids:
        number = ids.index(wanted)
    if not 0 <= number < len(sensors):
        named = "".join(f", {name}" for name in ids if name)
        count = f"numbers 0 to {len(sensors) - 1}{named}" if sensors else "none"
        raise ValueError(f'sensor="{wanted}" is unknown; the scene has {count}')
    for k, (parent, name, _) in enumerate(sensors):
        if k != number:
            del state.nodes[parent].props[name]


# ---- Integrator ----


def _replace_integrator(state: mi.parser.ParserState, plugin: str) -> None:
    """Put another integrator into a scene, with the depth of the paths of the old one."""
    old = _children(state, ROOT, mi.ObjectType.Integrator)
    index = old[0][1] if old else _add(state, ROOT, mi.ObjectType.Integrator, plugin)
    before = state.nodes[index].props
    props = mi.Properties(plugin)
    for name in KEPT:
        if name in before:
            props[name] = before[name]
    for name in _unknown(props):
        del props[name]
    props.set_id(before.id())
    state.nodes[index].props = props


def _unknown(props: mi.Properties) -> list[str]:
    """Return the parameters that an integrator does not ask for when it is made."""
    tried = mi.Properties(props)
    plugin = props.plugin_name()
    try:
        integrator = mi.PluginManager.instance().create_object(tried)
    except RuntimeError as error:
        if "not found" in str(error):
            raise ValueError(_unknown_integrator(plugin)) from None
        raise ValueError(
            f'integrator="{plugin}" cannot be chosen from outside, the scene must describe it:'
            f" {error}"
        ) from None
    if not isinstance(integrator, mi.Integrator):
        raise ValueError(_unknown_integrator(plugin))
    return [name for name in KEPT if name in props and not tried.was_queried(name)]


def _unknown_integrator(plugin: str) -> str:
    return f'integrator="{plugin}": Mitsuba has none of this name; some are {SOME_INTEGRATORS}'


def _add(state: mi.parser.ParserState, parent: int, kind: mi.ObjectType, plugin: str) -> int:
    """Add an object to another one of a scene, and return its index."""
    node = mi.parser.SceneNode()
    node.type = kind
    node.props = mi.Properties(plugin)
    index = len(state.nodes)
    state.nodes[parent].props[f"_added_{index}"] = mi.Properties.ResolvedReference(index)
    state.nodes.append(node)  # What was taken from the list before may be gone now.
    return index


# ---- Resolution ----


def _resize(state: mi.parser.ParserState, width: int, height: int) -> None:
    """Give every sensor a film of another size."""
    sensors = [index for _, _, index in _sensors(state)]
    if not sensors:
        raise ValueError(f"resolution={width}x{height}: the scene has no sensor")
    for sensor in sensors:
        films = _children(state, sensor, mi.ObjectType.Film)
        film = films[0][1] if films else _add(state, sensor, mi.ObjectType.Film, "hdrfilm")
        props = state.nodes[film].props
        if any(name in props for name in CROP):
            raise ValueError(
                f"resolution={width}x{height}: the film renders a part of the picture alone"
                f" ({', '.join(name for name in CROP if name in props)}), and that does not scale"
            )
        props["width"], props["height"] = width, height
