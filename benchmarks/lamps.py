"""What many lamps cost: operations, callables, tracing and execution, against `disk` + `area`."""

from __future__ import annotations

import gc
import re
import time

import drjit as dr
import mitsuba as mi
import numpy as np

from .scenes import BUILT_IN, PATH, lamp

COUNTS = (1, 10, 100, 1000)
KINDS = (BUILT_IN, "area", "solid_angle", "projected_solid_angle")
ROUNDS = 5
RENDERS = 2  # of each kind in a round
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


def measure(kind: str, count: int) -> dict:
    """Kernel size, and medians of the time to trace and to execute a render.

    The scene is loaded for this alone: a render traces the emitters of all living scenes.
    """
    scene = many_lamps(kind, count)
    mi.render(scene, spp=SPP, seed=0).numpy()
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
    ir = largest["ir"].getvalue() if hasattr(largest["ir"], "getvalue") else str(largest["ir"])
    return {
        "operations": largest["operation_count"],
        "callables": len(set(re.findall(r"^define .*@(func_\w+)", ir, re.MULTILINE))),
        "tracing_ms": 1e3 * float(np.median(tracing)),
        "execution_ms": float(np.median(execution)),
    }


def run() -> dict:
    """Table over numbers and kinds of lamps: medians over rounds, in which the kinds take turns."""
    results = {kind: {} for kind in KINDS}
    for count in COUNTS:
        rounds = []
        for _ in range(ROUNDS):
            rounds.append({})
            for kind in KINDS:
                rounds[-1][kind] = measure(kind, count)
                gc.collect()
        for kind in KINDS:
            rows = [of[kind] for of in rounds]
            ratios = [of[kind]["execution_ms"] / of[BUILT_IN]["execution_ms"] for of in rounds]
            results[kind][count] = row = rows[0] | {
                "tracing_ms": float(np.median([row["tracing_ms"] for row in rows])),
                "execution_ms": float(np.median([row["execution_ms"] for row in rows])),
                "execution_ratio": float(np.median(ratios)),
            }
            print(f"{count:>5} {kind:<24}{row}")
    return results
