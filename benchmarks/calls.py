"""A call of `sample_direction` and of `pdf_direction`: kernels that do nothing else."""

from __future__ import annotations

from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
from mi_ellipse.sampling import STRATEGIES

from .harness import PAIRS, ROUNDS, Ratio, Work, Worker
from .scenes import BUILT_IN, CONTROL, SEMI_AXES, lamp, lamp_to_world

NOTHING = "nothing"  # The same kernel without the call, whose time is taken from the others
KINDS = (NOTHING, BUILT_IN, CONTROL, *STRATEGIES)
LANES = 2**18
REPEATS = 64  # calls of each lane
HEIGHT = 0.6


def make(kind: str, method: str) -> Work:
    """Work that returns nanoseconds of a call, drawing its random numbers included.

    Called from points on and above the floor under the lamp of `floor_ball_lamp`; a few are behind
    the lamp.
    """
    to_world = lamp_to_world(HEIGHT)
    shape = lamp(kind if kind in STRATEGIES else BUILT_IN, to_world)
    scene = mi.load_dict({"type": "scene", "lamp": shape})
    call = partial(CALLS[method], called=kind != NOTHING, to_world=mi.Transform4f(to_world))

    def kernel(seed: mi.UInt64) -> mi.Float:
        emitter = dr.gather(mi.EmitterPtr, scene.emitters_dr(), dr.zeros(mi.UInt32, LANES))

        def body(k, total, rng):
            it = dr.zeros(mi.SurfaceInteraction3f)
            x, y, z, *u = (rng.next_float32() for _ in range(5))
            it.p = mi.Point3f(4 * x - 2, 4 * y - 2, 0.7 * z)
            it.n = mi.Normal3f(0, 0.6, 0.8)
            it.wavelengths = mi.Color0f()
            return k + 1, total + call(emitter, it, mi.Point2f(*u)), rng

        state = mi.UInt32(0), mi.Float(0), mi.PCG32(size=LANES, initstate=seed)
        return dr.while_loop(state, lambda k, total, rng: k < REPEATS, body)[1]

    def work(seed: int) -> float:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(kernel(dr.opaque(mi.UInt64, seed)))
            dr.sync_thread()
            execution = sum(k["execution_time"] for k in dr.kernel_history([dr.KernelType.JIT]))
        return 1e6 * execution / (LANES * REPEATS)

    return work


def _sample_direction(emitter, it, u, called, to_world) -> mi.Float:
    """Sum of what a draw gives to integrators."""
    if not called:
        return dr.sum(it.p) + dr.sum(u)
    ds, weight = emitter.sample_direction(it, u, mi.Bool(True))
    return ds.pdf + ds.dist + dr.sum(ds.p) + dr.sum(ds.d) + dr.sum(weight)


def _pdf_direction(emitter, it, u, called, to_world) -> mi.Float:
    """Density of a direction towards the lamp; its points are those of the rectangle around it."""
    ds = dr.zeros(mi.DirectionSample3f)
    ds.p = to_world @ mi.Point3f(SEMI_AXES[0] * (2 * u.x - 1), SEMI_AXES[1] * (2 * u.y - 1), 0)
    ds.n = to_world @ mi.Normal3f(0, 0, 1)
    ds.d = ds.p - it.p
    ds.dist = dr.norm(ds.d)
    ds.d /= ds.dist
    if not called:
        return ds.dist + dr.sum(ds.d)
    return emitter.pdf_direction(it, ds, mi.Bool(True))


CALLS = {"sample_direction": _sample_direction, "pdf_direction": _pdf_direction}


def run(pairs: int = PAIRS) -> dict:
    """Nanoseconds and, against built-in in the same round, ratios of each kind and method."""
    results = {}
    for method in CALLS:
        rounds = []
        for first in range(ROUNDS):
            workers = {kind: Worker(partial(make, kind, method)) for kind in KINDS}
            for worker in workers.values():
                worker.time(0)  # Compilation
            for k in range(first, pairs, ROUNDS):
                order = KINDS[:: 1 if k // ROUNDS % 2 else -1]
                rounds.append({kind: workers[kind].time(k) for kind in order})
            for worker in workers.values():
                worker.close()
        results[method] = {}
        for kind in KINDS[1:]:
            calls = np.array([of[kind] - of[NOTHING] for of in rounds])
            base = np.array([of[BUILT_IN] - of[NOTHING] for of in rounds])
            ratio = Ratio.of(calls / base)
            row = {"nanoseconds": float(np.median(calls)), "ratio": vars(ratio)}
            results[method][kind] = row
            print(f"{method:<20}{kind:<34}{row['nanoseconds']:7.2f} ns  {ratio}", flush=True)
    return results
