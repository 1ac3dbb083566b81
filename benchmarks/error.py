"""Error times render time near a lamp, against Mitsuba's `disk` + `area`."""

from __future__ import annotations

from functools import partial

import mitsuba as mi
import numpy as np

from .harness import PAIRS, Ratio, compare_times
from .scenes import BUILT_IN, LIGHT_SAMPLES, PATH, floor_ball_lamp

HEIGHTS = (0.25, 0.6)
KINDS = ("area", "rejection", "solid_angle", "projected_solid_angle")
SIZE = 160
SPP = 64
SEEDS = 8
REFERENCE_SPP = 16384
TRIMMED = 1e-3  # Share of the worst values left out: area sampling has no finite variance


def errors(scene: mi.Scene, reference: np.ndarray, spp: int = SPP) -> dict[str, float]:
    """Mean squared error over pixels, channels and seeds; plain and trimmed."""
    squares = np.sort(
        [
            (np.array(mi.render(scene, spp=spp, seed=1000 + seed)) - reference).ravel() ** 2
            for seed in range(SEEDS)
        ],
        axis=1,
    )
    kept = round(squares.shape[1] * (1 - TRIMMED))
    return {"plain": float(squares.mean()), "trimmed": float(squares[:, :kept].mean())}


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

    From solid-angle samples, one and 64 at each vertex: ``(64 MSE64 - MSE1) / 63``.
    """
    one, many = (
        errors(
            floor_ball_lamp("solid_angle", LIGHT_SAMPLES | {"emitter_samples": n}, height, SIZE),
            reference,
        )["trimmed"]
        for n in (1, 64)
    )
    return (64 * many - one) / 63


def run(pairs: int = PAIRS) -> dict:
    """Errors, time ratios and the gains in error × time, for light samples alone and for MIS."""
    results = {"spp": SPP, "size": SIZE, "heights": {}}
    for height in HEIGHTS:
        reference = render_reference(height)
        pixel_floor = floor(height, reference)
        entry = results["heights"][str(height)] = {"floor": pixel_floor}
        print(f"lamp at {height}: floor of the pixel {pixel_floor:.2e}")
        for label, integrator in (("light samples", LIGHT_SAMPLES), ("MIS", PATH)):
            load = {
                kind: partial(floor_ball_lamp, kind, integrator, height, SIZE)
                for kind in (BUILT_IN, *KINDS)
            }
            measured = {kind: errors(load[kind](), reference) for kind in load}
            others = {kind: load[kind] for kind in KINDS}
            ratios, _ = compare_times(load[BUILT_IN], others, 4 * SPP, pairs)
            entry[label] = {
                kind: _gains(measured, ratios.get(kind), kind, pixel_floor) for kind in load
            }
            for kind, values in entry[label].items():
                print(f"    {label:<14}{kind:<24}{values}")
    return results


def _gains(measured: dict, time: Ratio | None, kind: str, pixel_floor: float) -> dict:
    """Error of a kind of lamp, and how many times sooner than built-in it is reached."""
    result = {error: float(f"{value:.4g}") for error, value in measured[kind].items()}
    if time is None:
        return result
    base = measured[BUILT_IN]
    result["time"] = round(time.median, 3)
    for error in ("plain", "trimmed"):
        result[f"gain_{error}"] = round(base[error] / measured[kind][error] / time.median, 2)
    above = measured[kind]["trimmed"] - pixel_floor
    result["gain_above_floor"] = round((base["trimmed"] - pixel_floor) / above / time.median, 2)
    return result
