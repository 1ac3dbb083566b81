"""How time and memory of a render grow with the size of the image and the samples per pixel."""

from __future__ import annotations

from functools import partial

from .harness import PAIRS, compare_times, rendering
from .scenes import BUILT_IN, floor_ball_lamp

KINDS = (BUILT_IN, "solid_angle", "projected_solid_angle")  # Built-in as its own control
SIZES = (32, 64, 128, 256, 512)  # at `SPP`
SAMPLES = (1, 4, 16, 64, 256)  # at `SIZE`
SPP = 16
SIZE = 128


def run(pairs: int = PAIRS) -> dict:
    """Seconds of built-in, ratios of the others and memory, per edge of the image and spp."""
    cases = {f"{size}², {SPP} spp": (size, SPP) for size in SIZES}
    cases |= {f"{SIZE}², {spp} spp": (SIZE, spp) for spp in SAMPLES}
    results = {}
    for name, (size, spp) in cases.items():
        make = {kind: rendering(partial(floor_ball_lamp, kind, size=size), spp) for kind in KINDS}
        measured = compare_times(make[BUILT_IN], make, pairs)
        results[name] = {
            "seconds": measured.seconds,
            "ratios": {kind: vars(ratio) for kind, ratio in measured.ratios.items()},
            "peak_mib": measured.peak_mib,
        }
        ratios = "  ".join(f"{kind} {ratio}" for kind, ratio in measured.ratios.items())
        print(f"{name:<16}{measured.seconds:.4f} s  {ratios}", flush=True)
    return results
