"""Whole renders against Mitsuba's `disk` + `area`: the scenes of the study and the bare floor."""

from __future__ import annotations

from functools import partial

import mitsuba as mi

from .harness import PAIRS, compare_times, rendering
from .scenes import BUILT_IN, MESH, RECTANGLE, floor_ball_lamp, scene_file

BARE = "bare floor and ball"
# Samples per pixel, and the size of the scenes from files: at least 0.2 s a render
SCENES = {
    BARE: (128, None),
    "lamp": (64, (320, 240)),
    "bunny": (64, (256, 256)),
    "spheres_fog": (32, (160, 120)),
    "dragon": (48, (160, 120)),
    "panel": (24, (160, 120)),
}
STRATEGIES = ("area", "solid_angle", "projected_solid_angle")


def load(name: str, kind: str) -> mi.Scene:
    """One of the scenes with a kind of lamps."""
    if name == BARE:
        return floor_ball_lamp(kind)
    width, height = SCENES[name][1]
    return scene_file(name, kind, resx=width, resy=height)


def run(pairs: int = PAIRS, scenes: tuple[str, ...] = tuple(SCENES)) -> dict:
    """Ratio of render times for every scene and kind of lamp, with built-in as its own control."""
    results = {}
    for name in scenes:
        spp = SCENES[name][0]
        kinds = [BUILT_IN, *STRATEGIES, MESH, RECTANGLE]
        others = {kind: rendering(partial(load, name, kind), spp) for kind in kinds}
        measured = compare_times(rendering(partial(load, name, BUILT_IN), spp), others, pairs)
        ratios = {kind: vars(ratio) for kind, ratio in measured.ratios.items()}
        results[name] = {"seconds": measured.seconds, "ratios": ratios}
        print(f"{name}: built-in {measured.seconds:.3f} s, {spp} spp")
        for kind, ratio in measured.ratios.items():
            print(f"    {kind:<24}{ratio}", flush=True)
    return results
