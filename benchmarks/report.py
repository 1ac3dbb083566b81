"""The page `docs/benchmarks.md` and its plot, from the figures in `docs/data`."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib.pyplot as plt

from .accuracy import COLOURS
from .lamps import SPP as LAMPS_SPP
from .scenes import MESH

DOCS = Path(__file__).parent.parent / "docs"

HEAD = """# What it costs and what it buys

Every figure is a ratio against Mitsuba's own `disk` + `area`, measured in one run in interleaved
pairs: absolute times drift on a shared machine, ratios hold. This page is written by
`python -m benchmarks` from `docs/data`; one part of it is made again with
`python -m benchmarks NAME`, the name being in brackets behind each heading.

![Time of a render on every scene, and what it buys near a lamp](images/benchmarks.png)
"""


def write() -> None:
    """Write the page from whatever has been measured."""
    parts, measured = [HEAD], {}
    for name, section in SECTIONS.items():
        path = DOCS / "data" / f"{name}.json"
        if path.exists():
            data = json.loads(path.read_text(encoding="utf-8"))
            measured[name] = data[name]
            parts.append(section(data[name]) + f"\nMachine: {data['machine']}.\n")
    if {"render_time", "error"} <= measured.keys():
        _plot(measured["render_time"], measured["error"])
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
        " itself is the control. Each scene is in a process of its own, as Dr.Jit compiles the"
        " lights of all living scenes of a process into every render.\n\n"
        + table(["scene", "lamp", "ratio", "95 %"], rows)
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
            f"{row['execution_ratio']:.2f}",
        ]
        for kind, counts in results.items()
        for count, row in counts.items()
    ]
    return (
        "## Many lamps [lamps]\n\n"
        "Operations and callables of the kernel, milliseconds to trace a lamp in every `mi.render`"
        " (`dr.freeze` traces once), and the execution of the kernel against `disk + area`, at"
        f" {LAMPS_SPP} samples per pixel.\n\n"
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


def _growth(results: dict) -> str:
    kinds = list(next(iter(results.values()))["ratios"])
    rows = [
        [case, f"{entry['seconds']:.4f}"]
        + ["{median:.3f} ({low:.3f}–{high:.3f})".format(**entry["ratios"][kind]) for kind in kinds]
        for case, entry in results.items()
    ]
    return (
        "## Image size and sample count [growth]\n\n"
        "The bare floor and ball: seconds of a render with `disk + area`, tracing included, and"
        " the ratio of the others to it. What is the same for every size is the tracing of a"
        " render in Python, which `dr.freeze` does once.\n\n"
        + table(["image", "disk + area, s", *kinds], rows)
    )


def _plot(render_time: dict, error: dict) -> None:
    figure, (times, gains) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    kinds = ["area", "solid_angle", "projected_solid_angle", MESH]
    for k, kind in enumerate(kinds):
        found = [
            (scene + 0.15 * (k - 1.5), entry["ratios"][kind])
            for scene, entry in enumerate(render_time.values())
            if kind in entry["ratios"]
        ]
        median = [ratio["median"] for _, ratio in found]
        below = [ratio["median"] - ratio["low"] for _, ratio in found]
        above = [ratio["high"] - ratio["median"] for _, ratio in found]
        places = [place for place, _ in found]
        style = {"color": COLOURS.get(kind, "black"), "label": kind}
        times.errorbar(places, median, (below, above), fmt="o", ms=4, capsize=2, **style)
    times.axhline(1, color="grey", lw=0.8)
    times.set_xticks(range(len(render_time)), list(render_time), rotation=20, ha="right")
    times.set_ylabel("time of a render over disk + area")
    times.legend(frameon=False, fontsize=8)

    kinds = ["area", "rejection", "solid_angle", "projected_solid_angle"]
    cases = [(h, label) for h in error["heights"] for label in ("light samples", "MIS")]
    for k, kind in enumerate(kinds):
        places = [case + 0.15 * (k - 1.5) for case in range(len(cases))]
        values = [error["heights"][h][label][kind]["gain_trimmed"] for h, label in cases]
        gains.plot(places, values, "o", ms=5, color=COLOURS[kind], label=kind)
    gains.axhline(1, color="grey", lw=0.8)
    gains.set_yscale("log")
    gains.set_xticks(range(len(cases)), [f"{label}\nlamp at {h}" for h, label in cases])
    gains.set_ylabel("disk + area's trimmed error × time over it")
    gains.legend(frameon=False, fontsize=8)

    for suffix in ("png", "svg"):
        figure.savefig(DOCS / "images" / f"benchmarks.{suffix}", dpi=150)
    plt.close(figure)


SECTIONS = {
    "render_time": _render_time,
    "error": _error,
    "lamps": _lamps,
    "first_frame": _first_frame,
    "growth": _growth,
}
