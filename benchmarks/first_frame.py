"""Latency of the first frame: loading, tracing and compilation, each in a new process."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

KINDS = ("disk + area", "area", "solid_angle", "projected_solid_angle")
REPEATS = 7


def measure(kind: str) -> dict[str, float]:
    """Seconds of each step and peak memory, in this process, which must be new."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    from .scenes import floor_ball_lamp

    ready = time.perf_counter()
    scene = floor_ball_lamp(kind, size=64)
    loaded = time.perf_counter()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        image = mi.render(scene, spp=1)
        traced = time.perf_counter()
        image.numpy()
        end = time.perf_counter()
        compilation = sum(k.get("backend_time", 0) for k in dr.kernel_history()) / 1e3
    return {
        "load": loaded - ready,
        "trace": traced - loaded,
        "compile": compilation,
        "first frame": end - ready,
        "peak MiB": _peak_memory(),
    }


def _peak_memory() -> float:
    """Peak memory of this process in MiB, on Linux; `getrusage` would include its parent's."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s*(\d+)", status).group(1)) / 1024


def import_cost() -> float:
    """Seconds that `import mi_ellipse` adds to `import mitsuba`: the median of new processes."""
    code = (
        "import time, mitsuba; start = time.perf_counter(); import mi_ellipse;"
        "print(time.perf_counter() - start)"
    )
    runs = [
        float(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)
        for _ in range(REPEATS)
    ]
    return float(np.median(runs))


def run() -> dict:
    """Medians over processes, kinds interleaved, with an empty kernel cache in each."""
    runs = {kind: [] for kind in KINDS}
    for _ in range(REPEATS):
        for kind in KINDS:
            with tempfile.TemporaryDirectory() as home:
                # Dr.Jit keeps compiled kernels in the home folder.
                command = f"HOME={home} exec {sys.executable} -m benchmarks.first_frame '{kind}'"
                output = subprocess.run(["sh", "-c", command], capture_output=True, check=True)
            runs[kind].append(json.loads(output.stdout))
    results = {
        kind: {step: float(np.median([row[step] for row in rows])) for step in rows[0]}
        for kind, rows in runs.items()
    }
    for kind, row in results.items():
        print(f"{kind:<24}" + "  ".join(f"{step} {value:.3f}" for step, value in row.items()))
    results["import of mi_ellipse after mitsuba"] = import_cost()
    print(f"import of mi_ellipse after mitsuba: {results[list(results)[-1]]:.3f} s")
    return results


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1])))
