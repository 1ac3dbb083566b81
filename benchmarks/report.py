"""The page `docs/benchmarks.md`, written from the figures in `docs/data`."""

from __future__ import annotations

import json
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"

HEAD = """# What it costs and what it buys

Every figure is a ratio against Mitsuba's own `disk` + `area`, measured in one run in interleaved
pairs: absolute times drift on a shared machine, ratios hold. This page is written by
`python -m benchmarks` from `docs/data`; one part of it is made again with
`python -m benchmarks NAME`, the name being in brackets behind each heading.
"""


def write() -> None:
    """Write the page from whatever has been measured."""
    parts = [HEAD]
    for name, section in SECTIONS.items():
        path = DOCS / "data" / f"{name}.json"
        if path.exists():
            data = json.loads(path.read_text(encoding="utf-8"))
            parts.append(section(data[name]) + f"\nMachine: {data['machine']}.\n")
    (DOCS / "benchmarks.md").write_text("\n".join(parts), encoding="utf-8")


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _render_time(results: dict) -> str:
    rows = [
        [scene, kind, f"{ratio['median']:.3f}", f"{ratio['low']:.3f}–{ratio['high']:.3f}"]
        for scene, entry in results.items()
        for kind, ratio in entry["ratios"].items()
    ]
    return (
        "## Time of a render [render_time]\n\n"
        "Median ratio of the time of a whole render, with its 95 % interval. `disk + area` against"
        " itself is the control.\n\n" + table(["scene", "lamp", "ratio", "95 %"], rows)
    )


def _error(results: dict) -> str:
    rows = [
        [
            height,
            label,
            kind,
            f"{values['plain']:.3g}",
            f"{values['trimmed']:.3g}",
            *(str(values.get(key, "")) for key in ("time", "gain_trimmed", "gain_above_floor")),
        ]
        for height, entry in results["heights"].items()
        for label in ("light samples", "MIS")
        for kind, values in entry[label].items()
    ]
    floors = ", ".join(f"{e['floor']:.2g} at {h}" for h, e in results["heights"].items())
    return (
        "## Error times time near a lamp [error]\n\n"
        "A lamp with semi-axes 1.5 and 0.4, tilted by 30° about the longer, at two heights above a"
        f" floor; {results['spp']} samples per pixel, `independent`. *Trimmed* leaves out the worst"
        " 0.1 % of the values: area sampling has no finite variance near the lamp. *Gain* is how"
        " many times lower trimmed error × time is; *above the floor*, after subtracting the part"
        f" that no sampling of the lamp removes ({floors}).\n\n"
        + table(
            ["height", "samples", "lamp", "MSE", "trimmed", "time", "gain", "above the floor"],
            rows,
        )
    )


def _lamps(results: dict) -> str:
    rows = [
        [
            count,
            kind,
            str(row["operations"]),
            str(row["callables"]),
            f"{row['tracing_ms'] / int(count):.2f}",
            f"{row['execution_ms'] / results['disk + area'][count]['execution_ms']:.2f}",
        ]
        for kind, counts in results.items()
        for count, row in counts.items()
    ]
    return (
        "## Many lamps [lamps]\n\n"
        "Operations and callables of the kernel, milliseconds to trace a lamp in every `mi.render`"
        " (`dr.freeze` traces once), and the execution of the kernel against `disk + area`.\n\n"
        + table(
            ["lamps", "kind", "operations", "callables", "tracing, ms a lamp", "execution"], rows
        )
    )


def _first_frame(results: dict) -> str:
    kinds = {kind: row for kind, row in results.items() if isinstance(row, dict)}
    steps = list(next(iter(kinds.values())))
    rows = [[kind, *(f"{row[step]:.3f}" for step in steps)] for kind, row in kinds.items()]
    seconds = next(value for value in results.values() if not isinstance(value, dict))
    return (
        "## The first frame [first_frame]\n\n"
        "Seconds of each step in a new process without cached kernels, 64² at 1 sample per pixel."
        f" `import mi_ellipse` adds {seconds:.2f} s to `import mitsuba`.\n\n"
        + table(["lamp", *steps], rows)
    )


SECTIONS = {
    "render_time": _render_time,
    "error": _error,
    "lamps": _lamps,
    "first_frame": _first_frame,
}
