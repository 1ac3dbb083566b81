"""Interleaved timing: ratios that hold while the machine's speed drifts."""

from __future__ import annotations

import multiprocessing
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.stats import binom

Loader = Callable[[], "mi.Scene"]  # One that can be pickled

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


class Renderer:
    """A scene in a process of its own.

    Dr.Jit compiles the lights of all living scenes of a process into every render, and a kernel
    with one kind of light is not that of several.
    """

    def __init__(self, load: Loader, spp: int):
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, load, spp), daemon=True)
        self._process.start()
        other.close()

    def time(self, seed: int) -> float:
        """Seconds of a render."""
        self._connection.send(seed)
        return self._connection.recv()

    def close(self) -> None:
        """End the process."""
        self._connection.close()
        self._process.join()


def _serve(connection: Connection, load: Loader, spp: int) -> None:
    """Render once for every seed that arrives."""
    mi.set_variant("llvm_ad_rgb")
    scene = load()
    while True:
        try:
            seed = connection.recv()
        except EOFError:
            return
        start = time.perf_counter()
        dr.eval(mi.render(scene, spp=spp, seed=seed))
        dr.sync_thread()
        connection.send(time.perf_counter() - start)


def compare_times(
    base: Loader, others: dict[str, Loader], spp: int, pairs: int = PAIRS
) -> tuple[dict[str, Ratio], float]:
    """Time renders of each of `others` right beside one of `base`, in changing order.

    Parameters
    ----------
    base, others
        Functions that load a scene.
    spp
        Samples per pixel.
    pairs
        Number of pairs for each.

    Returns
    -------
    ratios
        Time of each over that of `base` beside it.
    seconds
        Median time of `base`.
    """
    ratios = {name: [] for name in others}
    seconds = []
    for first in range(ROUNDS):
        reference = Renderer(base, spp)
        renderers = {name: Renderer(load, spp) for name, load in others.items()}
        for renderer in (reference, *renderers.values()):
            renderer.time(0)  # Compilation
            renderer.time(1)
        for k in range(first, pairs, ROUNDS):
            for name, renderer in renderers.items():
                order = (reference, renderer) if k // ROUNDS % 2 else (renderer, reference)
                times = {each: each.time(k) for each in order}
                ratios[name].append(times[renderer] / times[reference])
                seconds.append(times[reference])
        for renderer in (reference, *renderers.values()):
            renderer.close()
    return {name: Ratio.of(values) for name, values in ratios.items()}, float(np.median(seconds))


def machine() -> str:
    """Processor, cores and LLVM, for the head of a table."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = f"{lines[0].split(':')[1].strip()}, {len(lines)} cores"
    version = ".".join(map(str, dr.detail.llvm_version()))
    return f"{model}, LLVM {version}, Dr.Jit {dr.__version__}"
