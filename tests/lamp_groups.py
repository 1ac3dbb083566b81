"""Scenes of many lamps over a floor, for the tests of groups."""

import mi_ellipse
import mitsuba as mi
import numpy as np
from conftest import floor_and, lamp

from oracles.ellipse import rotation, translation

DOWN = rotation([1, 0, 0], 180)
LEFT = translation(-0.9, 0, 0.7) @ rotation([0, 1, 0], 20) @ DOWN @ np.diag([0.7, 0.3, 1, 1])
RIGHT = translation(0.9, 0.3, 0.9) @ rotation([1, 1, 0], -30) @ DOWN @ np.diag([0.3, 0.5, 1, 1])
RED, BLUE = ({"type": "rgb", "value": value} for value in ([3, 1, 0.5], [0.5, 1, 2]))

PATH = {"type": "path", "max_depth": 3}
LIGHT_ONLY = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}


def two(first="solid_angle", second="solid_angle", **options):
    return {"left": lamp(LEFT, first, RED, **options), "right": lamp(RIGHT, second, BLUE)}


def ring(count=12, sampling="solid_angle"):
    """Tilted lamps around the floor: a tree."""
    return {
        f"lamp{k}": lamp(
            rotation([0, 0, 1], 360 * k / count + 5)
            @ translation(1.3, 0, 0.5 + 0.05 * k)
            @ rotation([0, 1, 0], -40 + 7 * k)
            @ DOWN
            @ np.diag([0.25, 0.12, 1, 1]),
            sampling,
            {"type": "rgb", "value": [1 + 0.3 * (k % 12), 2, 3 - 0.2 * (k % 12)]},
        )
        for k in range(count)
    }


def half_dark():
    """A tree whose left half, and so one of its nodes as a whole, gives no light."""
    lamps = ring(20)
    for k in range(5, 15):
        lamps[f"lamp{k}"]["emitter"]["radiance"] = {"type": "rgb", "value": 0.0}
    return lamps


def weighted():
    lamps = two()
    lamps["left"]["emitter"]["sampling_weight"] = 3.0
    return lamps


def textured():
    values = np.random.default_rng(2).random((4, 3, 3)).astype(np.float32)
    lamps = two()
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True}
    lamps["left"]["emitter"]["radiance"] = bitmap
    return lamps


def solids():
    """Ellipses, a sphere and an ellipsoid."""
    half = mi.ScalarTransform4f()
    own = {"type": "ellipticalarea", "sampling": "projected_solid_angle", "radiance": RED}
    matrix = half.translate([-0.5, 0.9, 0.5]).scale([0.3, 0.2, 0.1])
    return two() | {
        "ball": {"type": "sphere", "center": [0.2, -0.9, 0.4], "radius": 0.2, "emitter": own},
        "egg": {"type": "ellipsoid", "to_world": matrix, "emitter": own},
    }


def others():
    """A sky, a point light and a mesh light beside the lamps."""
    square = mi.ScalarTransform4f().translate([0, 1.2, 1]).rotate([1, 0, 0], 150).scale(0.3)
    return two() | {
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.2}},
        "point": {"type": "point", "position": [0.3, -0.8, 1], "intensity": RED},
        "mesh": {"type": "cube", "to_world": square, "emitter": {"type": "area", "radiance": BLUE}},
    }


def facing_away():
    return two(flip_normals=True) | {"third": lamp(translation(0, -0.8, 0.8) @ DOWN, "solid_angle")}


def fog():
    box = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().scale(2.9),
        "bsdf": {"type": "null"},
        "interior": {"type": "homogeneous", "albedo": 0.8, "sigma_t": 0.3},
    }
    return two() | {"box": box}


def flipped_floor():
    """The floor is seen from the far side of its normal."""
    both = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    turned = mi.ScalarTransform4f().rotate([1, 0, 0], 180).scale(3)
    return two() | {"floor": {"type": "rectangle", "to_world": turned, "bsdf": both}}


def load(lamps, grouped, size=8, sampler="independent", below=False, **options):
    """A scene with a floor, seen from above the lamps or from below them.

    From below, no edge of a lamp and no shadow is in the picture.
    """
    scene = floor_and(lamps, size, **options)
    scene["sensor"]["sampler"] = {"type": sampler}
    scene["sensor"]["film"]["sample_border"] = True  # For gradients of what moves into the picture
    if below:
        look = mi.ScalarTransform4f().look_at([0, 0, 0.4], [0, 0, 0], [0, 1, 0])
        scene["sensor"] |= {"fov": 120.0, "to_world": look}
    scene = mi.load_dict(scene)
    if grouped:
        assert mi_ellipse.group_lamps(scene) is not None
    return scene
