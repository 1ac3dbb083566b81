"""The scenes of the benchmarks, with our lamps and with Mitsuba's own."""

from __future__ import annotations

from pathlib import Path

import mi_ellipse
import mitsuba as mi
from mi_ellipse.sampling import STRATEGIES
from mi_ellipse.scene import load_scene

SCENES = Path(__file__).parent.parent / "scenes"
SEMI_AXES = (1.5, 0.4)
RADIANCE = {"type": "rgb", "value": [4, 3, 2]}
BUILT_IN = "disk + area"
MESH = "64 triangles + area"
RECTANGLE = "rectangle + area"

PATH = {"type": "path", "max_depth": 2}
LIGHT_SAMPLES = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}


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
    to_world = mi.ScalarTransform4f().translate([0, 0, height]).rotate([1, 0, 0], 150)
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": {
                "type": "perspective",
                "fov": 40,
                "to_world": mi.ScalarTransform4f().look_at([0, -6, 4], [0, 0, 0.3], [0, 0, 1]),
                "film": {
                    "type": "hdrfilm",
                    "width": size,
                    "height": size,
                    "rfilter": {"type": "box"},  # independent pixel errors
                    "pixel_format": "rgb",
                    "component_format": "float32",
                },
                "sampler": {"type": "independent"},
            },
            "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(4)},
            "ball": {"type": "sphere", "center": [-0.5, -1.6, 0.4], "radius": 0.4},
            "lamp": lamp(kind, to_world),
        }
    )


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
        side = (mi.ScalarFloat(3.14159265) / 4) ** 0.5  # of a square with the area of the disk
        to_world = to_world @ scale([SEMI_AXES[0] * side, SEMI_AXES[1] * side, 1])
        return {"type": "rectangle", "to_world": to_world, "emitter": area}
    props = mi.Properties()
    props["emitter"] = mi.load_dict(area)
    return mi_ellipse.tessellate(to_world @ scale([*SEMI_AXES, 1]), 64, props)


def scene_file(name: str, kind: str, **parameters) -> mi.Scene:
    """A scene of the study by the stem of its file, with a strategy or with `BUILT_IN`."""
    path = SCENES / f"{name}.xml"
    parameters = {key: str(value) for key, value in parameters.items()}
    if kind != BUILT_IN:
        return load_scene(path, parameters, kind)

    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_file(config, str(path), **parameters)
    for node in state.nodes:
        props = node.props
        if props.plugin_name() == "ellipticalarea":
            props.set_plugin_name("area")
            props.remove_property("sampling")
        elif props.plugin_name() == "ellipse":
            axes = [props.get(f"semi_axis_{axis}", 1.0) for axis in "xy"]
            to_world = props.get("to_world", mi.ScalarTransform4d())
            props["to_world"] = to_world @ mi.ScalarTransform4d().scale([*axes, 1])
            props.set_plugin_name("disk")
            for axis in "xy":
                props.remove_property(f"semi_axis_{axis}")
    resolver = mi.file_resolver()
    resolver.prepend(str(SCENES))
    mi.parser.transform_all(config, state)
    return mi.parser.instantiate(config, state)
