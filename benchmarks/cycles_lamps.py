"""Noise against Blender's Cycles with its light tree, for many elliptical lamps above a floor.

    python -m benchmarks.cycles_lamps --bpy-python PATH/TO/python [--seeds 4]

prints the table and writes `docs/data/cycles_lamps.json`. It takes the other interpreter, the
samples and the estimators of `benchmarks.cycles`.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import drjit as dr
import mi_ellipse
import mitsuba as mi
import numpy as np

from .cycles import DOCS, ESTIMATORS, SCENE, Blender, agreement, moments, render
from .harness import machine
from .scenes import BUILT_IN, sensor

COUNTS = (2, 16, 100)
SIZE = 100
COLOUR = (4, 3, 2)
BOXES = [
    {"center": [x, y], "half_sides": [0.3, 0.3, 0.15]}
    for x, y in ((-1.6, -1.3), (0.1, -2.1), (1.5, -0.6), (-0.4, 0.5))
]
CLEARANCE = 0.35  # Of the lowest point of a lamp; the boxes are 0.3 high
GRID = 6  # Length of an edge of the square that the lamps fill
TREE, UNIFORM = "Cycles, light tree", "Cycles, uniform choice"
GROUPED = "{}, grouped"
STRATEGIES = ("solid_angle", "projected_solid_angle")
REFERENCE_SPP = 2048
TOLERANCE = 2e-3  # Relative, of the mean


def lamps(count: int) -> list[dict]:
    """Tilted lamps of different shape, height and brightness that face down.

    Two of them stand side by side; more of them fill a grid. The area of all lamps together hardly
    depends on their number.
    """
    rng = np.random.default_rng(count)
    if count == 2:
        places, long = [(-1.2, 0.0), (1.2, 0.0)], 0.8
    else:
        side = math.isqrt(count)
        steps = GRID * ((np.arange(side) + 0.5) / side - 0.5)
        places, long = [(x, y) for y in steps for x in steps], 0.5 * GRID / side
    return [_lamp(rng, place, long) for place in places]


def _lamp(rng: np.random.Generator, place: tuple[float, float], long: float) -> dict:
    """A lamp whose longer semi-axis is at most `long`."""
    a = long * rng.uniform(0.5, 1)
    b = a * rng.uniform(0.3, 1)
    tilt, azimuth, turn = rng.uniform(15, 60), rng.uniform(0, 360), rng.uniform(0, 360)
    height = CLEARANCE + a * math.sin(math.radians(tilt)) + rng.uniform(0, 0.5)
    to_world = (
        mi.ScalarTransform4f()
        .translate([*map(float, place), height])
        .rotate([0, 0, 1], azimuth)
        .rotate([1, 0, 0], 180 - tilt)
        .rotate([0, 0, 1], turn)
    )
    brightness = rng.uniform(0.5, 2)
    return {
        "to_world": np.array(to_world.matrix, dtype=float).tolist(),
        "semi_axes": [a, b],
        "radiance": [brightness * value for value in COLOUR],
    }


def description(count: int) -> dict:
    """The scene for both renderers."""
    return SCENE | {"size": SIZE, "boxes": BOXES, "lamps": lamps(count)}


def mitsuba_scene(kind: str, integrator: dict, scene: dict) -> mi.Scene:
    """The described scene with a strategy or Mitsuba's own lamps."""
    transform = mi.ScalarTransform4f()
    gray = {"type": "diffuse", "reflectance": {"type": "rgb", "value": scene["albedo"]}}
    things = {
        "floor": {"type": "rectangle", "to_world": transform.scale(scene["floor_half_width"])}
    }
    for k, box in enumerate(scene["boxes"]):
        to_world = transform.translate([*box["center"], box["half_sides"][2]])
        things[f"box{k}"] = {"type": "cube", "to_world": to_world.scale(box["half_sides"])}
    for thing in things.values():
        thing["bsdf"] = gray
    for k, lamp in enumerate(scene["lamps"]):
        things[f"lamp{k}"] = mitsuba_lamp(kind, lamp)
    camera = transform.look_at(scene["origin"], scene["target"], [0, 0, 1])
    things["sensor"] = sensor(camera, scene["fov"], scene["size"])
    return mi.load_dict({"type": "scene", "integrator": integrator} | things)


def mitsuba_lamp(kind: str, lamp: dict) -> dict:
    """A described lamp with a strategy, or Mitsuba's own."""
    to_world = mi.ScalarTransform4f(np.array(lamp["to_world"]))
    a, b = lamp["semi_axes"]
    radiance = {"type": "rgb", "value": lamp["radiance"]}
    if kind == BUILT_IN:
        emitter = {"type": "area", "radiance": radiance}
        return {"type": "disk", "to_world": to_world.scale([a, b, 1]), "emitter": emitter}
    return {
        "type": "ellipse",
        "semi_axis_x": a,
        "semi_axis_y": b,
        "to_world": to_world,
        "emitter": {"type": "ellipticalarea", "sampling": kind, "radiance": radiance},
    }


def plain_pixels(scene: mi.Scene, grid: int = 16) -> np.ndarray:
    """Mask of the pixels that show one plane of the floor or of a box.

    In Mitsuba the lamps hide a part of the floor, in Cycles they do not. The variance within a
    pixel with an edge is no noise of the lamps.
    """
    x, y = dr.meshgrid(*[(dr.arange(mi.Float, SIZE * grid) + 0.5) / (SIZE * grid)] * 2)
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    hit = scene.ray_intersect(ray)

    def in_pixels(values: np.ndarray) -> np.ndarray:
        return values.reshape(SIZE, grid, SIZE, grid)

    shown = hit.is_valid() & (hit.emitter(scene) == None)  # noqa: E711  a pointer of Dr.Jit
    mask = in_pixels(shown.numpy()).all(axis=(1, 3))
    for value in (dr.dot(hit.n, mi.Vector3f(1, 2, 3)), dr.dot(hit.n, hit.p)):
        mask &= np.ptp(in_pixels(value.numpy()), axis=(1, 3)) < 1e-3
    return mask


