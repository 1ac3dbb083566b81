"""Hold what a comparison found, and write it as tables."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ..files import atomic, images
from .metrics import LABELS, METRICS, SQUARED, Estimate
from .pictures import Picture, read_exr
from .reference import Reference

EQUAL_SAMPLES = "equal samples"
EQUAL_TIME = "equal time"

# Beyond this share of a measured error, the reference's own error is no longer negligible.
TOLERATED_REFERENCE_ERROR = 0.05


@dataclass(frozen=True)
class Measurement:
    """One strategy at one number of samples, over all seeds."""

    kind: str  # EQUAL_SAMPLES or EQUAL_TIME
    sampling: str
    spp: int  # as asked for
    first_spp: int  # samples of the first strategy that this is compared with
    pictures: tuple[Picture, ...]  # one a seed
    values: dict[str, tuple[float, ...]]  # metric → one value a seed
    errors: dict[str, Estimate]  # metric → mean over the seeds
    seconds: float  # of a render after a warm-up: tracing and execution; median, as the next two
    tracing_seconds: float
    execution_seconds: float
    compilation_seconds: float  # longest of the warm-ups; zero if Dr.Jit knew the kernel
    efficiency: dict[str, float]  # metric → 1 / (error · seconds), relative to the first strategy


@dataclass(frozen=True)
class Comparison:
    """A finished comparison of strategies in a scene."""

    scene_file: Path
    parameters: dict[str, str]
    folder: Path
    strategies: tuple[str, ...]
    spp: tuple[int, ...]
    seeds: int
    settings: dict[str, str]  # scene, variant and versions
    machine: str
    reference: Reference
    measurements: tuple[Measurement, ...]

    def find(self, kind: str, sampling: str, first_spp: int) -> Measurement:
        """Return the measurement of a strategy."""
        wanted = (kind, sampling, first_spp)
        for measurement in self.measurements:
            if (measurement.kind, measurement.sampling, measurement.first_spp) == wanted:
                return measurement
        raise KeyError(wanted)

    def series(self, sampling: str) -> list[Measurement]:
        """Return a strategy's measurements at equal samples, from few to many."""
        return [self.find(EQUAL_SAMPLES, sampling, spp) for spp in self.spp]

    @property
    def exposure(self) -> float:
        """Stops that all pictures are shown with, so that they can be compared."""
        return images.choose_exposure(self.reference_image())

    def reference_image(self) -> np.ndarray:
        return read_exr(self.reference.file)

    def image(self, measurement: Measurement) -> np.ndarray:
        """Return the picture of the first seed."""
        return read_exr(measurement.pictures[0].file)

    def warnings(self) -> list[str]:
        """Return a sentence if the reference is not good enough for every measured error."""
        own = self.reference.errors
        share, metric, one = max(
            (
                (own[metric] / one.errors[metric].mean, metric, one)
                for metric in SQUARED
                for one in self.measurements
            ),
            key=lambda entry: entry[0],
        )
        if share <= TOLERATED_REFERENCE_ERROR:
            return []
        return [
            f"The reference's own {LABELS[metric]}, {own[metric]:.2g}, is {100 * share:.0f} %"
            f" of the {one.errors[metric].mean:.2g} measured for {one.sampling} at {one.spp} spp:"
            f" it needs more samples than its {self.reference.spp}."
        ]


def write_tables(comparison: Comparison) -> tuple[Path, Path]:
    """Write ``results.csv``, a row a measurement, and ``results.json``, with every seed."""
    table = io.StringIO(newline="")
    rows = [_row(comparison, measurement) for measurement in comparison.measurements]
    writer = csv.DictWriter(table, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)

    document = {
        "scene": str(comparison.scene_file),
        "parameters": comparison.parameters,
        "settings": comparison.settings,
        "machine": comparison.machine,
        "seeds": comparison.seeds,
        "reference": {
            "file": comparison.reference.file.relative_to(comparison.folder).as_posix(),
            "spp": comparison.reference.spp,
            "errors": comparison.reference.errors,
            "flip_between_halves": comparison.reference.flip_between_halves,
        },
        "warnings": comparison.warnings(),
        "measurements": [_entry(comparison, one) for one in comparison.measurements],
    }
    files = comparison.folder / "results.csv", comparison.folder / "results.json"
    texts = table.getvalue(), json.dumps(document, indent=1) + "\n"
    for file, text in zip(files, texts, strict=True):
        with atomic.replacement(file) as temporary:
            temporary.write_text(text)
    return files


def _row(comparison: Comparison, measurement: Measurement) -> dict[str, object]:
    row = _summary(measurement)
    for metric in METRICS:
        error = measurement.errors[metric]
        row[metric] = error.mean
        row[f"{metric}_standard_error"] = error.standard_error
        if metric in comparison.reference.errors:
            row[f"{metric}_of_reference"] = comparison.reference.errors[metric]
    row["seeds"] = comparison.seeds
    row["reference_spp"] = comparison.reference.spp
    return row


def _entry(comparison: Comparison, measurement: Measurement) -> dict[str, object]:
    pictures = [
        {
            "file": picture.file.relative_to(comparison.folder).as_posix(),
            "seed": picture.task.seed,
            "timing": asdict(picture.timing),
            "warm_up": asdict(picture.warm_up),
            "errors": {metric: measurement.values[metric][i] for metric in METRICS},
        }
        for i, picture in enumerate(measurement.pictures)
    ]
    # JSON knows no NaN: without a second seed there is no standard error.
    errors = {
        metric: {"mean": error.mean}
        | ({"standard_error": error.standard_error} if comparison.seeds > 1 else {})
        for metric, error in measurement.errors.items()
    }
    return _summary(measurement) | {"errors": errors, "pictures": pictures}


def _summary(measurement: Measurement) -> dict[str, object]:
    """Return what a row of the table and an entry of the document share."""
    return {
        "kind": measurement.kind,
        "first_spp": measurement.first_spp,
        "sampling": measurement.sampling,
        "spp": measurement.spp,
        "spp_taken": measurement.pictures[0].spp,
        "seconds": measurement.seconds,
        "tracing_seconds": measurement.tracing_seconds,
        "execution_seconds": measurement.execution_seconds,
        "compilation_seconds": measurement.compilation_seconds,
    } | {f"efficiency_{metric}": value for metric, value in measurement.efficiency.items()}
