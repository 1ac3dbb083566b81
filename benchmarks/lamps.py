"""What many lamps cost, each case in a new process: latency, memory, tracing and execution."""

from __future__ import annotations

import json
import re
import sys
import time

import drjit as dr
import mitsuba as mi
import numpy as np

from .harness import in_new_process, peak_memory
from .scenes import BUILT_IN, PATH, lamp

COUNTS = (1, 10, 100, 1000)
KINDS = (BUILT_IN, "area", "solid_angle", "projected_solid_angle")
ROUNDS = 5
RENDERS = 3  # timed, in a process
# So many that the first moments of a kernel, when the main thread still clears away what it has
# traced and takes time from one of two cores, do not count.
SPP = 256


def many_lamps(kind: str, count: int) -> mi.Scene:
    """Lamps of different sizes and tilts in a grid above a floor."""
    rng = np.random.default_rng(0)
    side = int(np.ceil(np.sqrt(count)))
    shapes = {}
    for k in range(count):
        x, y = (k % side - 0.5 * side) / side * 6, (k // side - 0.5 * side) / side * 6
        size, tilt = rng.uniform(0.2, 1.0) / side, rng.uniform(120, 240)
        to_world = mi.ScalarTransform4f().translate([x, y, 1]).rotate([0, 1, 0], tilt).scale(size)
        shapes[f"lamp{k}"] = lamp(kind, to_world)
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": PATH,
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, -8, 5], [0, 0, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 128, "height": 128},
            },
            "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(4)},
            **shapes,
        }
    )


def measure(kind: str, count: int) -> dict[str, float]:
    """Kernel size, latency, memory, and medians of tracing and execution, in a new process."""
    mi.set_variant("llvm_ad_rgb")
    start = time.perf_counter()
    scene = many_lamps(kind, count)
    loaded = time.perf_counter()
    mi.render(scene, spp=1).numpy()
    result = {"load_s": loaded - start, "first_frame_s": time.perf_counter() - start}
    tracing, execution = [], []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for seed in range(1, RENDERS + 1):
            dr.kernel_history_clear()
            start = time.perf_counter()
            image = mi.render(scene, spp=SPP, seed=seed)
            tracing.append(time.perf_counter() - start)
            image.numpy()
            kernels = [k for k in dr.kernel_history() if "operation_count" in k]
            largest = max(kernels, key=lambda kernel: kernel["operation_count"])
            execution.append(largest["execution_time"])
    ir = largest["ir"].getvalue()
    return result | {
        "operations": largest["operation_count"],
        "callables": len(set(re.findall(r"^define .*@(func_\w+)", ir, re.MULTILINE))),
        "tracing_ms": 1e3 * float(np.median(tracing)),
        "execution_ms": float(np.median(execution)),
        "peak_mib": peak_memory(),
    }


def run() -> dict:
    """Table over numbers and kinds of lamps: medians over rounds, in which the kinds take turns."""
    results = {kind: {} for kind in KINDS}
    for count in COUNTS:
        rounds = [
            {kind: in_new_process("benchmarks.lamps", kind, str(count)) for kind in KINDS}
            for _ in range(ROUNDS)
        ]
        for kind in KINDS:
            results[kind][count] = row = {
                key: float(np.median([of[kind][key] for of in rounds])) for key in rounds[0][kind]
            }
            for step in ("tracing", "execution"):
                ratios = [of[kind][f"{step}_ms"] / of[BUILT_IN][f"{step}_ms"] for of in rounds]
                row[f"{step}_ratio"] = float(np.median(ratios))
            print(f"{count:>5} {kind:<24}{row}", flush=True)
    return results


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1], int(sys.argv[2]))))
