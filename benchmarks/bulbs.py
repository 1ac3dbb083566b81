"""Error and time of the scene `bulbs.xml`: sphere and ellipsoid lamps against Mitsuba's own."""

from __future__ import annotations

from functools import partial

import mi_ellipse
import mitsuba as mi
import numpy as np
from mi_ellipse.study.metrics import trimmed_mean

from .harness import PAIRS, compare_times, rendering, squared_deviations
from .pictures import draw
from .scenes import LIGHT_SAMPLES, SCENES, SOLIDS, scene_file

GROUPED = ", grouped"
STRATEGIES = ("area", "solid_angle", "projected_solid_angle")
KINDS = (*STRATEGIES, *(f"{name}{GROUPED}" for name in STRATEGIES[1:]))
RESOLUTION = {"resx": 320, "resy": 240}
SPP = 64
SEEDS = 8

FIGURE = SCENES.parent / "docs" / "images" / "bulbs_4spp.png"
FIGURE_SPP = 4
SHOWN = (SOLIDS, "solid_angle", "projected_solid_angle", f"projected_solid_angle{GROUPED}")
INSETS = {"#D55E00": (40, 112, 80, 60), "#0072B2": (180, 80, 80, 60)}  # column, row, width, height


def bulbs(kind: str) -> mi.Scene:
    """The scene with lamps of a kind, which may be grouped."""
    name, grouped, _ = kind.partition(GROUPED)
    scene = scene_file("bulbs", name, **RESOLUTION)
    if grouped:
        mi_ellipse.group_lamps(scene)
    return scene


def run(pairs: int = PAIRS) -> dict:
    """Errors, how many times lower they are than with Mitsuba's lamps, and time ratios."""
    measured = {}
    for kind in (SOLIDS, *KINDS):
        scene = bulbs(kind)
        alone, best = _error(scene, mi.load_dict(LIGHT_SAMPLES))
        both, _ = _error(scene)
        measured[kind] = {"light samples": alone, "MIS": both}
        print(f"{kind:<32}{measured[kind]}", flush=True)
        del scene  # Its lamps would be compiled into all that follows
    _draw(best)

    make = {kind: rendering(partial(bulbs, kind), SPP) for kind in measured}
    times = compare_times(make[SOLIDS], make, pairs).ratios
    results = {"spp": SPP, "size": list(RESOLUTION.values()), "kinds": {}}
    for kind, own in measured.items():
        entry = {"time": vars(times[kind])}
        for samples, error in own.items():
            ratio = measured[SOLIDS][samples]["trimmed"] / error["trimmed"]
            entry[samples] = error | {"error_ratio": ratio}
        results["kinds"][kind] = entry
        print(f"{kind:<32}{times[kind]}", flush=True)
    return results


def _error(
    scene: mi.Scene, integrator: mi.Integrator | None = None
) -> tuple[dict[str, float], np.ndarray]:
    """Mean squared deviation of a render from the mean of `SEEDS` of them, and that mean.

    All kinds of lamps have the same mean, so this is their error.
    """
    pictures = [
        np.array(mi.render(scene, integrator=integrator, spp=SPP, seed=seed), dtype=float)
        for seed in range(SEEDS)
    ]
    squares, mean = squared_deviations(pictures)
    trimmed = np.array([trimmed_mean(of_seed) for of_seed in squares])
    return {
        "plain": float(np.mean(squares)),
        "trimmed": float(trimmed.mean()),
        "standard_error": float(trimmed.std(ddof=1) / np.sqrt(SEEDS)),
    }, mean


def _draw(best: np.ndarray) -> None:
    """Pictures of light samples alone, and two regions of each, enlarged."""
    integrator = mi.load_dict(LIGHT_SAMPLES)
    pictures = {f"{SEEDS * SPP} spp": best}
    for kind in SHOWN:
        image = mi.render(bulbs(kind), integrator=integrator, spp=FIGURE_SPP, seed=1)
        pictures[kind.replace("_", " ")] = np.array(image)
    draw(FIGURE, pictures, INSETS)
