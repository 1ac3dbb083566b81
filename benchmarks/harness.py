"""Interleaved timing: ratios that hold while the machine's speed drifts."""

from __future__ import annotations

import json
import multiprocessing
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.stats import binom
from scipy.stats import t as student

Work = Callable[[int], float]  # Of a seed; returns the time that counts
Make = Callable[[], Work]  # One that can be pickled

# Built-in against itself scatters by 10 % from pair to pair, and where a process happens to have
# its code and data is worth 2 % for as long as it lives.
PAIRS = 40
ROUNDS = 4  # of new processes


@dataclass(frozen=True)
class Ratio:
    """Median of paired ratios with its 95 % confidence interval."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values) -> Ratio:
        """From the ratios of all pairs; the interval is that of order statistics, exact."""
        values = np.sort(values)
        rank = max(int(binom.ppf(0.025, len(values), 0.5)), 1)
        return cls(float(np.median(values)), float(values[rank - 1]), float(values[-rank]))

    def __str__(self) -> str:
        return f"{self.median:.3f} [{self.low:.3f}, {self.high:.3f}]"


def ratio_of_means(over: tuple[float, float], under: tuple[float, float], count: int) -> Ratio:
    """Ratio of two independent means, each with its standard error from `count` values.

    The 95 % interval is symmetric in the logarithm.
    """
    relative = np.hypot(*(error / mean for mean, error in (over, under)))
    reach = float(np.exp(student.ppf(0.975, count - 1) * relative))
    value = over[0] / under[0]
    return Ratio(value, value / reach, value * reach)


def squared_deviations(pictures: Sequence[np.ndarray]) -> tuple[list[np.ndarray], np.ndarray]:
    """Squared deviations of pictures of several seeds from their mean, and that mean.

    The factor makes them those from the truth. Lamps whose mean is the same need no reference.
    """
    count, mean = len(pictures), np.mean(pictures, axis=0)
    return [(picture - mean) ** 2 * (count / (count - 1)) for picture in pictures], mean


class Worker:
    """Work in a process of its own.

    Dr.Jit compiles the lights of all living scenes of a process into every render, and a kernel
    with one kind of light is not that of several.
    """

    def __init__(self, make: Make):
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, make), daemon=True)
        self._process.start()
        other.close()

    def time(self, seed: int) -> float:
        """Time of the work."""
        return self._ask(seed)

    def peak_memory(self) -> float:
        """MiB that the process had at most."""
        return self._ask(None)

    def _ask(self, question: int | None) -> float:
        self._connection.send(question)
        return self._connection.recv()

    def close(self) -> None:
        """End the process."""
        self._connection.close()
        self._process.join()


def _serve(connection: Connection, make: Make) -> None:
    """Work for every seed that arrives."""
    mi.set_variant("llvm_ad_rgb")
    work = make()
    while True:
        try:
            seed = connection.recv()
        except EOFError:
            return
        connection.send(peak_memory() if seed is None else work(seed))


def rendering(load: Callable[[], mi.Scene], spp: int) -> Make:
    """Whole renders of a scene, tracing included."""
    return partial(_renderer, load, spp)


def _renderer(load: Callable[[], mi.Scene], spp: int) -> Work:
    scene = load()

    def render(seed: int) -> float:
        start = time.perf_counter()
        dr.eval(mi.render(scene, spp=spp, seed=seed))
        dr.sync_thread()
        return time.perf_counter() - start

    return render


@dataclass(frozen=True)
class Comparison:
    """What `compare_times` measures."""

    ratios: dict[str, Ratio]  # Time of each over that of the base beside it
    seconds: float  # Median time of the base, if its work returns seconds
    peak_mib: dict[str, float]  # Most memory of each process of the last round


def compare_times(base: Make, others: dict[str, Make], pairs: int = PAIRS) -> Comparison:
    """Time each of `others` right beside `base`, in changing order; each round in new processes."""
    ratios = {name: [] for name in others}
    seconds = []
    for first in range(ROUNDS):
        reference = Worker(base)
        workers = {name: Worker(make) for name, make in others.items()}
        for worker in (reference, *workers.values()):
            worker.time(0)  # Compilation
            worker.time(1)
        for k in range(first, pairs, ROUNDS):
            for name, worker in workers.items():
                order = (reference, worker) if k // ROUNDS % 2 else (worker, reference)
                times = {each: each.time(k) for each in order}
                ratios[name].append(times[worker] / times[reference])
                seconds.append(times[reference])
        peaks = {name: worker.peak_memory() for name, worker in workers.items()}
        for worker in (reference, *workers.values()):
            worker.close()
    ratios = {name: Ratio.of(values) for name, values in ratios.items()}
    return Comparison(ratios, float(np.median(seconds)), peaks)


def in_new_process(module: str, *arguments: str) -> dict:
    """The JSON that a module prints, run in a new process without any compiled kernel on disk."""
    with tempfile.TemporaryDirectory() as home:  # Dr.Jit keeps them in the home folder
        environment = os.environ | {"HOME": home}
        command = [sys.executable, "-m", module, *arguments]
        output = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)
    return json.loads(output.stdout)


def peak_memory() -> float:
    """Peak memory of this process in MiB, on Linux; `getrusage` would include its parent's."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s*(\d+)", status).group(1)) / 1024


def machine() -> str:
    """Processor, cores and LLVM, for the head of a table."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = f"{lines[0].split(':')[1].strip()}, {len(lines)} cores"
    version = ".".join(map(str, dr.detail.llvm_version()))
    return f"{model}, LLVM {version}, Dr.Jit {dr.__version__}"
