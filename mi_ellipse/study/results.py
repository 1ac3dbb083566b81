"""Hold what a comparison found; write it as tables, and read it back."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..files import atomic, images, sealed
from ..files.images import Image
from .album import Album
from .gallery import Picture, Task
from .metrics import METRICS
from .reference import Reference
from .statistics import Efficiency, Estimate, Spread
from .timing import PairedTime

EQUAL_SAMPLES = "equal samples"
EQUAL_TIME = "equal time"

# Beyond this share of a measured error, the reference's own error is no longer negligible.
TOLERATED_REFERENCE_ERROR = 0.05

# Times that differ by more are not called equal.
TOLERATED_TIME = 0.1

# For a folder that is damaged or of another version
REMEDY = "run `mi-ellipse compare` with the same arguments again"

# Of `results.json`; to be raised when its entries change.
FORMAT = 3


@dataclass(frozen=True)
class Measurement:
    """One strategy at one number of samples, over all seeds."""

    kind: str  # EQUAL_SAMPLES or EQUAL_TIME
    sampling: str
    spp: int  # as asked for
    first_spp: int  # samples of the first strategy that this is compared with
    pictures: tuple[Picture, ...]  # one a seed
    times: tuple[PairedTime, ...]  # beside the first strategy, one a seed
    values: dict[str, tuple[float, ...]]  # metric → one value a seed
    errors: dict[str, Estimate]  # metric → mean over the seeds
    efficiency: dict[str, Efficiency]  # metric → 1 / (error · seconds), relative to the first one

    @property
    def seconds(self) -> Spread:
        """Seconds of a render after a warm-up: tracing and execution."""
        return Spread.of([one.timing.total for one in self.times])

    @property
    def ratio(self) -> Spread:
        """
        Time over that of the first strategy in the same turn.

        That of the first one itself is the ratio of its two renders in a turn.
        """
        return Spread.of([one.ratio for one in self.times])

    @property
    def tracing_seconds(self) -> float:
        """Median of a part of the time, as the next one."""
        return Spread.of([one.timing.tracing for one in self.times]).median

    @property
    def execution_seconds(self) -> float:
        """See :class:`mi_ellipse.rendering.passes.Timing`."""
        return Spread.of([one.timing.execution for one in self.times]).median

    @property
    def compilation_seconds(self) -> float:
        """Longest of the warm-ups; zero if Dr.Jit knew the kernel."""
        return max(one.warm_up.compilation for one in self.times)

    @property
    def is_off(self) -> bool:
        """Whether the time differs from that of the first strategy by more than is tolerated."""
        return abs(math.log(self.ratio.median)) > math.log(1 + TOLERATED_TIME)


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
    album: Album = field(default_factory=Album, compare=False, repr=False)

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

    def reference_image(self) -> Image:
        """Return the reference; it is read once."""
        return self._read(self.reference.file)

    def image(self, measurement: Measurement) -> Image:
        """Return the picture of the first seed; it is read once."""
        return self._read(measurement.pictures[0].file)

    def _read(self, file: Path) -> Image:
        try:
            return self.album.read(file)
        except FileNotFoundError:
            raise ValueError(f"{file} is missing; {REMEDY}") from None
        except ValueError as error:
            raise ValueError(f"{error}; {REMEDY}") from None

    def warnings(self) -> list[str]:
        """Return a sentence for each reason not to trust a number."""
        return [*self._warnings_of_reference(), *self._warnings_of_times()]

    def _warnings_of_reference(self) -> list[str]:
        own = self.reference.errors
        share, metric, one = max(
            (
                (own[metric.name] / one.errors[metric.name].mean, metric, one)
                for metric in METRICS.values()
                if metric.squared and metric.name in own
                for one in self.measurements
            ),
            key=lambda entry: entry[0],
        )
        if share <= TOLERATED_REFERENCE_ERROR:
            return []
        return [
            f"The reference's own {metric.label}, {own[metric.name]:.2g}, is {100 * share:.0f} %"
            f" of the {one.errors[metric.name].mean:.2g} measured for {one.sampling} at"
            f" {one.spp} spp: it needs more samples than its {self.reference.spp}."
        ]

    def _warnings_of_times(self) -> list[str]:
        """Name the worst of the times that should be equal, and are not."""
        warnings = []
        first = self.strategies[0]
        off = [one for one in self.measurements if one.is_off]
        unsteady = [one for one in off if one.sampling == first]
        unequal = [one for one in off if one.sampling != first and one.kind == EQUAL_TIME]
        if unsteady:
            worst = max(unsteady, key=_distance)
            warnings.append(
                f"{first} at {worst.spp} spp, timed beside itself, took {worst.ratio.median:.2f}"
                f" times as long{_others(unsteady)}: the machine was busy. Efficiencies and equal"
                " times are no better than that."
            )
        if unequal:
            worst = max(unequal, key=_distance)
            warnings.append(
                f"At equal time, {worst.sampling} at {worst.spp} spp took"
                f" {worst.ratio.median:.2f} times as long as {first} at"
                f" {worst.first_spp}{_others(unequal)}: these errors are not those of equal times."
            )
        return warnings


def _distance(one: Measurement) -> float:
    return abs(math.log(one.ratio.median))


def _others(off: Sequence[Measurement]) -> str:
    return f" (and {len(off) - 1} more)" if len(off) > 1 else ""


# ---- Writing ----


def write(comparison: Comparison) -> tuple[Path, Path]:
    """
    Write ``results.csv``, a row a measurement, and ``results.json``, with every seed.

    The second one holds everything that :func:`read` needs. Its paths are relative to the folder.
    """
    table = io.StringIO(newline="")
    rows = [_row(comparison, measurement) for measurement in comparison.measurements]
    writer = csv.DictWriter(table, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)

    files = comparison.folder / "results.csv", comparison.folder / "results.json"
    atomic.write_text(files[0], table.getvalue())
    # JSON knows no NaN: without a second seed there is no standard error and no interval.
    sealed.write_json(files[1], _without_nan(_document(comparison)))
    return files


def _row(comparison: Comparison, measurement: Measurement) -> dict[str, object]:
    row = _summary(measurement)
    for metric, value in measurement.efficiency.items():
        row[f"efficiency_{metric}"] = value.value
        row[f"efficiency_{metric}_low"] = value.low
        row[f"efficiency_{metric}_high"] = value.high
    for metric, error in measurement.errors.items():
        row[metric] = error.mean
        row[f"{metric}_standard_error"] = error.standard_error
        if metric in comparison.reference.errors:
            row[f"{metric}_of_reference"] = comparison.reference.errors[metric]
    row["seeds"] = comparison.seeds
    row["reference_spp"] = comparison.reference.spp
    return row


def _document(comparison: Comparison) -> dict[str, object]:
    reference = comparison.reference
    return {
        "format": FORMAT,
        "scene": _relative(comparison.scene_file, comparison.folder),
        "parameters": comparison.parameters,
        "settings": comparison.settings,
        "machine": comparison.machine,
        "strategies": comparison.strategies,
        "spp": comparison.spp,
        "seeds": comparison.seeds,
        "reference": {
            "file": _relative(reference.file, comparison.folder),
            "spp": reference.spp,
            "errors": reference.errors,
            "flip_between_halves": reference.flip_between_halves,
        },
        "warnings": comparison.warnings(),
        "measurements": [_entry(comparison, one) for one in comparison.measurements],
    }


def _entry(comparison: Comparison, measurement: Measurement) -> dict[str, object]:
    pictures = [
        {
            "file": _relative(picture.file, comparison.folder),
            "seed": picture.task.seed,
            "time": asdict(measurement.times[i]),
            "errors": {metric: values[i] for metric, values in measurement.values.items()},
        }
        for i, picture in enumerate(measurement.pictures)
    ]
    return _summary(measurement) | {
        "efficiency": {name: asdict(value) for name, value in measurement.efficiency.items()},
        "errors": {name: asdict(error) for name, error in measurement.errors.items()},
        "pictures": pictures,
    }


def _summary(measurement: Measurement) -> dict[str, object]:
    """Return what a row of the table and an entry of the document share."""
    return {
        "kind": measurement.kind,
        "first_spp": measurement.first_spp,
        "sampling": measurement.sampling,
        "spp": measurement.spp,
        "spp_taken": measurement.pictures[0].spp,
        "seconds": measurement.seconds.median,
        "seconds_low": measurement.seconds.low,
        "seconds_high": measurement.seconds.high,
        "time_ratio": measurement.ratio.median,
        "time_ratio_low": measurement.ratio.low,
        "time_ratio_high": measurement.ratio.high,
        "tracing_seconds": measurement.tracing_seconds,
        "execution_seconds": measurement.execution_seconds,
        "compilation_seconds": measurement.compilation_seconds,
    }


def _relative(file: Path, folder: Path) -> str:
    """Return how to get from a folder to a file, with slashes on every system."""
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:  # on another drive of Windows
        return file.resolve().as_posix()


def _without_nan(value: Any) -> Any:
    """Return a document without the entries that are NaN."""
    if isinstance(value, Mapping):
        return {name: _without_nan(one) for name, one in value.items() if not _is_nan(one)}
    if isinstance(value, (list, tuple)):
        return [_without_nan(one) for one in value]
    return value


def _is_nan(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)


# ---- Reading ----


def read(folder: str | os.PathLike[str]) -> Comparison:
    """
    Read a finished comparison back from its folder; pictures are read when they are asked for.

    Raises
    ------
    ValueError
        If the folder holds no finished comparison, or one of another version.
    """
    folder = Path(folder)
    file = folder / "results.json"
    if not file.is_file():
        raise ValueError(
            f"{folder} holds no finished comparison (results.json is missing): name the folder that"
            " `mi-ellipse compare` wrote to"
        )
    try:
        document = sealed.parse(file)
        if document.get("format") == FORMAT:
            sealed.verify(file, document)
            return _comparison(folder, document)
    except ValueError as error:
        raise ValueError(f"{error}; {REMEDY}") from None
    raise ValueError(
        f"{file} has format {document.get('format')}, and this version reads {FORMAT}; {REMEDY}"
    )


def _comparison(folder: Path, document: dict[str, Any]) -> Comparison:
    reference = document["reference"]
    return Comparison(
        scene_file=folder / document["scene"],
        parameters=document["parameters"],
        folder=folder,
        strategies=tuple(document["strategies"]),
        spp=tuple(document["spp"]),
        seeds=document["seeds"],
        settings=document["settings"],
        machine=document["machine"],
        reference=Reference(
            folder / reference["file"],
            reference["spp"],
            reference["errors"],
            reference["flip_between_halves"],
        ),
        measurements=tuple(_measurement(folder, entry) for entry in document["measurements"]),
    )


def _measurement(folder: Path, entry: dict[str, Any]) -> Measurement:
    pictures = entry["pictures"]
    return Measurement(
        kind=entry["kind"],
        sampling=entry["sampling"],
        spp=entry["spp"],
        first_spp=entry["first_spp"],
        pictures=tuple(
            Picture(
                folder / picture["file"],
                Task(picture["seed"], entry["sampling"], entry["spp"]),
                entry["spp_taken"],
            )
            for picture in pictures
        ),
        times=tuple(PairedTime.read(picture["time"]) for picture in pictures),
        values={
            metric: tuple(picture["errors"][metric] for picture in pictures)
            for metric in entry["errors"]
        },
        errors={
            metric: Estimate(error["mean"], error.get("standard_error", math.nan))
            for metric, error in entry["errors"].items()
        },
        efficiency={
            metric: Efficiency(one["value"], one.get("low", math.nan), one.get("high", math.nan))
            for metric, one in entry["efficiency"].items()
        },
    )
