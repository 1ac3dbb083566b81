"""Latency of the first frame: import, loading, tracing and compilation, each in a new process."""

from __future__ import annotations

import json
import subprocess
import sys
import time

import numpy as np
from mi_ellipse.sampling import STRATEGIES

from .harness import PAIRS, Ratio, in_new_process, peak_memory
from .scenes import BUILT_IN, CONTROL, floor_ball_lamp

KINDS = (BUILT_IN, CONTROL, *STRATEGIES)
IMPORTS = 9


def measure(kind: str) -> dict[str, float]:
    """Seconds of each step and peak memory, in this process, which must be new."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    ready = time.perf_counter()
    scene = floor_ball_lamp(BUILT_IN if kind == CONTROL else kind, size=64)
    loaded = time.perf_counter()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        mi.render(scene, spp=1).numpy()
        end = time.perf_counter()
        kernels = dr.kernel_history()
    compilation, execution = (
        sum(kernel.get(f"{step}_time", 0) for kernel in kernels) / 1e3
        for step in ("backend", "execution")
    )
    return {
        "load": loaded - ready,
        "trace": end - loaded - compilation - execution,
        "compile": compilation,
        "run": execution,
        "first frame": end - ready,
        "peak MiB": peak_memory(),
    }


def import_times() -> dict[str, float]:
    """Median seconds of `import mitsuba`, and of `import mi_ellipse` after it."""
    code = (
        "import time; a = time.perf_counter(); import mitsuba; b = time.perf_counter();"
        "import mi_ellipse; print(b - a, time.perf_counter() - b)"
    )
    command = [sys.executable, "-c", code]
    runs = [
        subprocess.run(command, capture_output=True, check=True).stdout.split()
        for _ in range(IMPORTS)
    ]
    seconds = np.median(np.array(runs, dtype=float), axis=0)
    return dict(zip(("mitsuba", "mi_ellipse"), seconds.tolist(), strict=True))


def run(pairs: int = PAIRS) -> dict:
    """Medians over processes, in which the kinds take turns, and ratios against built-in."""
    rows = {kind: [] for kind in KINDS}
    for k in range(pairs):
        for kind in KINDS[:: 1 if k % 2 else -1]:
            rows[kind].append(in_new_process("benchmarks.first_frame", kind))
    results = {"imports": import_times(), "kinds": {}}
    print(f"imports: {results['imports']}")
    for kind in KINDS:
        steps = {
            step: float(np.median([row[step] for row in rows[kind]])) for step in rows[kind][0]
        }
        ratios = {
            step: Ratio.of(
                [
                    row[step] / base[step]
                    for row, base in zip(rows[kind], rows[BUILT_IN], strict=True)
                ]
            )
            for step in ("compile", "first frame")
        }
        results["kinds"][kind] = steps | {"ratios": {k: vars(r) for k, r in ratios.items()}}
        print(f"{kind:<32}" + "  ".join(f"{step} {value:.3f}" for step, value in steps.items()))
        print(" " * 32 + "  ".join(f"{step} {ratio}" for step, ratio in ratios.items()))
    return results


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1])))
