"""Which strategy to choose: error times render time of three of them on every scene."""

from __future__ import annotations

from functools import partial

import mitsuba as mi
import numpy as np
from mi_ellipse.study.metrics import trimmed_mean

from .harness import PAIRS, compare_times, rendering
from .render_time import BARE, SCENES, STRATEGIES, load
from .scenes import BUILT_IN, floor_ball_lamp

HEIGHTS = (0.25, 0.6, 2, 8)  # of the lamp, 3 long, above the bare floor
SEEDS = 8


def variance(scene: mi.Scene, spp: int) -> dict[str, float]:
    """Mean squared deviation of a render from the mean of `SEEDS` of them; plain and trimmed."""
    pictures = np.stack([np.array(mi.render(scene, spp=spp, seed=seed)) for seed in range(SEEDS)])
    squares = (pictures - pictures.mean(axis=0, dtype=float)) ** 2 * (SEEDS / (SEEDS - 1))
    trimmed = np.mean([trimmed_mean(of_seed) for of_seed in squares])
    return {"plain": float(squares.mean()), "trimmed": float(trimmed)}


def cases() -> dict[str, tuple]:
    """Samples per pixel, and how to load a scene with a kind of lamps."""
    spp, _ = SCENES[BARE]
    bare = {
        f"lamp {height} above a floor": (spp, partial(floor_ball_lamp, height=height, size=160))
        for height in HEIGHTS
    }
    return bare | {name: (SCENES[name][0], partial(load, name)) for name in SCENES if name != BARE}


def run(pairs: int = PAIRS) -> dict:
    """Variances and times; *gain* is how many times lower their product is than built-in's."""
    results = {}
    for name, (spp, load_kind) in cases().items():
        make = {kind: rendering(partial(load_kind, kind), spp) for kind in (BUILT_IN, *STRATEGIES)}
        others = {kind: make[kind] for kind in STRATEGIES}
        times = compare_times(make[BUILT_IN], others, pairs).ratios
        base = variance(load_kind(BUILT_IN), spp)
        results[name] = {}
        for kind in STRATEGIES:
            own = variance(load_kind(kind), spp)
            gains = {key: base[key] / own[key] / times[kind].median for key in own}
            results[name][kind] = {"time": vars(times[kind]), "gain": gains}
            print(f"{name:<24}{kind:<24}{times[kind]}  gain {gains}", flush=True)
    return results
