"""What it buys and costs that lamps choose among themselves: error, time and tracing."""

from __future__ import annotations

import gc
import json
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import drjit as dr
import matplotlib.pyplot as plt
import mi_ellipse
import mitsuba as mi
import numpy as np
from mi_ellipse.sampling import STRATEGIES as REGISTERED
from mi_ellipse.study.metrics import trimmed_mean

from .harness import (
    Ratio,
    Work,
    Worker,
    compare_times,
    in_new_process,
    peak_memory,
    ratio_of_means,
    rendering,
)
from .lamps import many_lamps
from .pictures import draw
from .scenes import BUILT_IN, LIGHT_SAMPLES, PATH, SCENES, floor_and_ball, lamp, scene_file

STRATEGIES = ("solid_angle", "projected_solid_angle")
GROUPED = ", grouped"
KINDS = (BUILT_IN, *(name + mark for name in STRATEGIES for mark in ("", GROUPED)))
INTEGRATORS = {"light samples": LIGHT_SAMPLES, "MIS": PATH}
SIZE = 128
SPP = 64
SEEDS = 6
REFERENCE_PASSES = 4  # of 1024 samples per pixel
PAIRS = 14
PAIRS_OF_MANY = 4  # Tracing alone takes a second or more.
MANY = 1000
ROUNDS = 2  # of new processes
COUNTS = (1, 10, 100, 1000)
TRACED = 2  # processes of each count and kind
EXACT_UP_TO = 16  # lamps; the exact choice looks at every lamp, one after the other

IMAGES = SCENES.parent / "docs" / "images"
GAINS = IMAGES / "many_lamps.svg"
PICTURES = IMAGES / "many_lamps_bunny.png"
SIZE_SHOWN, SPP_SHOWN, REFERENCE_SPP = 320, 16, 2048
INSETS = {"#D55E00": (40, 190, 72, 72), "#0072B2": (160, 105, 72, 72)}  # column, row, width, height

Load: TypeAlias = "Callable[[str], mi.Scene]"  # Of a kind of lamps


# ---- Scenes ----


def above_floor(lamps: dict, camera: Sequence[float]) -> mi.Scene:
    """Lamps above a floor with a ball."""
    return floor_and_ball(lamps, PATH, SIZE, camera)


def two_discs(kind: str, tilt: float) -> mi.Scene:
    """Discs of radius 0.8 and 0.5, 0.6 above the floor, turned from each other by `tilt`."""
    lamps = {}
    for name, radius, side, radiance in (
        ("left", 0.8, -1, [3, 3, 3]),
        ("right", 0.5, 1, [4, 3, 2]),
    ):
        to_world = (
            mi.ScalarTransform4f()
            .translate([1.2 * side, 0, 0.6])
            .rotate([1, 0, 0], 180)
            .rotate([0, 1, 0], tilt * side)
            .scale(radius)
        )
        lamps[name] = _disc(kind, to_world, radiance)
    return above_floor(lamps, [0, -6, 4])


def equal_lamps_far_away(kind: str) -> mi.Scene:
    """Four equal discs beside each other, 20 radii above the floor."""
    lamps = {}
    for k, (x, y) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        place = mi.ScalarTransform4f().translate([0.5 * x, 0.5 * y, 8])
        to_world = place.rotate([1, 0, 0], 180).scale(0.4)
        lamps[f"lamp{k}"] = _disc(kind, to_world, [30, 30, 30])
    return above_floor(lamps, [0, -6, 4])


