"""Interleaved timing: ratios that hold while the machine's speed drifts."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import numpy as np
from scipy.stats import binom

# Built-in against itself scatters by 10 % from pair to pair.
PAIRS = 40


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


def compare_times(
    base: Callable[[int], None], others: dict[str, Callable[[int], None]], pairs: int = PAIRS
) -> tuple[dict[str, Ratio], float]:
    """Time each of `others` right beside `base`, in changing order.

    Parameters
    ----------
    base, others
        Functions of a seed that return once their work is done.
    pairs
        Number of pairs for each.

    Returns
    -------
    ratios
        Time of each over that of `base` beside it.
    seconds
        Median time of `base`.
    """
    for work in (base, *others.values()):
        work(0)  # Compilation
        work(1)
    ratios = {name: [] for name in others}
    seconds = []
    for k in range(pairs):
        for name, other in others.items():
            order = (base, other) if k % 2 else (other, base)
            times = {work: _time(work, k) for work in order}
            ratios[name].append(times[other] / times[base])
            seconds.append(times[base])
    return {name: Ratio.of(values) for name, values in ratios.items()}, float(np.median(seconds))


def _time(work: Callable[[int], None], seed: int) -> float:
    dr.sync_thread()
    start = time.perf_counter()
    work(seed)
    dr.sync_thread()
    return time.perf_counter() - start


def machine() -> str:
    """Processor, cores and LLVM, for the head of a table."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = [line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")]
        model = f"{lines[0].split(':')[1].strip()}, {len(lines)} cores"
    version = ".".join(map(str, dr.detail.llvm_version()))
    return f"{model}, LLVM {version}, Dr.Jit {dr.__version__}"
