"""Noise and time against Blender's Cycles, for one elliptical lamp above a floor.

    python -m benchmarks.cycles --bpy-python PATH/TO/python [--seeds 256] [--rounds 20]

prints the tables and writes `docs/data/cycles.json` and `docs/images/cycles.png`. The other
interpreter needs `bpy` 5.0 from PyPI; it runs `cycles_render.py`. Both renderers use one thread.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
from pathlib import Path

import drjit as dr
import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

from .harness import Ratio, machine  # noqa: E402
from .scenes import BUILT_IN, LIGHT_SAMPLES, PATH, RADIANCE, SEMI_AXES, lamp  # noqa: E402

DOCS = Path(__file__).resolve().parent.parent / "docs"
HEIGHTS = (0.25, 0.6)
TILT = 30
SCENE = {  # The scene of `scenes.floor_ball_lamp`, without its ball, for both renderers
    "size": 160,
    "fov": 40,
    "origin": [0, -6, 4],
    "target": [0, 0, 0.3],
    "floor_half_width": 4,
    "albedo": 0.5,
    "semi_axes": SEMI_AXES,
    "radiance": RADIANCE["value"],
    "threads": 1,
}
CYCLES = "Cycles"
KINDS = (BUILT_IN, "solid_angle", "projected_solid_angle")
ESTIMATORS = {"light samples": LIGHT_SAMPLES, "MIS": PATH}
REFERENCE_SPP = 4096
TOLERANCE = 1e-3  # Relative, of the mean over the floor
TRIMMED = 1e-3  # Share of the worst values left out, as in `error`
# Time of a sample is a slope: from one count to the other what is paid once per picture cancels.
SPP = {CYCLES: (16, 112), "Mitsuba": (64, 576)}


# ---- The two renderers -------------------------------------------------------------------------


class Cycles:
    """Cycles in an interpreter of its own."""

    def __init__(self, python: str):
        # -P: the folder of the script holds this module, and Blender's add-on is named alike.
        script = Path(__file__).parent / "cycles_render.py"
        self.process = subprocess.Popen(
            [python, "-P", str(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.version = self._ask(SCENE)["version"]

    def _ask(self, request: dict) -> dict:
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        reply = self.process.stdout.readline()
        if not reply:
            raise RuntimeError(f"Blender's process ended with status {self.process.wait()}")
        return json.loads(reply)

    def time(self, height: float, estimator: str, spp: int, seed: int) -> dict[str, float]:
        """Wall-clock and processor seconds of one picture."""
        reply = self._ask(self._request(height, estimator, spp, [seed]))
        return {clock: values[0] for clock, values in reply.items()}

    def pictures(self, height: float, estimator: str, spp: int, seeds: range) -> np.ndarray:
        """One picture for each seed."""
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "pictures.npy"
            request = self._request(height, estimator, spp, list(seeds))
            self._ask(request | {"output": str(output)})
            return np.load(output)

    def _request(self, height: float, estimator: str, spp: int, seeds: list[int]) -> dict:
        mis = estimator == "MIS"
        return {"height": height, "tilt": TILT, "mis": mis, "spp": spp, "seeds": seeds}

    def close(self) -> None:
        """End the other process."""
        self.process.stdin.close()
        self.process.wait()


def mitsuba_scene(kind: str, integrator: dict, height: float) -> mi.Scene:
    """The same scene with a strategy or Mitsuba's own lamp."""
    transform = mi.ScalarTransform4f()
    film = {
        "type": "hdrfilm",
        "width": SCENE["size"],
        "height": SCENE["size"],
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }
    floor = {
        "type": "rectangle",
        "to_world": transform.scale(SCENE["floor_half_width"]),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": SCENE["albedo"]}},
    }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": {
                "type": "perspective",
                "fov": SCENE["fov"],
                "to_world": transform.look_at(SCENE["origin"], SCENE["target"], [0, 0, 1]),
                "film": film,
                "sampler": {"type": "independent"},
            },
            "floor": floor,
            "lamp": lamp(kind, transform.translate([0, 0, height]).rotate([1, 0, 0], 180 - TILT)),
        }
    )


def render(scene: mi.Scene, spp: int, seeds: range) -> np.ndarray:
    """One picture for each seed."""
    return np.stack([np.array(mi.render(scene, spp=spp, seed=seed)) for seed in seeds])


def time_mitsuba(scene: mi.Scene, spp: int, seed: int) -> dict[str, float]:
    """Wall-clock and processor seconds of one picture."""
    dr.sync_thread()
    start, start_cpu = time.perf_counter(), time.process_time()
    dr.eval(mi.render(scene, spp=spp, seed=seed))
    dr.sync_thread()
    return {"wall": time.perf_counter() - start, "cpu": time.process_time() - start_cpu}


# ---- What is compared --------------------------------------------------------------------------


def floor_pixels(scene: mi.Scene, grid: int = 16) -> np.ndarray:
    """Mask of the pixels that show the floor alone; in Mitsuba the lamp hides a part of it."""
    size = SCENE["size"]
    x, y = dr.meshgrid(*[(dr.arange(mi.Float, size * grid) + 0.5) / (size * grid)] * 2)
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    hit = scene.ray_intersect(ray)
    on_floor = hit.is_valid() & (dr.abs(hit.p.z) < 1e-3)  # the lamp's rim is 0.05 above it
    return on_floor.numpy().reshape(size, grid, size, grid).all(axis=(1, 3))


def agreement(pictures: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Relative deviation of the mean over pixels from a reference, and of its quarters."""
    ratio = pictures.mean(axis=(0, 2)) / reference.mean(axis=1)
    quarters = [
        pictures[:, part].mean() / reference[part].mean() - 1
        for part in np.array_split(np.argsort(reference[:, 0]), 4)
    ]
    return {
        "mean": float(pictures.mean() / reference.mean() - 1),
        "standard_error": float(
            pictures.mean(axis=(1, 2)).std(ddof=1) / np.sqrt(len(pictures)) / reference.mean()
        ),
    }
