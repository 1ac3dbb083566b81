"""Write a comparison as one HTML file that needs nothing else, not even a network."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from simpleimageio import flip

from ..files import atomic
from .figures import TEXT, Inset, choose_insets, curves, picture_grid, style_of
from .metrics import LABELS, METRICS, RELATIVE_EPSILON, TRIMMED_FRACTION, Estimate
from .results import EQUAL_SAMPLES, EQUAL_TIME, Comparison, Measurement

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1100px; margin: 2em auto;
       padding: 0 1em; }
h1 { font-size: 1.6em; } h2 { font-size: 1.25em; margin-top: 2.2em; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums;
        margin: 1em 0; }
th, td { padding: .25em .7em; text-align: right; white-space: nowrap; }
th { border-bottom: 1.5px solid #222; font-weight: 600; vertical-align: bottom; }
td:first-child, th:first-child { text-align: left; }
tr.group td { border-top: 1px solid #bbb; }
td.best { font-weight: 700; }
.scroll { overflow-x: auto; }
.warning { background: #fff2d8; border-left: 4px solid #e69f00; padding: .5em 1em; }
.curves { display: grid; grid-template-columns: repeat(auto-fill, minmax(480px, 1fr)); gap: 1em; }
.curves svg, img { width: 100%; height: auto; }
.note { color: #555; font-size: 13px; max-width: 60em; }
.mark { display: inline-block; width: .8em; height: .8em; margin-right: .4em; }
"""

HINT = """In a view of pictures, a click on a name, a digit or an arrow key switches; Ctrl and the
mouse wheel zoom, down to single pixels and their values; <kbd>e</kbd> and <kbd>Shift</kbd> +
<kbd>e</kbd> change the exposure; the button Help tells the rest."""


def write_report(comparison: Comparison, insets: Sequence[Inset] | None = None) -> Path:
    """
    Write ``report.html`` to a comparison's folder.

    It holds the pictures to flip through and to zoom into, the tables and the curves. `insets` are
    those of :func:`mi_ellipse.study.figures.write_figures`.
    """
    insets = choose_insets(comparison) if insets is None else list(insets)
    name = escape(comparison.scene_file.stem)
    sections = {
        **{
            f"Pictures at {spp} samples per pixel": _pictures(comparison, EQUAL_SAMPLES, spp)
            for spp in comparison.spp
        },
        f"Pictures in the time of {comparison.strategies[0]} at {comparison.spp[-1]}": _pictures(
            comparison, EQUAL_TIME, comparison.spp[-1]
        ),
        "Results at equal samples": _tables(comparison, EQUAL_SAMPLES) + _notes(comparison),
        "Results at equal time": "<p>Each strategy takes as many samples as should fit into the"
        " time of the first one.</p>" + _tables(comparison, EQUAL_TIME),
        "Time and error": _curves(comparison),
        "Differences from the reference": _differences(comparison, insets),
    }
    titles = [escape(title) for title, content in sections.items() if content]
    links = [f'<li><a href="#part{i}">{title}</a></li>' for i, title in enumerate(titles)]
    parts = [
        f"<h1>Sampling strategies in the scene “{name}”</h1>",
        _settings(comparison),
        *(f'<p class="warning">{escape(text)}</p>' for text in comparison.warnings()),
        f"<ul>{''.join(links)}</ul>",
        f'<p class="note">{HINT}</p>',
    ]
    contents = filter(None, sections.values())
    for i, (title, content) in enumerate(zip(titles, contents, strict=True)):
        parts.append(f'<h2 id="part{i}">{title}</h2>{content}')
    html = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{name}</title>\n'
        f"<style>{STYLE}</style>\n{flip.make_header()}\n</head><body>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )
    file = comparison.folder / "report.html"
    with atomic.replacement(file) as temporary:
        temporary.write_text(html, encoding="utf-8")
    return file


