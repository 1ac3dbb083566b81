"""How figures look: sizes and text, the colour and mark of each strategy, numbers as words."""

from __future__ import annotations

from textwrap import wrap
from typing import Any

from ...rendering.rewrite import BUILT_IN
from ...sampling import STRATEGIES
from ..kinds import split
from .fonts import families

COLUMN_WIDTH = 3.4  # inches, of a page with two columns
PAGE_WIDTH = 7.1
DPI = 300  # of pictures and of PNG
TEXT: dict[Any, Any] = {
    "font.size": 7.5,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.linewidth": 0.6,
    "pdf.fonttype": 42,  # text stays text
    "svg.hashsalt": "mi_ellipse",
    "image.composite_image": False,  # Pictures stay apart, as small as they are.
}

# Of Mitsuba's own emitter; no strategy is black
BUILT_IN_STYLE = ("#000000", "*")


def text() -> dict[Any, Any]:
    """Return matplotlib's settings for figures."""
    return TEXT | {"font.family": list(families())}


# Of a choice by lamp, and of a strategy that this version does not know, in results of another one
OTHER_STYLE = ("#555555", "X")


def style_of(sampling: str) -> tuple[str, str]:
    """Return the colour and the mark of a strategy; where lamps are not grouped, a pale colour."""
    strategy, grouping = split(sampling)
    entry = STRATEGIES.get(strategy)
    colour, mark = (entry.colour, entry.mark) if entry else OTHER_STYLE
    if strategy == BUILT_IN:
        colour, mark = BUILT_IN_STYLE
    return colour if grouping else _pale(colour), mark


def label_of(sampling: str) -> str:
    """Return what figures call a strategy."""
    strategy, grouping = split(sampling)
    entry = STRATEGIES.get(strategy)
    label = entry.label if entry else strategy.replace("_", " ")
    return label if grouping else f"{label}, ungrouped"


def _pale(colour: str) -> str:
    """Return a colour, "#rrggbb", half way to white."""
    parts = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return "#" + "".join(f"{(part + 255) // 2:02x}" for part in parts)


# ---- Words and numbers ----


def wrap_lines(title: str, inches: float) -> str:
    """Break the lines of a title that are wider than its column."""
    lines = [part for line in title.split("\n") for part in wrap(line, _characters(inches))]
    return "\n".join(lines)


def shorten(name: str, inches: float) -> str:
    """Return a name that is not wider than a place, with its end left out where it is."""
    longest = _characters(inches)
    return name if len(name) <= longest else name[: longest - 1] + "…"


def _characters(inches: float) -> int:
    return round(inches / 0.065)  # at the size of titles


def plain(value: float, _position: float | None = None) -> str:
    """Return a number in short, for the ticks of an axis."""
    return f"{value:g}"


def thousands(count: int) -> str:
    """Return a count, with thin spaces between thousands from 10 000 on."""
    return f"{count:,}".replace(",", "\u2009") if count >= 10_000 else str(count)


def scientific(value: float) -> str:
    """Return a number as mantissa and power of ten."""
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{mantissa}·{power_of_ten(int(exponent))}"


def power_of_ten(exponent: int) -> str:
    """Return it with raised digits; formulas of matplotlib would bring a font of their own."""
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def seconds(value: float) -> str:
    """Return a time in seconds or milliseconds."""
    return f"{value:.2f} s" if value >= 1 else f"{1000 * value:.0f} ms"