def exact_choice(scene: mi.Scene, lamps: list[dict], reference: np.ndarray, mask) -> float:
    """Variance that light samples keep where choice and direction follow the irradiance exactly.

    Such a sample is worth U, the light without shadows, or 0 in a shadow. Its mean is E, the
    reference, so its variance is E (U - E). The value is relative, as in `moments`, and U is that
    at the centre of a pixel.
    """
    x, y = dr.meshgrid(*[(dr.arange(mi.Float, SIZE) + 0.5) / SIZE] * 2)
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    hit = scene.ray_intersect(ray)
    point, normal = (np.array(v).T.reshape(SIZE, SIZE, 3)[mask] for v in (hit.p, hit.n))
    bright = np.zeros(len(point))
    for lamp in lamps:
        a, b = lamp["semi_axes"]
        to_world = np.array(lamp["to_world"]) @ np.diag([a, b, 1, 1])
        front = (point - to_world[:3, 3]) @ to_world[:3, 2] > 0
        irradiance = mi_ellipse.irradiance(to_world, point, normal)
        bright += np.mean(lamp["radiance"]) * front * irradiance
    bright *= SCENE["albedo"] / np.pi
    seen = reference[mask].mean(axis=1)
    return float(np.mean(seen * np.maximum(bright - seen, 0)) / seen.mean() ** 2)


def compare(blender: Blender, scene: dict, seeds: int) -> dict:
    """All estimators of one scene."""
    best = mitsuba_scene("projected_solid_angle", ESTIMATORS["light samples"], scene)
    mask = plain_pixels(best)
    mi_ellipse.group_lamps(best)
    passes, spp = range(4), REFERENCE_SPP // 4
    reference = render(best, spp, passes).mean(axis=0)
    exact = exact_choice(best, scene["lamps"], reference, mask)
    del best
    result = {"pixels": int(mask.sum()), "exact_choice": exact}
    for estimator, integrator in ESTIMATORS.items():
        request = {"mis": estimator == "MIS", "light_tree": True}
        pictures = blender.render(request | {"spp": spp}, passes)
        agreed = agreement(pictures, reference, mask)
        print(f"{len(scene['lamps'])} lamps, {estimator}: {agreed}", flush=True)
        if abs(agreed["mean"]) > TOLERANCE:
            raise RuntimeError("The renderers disagree about the picture: nothing to compare")

        ones = range(1000, 1000 + seeds)  # None is shared with the reference
        rows = {}
        for name, tree in ((UNIFORM, False), (TREE, True)):
            pictures = blender.render(request | {"spp": 1, "light_tree": tree}, ones)
            rows[name] = moments(pictures, reference, mask)
        for name, pictures in mitsuba_pictures(integrator, scene, ones):
            rows[name] = moments(pictures, reference, mask)
        result[estimator] = {"agreement": agreed, "rows": rows}
    return result


def mitsuba_pictures(integrator: dict, scene: dict, seeds: range):
    """Name and pictures at one sample of each kind of lamps, ungrouped and grouped."""
    for kind in (BUILT_IN, *STRATEGIES):
        yield kind, render(mitsuba_scene(kind, integrator, scene), 1, seeds)
    for kind in STRATEGIES:
        grouped = mitsuba_scene(kind, integrator, scene)
        mi_ellipse.group_lamps(grouped)
        yield GROUPED.format(kind), render(grouped, 1, seeds)


def table(counts: dict) -> str:
    """Markdown table of the variances, and of how many times they are less than the tree's."""
    lines = [
        "| lamps | estimator | renderer and lamps | variance | less than the light tree, trimmed |",
        "|---|---|---|---|---|",
    ]
    for count, entry in counts.items():
        for estimator in ESTIMATORS:
            rows = entry[estimator]["rows"]
            for name, row in rows.items():
                less = [rows[TREE][key] / row[key] for key in ("variance", "trimmed")]
                kind, _, rest = name.partition(", ")
                shown = f"Mitsuba, `{kind}`{rest and ', ' + rest}"
                cells = [
                    count,
                    estimator,
                    name if name in (TREE, UNIFORM) else shown,
                    f"{row['variance']:.3g} ± {row['standard_error']:.1g}",
                    f"{less[0]:.3g}, {less[1]:.3g}",
                ]
                lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Compare, print, and keep the figures in `docs`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cycles_lamps", description=__doc__)
    parser.add_argument("--bpy-python", required=True, help="interpreter that can import bpy 5.0")
    parser.add_argument("--seeds", type=int, default=4, help="pictures at 1 spp")
    parser.add_argument("--output", type=Path, default=DOCS, help="folder, by default docs")
    arguments = parser.parse_args()

    counts = {}
    for count in COUNTS:
        scene = description(count)
        blender = Blender(arguments.bpy_python, scene)
        counts[str(count)] = compare(blender, scene, arguments.seeds)
        blender.close()

    versions = {"Blender": blender.version, "Mitsuba": mi.__version__, "Dr.Jit": dr.__version__}
    results = {
        "machine": machine(),
        "versions": versions,
        "seeds": arguments.seeds,
        "counts": counts,
    }
    path = arguments.output / "data" / "cycles_lamps.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(results, indent=1) + "\n")
    print(table(counts))


if __name__ == "__main__":
    main()
