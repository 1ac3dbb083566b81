"""How the time of a render grows with the size of the image and with the samples per pixel."""

from __future__ import annotations

from functools import partial

from .harness import compare_times
from .scenes import BUILT_IN, floor_ball_lamp

KINDS = (BUILT_IN, "solid_angle", "projected_solid_angle")
SIZES = (32, 64, 128, 256, 512)  # at `SPP`
SAMPLES = (1, 4, 16, 64, 256)  # at `SIZE`
SPP = 16
SIZE = 128
PAIRS = 15


def run() -> dict:
    """Seconds of built-in and ratios of the others, per edge of the image and sample count."""
    cases = {f"{size}², {SPP} spp": (size, SPP) for size in SIZES}
    cases |= {f"{SIZE}², {spp} spp": (SIZE, spp) for spp in SAMPLES}
    results = {}
    for name, (size, spp) in cases.items():
        load = {kind: partial(floor_ball_lamp, kind, size=size) for kind in KINDS}
        ratios, seconds = compare_times(load.pop(BUILT_IN), load, spp, PAIRS)
        results[name] = {"seconds": seconds, "ratios": {k: vars(r) for k, r in ratios.items()}}
        print(f"{name:<16}{seconds:.4f} s  " + "  ".join(f"{k} {r}" for k, r in ratios.items()))
    return results
