"""Measure the pictures of a comparison, and gather what is known of each strategy."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ..files import sealed
from ..files.images import Image
from .album import Album
from .gallery import Picture
from .metrics import METRICS, Pair
from .reference import Reference
from .results import Measurement
from .statistics import efficiency, estimate
from .timing import Key, TimedPair, Times

# One picture a seed
Pictures = dict[Key, tuple[Picture, ...]]

# Metric, and one value a seed
Values = dict[str, tuple[float, ...]]

# Called with a step of the work, and how much of how much is done.
Progress = Callable[[str, int, int], None]


def measure(
    folder: Path,
    pictures: Pictures,
    reference: Reference,
    album: Album,
    progress: Progress,
    say: Callable[[str], None],
) -> dict[Key, Values]:
    """
    Measure all pictures. The slow metrics are measured only where their values are not known.

    Parameters
    ----------
    folder
        Of the comparison; ``slow_metrics.json`` in it keeps the values of slow metrics.
    pictures, reference
        What to compare. Each file is read once.
    album
        Takes the pictures of the first seed, which are shown later.
    progress, say
        Called with the number of pictures done and their total, and with sentences for the user.
    """
    truth = album.read(reference.file)
    known = _Known(folder / "slow_metrics.json", truth, say)
    total = sum(len(group) for group in pictures.values())
    done, result = 0, {}
    for key, group in pictures.items():
        measured = []
        for picture in group:
            is_shown = picture is group[0]
            image = album.read(picture.file) if is_shown else album.look(picture.file)
            measured.append(_measure(image, truth, known))
            done += 1
            progress("metrics", done, total)
        result[key] = {metric: tuple(one[metric] for one in measured) for metric in METRICS}
        known.save()
    return result


def summarize(
    kind: str,
    keys: Sequence[Key],
    pictures: Pictures,
    values: Mapping[Key, Values],
    times: Times,
) -> list[Measurement]:
    """
    Gather what is known of strategies that are compared with one another.

    Parameters
    ----------
    kind
        ``EQUAL_SAMPLES`` or ``EQUAL_TIME``.
    keys
        The strategies and their samples; all are compared with the first one.
    pictures, values
        All pictures, and their errors.
    times
        Those of the strategies beside the first one.
    """
    return [_summarize(kind, key, keys[0], pictures, values, times) for key in keys]


def _summarize(
    kind: str,
    key: Key,
    first: Key,
    pictures: Pictures,
    values: Mapping[Key, Values],
    times: Times,
) -> Measurement:
    group = pictures[key]
    paired = tuple(times[TimedPair(kind, first, key, picture.task.seed)] for picture in group)
    first_seconds = [time.first_seconds for time in paired]
    seconds = [time.timing.total for time in paired]
    return Measurement(
        kind=kind,
        sampling=key[0],
        spp=key[1],
        first_spp=first[1],
        pictures=group,
        times=paired,
        values=values[key],
        errors={metric: estimate(of_seeds) for metric, of_seeds in values[key].items()},
        efficiency={
            name: efficiency(values[first][name], first_seconds, values[key][name], seconds)
            for name, metric in METRICS.items()
            if metric.efficiency
        },
    )


def _measure(image: Image, truth: Image, known: _Known) -> dict[str, float]:
    pair = Pair(image, truth)
    return {
        name: known.value(name, pair) if metric.slow else metric.function(pair)
        for name, metric in METRICS.items()
    }


class _Known:
    """Values of slow metrics that were measured before, by the pixels that they belong to."""

    def __init__(self, file: Path, reference: Image, say: Callable[[str], None]):
        self._file = file
        self._values: dict[str, float] = {}
        try:
            self._values = sealed.read_json(file)
        except FileNotFoundError:
            pass
        except ValueError:
            say(f"{file.name} was damaged and is computed again")
        self._of_reference = hashlib.sha256(reference.tobytes())

    def value(self, metric: str, pair: Pair) -> float:
        """Return the value of a metric for a picture."""
        digest = self._of_reference.copy()
        digest.update(pair.image.tobytes())
        name = f"{metric} {digest.hexdigest()}"
        if name not in self._values:
            self._values[name] = METRICS[metric].function(pair)
        return self._values[name]

    def save(self) -> None:
        """Keep the values for the next run."""
        sealed.write_json(self._file, self._values)
