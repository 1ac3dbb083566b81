"""The study: the scenes of `scenes/` with all strategies, grouped and not, against references.

Every comparison is one of `mi-ellipse compare`, in a folder of its own below `out/study`. What lies
there is used again, so an interrupted run goes on.
"""

from __future__ import annotations

import gc
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mi_ellipse
import mitsuba as mi
import numpy as np
import PIL.Image
from matplotlib.figure import Figure
from mi_ellipse.files.images import read_exr
from mi_ellipse.rendering.rewrite import BUILT_IN
from mi_ellipse.rendering.scene import load_scene
from mi_ellipse.study.drawing import choose_insets, picture_grid
from mi_ellipse.study.kinds import UNGROUPED, split
from mi_ellipse.study.metrics import trimmed_mean
from mi_ellipse.study.results import EQUAL_SAMPLES, Comparison, Measurement
from mi_ellipse.study.run import compare
from mi_ellipse.study.statistics import efficiency

from .harness import ratio_of_means, squared_deviations
from .scenes import LIGHT_SAMPLES, SCENES

ROOT = SCENES.parent
FOLDER = ROOT / "out" / "study"
IMAGES = ROOT / "docs" / "images"
SEEDS = 4
DPI = 180

ORIGINAL = ("area", "rejection", "concentric", "tangent_disk")  # of the study by Guillén et al.
OURS = ("solid_angle", "projected_solid_angle")
ALL = (*ORIGINAL, *OURS)


def ungrouped(names: Sequence[str]) -> tuple[str, ...]:
    """The same strategies, with lamps that Mitsuba picks."""
    return tuple(name + UNGROUPED for name in names)


@dataclass(frozen=True)
class Case:
    """A scene, what is compared in it, and the picture of it."""

    name: str
    scene: str
    size: tuple[int, int]
    strategies: tuple[str, ...]  # the first one is what all are compared with
    spp: tuple[int, ...]
    reference_spp: int
    figure: str
    rows: tuple[tuple[str, ...], ...]  # strategies of each row of pictures, at the fewest samples

    @property
    def command(self) -> str:
        """What makes the same comparison from the command line."""
        width, height = self.size
        return (
            f"mi-ellipse compare scenes/{self.scene}.xml -D resx={width} -D resy={height}"
            f" --sampling {','.join(self.strategies)} --spp {','.join(map(str, self.spp))}"
            f" --reference-spp {self.reference_spp} --seeds {SEEDS} -o out/study/{self.name}"
        )


SEVERAL = (BUILT_IN, *ungrouped(("area", *OURS)), *OURS)
ONE = (BUILT_IN, "area", "rejection", *OURS)
CASES = (
    Case(
        "bunny", "bunny", (256, 256), (BUILT_IN, *ungrouped(ALL), *ALL), (8, 16, 32, 256), 16384,
        "study_bunny.png", (ungrouped(ALL), ALL),
    ),
    Case("fog", "spheres_fog", (240, 180), ONE, (16, 32, 128), 4096, "fog_16spp.png", (ONE,)),
    Case(
        "panel", "panel", (320, 240), (*SEVERAL, "rejection" + UNGROUPED), (8, 32), 2048,
        "panel_8spp.png", ((BUILT_IN, *ungrouped(OURS), *OURS),),
    ),
    Case(
        "dragon", "dragon", (320, 240), (BUILT_IN, "area", *OURS), (32, 128), 4096,
        "dragon_32spp.png", ((BUILT_IN, *OURS),),
    ),
    Case(
        "hall", "hall", (320, 200), SEVERAL, (8, 32), 2048,
        "hall_8spp.png", ((BUILT_IN, *ungrouped(OURS), *OURS),),
    ),
)  # fmt: skip


# ---- Comparisons ----


def measure(case: Case) -> dict:
    """Compare, draw the picture, and return what the pages show."""
    os.chdir(ROOT)  # Paths in the folder do not depend on where the command was called.
    width, height = case.size
    comparison = compare(
        SCENES / f"{case.scene}.xml",
        FOLDER / case.name,
        case.strategies,
        case.spp,
        case.reference_spp,
        SEEDS,
        {"resx": str(width), "resy": str(height)},
        say=lambda sentence: print(sentence, flush=True),
    )
    draw(case, comparison)
    for warning in comparison.warnings():
        print(f"{case.name}: {warning}", flush=True)
    return summary(case, comparison)


def summary(case: Case, comparison: Comparison) -> dict:
    """What the pages show of a comparison."""
    first = {one.spp: one for one in comparison.series(case.strategies[0])}
    reference = comparison.reference_image()
    return {
        "command": case.command,
        "seeds": comparison.seeds,
        "reference_spp": comparison.reference.spp,
        "reference_errors": comparison.reference.errors,
        "warnings": comparison.warnings(),
        "strategies": {
            name: {
                str(one.spp): entry(one, first[one.spp], reference)
                for one in comparison.series(name)
            }
            for name in case.strategies
        },
    }


