"""Throughput of workers beside that of one process, and what a job costs on top of its render."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import drjit as dr
import numpy as np
from mi_ellipse.rendering import cluster
from mi_ellipse.rendering.cluster import ClusterExecutor
from mi_ellipse.rendering.division import SAMPLES_PER_PASS
from mi_ellipse.rendering.executor import JobExecutor, LocalExecutor
from mi_ellipse.rendering.job import RenderJob

from .harness import PAIRS, Ratio, Work, Worker

SCENE = Path(__file__).parent.parent / "scenes" / "lamp.xml"
PIXELS = 640 * 480

# Of one measurement: as many jobs as keep two workers equally busy
JOBS = 8

# A render takes no time worth mentioning, so what remains is the cost of a job.
TINY = {"resx": "16", "resy": "16"}
TINY_JOBS = 200

# MB of what a worker returns; 3.7 is a picture of 640 × 480 pixels.
SIZES = (0.1, 3.7, 15.0, 60.0)


def run(pairs: int = PAIRS, jobs: int = JOBS, spp: int = SAMPLES_PER_PASS // PIXELS) -> dict:
    """Measure in turns; in each, every place renders `jobs` jobs of `spp` samples a pixel."""
    turns, batch = max(3, pairs // 8), Batch(jobs, spp)
    with ExitStack() as stack:
        one, two = (stack.enter_context(cluster.start(count)) for count in (1, 2))
        local = [Worker(partial(_local, threads, batch)) for threads in (1, 2)]
        for worker in local:
            stack.callback(worker.close)
        places: dict[str, Callable[[int], float]] = {
            "1 worker": partial(batch.seconds, one),
            "2 workers": partial(batch.seconds, two),
            "1 thread": local[0].time,
            "2 threads": local[1].time,
        }
        results = vars(batch) | {"turns": turns} | _throughput(places, turns, jobs)
        results["overhead"] = _overhead(one, turns)
        results["transfer"] = _transfer(one, turns)
    return results


def _throughput(places: dict[str, Callable[[int], float]], turns: int, jobs: int) -> dict:
    """Seconds of a batch of jobs in each place, in changing order, and what is gained in pairs."""
    for measure in places.values():
        measure(0)  # Compilation
    times: dict[str, list[float]] = {name: [] for name in places}
    for turn in range(1, turns + 1):
        for name in list(places)[:: 1 if turn % 2 else -1]:
            times[name].append(places[name](turn))
    seconds = {name: median(values) / jobs for name, values in times.items()}
    ratios = {
        f"{a} over {b}": vars(Ratio.of(np.divide(times[b], times[a])))
        for a, b in (
            ("2 workers", "1 worker"),
            ("2 threads", "1 thread"),
            ("1 worker", "1 thread"),
            ("2 workers", "2 threads"),
        )
    }
    for name, value in seconds.items():
        print(f"{name:<12}{value:.3f} s a job")
    for name, ratio in ratios.items():
        print(f"{name:<28}{Ratio(**ratio)}")
    return {"seconds_a_job": seconds, "throughput": ratios}


@dataclass(frozen=True)
class Batch:
    """Jobs that are measured together."""

    jobs: int
    spp: int

    def seconds(self, executor: JobExecutor, seed: int) -> float:
        """Render them, and return how long it took until all pictures were here."""
        jobs = [RenderJob(SCENE, spp=self.spp, seed=self.jobs * seed + k) for k in range(self.jobs)]
        start = time.perf_counter()
        for _ in executor.map(RenderJob.run, jobs):
            pass
        return time.perf_counter() - start


def _local(threads: int, batch: Batch) -> Work:
    """Jobs in a process of its own."""
    dr.set_thread_count(threads)
    return partial(batch.seconds, LocalExecutor())


def _overhead(executor: ClusterExecutor, turns: int) -> dict[str, float]:
    """Milliseconds that a job costs beside its render: in a row, and alone from end to end."""
    jobs = [RenderJob(SCENE, TINY, spp=1, seed=k) for k in range(TINY_JOBS)]
    row, alone, render = [], [], []
    with LocalExecutor() as local:
        for place in (executor, local):
            place.submit(jobs[0].run).result()
        for _ in range(turns):
            start = time.perf_counter()
            row_render = [one.seconds for one in executor.map(RenderJob.run, jobs)]
            row.append((time.perf_counter() - start) / TINY_JOBS)
            start = time.perf_counter()
            for job in jobs[:20]:
                executor.submit(job.run).result()
            alone.append((time.perf_counter() - start) / 20)
            render.append(median(row_render))
    result = {
        "job_ms": 1e3 * median(np.subtract(row, render)),
        "latency_ms": 1e3 * median(np.subtract(alone, render)),
        "render_ms": 1e3 * median(render),
    }
    print("  ".join(f"{name} {value:.2f}" for name, value in result.items()))
    return result


def _transfer(executor: ClusterExecutor, turns: int) -> dict[str, float]:
    """MB/s from a worker to here, from the slope over sizes; on loopback, not on a network."""
    seconds = []
    for size in SIZES:
        count = int(size * 1e6 / 4)
        times = []
        for _ in range(2 * turns):
            start = time.perf_counter()
            executor.submit(np.full, count, 0.5, np.float32).result()
            times.append(time.perf_counter() - start)
        seconds.append(median(times))
    slope = np.polyfit(SIZES, seconds, 1)[0]
    print(f"transfer {1 / slope:.0f} MB/s")
    return {"mb_s": float(1 / slope)}
