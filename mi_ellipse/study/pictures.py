"""Render the pictures of a comparison with their times, and keep them for the next run."""

from __future__ import annotations

import gc
import hashlib
import json
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import __version__, render, scene

PACKAGE = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Timing:
    """Seconds of one render, `total` = `tracing` + `compilation` + `execution`."""

    total: float
    tracing: float  # Python, and Dr.Jit writing the kernel
    compilation: float  # by LLVM or CUDA; zero where the kernel was known
    execution: float  # of the kernels


@dataclass(frozen=True, order=True)
class Task:
    """A picture to be rendered."""

    seed: int
    sampling: str
    spp: int  # as asked for

    @property
    def name(self) -> str:
        return f"{self.sampling}_{self.spp}spp_seed{self.seed}"


@dataclass(frozen=True)
class Picture:
    """A picture on disk."""

    file: Path
    task: Task
    spp: int  # as taken: some samplers round up
    timing: Timing  # after a warm-up
    warm_up: Timing


class Gallery:
    """
    The pictures of one scene in one folder.

    A picture counts as there if it was made with the same settings: scene and the files it names,
    parameters, variant, samples, seed, strategy, versions, the package's own rendering code, and
    the machine, since its times are kept with it.
    """

    def __init__(self, folder: Path, scene_file: Path, parameters: Mapping[str, str]):
        self.folder = folder
        self.scene_file = scene_file
        self.parameters = dict(parameters)
        self._settings = settings(scene_file, parameters)
        self._settings |= {"code_sha256": _code_digest(), "machine": describe_machine()}

    def find(self, task: Task) -> Picture | None:
        """Return the picture if it is there and fits."""
        file = self._file(task)
        if not file.exists():
            return None
        found = mi.Bitmap(str(file)).metadata()
        wanted = self._settings | _settings_of(task)
        if any(name not in found or found[name] != value for name, value in wanted.items()):
            return None
        timing, warm_up = (Timing(**json.loads(found[name])) for name in ("timing", "warm_up"))
        return Picture(file, task, int(found["spp"]), timing, warm_up)

    def holds(self, task: Task) -> bool:
        """Tell whether the picture is there, with whatever settings."""
        return self._file(task).exists()

    def render(self, tasks: Sequence[Task], progress: Callable[[Task], None]) -> None:
        """
        Render pictures and write them, in an order that is fair to the strategies.

        Strategies take turns, so that a machine that slows down slows all of them. Only one scene
        is loaded at a time, since every living lamp is part of every render.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        for (_, sampling), group in groupby(sorted(tasks), lambda task: (task.seed, task.sampling)):
            group = list(group)
            loaded = scene.load_scene(self.scene_file, self.parameters, sampling)
            # Compiles the kernel, which is the same for every number of samples.
            _, warm_up = render_timed(loaded, group[0].spp, group[0].seed)
            for task in group:
                rendering, timing = render_timed(loaded, task.spp, task.seed)
                image = colour(rendering, f"{task.sampling} at {task.spp} spp, seed {task.seed}")
                description = render.describe(
                    self.scene_file, rendering, task.seed, sampling, self.parameters
                )
                times = {"timing": timing, "warm_up": warm_up}
                times = {name: json.dumps(asdict(time)) for name, time in times.items()}
                description |= self._settings | _settings_of(task) | times
                render.write_exr(self._file(task), image, description)
                progress(task)
            del loaded
            gc.collect()

    def _file(self, task: Task) -> Path:
        return self.folder / f"{task.name}.exr"


def settings(scene_file: Path, parameters: Mapping[str, str]) -> dict[str, str]:
    """Return what two pictures of a scene must have in common to be compared."""
    return {
        "scene_digest": scene.digest(scene_file, parameters),
        "variant": mi.variant(),
        "mi_ellipse_version": __version__,
        "mitsuba_version": mi.__version__,
        "drjit_version": dr.__version__,
    }


def describe_machine() -> str:
    """Return the processor's name, as far as the system tells it, and the threads in use."""
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        models = [
            line for line in cpuinfo.read_text().splitlines() if line.startswith("model name")
        ]
        name = models[0].partition(":")[2].strip() if models else name
    return f"{name}, {dr.thread_count()} threads"


def render_timed(loaded: mi.Scene, spp: int, seed: int) -> tuple[render.Rendering, Timing]:
    """Render as :func:`mi_ellipse.render.render` does, and tell where the time went."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        rendering = render.render(loaded, spp, seed)
        history = dr.kernel_history()

    if not history:  # scalar variants have no kernels
        return rendering, Timing(rendering.seconds, 0.0, 0.0, rendering.seconds)
    execution = sum(kernel["execution_time"] for kernel in history) / 1000
    compilation = sum(kernel.get("backend_time", 0.0) for kernel in history) / 1000
    tracing = rendering.seconds - execution - compilation
    return rendering, Timing(rendering.seconds, tracing, compilation, execution)


def colour(rendering: render.Rendering, what: str) -> np.ndarray:
    """
    Return the RGB picture of a rendering, luminance repeated.

    Raises
    ------
    ValueError
        If it has neither, or holds a NaN or an infinity; `what` says which picture it is.
    """
    if rendering.channels[:3] == ("R", "G", "B"):
        image = rendering.image[..., :3]
    elif rendering.channels[:1] == ("Y",):
        image = rendering.image[..., [0, 0, 0]]
    else:
        channels = ", ".join(rendering.channels)
        raise ValueError(f"{what}: the picture has no colour, only the channels {channels}")

    invalid = np.argwhere(~np.isfinite(image).all(axis=2))
    if invalid.size:
        y, x = invalid[0]
        raise ValueError(
            f"{what}: {len(invalid)} pixel(s) are NaN or infinite, the first at x={x}, y={y};"
            " the picture was not kept"
        )
    return image


def read_exr(file: Path) -> np.ndarray:
    """Return a picture as an array of shape (height, width, channels)."""
    return np.array(mi.Bitmap(str(file)))


def _settings_of(task: Task) -> dict[str, str]:
    return {"sampling": task.sampling, "asked_spp": str(task.spp), "seed": str(task.seed)}


def _code_digest() -> str:
    """Return a SHA-256 of the package's modules, without this study and the command line."""
    files = [*PACKAGE.glob("*.py"), *PACKAGE.glob("sampling/*.py")]
    files = sorted(file for file in files if file.name != "cli.py")
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
