"""Error and time of the scene `bulbs.xml`: sphere and ellipsoid lamps against Mitsuba's own."""

from __future__ import annotations

from functools import partial

import mi_ellipse
import mitsuba as mi
import numpy as np

from .error import errors
from .harness import PAIRS, compare_times, rendering
from .pictures import draw
from .scenes import LIGHT_SAMPLES, SCENES, SOLIDS, scene_file

GROUPED = ", grouped"
STRATEGIES = ("area", "solid_angle", "projected_solid_angle")
KINDS = (*STRATEGIES, *(f"{name}{GROUPED}" for name in STRATEGIES[1:]))
RESOLUTION = {"resx": 320, "resy": 240}
SPP = 64
REFERENCE_PASSES = 8  # of 1 024 samples: an error of 1 % of that of the best kind

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
    # The light that arrives straight from the lamps is the same for both kinds of samples.
    print("reference", flush=True)
    best = bulbs(f"projected_solid_angle{GROUPED}")
    passes = (np.array(mi.render(best, spp=1024, seed=k)) for k in range(REFERENCE_PASSES))
    reference = sum(image.astype(float) for image in passes) / REFERENCE_PASSES
    del best
    _draw(reference)

    make = {kind: rendering(partial(bulbs, kind), SPP) for kind in (SOLIDS, *KINDS)}
    times = compare_times(make[SOLIDS], make, pairs).ratios
    measured = {kind: _errors(bulbs(kind), reference) for kind in make}
    results = {"spp": SPP, "size": list(RESOLUTION.values()), "kinds": {}}
    for kind, own in measured.items():
        entry = {"time": vars(times[kind])}
        for samples, error in own.items():
            ratio = measured[SOLIDS][samples]["trimmed"] / error["trimmed"]
            entry[samples] = error | {"error_ratio": ratio}
        results["kinds"][kind] = entry
        print(f"{kind:<32}{entry}", flush=True)
    return results


def _errors(scene: mi.Scene, reference: np.ndarray) -> dict[str, dict[str, float]]:
    return {
        "light samples": errors(scene, reference, mi.load_dict(LIGHT_SAMPLES)),
        "MIS": errors(scene, reference),
    }


def _draw(reference: np.ndarray) -> None:
    """Pictures of light samples alone, and two regions of each, enlarged."""
    integrator = mi.load_dict(LIGHT_SAMPLES)
    pictures = {"reference": reference}
    for kind in SHOWN:
        image = mi.render(bulbs(kind), integrator=integrator, spp=FIGURE_SPP, seed=1)
        pictures[kind.replace("_", " ")] = np.array(image)
    draw(FIGURE, pictures, INSETS)