def _settings(comparison: Comparison) -> str:
    entries = {
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
    rows = [
        f'<tr><td>{name}</td><td style="text-align: left">{escape(value)}</td></tr>'
        for name, value in entries.items()
    ]
    return f"<table>{''.join(rows)}</table>"


# ---- Pictures ----


def _pictures(comparison: Comparison, kind: str, first_spp: int) -> str:
    """Return the pictures of one number of samples, to flip through."""
    images = [("reference", comparison.reference_image())]
    for sampling in comparison.strategies:
        measurement = comparison.find(kind, sampling, first_spp)
        images.append((f"{sampling}, {measurement.spp} spp", comparison.image(measurement)))
    return _flip_book(comparison, images)


def _flip_book(comparison: Comparison, images: list[tuple[str, np.ndarray]]) -> str:
    """Return the interactive view of some pictures, with the comparison's exposure."""
    # Values that light cannot have would be decoded as very bright ones.
    images = [(name, np.maximum(image, 0)) for name, image in images]
    html = flip.make_flip_book(images, html_width="100%", html_height=700)
    html = html.replace("width:100%px", "width:100%")
    # The function has no parameter for these two, and misspells the first.
    exposure = f'"initialTMO": {{"activeTMO": "exposure", "exposure": {comparison.exposure}}}'
    html, count = re.subn(r'"initialTMO": \{[^}]*\}', exposure, html)
    html, fits = re.subn(r'"initialZoom": 1\.0', '"initialZoom": -1', html)
    if (count, fits) != (1, 1):
        raise RuntimeError("this version of simpleimageio writes its settings in an unknown way")
    return html


def _differences(comparison: Comparison, insets: Sequence[Inset]) -> str:
    """Return the grids of pictures and their differences, folded up."""
    parts = []
    for spp in comparison.spp:
        buffer = io.BytesIO()
        with mpl.rc_context(TEXT):
            picture_grid(comparison, EQUAL_SAMPLES, spp, insets).savefig(
                buffer, dpi=250, format="png"
            )
        data = base64.b64encode(buffer.getvalue()).decode()
        parts.append(
            f"<details><summary>{spp} samples per pixel</summary>"
            f'<img alt="Pictures at {spp} spp and their differences from the reference"'
            f' src="data:image/png;base64,{data}"></details>'
        )
    return "".join(parts)


# ---- Numbers ----


def _tables(comparison: Comparison, kind: str) -> str:
    """Return a table of errors and one of costs."""
    own = [comparison.reference.errors.get(metric) for metric in METRICS]
    own = [_cell("" if value is None else f"{value:.3g}") for value in own]
    name, spp = _cell("the reference's own"), _cell(str(comparison.reference.spp))
    errors = _table(
        comparison,
        kind,
        [LABELS[metric].replace("trimmed ", "trimmed<br>") for metric in METRICS],
        _error_cells,
        f"<tr class=group>{name}{spp}{''.join(own)}</tr>",
    )
    header = ["efficiency", "trimmed<br>efficiency", "time (s)", "tracing (s)", "execution (s)"]
    costs = _table(comparison, kind, [*header, "compilation (s)"], _cost_cells)
    return errors + costs


def _table(
    comparison: Comparison,
    kind: str,
    header: Sequence[str],
    cells: Callable[[Measurement, Sequence[Measurement]], list[str]],
    last_row: str = "",
) -> str:
    """Return a table with a row for each strategy, grouped by the number of samples."""
    rows = []
    for spp in comparison.spp:
        group = [comparison.find(kind, sampling, spp) for sampling in comparison.strategies]
        for one in group:
            mark = f'<span class=mark style="background: {style_of(one.sampling)[0]}"></span>'
            row = [_cell(mark + escape(one.sampling)), _cell(str(one.spp)), *cells(one, group)]
            start = "<tr class=group>" if one is group[0] else "<tr>"
            rows.append(f"{start}{''.join(row)}</tr>")
    head = "".join(f"<th>{cell}</th>" for cell in ["strategy", "spp", *header])
    return f"<div class=scroll><table><tr>{head}</tr>{''.join(rows)}{last_row}</table></div>"


def _error_cells(one: Measurement, group: Sequence[Measurement]) -> list[str]:
    best = {metric: min(other.errors[metric].mean for other in group) for metric in METRICS}
    return [
        _cell(_with_error(one.errors[metric]), one.errors[metric].mean == best[metric])
        for metric in METRICS
    ]


def _cost_cells(one: Measurement, group: Sequence[Measurement]) -> list[str]:
    cells = []
    for metric, value in one.efficiency.items():
        best = max(other.efficiency[metric] for other in group)
        cells.append(_cell(f"{value:.2f}", value == best))
    seconds = (
        one.seconds,
        one.tracing_seconds,
        one.execution_seconds,
        one.compilation_seconds,
    )
    return cells + [_cell(f"{value:.3f}") for value in seconds]


def _cell(text: str, best: bool = False) -> str:
    return f"<td{' class=best' if best else ''}>{text}</td>"


def _with_error(error: Estimate) -> str:
    if np.isnan(error.standard_error):
        return f"{error.mean:.3g}"
    return f"{error.mean:.3g} ± {error.standard_error:.1g}"


def _notes(comparison: Comparison) -> str:
    first = escape(comparison.strategies[0])
    return f"""<p class="note">Errors are means over {comparison.seeds} seeds ± their standard
error; bold is the best of its group. Relative MSE: the mean of (image − reference)² / (reference² +
ε), ε being {RELATIVE_EPSILON} times the squared mean of the reference. Trimmed: without the worst
{TRIMMED_FRACTION:.1%} of values. HDR-FLIP: perceptual, 0 (equal) to 1, at 67 pixels per degree. The
errors hold that of the reference, which is estimated from its two independent halves and not
subtracted; HDR-FLIP between these halves is {comparison.reference.flip_between_halves:.3g}. Time:
of a render after a warm-up, median over the seeds; it is tracing plus execution. Compilation: of
the longest warm-up, and 0 where the compiled kernel lay in Dr.Jit's cache. Efficiency: 1 / (error ·
time), relative to {first}, for the MSE and the trimmed MSE.</p>"""


def _curves(comparison: Comparison) -> str:
    figures = curves(comparison)
    if not figures:
        return ""
    drawings = "".join(_svg(name, figure) for name, figure in figures.items())
    return f'<div class="curves">{drawings}</div>'


def _svg(name: str, figure: Figure) -> str:
    """Return a figure as an element of an HTML page."""
    buffer = io.StringIO()
    # Each with its own salt: names of clip paths must differ within a page.
    with mpl.rc_context(TEXT | {"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
