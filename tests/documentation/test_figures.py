"""Figures in the pages are those of `docs/data`."""

import json
import re

import pytest

from benchmarks import figures

DATA = figures.ROOT / "docs" / "data"


@pytest.mark.parametrize("name", figures.PAGES)
def test_pages_are_as_the_data_have_them(name):
    """After a change of the data or of a page: `python -m benchmarks figures`."""
    page = (figures.ROOT / name).read_text(encoding="utf-8")
    assert page.count("<!-- figures:") == len(figures.BLOCK.findall(page)) >= 1
    assert figures.filled(page) == page


def test_a_drifting_page_is_seen():
    page = (figures.ROOT / "README.md").read_text(encoding="utf-8")
    time = json.loads((DATA / "render_time.json").read_text(encoding="utf-8"))["render_time"]
    shown = f"{time['bare floor and ball']['ratios']['solid_angle']['median']:.2f}"
    drifted = re.sub(rf"\| {re.escape(shown)} \|", "| 9.99 |", page)
    assert drifted != page
    assert figures.filled(drifted) == page


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0, 2, "0"),
        (0.000228, 2, "0.00023"),
        (0.0399, 2, "0.040"),
        (1.02, 2, "1.0"),
        (46.6, 2, "47"),
        (2349.0, 2, "2300"),
        (1.53e7, 2, "1.5e7"),
        (0.995, 3, "0.995"),
    ],
)
def test_significant_digits(value, digits, text):
    assert figures.number(value, digits) == text
