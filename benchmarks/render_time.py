"""Whole renders against Mitsuba's `disk` + `area`: the scenes of the study and the bare floor."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .harness import PAIRS, compare_times
from .scenes import BUILT_IN, MESH, RECTANGLE, floor_ball_lamp, scene_file

# Name, samples per pixel, and how to load it with a kind of lamp. Sizes give some 0.3 s a render.
SCENES = {
    "bare floor and ball": (128, lambda kind: floor_ball_lamp(kind)),
    "lamp": (64, lambda kind: scene_file("lamp", kind, resx=320, resy=240)),
    "bunny": (64, lambda kind: scene_file("bunny", kind, resx=256, resy=256)),
    "spheres_fog": (8, lambda kind: scene_file("spheres_fog", kind, resx=160, resy=120)),
    "dragon": (16, lambda kind: scene_file("dragon", kind, resx=160, resy=120)),
    "panel": (8, lambda kind: scene_file("panel", kind, resx=160, resy=120)),
}
STRATEGIES = ("area", "solid_angle", "projected_solid_angle")


def work(scene: mi.Scene, spp: int):
    """Function of a seed that renders a scene."""
    return lambda seed: dr.eval(mi.render(scene, spp=spp, seed=seed))


def run(pairs: int = PAIRS, scenes: tuple[str, ...] = tuple(SCENES)) -> dict:
    """Ratio of render times for every scene and kind of lamp, with built-in as its own control."""
    results = {}
    for name in scenes:
        spp, load = SCENES[name]
        kinds = [BUILT_IN, *STRATEGIES, MESH, RECTANGLE]
        others = {kind: work(load(kind), spp) for kind in kinds}
        ratios, seconds = compare_times(work(load(BUILT_IN), spp), others, pairs)
        results[name] = {"seconds": seconds, "ratios": {k: vars(r) for k, r in ratios.items()}}
        print(f"{name}: built-in {seconds:.3f} s, {spp} spp")
        for kind, ratio in ratios.items():
            print(f"    {kind:<24}{ratio}")
    return results
