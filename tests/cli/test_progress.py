"""Progress without a terminal."""

import time

import pytest
from mi_ellipse.cli.progress import Lines


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands until it is set."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_lines_are_few_and_tell_the_remaining_time(clock):
    said = []
    lines = Lines(said.append, "Rendering")
    for second in range(1, 2001):  # a work of 2000 s, told each second
        clock[0] = second
        lines.update(second / 2000)
    percents = [line.split(" %")[0] for line in said]
    assert percents == [f"Rendering: {10 * k}" for k in range(1, 10)]
    assert said[0] == "Rendering: 10 %, 0:30:00 left"


def test_long_work_is_told_every_five_minutes(clock):
    said = []
    lines = Lines(said.append, "Rendering", 0.5)
    for minute in range(1, 31):  # a tenth of a percent a minute, from the middle on
        clock[0] = 60 * minute
        lines.update(0.5 + minute / 1000)
    assert len(said) == 6
    assert said[1] == "Rendering: 51 %, 8:10:00 left"


def test_short_work_says_nothing(clock):
    said = []
    lines = Lines(said.append, "Rendering")
    for tenth in range(1, 96):
        clock[0] = tenth / 10
        lines.update(tenth / 95)
    assert said == []
