"""Error and time of sphere and ellipsoid lamps, against `sphere` + `area` and a mesh + `area`."""

from __future__ import annotations

from functools import partial

import mi_ellipse
import mitsuba as mi
import numpy as np

from .error import errors
from .harness import PAIRS, compare_times, rendering
from .scenes import LIGHT_SAMPLES, PATH, RADIANCE, sensor

BUILT_IN = "built-in"  # `sphere` + `area`, or 20 480 triangles + `area`
KINDS = ("area", "solid_angle", "projected_solid_angle")
SHAPES = {"sphere": (0.3, 0.3, 0.3), "ellipsoid": (1.2, 0.3, 0.15)}
HEIGHTS = {"sphere": (0.35, 1.0), "ellipsoid": (0.4, 1.0)}
BESIDE = {"sphere": 0.95, "ellipsoid": 1.85}  # Middle of the picture; no lamp is in it
TURN = 40  # degrees
SIZE = 128
SPP = 64
REFERENCE_PASSES = 16  # of 1 024 samples


def floor_lamp(shape: str, kind: str, height: float, integrator: dict) -> mi.Scene:
    """A floor under a lamp, seen from straight above beside the lamp."""
    transform = mi.ScalarTransform4f
    x = BESIDE[shape]
    camera = transform().look_at([x, -0.001, 6], [x, 0, 0], [0, 1, 0])
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": sensor(camera, 12, SIZE),
            "floor": {"type": "rectangle", "to_world": transform().scale(4)},
            "lamp": lamp(shape, kind, height),
        }
    )


def lamp(shape: str, kind: str, height: float) -> dict | mi.Mesh:
    """A sphere or an ellipsoid of this package, or what a user of Mitsuba alone would take."""
    place = mi.ScalarTransform4f().translate([0, 0, height])
    if shape == "ellipsoid":
        place = place.rotate([1, 0.2, 0.3], TURN)
    axes = SHAPES[shape]
    if kind in KINDS:
        names = ("semi_axis_x", "semi_axis_y", "semi_axis_z")
        emitter = {"type": "ellipticalarea", "sampling": kind, "radiance": RADIANCE}
        return dict(zip(names, axes, strict=True)) | {
            "type": "ellipsoid",
            "to_world": place,
            "emitter": emitter,
        }
    area = {"type": "area", "radiance": RADIANCE}
    to_world = place @ mi.ScalarTransform4f().scale([*axes])
    if shape == "sphere":
        return {"type": "sphere", "to_world": to_world, "emitter": area}
    props = mi.Properties()
    props["emitter"] = mi.load_dict(area)
    return mi_ellipse.tessellate(mi_ellipse.Ellipsoid(to_world), 160, props)


def run(pairs: int = PAIRS) -> dict:
    """Errors, how many times lower they are, and time ratios, of both shapes at two heights."""
    results = {"spp": SPP, "size": SIZE, "shapes": {}}
    for shape, heights in HEIGHTS.items():
        results["shapes"][shape] = {str(height): _of(shape, height, pairs) for height in heights}
    return results


def _of(shape: str, height: float, pairs: int) -> dict:
    best = floor_lamp(shape, "projected_solid_angle", height, LIGHT_SAMPLES)
    passes = [
        np.array(mi.render(best, spp=1024, seed=seed), dtype=float)
        for seed in range(REFERENCE_PASSES)
    ]
    reference = sum(passes) / len(passes)
    entry = {}
    for label, integrator in (("light samples", LIGHT_SAMPLES), ("MIS", PATH)):
        load = {k: partial(floor_lamp, shape, k, height, integrator) for k in (BUILT_IN, *KINDS)}
        measured = {kind: errors(load[kind](), reference) for kind in load}
        make = {kind: rendering(load[kind], SPP) for kind in load}
        ratios = compare_times(make[BUILT_IN], make, pairs).ratios
        base = measured[BUILT_IN]["trimmed"]
        entry[label] = {
            kind: measured[kind]
            | {"time": vars(ratios[kind]), "error_ratio": base / measured[kind]["trimmed"]}
            for kind in load
        }
        for kind, values in entry[label].items():
            ratio, time = values["error_ratio"], ratios[kind]
            print(f"{shape} at {height}, {label}: {kind:<24}{ratio:8.1f} times lower, {time}")
    return entry