def tilted_lamps(kind: str, count: int) -> mi.Scene:
    """Ellipses of different sizes and tilts in a grid above the floor."""
    rng = np.random.default_rng(0)
    side = int(np.ceil(np.sqrt(count)))
    lamps = {}
    for k in range(count):
        x, y = ((index + 0.5 - 0.5 * side) / side * 6 for index in (k % side, k // side))
        size, tilt = rng.uniform(0.2, 1.0) / side, rng.uniform(120, 240)
        place = mi.ScalarTransform4f().translate([x, y, 1])
        lamps[f"lamp{k}"] = lamp(kind, place.rotate([0, 1, 0], tilt).scale(size))
    return above_floor(lamps, [0, -8, 5])


def rooms(kind: str) -> mi.Scene:
    """Nine rooms with a lamp below each ceiling. The camera is in one of them, and sees two more.

    Most lamps cannot be seen from most points. A choice does not know that.
    """
    lamps: dict[str, dict] = {}
    for k in range(9):
        x, y = 3.0 * (k % 3 - 1), 3.0 * (k // 3 - 1)
        place = mi.ScalarTransform4f().translate([x, y, 1.9]).rotate([1, 0, 0], 180)
        lamps[f"lamp{k}"] = _disc(kind, place.scale(0.4), [4, 4, 3.5])
    for k, at in enumerate((-4.5, -1.5, 1.5, 4.5)):
        # A door is open in the middle of each inner wall.
        for j, (begin, end) in enumerate(
            ((-4.5, -0.6), (0.6, 4.5)) if k in (1, 2) else ((-4.5, 4.5),)
        ):
            middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
            size = [0.05, half, 1.0]
            lamps[f"wall_x{k}{j}"] = _wall([at, middle, 1.0], size)
            lamps[f"wall_y{k}{j}"] = _wall([middle, at, 1.0], [size[1], size[0], 1.0])
    lamps["ceiling"] = _wall([0, 0, 2.05], [4.6, 4.6, 0.05])
    return above_floor(lamps, [1.0, -1.2, 1.5])


def _wall(centre: Sequence[float], half: Sequence[float]) -> dict:
    return {"type": "cube", "to_world": mi.ScalarTransform4f().translate(centre).scale(half)}


def bunny(kind: str) -> mi.Scene:
    """The bunny between two round lamps."""
    return scene_file("bunny", kind, resx=SIZE, resy=SIZE)


def _disc(kind: str, to_world: mi.ScalarTransform4f, radiance: list[float]) -> dict:
    emission = {"radiance": {"type": "rgb", "value": radiance}}
    if kind == BUILT_IN:
        return {"type": "disk", "to_world": to_world, "emitter": {"type": "area"} | emission}
    emitter = {"type": "ellipticalarea", "sampling": kind} | emission
    return {"type": "ellipse", "to_world": to_world, "emitter": emitter}


# Number of lamps, and how to load the scene
CASES: dict[str, tuple[int, Load]] = {
    "2 lamps that face the floor": (2, partial(two_discs, tilt=0)),
    "2 tilted lamps": (2, partial(two_discs, tilt=60)),
    "bunny": (2, bunny),
    "4 equal lamps far away": (4, equal_lamps_far_away),
    "9 rooms with a lamp each": (9, rooms),
    "4 tilted lamps": (4, partial(tilted_lamps, count=4)),
    "16 tilted lamps": (16, partial(tilted_lamps, count=16)),
    "100 tilted lamps": (100, partial(tilted_lamps, count=100)),
    "1000 tilted lamps": (1000, partial(tilted_lamps, count=1000)),
}


def load(scene: Load, kind: str) -> mi.Scene:
    """A scene with a kind of lamps out of `KINDS`; grouped if the kind says so."""
    loaded = scene(kind.removesuffix(GROUPED))
    if kind.endswith(GROUPED):
        mi_ellipse.group_lamps(loaded)
    return loaded


# ---- Errors ----


def errors(scene: mi.Scene, integrator: mi.Integrator, reference: np.ndarray) -> dict:
    """Trimmed mean squared error with its standard error among the seeds, and the mean picture."""
    pictures = [
        np.array(mi.render(scene, integrator=integrator, spp=SPP, seed=1000 + seed))
        for seed in range(SEEDS)
    ]
    trimmed = [trimmed_mean((picture - reference) ** 2) for picture in pictures]
    return {
        "trimmed": float(np.mean(trimmed)),
        "standard_error": float(np.std(trimmed, ddof=1) / np.sqrt(SEEDS)),
        "mean": float(np.mean(pictures, dtype=float) / reference.mean()),
    }


def render_reference(scene: Load) -> np.ndarray:
    """Mean of passes with the kind of lamps of least variance."""
    loaded = load(scene, "projected_solid_angle" + GROUPED)
    integrator = mi.load_dict(LIGHT_SAMPLES)
    passes = [
        np.array(mi.render(loaded, integrator=integrator, spp=1024, seed=seed), dtype=float)
        for seed in range(REFERENCE_PASSES)
    ]
    return np.mean(passes, axis=0)


def exact_choice(scene: mi.Scene) -> mi.Integrator:
    """Integrator of light samples whose lamp is chosen in proportion to its exact irradiance.

    The irradiance is that of `mi_ellipse.irradiance` on the side of the surface that is seen, which
    an emitter does not know, and on the emitting side of the lamp. The direction is that of the
    lamp's own strategy. For scenes whose emitters are all lamps that are not grouped, and for
    diffuse surfaces.
    """
    lights = [
        (emitter.get_shape(), float(np.mean(np.array(mi.traverse(emitter)["radiance.value"]))))
        for emitter in scene.emitters()
    ]
    lights = [(mi.traverse(shape)["to_world"], power) for shape, power in lights]

    class ExactChoice(mi.SamplingIntegrator):
        def sample(self, scene, sampler, ray, medium=None, active=True):
            si = scene.ray_intersect(ray, active)
            normal = dr.mulsign(si.n, si.wi.z)
            weights = []
            for to_world, power in lights:
                axis, offset = to_world @ mi.Normal3f(0, 0, 1), si.p - to_world @ mi.Point3f(0)
                irradiance = mi_ellipse.irradiance(to_world, si.p, normal)
                weights.append(dr.select(dr.dot(axis, offset) > 0, power * irradiance, 0))
            total = sum(weights[1:], weights[0])
            mark = sampler.next_1d() * total
            chosen, weight, end = mi.UInt32(0), weights[0], weights[0]
            for k, own in enumerate(weights[1:], start=1):
                past = (mark >= end) & (own > 0)
                chosen, weight = dr.select(past, k, chosen), dr.select(past, own, weight)
                end = end + own
            lit = si.is_valid() & (weight > 0)
            emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), chosen, lit)
            ds, light = emitter.sample_direction(si, sampler.next_2d(), lit)
            lit &= (ds.pdf > 0) & ~scene.ray_test(si.spawn_ray_to(ds.p), lit)
            shaded = si.bsdf(ray).eval(mi.BSDFContext(), si, si.to_local(ds.d), lit)
            light = shaded * light * (total / weight)
            own = si.emitter(scene).eval(si)
            return dr.select(lit, light, 0) + own, si.is_valid(), []

    return ExactChoice(mi.Properties())


def measure_errors(scene: Load, count: int) -> dict[str, dict[str, dict]]:
    """Errors for both integrators and all kinds of lamps, one scene in memory at a time."""
    reference = render_reference(scene)
    results: dict[str, dict[str, dict]] = {label: {} for label in INTEGRATORS}
    for kind in KINDS:
        gc.collect()
        loaded = load(scene, kind)
        for label, integrator in INTEGRATORS.items():
            results[label][kind] = errors(loaded, mi.load_dict(integrator), reference)
        if kind in STRATEGIES and count <= EXACT_UP_TO:
            exact = errors(loaded, exact_choice(loaded), reference)
            results["light samples"][kind + ", exact choice"] = exact
        del loaded
    return results


# ---- Times ----


def _renderer(scene: Load, kind: str) -> Work:
    """Seconds of a whole render, tracing included, for each integrator."""
    loaded = load(scene, kind)
    integrators = [mi.load_dict(integrator) for integrator in INTEGRATORS.values()]

    def render(seed: int) -> list[float]:
        seconds = []
        for integrator in integrators:
            start = time.perf_counter()
            dr.eval(mi.render(loaded, integrator=integrator, spp=SPP, seed=seed))
            dr.sync_thread()
            seconds.append(time.perf_counter() - start)
        return seconds

    return render


def measure_times(scene: Load, pairs: int) -> dict[str, np.ndarray]:
    """Seconds of every kind for each integrator, `(turns, integrators)`. The kinds take turns."""
    seconds: dict[str, list] = {kind: [] for kind in KINDS}
    for first in range(ROUNDS):
        workers = {kind: Worker(partial(_renderer, scene, kind)) for kind in KINDS}
        for worker in workers.values():
            worker.time(0)  # Compilation
            worker.time(1)
        for k in range(first, pairs, ROUNDS):
            for kind in KINDS[:: 1 if k // ROUNDS % 2 else -1]:
                seconds[kind].append(workers[kind].time(k))
        for worker in workers.values():
            worker.close()
    return {kind: np.array(values) for kind, values in seconds.items()}


# ---- Results ----


def _gain(worse: dict, better: dict) -> Ratio:
    """Quotient of two errors, with the 95 % interval of the scatter among the seeds."""
    return ratio_of_means(
        *((one["trimmed"], one["standard_error"]) for one in (worse, better)), SEEDS
    )


def _entry(measured: dict[str, dict], seconds: dict[str, np.ndarray]) -> dict:
    """What one integrator gives: of every kind, and of grouped lamps over others."""
    entry = {
        kind: values | {"seconds": float(np.median(seconds[kind]))} if kind in seconds else values
        for kind, values in measured.items()
    }
    for name in STRATEGIES:
        grouped = name + GROUPED
        for base, key in ((name, "over ungrouped"), (BUILT_IN, "over built-in")):
            gain = _gain(measured[base], measured[grouped])
            of_time = Ratio.of(seconds[grouped] / seconds[base])
            net = gain.median / of_time.median
            entry[grouped][key] = {"error": vars(gain), "time": vars(of_time), "net": net}
        exact = measured.get(name + ", exact choice")
        if exact:
            entry[grouped]["exact choice"] = vars(_gain(measured[name], exact))
    return entry


def trace(kind: str, count: int) -> dict[str, float]:
    """Loading, first frame and tracing of the scene of `lamps`, in this process, which is new."""
    mi.set_variant("llvm_ad_rgb")
    start = time.perf_counter()
    scene = many_lamps(kind.removesuffix(GROUPED), count)
    loaded = time.perf_counter()
    if kind.endswith(GROUPED):
        mi_ellipse.group_lamps(scene)
    grouped = time.perf_counter()
    mi.render(scene, spp=1).numpy()
    first_frame = time.perf_counter()
    tracing = []
    for seed in range(1, 4):
        begin = time.perf_counter()
        image = mi.render(scene, spp=1, seed=seed)
        tracing.append(time.perf_counter() - begin)
        image.numpy()
    return {
        "load_s": loaded - start,
        "group_s": grouped - loaded,
        "first_frame_s": first_frame - start,
        "tracing_ms": 1e3 * float(np.median(tracing)),
        "peak_mib": peak_memory(),
    }


def measure_tracing() -> dict[str, dict[str, dict[str, float]]]:
    """Medians over processes, in which the kinds take turns, by number and kind of lamps."""
    results = {}
    for count in COUNTS:
        rounds = [
            {kind: in_new_process("benchmarks.groups", kind, str(count)) for kind in KINDS}
            for _ in range(TRACED)
        ]
        results[str(count)] = {
            kind: {
                key: float(np.median([of[kind][key] for of in rounds])) for key in rounds[0][kind]
            }
            for kind in KINDS
        }
        for kind, row in results[str(count)].items():
            print(f"{count:>5} {kind:<32}{row}", flush=True)
    return results


# ---- Figures ----


def draw_gains(cases: dict[str, dict]) -> None:
    """Error times time of built-in lamps over that of others, by the number of tilted lamps."""
    names = [name for name in cases if name.endswith(" tilted lamps") and name != "2 tilted lamps"]
    counts = [cases[name]["lamps"] for name in names]
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained", sharey=True)
    for panel, samples in zip(axes, INTEGRATORS, strict=True):
        for kind in KINDS:
            strategy = kind.removesuffix(GROUPED)
            entries = [cases[name][samples] for name in names]
            costs = [[e[k]["trimmed"] * e[k]["seconds"] for e in entries] for k in (BUILT_IN, kind)]
            entry = REGISTERED.get(strategy)
            panel.plot(
                counts,
                np.divide(*costs),
                color=entry.colour if entry else "black",
                marker=entry.mark if entry else "",
                linestyle="-" if kind.endswith(GROUPED) else "--",
                label=kind.replace("_", " "),
            )
        panel.set(xscale="log", yscale="log", title=samples, xlabel="lamps")
        panel.grid(alpha=0.3)
    axes[0].set_ylabel("error × time, built-in over this")
    axes[1].legend(fontsize=7)
    figure.savefig(GAINS)
    plt.close(figure)


def draw_pictures() -> dict[str, dict[str, float]]:
    """The bunny at equal time: built-in lamps, a strategy alone, and with a group.

    Returns how many samples each has, and its time over that of built-in at equal samples.
    """
    shown = BUILT_IN, "projected_solid_angle", "projected_solid_angle" + GROUPED
    make = {kind: rendering(partial(load, large_bunny, kind), SPP_SHOWN) for kind in shown}
    times = compare_times(make[BUILT_IN], make, PAIRS).ratios
    pictures, drawn = {}, {}
    for kind in shown:
        scene, ratio = load(large_bunny, kind), times[kind].median
        spp = max(round(SPP_SHOWN / ratio), 1)
        title = kind.replace("_", " ") + f"\n{spp} samples"
        pictures[title] = np.array(mi.render(scene, spp=spp, seed=1))
        drawn[kind] = {"spp": spp, "time": ratio}
    pictures["reference"] = np.array(mi.render(scene, spp=REFERENCE_SPP, seed=2))
    draw(PICTURES, pictures, INSETS)
    return drawn


def large_bunny(kind: str) -> mi.Scene:
    """The bunny as it is shown, large enough that its time is that of its samples."""
    return scene_file("bunny", kind, resx=SIZE_SHOWN, resy=SIZE_SHOWN)


def run(pairs: int = PAIRS) -> dict:
    """Errors, times and gains of every case, and what it takes to trace lamps."""
    cases = {}
    for name, (count, scene) in CASES.items():
        turns = min(pairs, PAIRS_OF_MANY) if count >= MANY else pairs
        seconds = measure_times(scene, turns)
        measured = measure_errors(scene, count)
        cases[name] = {"lamps": count}
        for k, label in enumerate(INTEGRATORS):
            own = {kind: values[:, k] for kind, values in seconds.items()}
            cases[name][label] = entry = _entry(measured[label], own)
            for kind, values in entry.items():
                print(f"{name:<28}{label:<14}{kind:<36}{values}", flush=True)
    draw_gains(cases)
    return {
        "equal time": draw_pictures(),
        "size": SIZE,
        "spp": SPP,
        "seeds": SEEDS,
        "pairs": pairs,
        "rounds": ROUNDS,
        "traced": TRACED,
        "cases": cases,
        "tracing": measure_tracing(),
    }


if __name__ == "__main__":
    print(json.dumps(trace(sys.argv[1], int(sys.argv[2]))))
