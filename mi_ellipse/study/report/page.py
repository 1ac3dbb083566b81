"""Fill the template of the report: pictures to flip through, tables, figures."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from simpleimageio import flip

from ...files import atomic
from ..drawing import Figures, Inset, style_of, write_figures
from ..metrics import METRICS
from ..results import (
    EQUAL_SAMPLES,
    EQUAL_TIME,
    TOLERATED_TIME,
    Comparison,
    Measurement,
)
from ..statistics import CONFIDENCE, Efficiency, Estimate, Spread, is_best


def write_report(
    comparison: Comparison,
    insets: Sequence[Inset] | None = None,
    figures: Figures | None = None,
) -> Path:
    """
    Write ``report.html`` to a comparison's folder.

    It holds the pictures to flip through and to zoom into, the tables and the figures.

    Parameters
    ----------
    comparison
        What to report.
    insets
        Those of :func:`mi_ellipse.study.drawing.write_figures`, for figures that are drawn here.
    figures
        What :func:`mi_ellipse.study.drawing.write_figures` returned; they are drawn if missing.

    Raises
    ------
    ValueError
        For insets that are not possible.
    """
    figures = figures or write_figures(comparison, insets)
    environment = Environment(
        loader=PackageLoader(__package__, ""),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    page = environment.get_template("template.html").render(
        name=comparison.scene_file.stem,
        flip_header=Markup(flip.make_header()),
        settings=_settings(comparison),
        warnings=comparison.warnings(),
        books=_books(comparison),
        equal_samples=_table(comparison, EQUAL_SAMPLES),
        equal_time=_table(comparison, EQUAL_TIME),
        comparison=comparison,
        metrics=METRICS,
        confidence=f"{CONFIDENCE:.0%}".replace("%", " %"),
        tolerated=f"{100 * TOLERATED_TIME:.0f} %",
        curves=[_svg(file) for file in figures.curves.values()],
        grids={spp: _base64(figures.grids[EQUAL_SAMPLES, spp]) for spp in comparison.spp},
    )
    file = comparison.folder / "report.html"
    atomic.write_text(file, page)
    return file


def _settings(comparison: Comparison) -> dict[str, str]:
    return {
        "Scene": comparison.scene_file.name,
        "Parameters": ", ".join(f"{k}={v}" for k, v in comparison.parameters.items()) or "none",
        "Seeds": str(comparison.seeds),
        "Reference": f"{comparison.reference.spp} samples per pixel, with the scene's own strategy",
        "Variant": comparison.settings["variant"],
        "Versions": ", ".join(
            f"{name} {comparison.settings[f'{name}_version']}"
            for name in ("mi_ellipse", "mitsuba", "drjit")
        ),
        "Machine": comparison.machine,
    }


# ---- Pictures ----


def _books(comparison: Comparison) -> dict[str, Markup]:
    """Return the pictures to flip through, by their headings."""
    books = {
        f"Pictures at {spp} samples per pixel": _book(comparison, EQUAL_SAMPLES, spp)
        for spp in comparison.spp
    }
    first, most = comparison.strategies[0], comparison.spp[-1]
    books[f"Pictures in the time of {first} at {most}"] = _book(comparison, EQUAL_TIME, most)
    return books


def _book(comparison: Comparison, kind: str, first_spp: int) -> Markup:
    """Return the interactive view of the pictures of one number of samples."""
    pictures = [("reference", comparison.reference_image())]
    for sampling in comparison.strategies:
        measurement = comparison.find(kind, sampling, first_spp)
        pictures.append((f"{sampling}, {measurement.spp} spp", comparison.image(measurement)))
    # Values that light cannot have would be decoded as very bright ones.
    pictures = [(name, np.maximum(image, 0)) for name, image in pictures]
    html = flip.make_flip_book(pictures, html_width="100%", html_height=700)
    html = html.replace("width:100%px", "width:100%")
    # The function has no parameter for these two, and misspells the first.
    exposure = f'"initialTMO": {{"activeTMO": "exposure", "exposure": {comparison.exposure}}}'
    html, count = re.subn(r'"initialTMO": \{[^}]*\}', exposure, html)
    html, fits = re.subn(r'"initialZoom": 1\.0', '"initialZoom": -1', html)
    if (count, fits) != (1, 1):
        raise RuntimeError("this version of simpleimageio writes its settings in an unknown way")
    return Markup(html)


# ---- Figures ----


def _svg(file: Path) -> Markup:
    """Return a figure as an element of an HTML page."""
    text = file.read_text(encoding="utf-8")
    return Markup(text[text.index("<svg") :])


def _base64(file: Path) -> str:
    return base64.b64encode(file.read_bytes()).decode()


# ---- Numbers ----


@dataclass(frozen=True)
class _Cell:
    text: str  # a spread stands in a line of its own: so the tables fit a small window
    best: bool = False  # as far as the intervals tell


@dataclass(frozen=True)
class _Row:
    """What the tables say of one strategy at one number of samples."""

    sampling: Markup  # which may be broken within the name
    colour: str
    spp: int
    errors: list[_Cell]
    costs: list[_Cell]


def _table(comparison: Comparison, kind: str) -> list[list[_Row]]:
    """Return a row for each strategy, grouped by the number of samples."""
    table = []
    for spp in comparison.spp:
        group = [comparison.find(kind, sampling, spp) for sampling in comparison.strategies]
        errors = _columns([_error_cells(group, name, comparison.seeds) for name in METRICS])
        costs = _columns([_efficiency_cells(group, name) for name in group[0].efficiency])
        table.append(
            [
                _Row(
                    _breakable(one.sampling),
                    style_of(one.sampling)[0],
                    one.spp,
                    own,
                    cost + _times(one),
                )
                for one, own, cost in zip(group, errors, costs, strict=True)
            ]
        )
    return table


def _breakable(name: str) -> Markup:
    """Return a name that a browser may break after each of its parts."""
    return Markup(re.sub("([_+=])", r"\1<wbr>", str(escape(name))))


def _columns(columns: list[list[_Cell]]) -> list[list[_Cell]]:
    """Return columns as rows."""
    return [list(row) for row in zip(*columns, strict=True)]


def _error_cells(group: Sequence[Measurement], metric: str, seeds: int) -> list[_Cell]:
    """
    Return a column of the table of errors; the best one is the smallest.

    None is best at equal time where a strategy took another time.
    """
    ends = [one.errors[metric].interval(seeds) for one in group]
    comparable = not any(one.is_off for one in group if one.kind == EQUAL_TIME)
    best = [comparable and one for one in _best([(-high, -low) for low, high in ends])]
    texts = [_with_error(one.errors[metric]) for one in group]
    return [_Cell(*cell) for cell in zip(texts, best, strict=True)]


def _efficiency_cells(group: Sequence[Measurement], metric: str) -> list[_Cell]:
    """
    Return a column of the table of costs; the best one is the largest.

    None is best where the first strategy did not take as long as itself.
    """
    found = [one.efficiency[metric] for one in group]
    steady = not group[0].is_off
    best = [steady and one for one in _best([(one.low, one.high) for one in found])]
    texts = [_with_interval(one) for one in found]
    return [_Cell(*cell) for cell in zip(texts, best, strict=True)]


def _best(intervals: list[tuple[float, float]]) -> list[bool]:
    """Tell for each interval whether it lies wholly above the others."""
    return [
        is_best(one, intervals[:place] + intervals[place + 1 :])
        for place, one in enumerate(intervals)
    ]


def _times(one: Measurement) -> list[_Cell]:
    spreads = [_with_spread(one.ratio, 2), _with_spread(one.seconds, 3)]
    seconds = (one.tracing_seconds, one.execution_seconds, one.compilation_seconds)
    return [_Cell(text) for text in [*spreads, *(f"{value:.3f}" for value in seconds)]]


def _with_spread(one: Spread, digits: int) -> str:
    if one.low == one.high:
        return f"{one.median:.{digits}f}"
    return f"{one.median:.{digits}f}\n[{one.low:.{digits}f}, {one.high:.{digits}f}]"


def _with_error(error: Estimate) -> str:
    if np.isnan(error.standard_error):
        return f"{error.mean:.3g}"
    return f"{error.mean:.3g}\n± {error.standard_error:.1g}"


def _with_interval(one: Efficiency) -> str:
    if np.isnan(one.low) or one.low == one.high:
        return f"{one.value:.2f}"
    return f"{one.value:.2f}\n[{_end(one.low)}, {_end(one.high)}]"


def _end(value: float) -> str:
    """Return an end of an interval; those of few seeds can be very far apart."""
    return f"{value:.2f}" if 0.005 <= value < 1000 else f"{value:.0e}"
