"""The scenes of the benchmarks, with our lamps and with Mitsuba's own."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

import mi_ellipse
import mitsuba as mi
from mi_ellipse.plugins.names import AREA, ELLIPSE, ELLIPSOID, ELLIPTICAL_AREA
from mi_ellipse.rendering.scene import load_scene
from mi_ellipse.sampling import STRATEGIES

SCENES = Path(__file__).parent.parent / "scenes"
SEMI_AXES = (1.5, 0.4)
RADIANCE = {"type": "rgb", "value": [4, 3, 2]}
BUILT_IN = "disk + area"
CONTROL = "disk + area again"
MESH = "64 triangles + area"
RECTANGLE = "rectangle + area"
SOLIDS = "sphere or mesh + area"  # For ellipsoids, the mesh of the shape itself: 20 480 triangles

HALF_SIDE = math.sqrt(math.pi) / 2  # of a square with the area of the unit disk
SEGMENTS = 64

PATH = {"type": "path", "max_depth": 2}
LIGHT_SAMPLES = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}


def sensor(to_world: mi.ScalarTransform4f, fov: float, size: int) -> dict:
    """A camera whose pixels, `size` along an edge, have independent errors."""
    return {
        "type": "perspective",
        "fov": fov,
        "to_world": to_world,
        "film": {
            "type": "hdrfilm",
            "width": size,
            "height": size,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "independent"},
    }


def floor_and_ball(
    lamps: dict, integrator: dict, size: int, camera: Sequence[float] = (0, -6, 4)
) -> mi.Scene:
    """Lamps above a floor with a ball, which the camera looks at."""
    look_at = mi.ScalarTransform4f().look_at(camera, [0, 0, 0.3], [0, 0, 1])
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": sensor(look_at, 40, size),
            "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(4)},
            "ball": {"type": "sphere", "center": [-0.5, -1.6, 0.4], "radius": 0.4},
            **lamps,
        }
    )


def floor_ball_lamp(
    kind: str, integrator: dict = PATH, height: float = 0.6, size: int = 320
) -> mi.Scene:
    """A floor, a ball and an ellipse: the bare scene in which sampling costs most.

    The ellipse is tilted by 30° about its longer axis.

    Parameters
    ----------
    kind
        A strategy of this package, or one of `BUILT_IN`, `MESH` and `RECTANGLE`.
    integrator
        Dictionary of the integrator.
    height
        Of the lamp's centre above the floor.
    size
        Pixels along an edge.
    """
    return floor_and_ball({"lamp": lamp(kind, lamp_to_world(height))}, integrator, size)


def lamp_to_world(height: float) -> mi.ScalarTransform4f:
    """Where the lamp of `floor_ball_lamp` is."""
    return mi.ScalarTransform4f().translate([0, 0, height]).rotate([1, 0, 0], 150)


def lamp(kind: str, to_world: mi.ScalarTransform4f) -> dict | mi.Mesh:
    """An ellipse with `SEMI_AXES`, or the lamp that a user of Mitsuba alone would take for it."""
    scale = mi.ScalarTransform4f().scale
    area = {"type": "area", "radiance": RADIANCE}
    if kind in STRATEGIES:
        return {
            "type": "ellipse",
            "semi_axis_x": SEMI_AXES[0],
            "semi_axis_y": SEMI_AXES[1],
            "to_world": to_world,
            "emitter": {"type": "ellipticalarea", "sampling": kind, "radiance": RADIANCE},
        }
    if kind == BUILT_IN:
        return {"type": "disk", "to_world": to_world @ scale([*SEMI_AXES, 1]), "emitter": area}
    if kind == RECTANGLE:
        to_world = to_world @ scale([SEMI_AXES[0] * HALF_SIDE, SEMI_AXES[1] * HALF_SIDE, 1])
        return {"type": "rectangle", "to_world": to_world, "emitter": area}
    props = mi.Properties()
    props["emitter"] = mi.load_dict(area)
    return mi_ellipse.tessellate(to_world @ scale([*SEMI_AXES, 1]), SEGMENTS, props)


def scene_file(name: str, kind: str, **parameters) -> mi.Scene:
    """A scene of the study by the stem of its file, with any kind of lamps."""
    path = SCENES / f"{name}.xml"
    parameters = {key: str(value) for key, value in parameters.items()}
    if kind in STRATEGIES:
        return load_scene(path, parameters, kind)

    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_file(config, str(path), **parameters)
    with tempfile.TemporaryDirectory() as folder:
        for count, node in enumerate(state.nodes):
            _replace_lamp(node.props, kind, Path(folder) / f"{count}.ply")
        before = mi.file_resolver()
        resolver = mi.FileResolver(before)
        resolver.prepend(str(SCENES))
        mi.set_file_resolver(resolver)
        try:
            mi.parser.transform_all(config, state)
            return mi.parser.instantiate(config, state)
        finally:
            mi.set_file_resolver(before)


def _replace_lamp(props: mi.Properties, kind: str, mesh_file: Path) -> None:
    """Make a part of a lamp of this package one of Mitsuba's own."""
    if props.plugin_name() == ELLIPTICAL_AREA:
        props.set_plugin_name(AREA)
        del props["sampling"]
    elif props.plugin_name() == ELLIPSE:
        axes = [props.get(f"semi_axis_{axis}", 1.0) for axis in "xy"]
        for axis in "xy":
            del props[f"semi_axis_{axis}"]
        to_world = props.get("to_world", mi.ScalarTransform4d())
        _replace_shape(props, kind, to_world @ mi.ScalarTransform4d().scale([*axes, 1]), mesh_file)
    elif props.plugin_name() == ELLIPSOID:
        axes = [props.get(f"semi_axis_{axis}", 1.0) for axis in "xyz"]
        to_world = props.get("to_world", mi.ScalarTransform4d()) @ mi.ScalarTransform4d().scale(
            axes
        )
        mi_ellipse.tessellate(mi_ellipse.Ellipsoid(to_world), 160).write_ply(str(mesh_file))
        for name in ("to_world", *(f"semi_axis_{axis}" for axis in "xyz")):
            if name in props:
                del props[name]
        props.set_plugin_name("ply")
        props["filename"] = str(mesh_file)


def _replace_shape(
    props: mi.Properties, kind: str, to_world: mi.ScalarTransform4d, mesh_file: Path
) -> None:
    """Make the image of the unit disk a shape of Mitsuba's own, or the rectangle of its area."""
    if kind == MESH:
        mi_ellipse.tessellate(to_world, SEGMENTS).write_ply(str(mesh_file))
        props.set_plugin_name("ply")
        props["filename"] = str(mesh_file)
        del props["to_world"]
        return
    if kind == RECTANGLE:
        to_world = to_world @ mi.ScalarTransform4d().scale([HALF_SIDE, HALF_SIDE, 1])
    props.set_plugin_name("disk" if kind == BUILT_IN else "rectangle")
    props["to_world"] = to_world
