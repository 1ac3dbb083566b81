"""Error times render time near a lamp, against Mitsuba's `disk` + `area`, and what bounds it."""

from __future__ import annotations

from functools import partial

import drjit as dr
import mi_ellipse
import mitsuba as mi
import numpy as np
from mi_ellipse.study.metrics import trimmed_mean

from .harness import PAIRS, Ratio, compare_times, rendering
from .scenes import (
    BUILT_IN,
    LIGHT_SAMPLES,
    PATH,
    RADIANCE,
    SEMI_AXES,
    floor_ball_lamp,
    lamp_to_world,
)

HEIGHTS = (0.25, 0.6)
KINDS = ("area", "rejection", "solid_angle", "projected_solid_angle")
SIZE = 160
SPP = 64
SEEDS = 8
REFERENCE_SPP = 16384
CANDIDATES = 32  # for a direction of the exact sampler


def errors(
    scene: mi.Scene, reference: np.ndarray, integrator: mi.Integrator | None = None
) -> dict[str, float]:
    """Mean squared error over pixels, channels and seeds; plain, trimmed, and its standard error.

    Trimmed, as area sampling has no finite variance. The standard error is that of the trimmed one,
    from its scatter among the seeds.
    """
    pictures = [
        np.array(mi.render(scene, integrator=integrator, spp=SPP, seed=1000 + seed))
        for seed in range(SEEDS)
    ]
    squares = [(picture - reference) ** 2 for picture in pictures]
    trimmed = np.array([trimmed_mean(of_seed) for of_seed in squares])
    return {
        "plain": float(np.mean(squares)),
        "trimmed": float(trimmed.mean()),
        "standard_error": float(trimmed.std(ddof=1) / np.sqrt(SEEDS)),
    }


def render_reference(height: float) -> np.ndarray:
    """Mean of passes with the strategy of least variance."""
    scene = floor_ball_lamp("projected_solid_angle", LIGHT_SAMPLES, height, SIZE)
    passes = REFERENCE_SPP // 1024
    total = sum(
        np.array(mi.render(scene, spp=1024, seed=seed), dtype=float) for seed in range(passes)
    )
    return total / passes


def floor(height: float, reference: np.ndarray) -> float:
    """Trimmed error that no sampling of the lamp removes: of the pixel's area alone.

    From solid-angle samples, one and 64 at each vertex: ``(64 MSE64 - MSE1) / 63``. That holds for
    plain errors; trimmed ones do not quite add up.
    """
    one, many = (
        errors(
            floor_ball_lamp("solid_angle", LIGHT_SAMPLES | {"emitter_samples": n}, height, SIZE),
            reference,
        )["trimmed"]
        for n in (1, 64)
    )
    return (64 * many - one) / 63


def exact_sampler(to_world: mi.ScalarTransform4f) -> mi.Integrator:
    """Integrator of light samples in proportion to radiance times cosine.

    About the best that is possible without knowledge of the shadows: the light without them, in
    closed form, times the visibility of one direction. That is chosen among `CANDIDATES` draws of
    `projected_solid_angle` by weights that hardly differ. For diffuse surfaces and one lamp.
    """

    class ExactSampler(mi.SamplingIntegrator):
        def sample(self, scene, sampler, ray, medium=None, active=True):
            si = scene.ray_intersect(ray, active)
            normal = dr.mulsign(si.n, si.wi.z)
            emitter, radiance = scene.emitters_dr()[0], mi.Color3f(RADIANCE["value"])

            def draw(k, chosen, total, sampler):
                ds, weight = emitter.sample_direction(si, sampler.next_2d(), si.is_valid())
                weight = weight.x * dr.maximum(dr.dot(ds.d, normal), 0)
                total += weight
                chosen = dr.select(sampler.next_1d() * total < weight, ds.p, chosen)
                return k + 1, chosen, total, sampler

            state = mi.UInt32(0), mi.Point3f(0), mi.Float(0), sampler
            _, chosen, total, _ = dr.while_loop(state, lambda k, *_: k < CANDIDATES, draw)
            lit = si.is_valid() & (total > 0)
            seen = lit & ~scene.ray_test(si.spawn_ray_to(chosen), lit)
            albedo = si.bsdf(ray).eval_diffuse_reflectance(si, lit)
            light = radiance * mi_ellipse.irradiance(to_world, si.p, normal) * dr.inv_pi
            own = si.emitter(scene).eval(si)
            return dr.select(seen, albedo * light, 0) + own, si.is_valid(), []

    return ExactSampler(mi.Properties())


def run(pairs: int = PAIRS) -> dict:
    """Errors, time ratios and the gains in error × time, for light samples alone and for MIS."""
    results = {"spp": SPP, "size": SIZE, "heights": {}}
    for height in HEIGHTS:
        reference = render_reference(height)
        pixel_floor = floor(height, reference)
        scene = floor_ball_lamp("projected_solid_angle", LIGHT_SAMPLES, height, SIZE)
        to_world = lamp_to_world(height) @ mi.ScalarTransform4f().scale([*SEMI_AXES, 1])
        exact = errors(scene, reference, exact_sampler(to_world))
        entry = results["heights"][str(height)] = {"floor": pixel_floor, "exact": exact}
        print(f"lamp at {height}: floor of the pixel {pixel_floor:.3e}, exact sampler {exact}")
        for label, integrator in (("light samples", LIGHT_SAMPLES), ("MIS", PATH)):
            load = {
                kind: partial(floor_ball_lamp, kind, integrator, height, SIZE)
                for kind in (BUILT_IN, *KINDS)
            }
            measured = {kind: errors(load[kind](), reference) for kind in load}
            make = {kind: rendering(load[kind], SPP) for kind in load}
            ratios = compare_times(make[BUILT_IN], make, pairs).ratios
            entry[label] = {
                kind: _gains(measured, ratios[kind], kind, pixel_floor) for kind in load
            }
            for kind, values in entry[label].items():
                print(f"    {label:<14}{kind:<24}{values}", flush=True)
    return results


def _gains(measured: dict, time: Ratio, kind: str, pixel_floor: float) -> dict:
    """Error of a kind of lamp, and how many times sooner than built-in it is reached."""
    base, own = measured[BUILT_IN], measured[kind]
    slower = 1 if kind == BUILT_IN else time.median
    gains = {error: base[error] / own[error] / slower for error in ("plain", "trimmed")}
    gains["above_floor"] = (base["trimmed"] - pixel_floor) / (own["trimmed"] - pixel_floor) / slower
    return own | {"time": vars(time)} | {f"gain_{name}": value for name, value in gains.items()}
