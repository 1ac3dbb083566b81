"""
Time strategies in turns, so that a machine that slows down does not decide a comparison.

In a turn, all strategies render the same seed one after the other; the first one begins and renders
again in the end. A time counts by its ratio to the time that the first strategy would have taken at
that moment, between its two. The two themselves tell what a ratio of 1 looks like on this machine.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..files import sealed
from ..rendering.job import Timing
from .gallery import Gallery, Picture, Task

FILE = "times.json"

# Strategy, and samples per pixel as asked for
Key = tuple[str, int]


@dataclass(frozen=True)
class TimedPair:
    """A strategy and the first one, to be timed beside each other."""

    kind: str  # at equal samples, or at equal time
    first: Key
    other: Key  # the first one, too: it is timed beside itself
    seed: int

    @property
    def name(self) -> str:
        """How the pair is called in the file."""
        parts = (self.kind, *self.other, "beside", *self.first, "seed", self.seed)
        return " ".join(str(part) for part in parts)


@dataclass(frozen=True)
class PairedTime:
    """The time of a strategy beside that of the first one."""

    timing: Timing  # after a warm-up
    warm_up: Timing
    first_seconds: float  # of the first strategy at the same moment

    @classmethod
    def read(cls, entry: Mapping[str, Any]) -> PairedTime:
        """Return what ``dataclasses.asdict`` made an entry of."""
        return cls(Timing(**entry["timing"]), Timing(**entry["warm_up"]), entry["first_seconds"])

    @property
    def ratio(self) -> float:
        """Time of the strategy over that of the first one."""
        return self.timing.total / self.first_seconds


class Times:
    """The times in a comparison's folder that were taken with the same settings."""

    def __init__(self, file: Path, settings: dict[str, str], say: Callable[[str], None]):
        self._file = file
        self._settings = settings
        self._times: dict[str, PairedTime] = {}
        try:
            document = sealed.read_json(file)
        except FileNotFoundError:
            return
        except ValueError:
            say(f"{file.name} was damaged: times are taken again")
            return
        changed = [name for name in settings if document["settings"].get(name) != settings[name]]
        if changed:
            say(f"Times were taken with another {', '.join(changed)}, and are taken again")
            return
        for name, entry in document["times"].items():
            self._times[name] = PairedTime.read(entry)

    def __contains__(self, pair: TimedPair) -> bool:
        return pair.name in self._times

    def __getitem__(self, pair: TimedPair) -> PairedTime:
        return self._times[pair.name]

    def add(self, times: dict[TimedPair, PairedTime]) -> None:
        """Take the times of a whole turn, and keep them on disk."""
        self._times |= {pair.name: time for pair, time in times.items()}
        entries = {name: asdict(time) for name, time in self._times.items()}
        sealed.write_json(self._file, {"settings": self._settings, "times": entries})


# ---- Turns ----


class Render(NamedTuple):
    """The times of one render."""

    timing: Timing
    warm_up: Timing


@dataclass(frozen=True)
class Turn:
    """Pairs of one kind and seed, which are timed one after the other."""

    pairs: tuple[TimedPair, ...]  # without those of the first strategy with itself

    @property
    def tasks(self) -> list[Task]:
        """Renders in their order: scenes of one strategy in a row, since they are loaded once."""
        firsts, seed = self._firsts, self._seed
        others = sorted({pair.other for pair in self.pairs} - set(firsts))
        return [Task(seed, *key) for key in (*firsts, *others, *firsts)]

    def evaluate(self, renders: Sequence[Render]) -> dict[TimedPair, PairedTime]:
        """Return the times of all pairs from those of :attr:`tasks`."""
        tasks, count = self.tasks, len(self._firsts)
        own = dict(zip(tasks[count:-count], range(count, len(tasks) - count), strict=True))
        result = {}
        for pair in self.pairs:
            before = self._firsts.index(pair.first)
            after = len(tasks) - count + before
            first, again = renders[before].timing.total, renders[after].timing.total
            if pair.other == pair.first:
                result[pair] = PairedTime(*renders[before], again)
                continue
            place = own[Task(pair.seed, *pair.other)]
            # A drift that is even within the turn has no part in the ratio.
            share = (place - before) / (after - before)
            result[pair] = PairedTime(*renders[place], first ** (1 - share) * again**share)
        return result

    @property
    def _firsts(self) -> list[Key]:
        return sorted({pair.first for pair in self.pairs})

    @property
    def _seed(self) -> int:
        return self.pairs[0].seed


def plan_turns(pairs: Iterable[TimedPair]) -> Iterator[Turn]:
    """Yield a turn for each seed; the first strategy is always timed beside itself as well."""
    pairs = list(pairs)
    for seed in sorted({pair.seed for pair in pairs}):
        own = [pair for pair in pairs if pair.seed == seed]
        controls = [TimedPair(pair.kind, pair.first, pair.first, seed) for pair in own]
        yield Turn(tuple(dict.fromkeys([*own, *controls])))


def take_turns(
    gallery: Gallery,
    turns: Sequence[Turn],
    times: Times,
    wanted: Collection[Task],
    progress: Callable[[Task], None],
) -> dict[Task, Picture]:
    """
    Time the strategies, and keep the pictures that are `wanted` of what was rendered.

    A turn that is interrupted leaves its pictures and no times. `progress` is called after each
    render.
    """
    tasks = [task for turn in turns for task in turn.tasks]
    jobs = [gallery.job(task, warm_up=True) for task in tasks]
    pictures: dict[Task, Picture] = {}
    with closing(gallery.run(jobs)) as renderings:
        for turn in turns:
            taken = []
            for task in turn.tasks:
                rendering = next(renderings)
                assert rendering.warm_up is not None  # Each job of a turn asks for it.
                taken.append(Render(rendering.timing, rendering.warm_up))
                if task in wanted and task not in pictures:
                    pictures[task] = gallery.keep(task, rendering)
                progress(task)
            times.add(turn.evaluate(taken))
    return pictures


# ---- Equal time ----


def match_samples(count: int, ratio: float, overhead: float) -> int:
    """
    Return the samples per pixel of a strategy that take the time of the first one.

    Parameters
    ----------
    count
        Samples per pixel of the first one.
    ratio
        Time of the strategy for as many samples, over that of the first one.
    overhead
        The part of its time that is the same for any number of samples, in samples per pixel, see
        :func:`overhead_in_samples`.
    """
    return max(1, round((count + overhead) / ratio - overhead))


def overhead_in_samples(spp: Sequence[int], seconds: Sequence[float]) -> float:
    """
    Return how many samples per pixel take as long as what a render does besides.

    A line is fitted to the times of several numbers of samples. From one alone nothing is known,
    and neither where more samples take no more time: then it is zero, and time is in proportion.
    """
    if len(spp) == 1:
        return 0.0
    slope, offset = np.polyfit(spp, seconds, 1, w=1 / np.array(seconds))
    return max(0.0, float(offset / slope)) if slope > 0 else 0.0
