"""Times in turns: what a drift of the machine does to them, and what is kept of them."""

import json
import math

import numpy as np
import pytest
from mi_ellipse.rendering.job import Timing
from mi_ellipse.study.gallery import Task
from mi_ellipse.study.timing import (
    PairedTime,
    Render,
    TimedPair,
    Times,
    match_samples,
    overhead_in_samples,
    plan_turns,
)

KIND = "equal samples"
STRATEGIES = {"area": 1.0, "b": 1.3, "c": 0.7}  # and their true times
COUNTS = (8, 32)


def pairs(seeds, strategies=tuple(STRATEGIES)):
    return [
        TimedPair(KIND, ("area", spp), (name, spp), seed)
        for seed in seeds
        for name in strategies
        for spp in COUNTS
    ]


def render(seconds, compilation=0.0):
    return Render(Timing(seconds, 0, 0, seconds), Timing(2 * seconds, 0, compilation, seconds))


def test_a_turn_begins_and_ends_with_the_first_strategy_and_loads_each_scene_once():
    (turn,) = plan_turns(pairs([3]))
    order = ["area", "area", "b", "b", "c", "c", "area", "area"]
    assert turn.tasks == [Task(3, name, spp) for name, spp in zip(order, COUNTS * 4, strict=True)]


def test_a_missing_pair_alone_makes_a_turn_of_its_own():
    turns = list(plan_turns(pairs([2], ["c"])[:1] + pairs([5], ["b"])))
    assert [task.sampling for task in turns[0].tasks] == ["area", "c", "area"]
    assert [task.sampling for task in turns[1].tasks] == ["area"] * 2 + ["b"] * 2 + ["area"] * 2
    assert {turn.pairs[0].seed for turn in turns} == {2, 5}


@pytest.mark.parametrize("drift", [0.0, 0.08, -0.05])
def test_an_even_drift_has_no_part_in_the_ratios(drift):
    (turn,) = plan_turns(pairs([1]))
    renders = [
        render(0.01 * task.spp * STRATEGIES[task.sampling] * math.exp(drift * place))
        for place, task in enumerate(turn.tasks)
    ]
    found = turn.evaluate(renders)
    assert set(found) == set(pairs([1]))
    for pair, time in found.items():
        if pair.other[0] == "area":  # beside itself, with six renders between
            assert time.ratio == pytest.approx(math.exp(-6 * drift))
        else:
            assert time.ratio == pytest.approx(STRATEGIES[pair.other[0]])


def test_one_picture_can_match_several_counts():
    """At equal time, a slow strategy takes one sample for each."""
    both = [TimedPair("equal time", ("area", spp), ("b", 1), 1) for spp in (1, 2)]
    (turn,) = plan_turns(both)
    assert [(task.sampling, task.spp) for task in turn.tasks] == [
        ("area", 1), ("area", 2), ("b", 1), ("area", 1), ("area", 2),
    ]  # fmt: skip
    found = turn.evaluate([render(seconds) for seconds in (1.0, 2.0, 3.0, 1.0, 2.0)])
    assert [found[pair].ratio for pair in both] == [pytest.approx(3), pytest.approx(1.5)]


# ---- On disk ----


def test_times_are_kept_for_the_same_settings_alone(tmp_path):
    pair, other = pairs([1], ["b"])
    time = PairedTime(*render(0.1, compilation=0.03), 0.2)
    said = []
    times = Times(tmp_path / "times.json", {"machine": "a", "code": "1"}, said.append)
    times.add({pair: time})
    again = Times(tmp_path / "times.json", {"machine": "a", "code": "1"}, said.append)
    assert (again[pair], pair in again, other in again) == (time, True, False)
    assert said == []
    assert pair not in Times(tmp_path / "times.json", {"machine": "b", "code": "1"}, said.append)
    assert said == ["Times were taken with another machine, and are taken again"]


def test_damaged_times_are_announced(tmp_path):
    file = tmp_path / "times.json"
    times = Times(file, {}, pytest.fail)
    times.add({pairs([1])[0]: PairedTime(*render(0.1), 0.2)})
    document = json.loads(file.read_text())
    next(iter(document["times"].values()))["first_seconds"] = 0.3
    file.write_text(json.dumps(document))
    said = []
    assert pairs([1])[0] not in Times(file, {}, said.append)
    assert said == ["times.json was damaged: times are taken again"]


# ---- Equal time ----


@pytest.mark.parametrize(
    ("count", "ratio", "overhead", "expected"),
    [
        (16, 0.8, 0, 20),
        (16, 2.0, 0, 8),
        (16, 100, 0, 1),  # not even one sample fits
        (16, 1.0, 50, 16),
        (20, 2.0, 4, 8),  # 24 parts take twice as long: 12 fit, 4 of which are no samples
    ],
)
def test_match_samples(count, ratio, overhead, expected):
    assert match_samples(count, ratio, overhead) == expected


def test_matched_samples_take_the_time_of_the_first_one():
    """Whatever the fixed and the proportional part of the two times are."""
    random = np.random.default_rng(1)
    for fixed, slope, first_fixed, first_slope in random.uniform(0.1, 2, (50, 4)):
        count = 5000
        seconds = [fixed + slope * spp for spp in (2000, count)]
        first = first_fixed + first_slope * count
        overhead = overhead_in_samples((2000, count), seconds)
        matched = match_samples(count, seconds[1] / first, overhead)
        assert fixed + slope * matched == pytest.approx(first, abs=slope)  # half a sample


def test_overhead():
    assert overhead_in_samples((10, 20, 40), (0.6, 1.1, 2.1)) == pytest.approx(2)
    assert overhead_in_samples((16,), (2.0,)) == 0  # nothing is known
    assert overhead_in_samples((10, 20, 40), (2.0, 1.9, 1.8)) == 0  # noise alone
    assert overhead_in_samples((10, 20), (0.9, 2.0)) == 0  # no part of a time is negative
