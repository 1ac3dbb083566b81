"""What many lamps cost: operations, callables, tracing and execution, against `disk` + `area`."""

from __future__ import annotations

import re
import time

import drjit as dr
import mitsuba as mi
import numpy as np

from .scenes import BUILT_IN, PATH, lamp

COUNTS = (1, 10, 100, 1000)
KINDS = (BUILT_IN, "area", "solid_angle", "projected_solid_angle")
REPEATS = 11


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


def render_once(scene: mi.Scene, seed: int) -> dict:
    """Size of the largest kernel of a render, and the times to trace and to execute it."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        start = time.perf_counter()
        image = mi.render(scene, spp=64, seed=seed)
        tracing = time.perf_counter() - start
        image.numpy()
        kernels = [k for k in dr.kernel_history() if "operation_count" in k]
    largest = max(kernels, key=lambda kernel: kernel["operation_count"])
    ir = largest["ir"].getvalue() if hasattr(largest["ir"], "getvalue") else str(largest["ir"])
    return {
        "operations": largest["operation_count"],
        "callables": len(set(re.findall(r"^define .*@(func_\w+)", ir, re.MULTILINE))),
        "tracing_ms": 1e3 * tracing,
        "execution_ms": largest["execution_time"],
    }


def run() -> dict:
    """Table over numbers and kinds of lamps; medians, the kinds interleaved."""
    results = {kind: {} for kind in KINDS}
    for count in COUNTS:
        scenes = {kind: many_lamps(kind, count) for kind in KINDS}
        runs = {kind: [] for kind in KINDS}
        for seed in range(REPEATS + 1):
            for kind, scene in scenes.items():
                runs[kind].append(render_once(scene, seed))
        for kind, rows in runs.items():
            rows, base = rows[1:], runs[BUILT_IN][1:]  # The first compiles
            ratios = [
                row["execution_ms"] / other["execution_ms"]
                for row, other in zip(rows, base, strict=True)
            ]
            results[kind][count] = row = rows[0] | {
                "tracing_ms": float(np.median([row["tracing_ms"] for row in rows])),
                "execution_ms": float(np.median([row["execution_ms"] for row in rows])),
                "execution_ratio": float(np.median(ratios)),
            }
            print(f"{count:>5} {kind:<24}{row}")
    return results
