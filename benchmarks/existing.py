"""Error and time of scenes that people know, as their files stand and with converted lamps."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import mi_ellipse
import mitsuba as mi
import numpy as np
from mi_ellipse.rendering.rewrite import BUILT_IN
from mi_ellipse.rendering.scene import load_scene
from mi_ellipse.study.metrics import trimmed_mean

from .harness import PAIRS, Ratio, compare_times, rendering, squared_deviations
from .pictures import draw
from .scenes import SCENES

GROUPED = ", grouped"
SHOWN = f"solid_angle{GROUPED}"
KINDS = (BUILT_IN, "solid_angle", SHOWN, f"projected_solid_angle{GROUPED}")
SEEDS = 12

PUBLIC = SCENES / "public"
FIGURE = SCENES.parent / "docs" / "images" / "veach_mis_16spp.png"
FIGURE_SPP = 16
# Column, row, width and height
INSETS = {"#D55E00": (70, 30, 128, 72), "#0072B2": (330, 180, 128, 72)}


@dataclass(frozen=True)
class Known:
    """A scene that `scenes/public/README.md` tells how to get."""

    folder: str
    parameters: dict[str, str]  # Of its file
    spp: int
    regions: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)
    # Left, top, right and bottom as shares of the picture

    @property
    def file(self) -> Path:
        """Where the scene file is expected."""
        return PUBLIC / self.folder / "scene.xml"

    def load(self, kind: str) -> mi.Scene:
        """The scene with lamps of a kind, which may be grouped; its file stays as it is."""
        name, grouped, _ = kind.partition(GROUPED)
        converted = name != BUILT_IN
        scene = load_scene(
            self.file, self.parameters, name if converted else None, convert_lamps=converted
        )
        if grouped:
            mi_ellipse.group_lamps(scene)
        return scene


KNOWN = {
    "Veach MIS": Known(
        "veach-mis",
        {"integrator": "path", "resx": "640", "resy": "360"},
        spp=32,
        regions={
            "wall": (0.05, 0.05, 0.32, 0.35),
            "plates": (0.28, 0.53, 0.72, 0.9),
            "floor": (0.1, 0.94, 0.9, 1),
        },
    ),
    "Modern Hall": Known("staircase2", {"integrator": "path", "resx": "256", "resy": "256"}, spp=8),
}


def run(pairs: int = PAIRS) -> dict | None:
    """Errors, how many times lower they are than with the lamps of the file, and time ratios."""
    if missing := [str(known.file) for known in KNOWN.values() if not known.file.exists()]:
        print(f"not measured: {', '.join(missing)} missing, see scenes/public/README.md")
        return None
    results = {}
    for name, known in KNOWN.items():
        measured, mean = _errors(known)
        make = {kind: rendering(partial(known.load, kind), known.spp) for kind in KINDS}
        times = compare_times(make[BUILT_IN], make, pairs).ratios
        for kind, entry in measured.items():
            entry["time"] = vars(times[kind])
            print(f"{name}, {kind:<32}{entry}", flush=True)
        size = [int(known.parameters[key]) for key in ("resx", "resy")]
        results[name] = {"spp": known.spp, "size": size, "kinds": measured}
        if known.folder == "veach-mis":
            _draw(known, mean, times[SHOWN].median)
    return {"seeds": SEEDS, "pairs": pairs, "scenes": results}


def _errors(known: Known) -> tuple[dict[str, dict], np.ndarray]:
    """Errors of each kind of lamps with their ratios, and the mean of the last kind's pictures."""
    measured, first = {}, {}
    for kind in KINDS:
        scene = known.load(kind)
        pictures = [
            np.array(mi.render(scene, spp=known.spp, seed=seed), dtype=float)
            for seed in range(SEEDS)
        ]
        del scene  # Its lamps would be compiled into all that follows
        squares, mean = squared_deviations(pictures)
        of_seeds = _of_seeds(known, squares)
        first = first or of_seeds
        measured[kind] = {
            name: {"error": float(values.mean()), "ratio": vars(Ratio.of(first[name] / values))}
            for name, values in of_seeds.items()
        }
    return measured, mean


def _of_seeds(known: Known, squares: list[np.ndarray]) -> dict[str, np.ndarray]:
    """Means of the squared deviations of each picture, over the whole picture and its regions."""
    height, width = squares[0].shape[:2]
    of_seeds = {
        "trimmed": np.array([trimmed_mean(each) for each in squares]),
        "plain": np.array([each.mean() for each in squares]),
    }
    for name, (left, top, right, bottom) in known.regions.items():
        rows = slice(round(top * height), round(bottom * height))
        columns = slice(round(left * width), round(right * width))
        of_seeds[name] = np.array([trimmed_mean(each[rows, columns]) for each in squares])
    return of_seeds


def _draw(known: Known, mean: np.ndarray, time: float) -> None:
    """Pictures at equal time, and two regions of each, enlarged."""
    pictures = {}
    for kind, spp in ((BUILT_IN, FIGURE_SPP), (SHOWN, round(FIGURE_SPP / time))):
        image = mi.render(known.load(kind), spp=spp, seed=SEEDS)
        pictures[f"{kind.replace('_', ' ')}, {spp} spp"] = np.array(image)
    pictures[f"{SEEDS * known.spp} spp"] = mean
    draw(FIGURE, pictures, INSETS)
