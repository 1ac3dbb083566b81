"""Noise and time against Blender's Cycles, for one elliptical lamp above a floor.

    python -m benchmarks.cycles --bpy-python PATH/TO/python [--seeds 256] [--rounds 24]

prints the tables and writes `docs/data/cycles.json` and `docs/images/cycles.png`. The other
interpreter needs `bpy` 5.0 from PyPI; it runs `cycles_render.py`. Both renderers use one thread.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import tempfile
import time
from pathlib import Path

import drjit as dr
import matplotlib.pyplot as plt
import mi_ellipse  # noqa: F401  before mitsuba: it chooses the LLVM
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

from mi_ellipse.study.metrics import trimmed_mean  # noqa: E402

from .harness import machine  # noqa: E402
from .scenes import (  # noqa: E402
    BUILT_IN,
    LIGHT_SAMPLES,
    PATH,
    RADIANCE,
    SEMI_AXES,
    lamp,
    sensor,
)

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
REFERENCE_SPP = 2048
TOLERANCE = 1e-3  # Relative, of the mean over the floor
# Time of a sample is a slope: from one count to the other what is paid once per picture cancels.
SPP = {CYCLES: (4, 36), "Mitsuba": (32, 288)}


# ---- The two renderers -------------------------------------------------------------------------


class Blender:
    """Cycles in an interpreter of its own, with the scene that a description says."""

    def __init__(self, python: str, description: dict):
        # -P: the folder of the script holds this module, and Blender's add-on is named alike.
        script = Path(__file__).parent / "cycles_render.py"
        self.process = subprocess.Popen(
            [python, "-P", str(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.version = self.ask(description)["version"]

    def ask(self, request: dict) -> dict:
        """Send a request and wait for the reply."""
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        reply = self.process.stdout.readline()
        if not reply:
            raise RuntimeError(f"Blender's process ended with status {self.process.wait()}")
        return json.loads(reply)

    def render(self, request: dict, seeds: range) -> np.ndarray:
        """One picture for each seed."""
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "pictures.npy"
            self.ask(request | {"seeds": list(seeds), "output": str(output)})
            return np.load(output)

    def close(self) -> None:
        """End the other process."""
        self.process.stdin.close()
        self.process.wait()


class Cycles(Blender):
    """Cycles with the scene of this module."""

    def __init__(self, python: str):
        super().__init__(python, SCENE)

    def time(self, height: float, estimator: str, spp: int, seed: int) -> dict[str, float]:
        """Wall-clock and processor seconds of one picture."""
        reply = self.ask(self._request(height, estimator, spp) | {"seeds": [seed]})
        return {clock: values[0] for clock, values in reply.items()}

    def pictures(self, height: float, estimator: str, spp: int, seeds: range) -> np.ndarray:
        """One picture for each seed."""
        return self.render(self._request(height, estimator, spp), seeds)

    def _request(self, height: float, estimator: str, spp: int) -> dict:
        return {"height": height, "tilt": TILT, "mis": estimator == "MIS", "spp": spp}


def mitsuba_scene(kind: str, integrator: dict, height: float) -> mi.Scene:
    """The same scene with a strategy or Mitsuba's own lamp."""
    transform = mi.ScalarTransform4f()
    camera = transform.look_at(SCENE["origin"], SCENE["target"], [0, 0, 1])
    floor = {
        "type": "rectangle",
        "to_world": transform.scale(SCENE["floor_half_width"]),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": SCENE["albedo"]}},
    }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": sensor(camera, SCENE["fov"], SCENE["size"]),
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