def entry(one: Measurement, first: Measurement, reference: np.ndarray) -> dict:
    """Errors at equal samples, how many times lower than the first one's, time and efficiency."""
    typical = (
        [typical_error(picture.file, reference) for picture in of.pictures] for of in (first, one)
    )
    return {
        "mse": vars(one.errors["mse"]),
        "trimmed": vars(one.errors["mse_trimmed"]),
        "lower": quotient(first.values["mse_trimmed"], one.values["mse_trimmed"]),
        "rmse_lower": quotient(first.values["rmse"], one.values["rmse"]),
        "typical_lower": quotient(*typical),
        "time": vars(one.ratio),
        "efficiency": vars(one.efficiency["mse_trimmed"]),
    }


def typical_error(file: Path, reference: np.ndarray) -> float:
    """Median over the pixels of the mean squared error of their channels.

    Few pixels on the edges of lamps have no part in it, and make most of the mean of some scenes.
    """
    return float(np.median(np.mean((read_exr(file) - reference) ** 2, axis=-1)))


def quotient(first: Sequence[float], others: Sequence[float]) -> dict[str, float]:
    """Quotient of two mean errors of the same seeds, with its 95 % interval."""
    equal = [1.0] * len(first)
    return vars(efficiency(first, equal, others, equal))


def draw(case: Case, comparison: Comparison) -> None:
    """Draw the rows of pictures of a case below each other."""
    insets = choose_insets(comparison)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, names in enumerate(case.rows):
            shown = replace(comparison, strategies=names)
            figure: Figure = picture_grid(shown, EQUAL_SAMPLES, case.spp[0], insets)
            file = Path(folder) / f"{number}.png"
            figure.savefig(file, dpi=DPI)
            with PIL.Image.open(file) as image:
                rows.append(image.convert("RGB"))
    sheet = PIL.Image.new(
        "RGB", (max(one.width for one in rows), sum(one.height for one in rows)), "white"
    )
    top = 0
    for row in rows:
        sheet.paste(row, (0, top))
        top += row.height
    sheet.save(IMAGES / case.figure, optimize=True)


# ---- The bunny in parts: what hid the strategies ----

PARTS_SPP = 64
PARTS_SEEDS = 8
NEEDLES = {"left_x": "0.9", "left_y": "0.1", "right_x": "0.9", "right_y": "0.1"}
LIGHTS: dict[str, tuple[dict[str, str], bool]] = {
    "two circles": ({}, True),
    "one circle": ({}, False),
    "two needles": (NEEDLES, True),
}
INTEGRATORS = {"light samples": LIGHT_SAMPLES, "MIS": None}  # None: that of the scene


def bunny_parts() -> dict:
    """Trimmed errors of the bunny by lights, integrator and strategy."""
    parts: dict[str, dict[str, dict]] = {}
    for lights, (parameters, both) in LIGHTS.items():
        names = (BUILT_IN, *(ungrouped(ALL) + ALL if both else ALL))
        for samples, integrator in INTEGRATORS.items():
            errors = {name: error(name, parameters, both, integrator) for name in names}
            first = errors[BUILT_IN]
            parts.setdefault(lights, {})[samples] = {
                name: {
                    "trimmed": float(np.mean(own)),
                    "lower": ratio_of_independent(first, own),
                }
                for name, own in errors.items()
            }
            print(lights, samples, {k: f"{np.mean(v):.3g}" for k, v in errors.items()}, flush=True)
    return {"spp": PARTS_SPP, "seeds": PARTS_SEEDS, "lights": parts}


def error(
    name: str, parameters: dict[str, str], both: bool, integrator: dict | None
) -> list[float]:
    """Trimmed squared deviations of each seed from the mean of all: no reference is needed."""
    gc.collect()
    strategy, grouping = split(name)
    size = {"resx": "256", "resy": "256"}
    scene = load_scene(SCENES / "bunny.xml", size | parameters, strategy)
    if not both:
        turn_off_right_lamp(scene)
    elif grouping and strategy != BUILT_IN:
        mi_ellipse.group_lamps(scene)
    how = integrator and mi.load_dict(integrator)
    pictures = [
        mi.render(scene, integrator=how, spp=PARTS_SPP, seed=seed).numpy().astype(float)
        for seed in range(PARTS_SEEDS)
    ]
    return [float(trimmed_mean(squares)) for squares in squared_deviations(pictures)[0]]


def turn_off_right_lamp(scene: mi.Scene) -> None:
    """Leave the left lamp alone, which then gets all samples."""
    traversed = mi.traverse(scene)
    traversed["right.emitter.radiance.value"] = mi.Color3f(0)
    traversed["right.emitter.sampling_weight"] = 0.0
    traversed.update()


def ratio_of_independent(first: Sequence[float], others: Sequence[float]) -> dict[str, float]:
    """Quotient of two means with its 95 % interval, symmetric in the logarithm."""
    count = len(first)
    ratio = ratio_of_means(
        *((np.mean(one), np.std(one, ddof=1) / np.sqrt(count)) for one in (first, others)), count
    )
    return {"value": float(ratio.median), "low": float(ratio.low), "high": float(ratio.high)}


def run() -> dict:
    """All comparisons, and the bunny in parts."""
    return {case.name: measure(case) for case in CASES} | {"parts": bunny_parts()}