def agreement(pictures: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Relative deviation from a reference: of the mean, and of the worst of 5 × 5 tiles."""
    place = 5 * np.arange(len(reference)) // len(reference)
    tile = np.add.outer(5 * place, place)
    total = [
        np.bincount(tile[mask], image.mean(axis=2)[mask], 25)
        for image in (pictures.mean(axis=0), reference)
    ]
    means = pictures[:, mask].mean(axis=(1, 2)) / reference[mask].mean()
    lit = total[1] > 0
    return {
        "mean": float(means.mean() - 1),
        "standard_error": float(means.std(ddof=1) / np.sqrt(len(means))),
        "worst_tile": float(np.abs(total[0][lit] / total[1][lit] - 1).max()),
    }


def moments(pictures: np.ndarray, reference: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Squared deviations of pictures at one sample, relative to the floor's squared mean.

    Returns
    -------
    dict
        ``variance`` with its ``standard_error`` over the seeds, ``trimmed`` of the worst values,
        and ``mean``, the relative deviation of the mean in standard errors.
    """
    scale = reference[mask].mean()
    deviation = (pictures[:, mask].mean(axis=2) - reference[mask].mean(axis=1)) / scale
    squares, means = deviation**2, deviation.mean(axis=1)
    of_seeds = squares.mean(axis=1)
    root = np.sqrt(len(pictures))
    return {
        "variance": float(of_seeds.mean()),
        "standard_error": float(of_seeds.std(ddof=1) / root),
        "trimmed": float(np.mean([trimmed_mean(of_seed) for of_seed in squares])),
        "mean": float(means.mean() / (means.std(ddof=1) / root)),
    }


def sample_times(contenders: dict, rounds: int) -> dict[str, dict]:
    """Time of a sample of each contender, a function of spp and seed, and against the first.

    All take their turn in every round, in changing order. A neighbour on the machine doubles the
    time of a picture, and never shortens it: the shortest at either count is taken. Processor time
    is kept beside it, and holds what idle threads of a renderer burn too. `low` and `high` are
    the ratios of even and odd rounds by themselves, whose shortest times are longer.
    """
    pictures = {name: [] for name in contenders}
    for work, counts in contenders.values():
        for spp in counts:
            work(spp, 0)  # Compilation
    for k in range(rounds):
        for name in list(contenders)[:: 1 if k % 2 else -1]:
            work, counts = contenders[name]
            pictures[name].append([work(spp, 2 * k + i) for i, spp in enumerate(counts, 1)])

    def slope(name: str, clock: str, part: slice) -> float:
        few, many = contenders[name][1]
        seconds = np.array([[picture[clock] for picture in pair] for pair in pictures[name][part]])
        shortest = seconds.min(axis=0)
        return float(shortest[1] - shortest[0]) / (many - few) / SCENE["size"] ** 2

    base = next(iter(contenders))
    times = {name: {} for name in contenders}
    for name, clock in itertools.product(contenders, ("wall", "cpu")):
        ratio, *halves = (
            slope(name, clock, part) / slope(base, clock, part)
            for part in (slice(None), slice(0, None, 2), slice(1, None, 2))
        )
        times[name][clock] = {
            "nanoseconds": 1e9 * slope(name, clock, slice(None)),
            "ratio": {"value": ratio, "low": min(halves), "high": max(halves)},
        }
    return times


def make_contenders(cycles: Cycles, scenes: dict, height: float, estimator: str) -> dict:
    """What `sample_times` runs: how to render, and the two sample counts."""

    def mitsuba(scene: mi.Scene):
        return lambda spp, seed: time_mitsuba(scene, spp, seed)

    peer = (lambda spp, seed: cycles.time(height, estimator, spp, seed), SPP[CYCLES])
    ours = {kind: (mitsuba(scene), SPP["Mitsuba"]) for kind, scene in scenes.items()}
    return {CYCLES: peer} | ours


def compare(cycles: Cycles, height: float, seeds: int, rounds: int) -> tuple[dict, list]:
    """Everything about a lamp at one height, and the pictures of both for the eye."""
    best = mitsuba_scene("projected_solid_angle", LIGHT_SAMPLES, height)
    mask = floor_pixels(best)
    passes, spp = range(4), REFERENCE_SPP // 4
    reference = render(best, spp, passes).mean(axis=0)
    result, shown = {}, [reference * mask[..., None]]
    for estimator, integrator in ESTIMATORS.items():
        pictures = cycles.pictures(height, estimator, spp, passes)
        agreed = agreement(pictures, reference, mask)
        print(f"lamp at {height}, {estimator}: Cycles against Mitsuba {agreed}", flush=True)
        if abs(agreed["mean"]) > TOLERANCE:
            raise RuntimeError("The renderers disagree about the picture: nothing to compare")
        shown.append(pictures.mean(axis=0) * mask[..., None])

        # Seeds from 1000: none is shared with the reference.
        ones = range(1000, 1000 + seeds)
        scenes = {kind: mitsuba_scene(kind, integrator, height) for kind in KINDS}
        rows = {CYCLES: moments(cycles.pictures(height, estimator, 1, ones), reference, mask)}
        for kind, scene in scenes.items():
            rows[kind] = moments(render(scene, 1, ones), reference, mask)

        times = sample_times(make_contenders(cycles, scenes, height, estimator), rounds)
        result[estimator] = {
            "agreement": agreed,
            "rows": {name: row | {"time": times[name]} for name, row in rows.items()},
        }
    return result, shown


# ---- Output ------------------------------------------------------------------------------------


def table(heights: dict) -> str:
    """Markdown table; a gain is in trimmed error × time."""
    lines = [
        "| lamp at | estimator | renderer and lamp | variance | less than Cycles, trimmed "
        "| ns a sample | of Cycles' time (of half the rounds each) | gain on Cycles "
        "| gain on `disk + area` |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for height, estimators in heights.items():
        for estimator, entry in estimators.items():
            rows = entry["rows"]
            bases = rows[CYCLES], rows[BUILT_IN]
            for name, row in rows.items():
                speed = [base["time"]["wall"]["ratio"]["value"] for base in (row, *bases)]
                halves = "{low:.3g}, {high:.3g}".format(**row["time"]["wall"]["ratio"])
                less = [bases[0][key] / row[key] for key in ("variance", "trimmed")]
                gains = [
                    np.format_float_positional(
                        base["trimmed"] / row["trimmed"] * time / speed[0],
                        precision=3,
                        fractional=False,
                        trim="-",
                    )
                    for base, time in zip(bases, speed[1:], strict=True)
                ]
                cells = [
                    height,
                    estimator,
                    name if name == CYCLES else f"Mitsuba, `{name}`",
                    f"{row['variance']:.3g} ± {row['standard_error']:.1g}",
                    f"{less[0]:.3g}, {less[1]:.3g}",
                    f"{row['time']['wall']['nanoseconds']:.3g}",
                    "1" if name == CYCLES else f"{speed[0]:.3g} ({halves})",
                    *(gains if name != CYCLES else (gains[0], "")),
                ]
                lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def plot(shown: dict[float, list], path: Path) -> None:
    """Both renderers' pictures beside each other, and how they differ."""
    titles = ["Mitsuba, projected_solid_angle", "Cycles, light samples", "Cycles, MIS"]
    titles += [f"{title} − Mitsuba" for title in titles[1:]]
    figure, axes = plt.subplots(len(shown), 5, figsize=(15, 3.2 * len(shown)), squeeze=False)
    for row, (height, pictures) in zip(axes, shown.items(), strict=True):
        reference = pictures[0]
        for axis, title, picture in zip(row, titles, pictures, strict=False):
            axis.imshow(np.clip(picture, 0, 1) ** (1 / 2.2))
            axis.set_title(title, fontsize=9)
        mean = reference.mean()
        for axis, title, picture in zip(row[3:], titles[3:], pictures[1:], strict=True):
            difference = (picture - reference).mean(axis=2) / mean
            image = axis.imshow(difference, cmap="RdBu_r", vmin=-0.05, vmax=0.05)
            axis.set_title(title, fontsize=9)
        figure.colorbar(image, ax=row[3:], label="in units of the picture's mean")
        row[0].set_ylabel(f"lamp at {height}")
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100, bbox_inches="tight")


def main() -> None:
    """Compare, print, and keep figures and pictures in `docs`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cycles", description=__doc__)
    parser.add_argument("--bpy-python", required=True, help="interpreter that can import bpy 5.0")
    parser.add_argument("--seeds", type=int, default=256, help="pictures at 1 spp")
    parser.add_argument("--rounds", type=int, default=24, help="timed rounds")
    parser.add_argument("--output", type=Path, default=DOCS, help="folder, by default docs")
    arguments = parser.parse_args()

    dr.set_thread_count(SCENE["threads"])
    cycles = Cycles(arguments.bpy_python)
    heights, shown = {}, {}
    for height in HEIGHTS:
        heights[str(height)], shown[height] = compare(
            cycles, height, arguments.seeds, arguments.rounds
        )
    cycles.close()

    versions = {"Blender": cycles.version, "Mitsuba": mi.__version__, "Dr.Jit": dr.__version__}
    results = {
        "machine": machine(),
        "versions": versions,
        "seeds": arguments.seeds,
        "rounds": arguments.rounds,
        "heights": heights,
    }
    (arguments.output / "data").mkdir(parents=True, exist_ok=True)
    path = arguments.output / "data" / "cycles.json"
    path.write_text(json.dumps(results, indent=1) + "\n")
    plot(shown, arguments.output / "images" / "cycles.png")
    print(table(heights))


if __name__ == "__main__":
    main()
