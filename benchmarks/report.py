"""The page `docs/benchmarks.md` and its plot, from the figures in `docs/data`."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib.pyplot as plt
from mi_ellipse.sampling import STRATEGIES

from .lamps import SPP as LAMPS_SPP
from .render_time import SCENES
from .scenes import BUILT_IN, MESH

COLOURS = {name: entry.colour for name, entry in STRATEGIES.items()}

DOCS = Path(__file__).parent.parent / "docs"

# Measured once: 100 lamps, three processes each in turns, the shortest of 36 renders.
FIRST_TRACING = (
    "The first version of this benchmark (commit 15e61bc) had 1.95 ms a lamp, of 100 lamps, with"
    " `solid_angle` and 5.33 with `projected_solid_angle`. Its code and today's, in turns on one"
    " machine: 1.66 and 1.13 ms, 6.06 and 2.15 ms, with built-in at 0.21 beside either."
)

HEAD = """# What it costs and what it buys

Times are ratios against Mitsuba's own `disk` + `area`, measured in one run, side by side: absolute
times drift on a shared machine, ratios hold. *[low, high]* is the 95 % interval of the median over
40 pairs. What is given in seconds or MiB has built-in beside it. The control is built-in against
itself in a process of its own, `disk + area again` or, in [render_time], [error] and [growth],
`disk + area`; by how much it misses 1 is what luck with a process and its neighbours is worth,
beyond the intervals.

`python -m benchmarks` measures all of this page and the accuracy of the strategies anew (an hour
and a half on two cores, with `pip install '.[test]'`) and writes `docs/data` and this page;
`python -m benchmarks NAME` one part, the name being in brackets behind each heading. What
`accuracy` measures is on the page [strategies](strategies.md).

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


def table(head: str, rows: list[list[str]]) -> str:
    """A Markdown table; the names of its columns are separated by ``|``."""
    columns = head.split(" | ")
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _ratio(ratio: dict) -> str:
    return "{median:.3f} [{low:.3f}, {high:.3f}]".format(**ratio)


def _number(value: float) -> str:
    """Three significant digits, or a whole number from 1000 on."""
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def _calls(results: dict) -> str:
    draws, densities = results["sample_direction"], results["pdf_direction"]
    rows = [
        [kind]
        + [f"{of[kind]['nanoseconds']:.2f}" for of in (draws, densities)]
        + [
            f"{of[kind]['nanoseconds'] / draws['area']['nanoseconds']:.2f}"
            for of in (draws, densities)
        ]
        + [_ratio(of[kind]["ratio"]) for of in (draws, densities)]
        for kind in draws
    ]
    return (
        "## A draw and a density alone [calls]\n\n"
        "Kernels that do nothing but call `sample_direction` or `pdf_direction` of an emitter, from"
        " points on and above the floor under a lamp: nanoseconds a call on both cores together,"
        " less those of the same kernel without the call; the same in units of a draw by `area`;"
        " and against built-in, whose density is next to nothing.\n\n"
        + table(
            "lamp | draw, ns | density, ns | draw, of `area` | density, of a draw by `area`"
            " | draw, of built-in | density, of built-in",
            rows,
        )
    )


def _render_time(results: dict) -> str:
    rows = [
        [scene, kind, _ratio(ratio)]
        for scene, entry in results.items()
        for kind, ratio in entry["ratios"].items()
    ]
    counts = ", ".join(
        f"{name} {spp} at {'320²' if size is None else '{}×{}'.format(*size)}"
        for name, (spp, size) in SCENES.items()
    )
    return (
        "## Time of a render [render_time]\n\n"
        "Time of a whole render, tracing included. Each scene is in a process of its own, as"
        " Dr.Jit compiles the lights of all living scenes of a process into every render; a"
        f" quarter of the pairs each is from new processes. Samples per pixel: {counts}.\n\n"
        + table("scene | lamp | time", rows)
    )


def _error(results: dict) -> str:
    rows = []
    for height, entry in results["heights"].items():
        exact = entry["exact"]
        for label in ("light samples", "MIS"):
            base = entry[label][BUILT_IN]
            for kind, values in entry[label].items():
                gains = [values[f"gain_{key}"] for key in ("plain", "trimmed", "above_floor")]
                rows.append(
                    [height, label, kind, *_error_cells(values), _ratio(values["time"])]
                    + ([""] * 3 if kind == BUILT_IN else [_number(gain) for gain in gains])
                )
            if label == "light samples":
                bound = [base[key] / exact[key] for key in ("plain", "trimmed")]
                rows.append(
                    [height, label, "*exact sampler*", *_error_cells(exact), "(1)"]
                    + [_number(value) for value in bound]
                    + [""]
                )
    floors = " and ".join(f"{e['floor']:.2g} at {h}" for h, e in results["heights"].items())
    return (
        "## Error times time near a lamp [error]\n\n"
        "A lamp with semi-axes 1.5 and 0.4, tilted by 30° about the longer, its centre at two"
        f" heights above a floor with a ball; {results['size']}² pixels, {results['spp']} samples"
        " each, `independent`. *MSE* is the mean squared error, *trimmed* without the worst 0.1 %"
        " of the values and with its standard error: area sampling has no finite variance near the"
        " lamp, and its plain mean is a lottery. *Gain* is how many times lower error × time is"
        " than built-in's, from plain errors, from trimmed ones, and from trimmed ones above the"
        f" part that no sampling of the lamp removes, that of the pixel's area ({floors}; an"
        " estimate, as trimmed errors do not quite add up).\n\n"
        "The *exact sampler* takes light samples in proportion to radiance times cosine (one of 32"
        " draws by its weight, with the light in closed form), as if at the time of built-in: what"
        " remains of its error is due to the pixel's area and the shadows.\n\n"
        + table(
            "height | samples | lamp | MSE | trimmed | time | gain: plain | trimmed"
            " | above the floor",
            rows,
        )
    )


def _error_cells(values: dict) -> list[str]:
    error = values["standard_error"] / values["trimmed"]
    return [f"{values['plain']:.3g}", f"{values['trimmed']:.3g} ± {100 * error:.1f} %"]


def _choice(results: dict) -> str:
    kinds = list(next(iter(results.values())))
    rows, worst = [], dict.fromkeys(kinds, 1.0)
    for scene, entry in results.items():
        gains = {kind: entry[kind]["gain"]["trimmed"] for kind in kinds}
        best = max(gains.values())
        share = {kind: gains[kind] / best for kind in kinds}
        worst = {kind: min(worst[kind], share[kind]) for kind in kinds}
        rows.append([scene] + [f"{_number(gains[kind])} ({share[kind]:.2f})" for kind in kinds])
    rows.append(["*worst*"] + [f"({worst[kind]:.2f})" for kind in kinds])
    return (
        "## Which strategy when [choice]\n\n"
        "How many times lower trimmed error × time is than with `disk + area`, in the integrator"
        " of each scene (`path` or `volpath`, with MIS), and in brackets the share of the best of"
        " the three.\n\n" + table(" | ".join(["scene", *kinds]), rows)
    )


def _lamps(results: dict) -> str:
    rows = [
        [
            count,
            kind,
            f"{row['operations']:.0f}",
            f"{row['callables']:.0f}",
            f"{row['load_s']:.2f}",
            f"{row['first_frame_s']:.2f}",
            f"{row['tracing_ms'] / int(count):.2f}",
            f"{row['tracing_ratio']:.1f}",
            f"{row['execution_ratio']:.2f}",
            f"{row['peak_mib']:.0f}",
        ]
        for kind, counts in results.items()
        for count, row in counts.items()
    ]
    return (
        "## Many lamps [lamps]\n\n"
        "Operations and callables of the kernel, seconds to load the scene and until its first"
        " frame, milliseconds to trace a render by the number of lamps (every `mi.render` traces;"
        " `dr.freeze`, and `mi-ellipse render` in several passes, do so once), tracing and the"
        f" execution of the kernel against `disk + area` at {LAMPS_SPP} samples per pixel, and the"
        " memory of the process. Medians of five processes; milliseconds double with a busy"
        " neighbour.\n\n"
        + FIRST_TRACING
        + "\n\n"
        + table(
            "lamps | kind | operations | callables | load, s | first frame, s"
            " | tracing, ms a lamp | tracing | execution | peak MiB",
            rows,
        )
    )


def _first_frame(results: dict) -> str:
    steps = ("load", "trace", "compile", "run")
    rows = [
        [
            kind,
            *(f"{row[step]:.3f} ({100 * row[step] / row['first frame']:.0f} %)" for step in steps),
            f"{row['first frame']:.3f}",
            *(_ratio(row["ratios"][step]) for step in ("compile", "first frame")),
            f"{row['peak MiB']:.0f}",
        ]
        for kind, row in results["kinds"].items()
    ]
    imports = results["imports"]
    return (
        "## The first frame [first_frame]\n\n"
        "Seconds of each step, and its share, in a new process without cached kernels, 64² at 1"
        f" sample per pixel. `import mitsuba` takes {imports['mitsuba']:.2f} s before that, and"
        f" `import mi_ellipse` {imports['mi_ellipse']:.2f} s more. Loading is longer with the first"
        " lamp of a process as the plugins are defined then.\n\n"
        + table(
            "lamp | load, s | trace, s | compile, s | run, s | in all, s | compile, of built-in"
            " | in all, of built-in | peak MiB",
            rows,
        )
    )


def _growth(results: dict) -> str:
    kinds = list(next(iter(results.values()))["ratios"])
    rows = [
        [case, f"{entry['seconds']:.4f}"]
        + [_ratio(entry["ratios"][kind]) for kind in kinds]
        + [" / ".join(f"{entry['peak_mib'][kind]:.0f}" for kind in kinds)]
        for case, entry in results.items()
    ]
    return (
        "## Image size and sample count [growth]\n\n"
        "The bare floor and ball: seconds of a render with `disk + area`, tracing included, the"
        " ratio of the others to it, and the memory of each process. What is the same for every"
        " size is the tracing of a render in Python, which `dr.freeze` does once.\n\n"
        + table(" | ".join(["image", "disk + area, s", *kinds, "peak MiB"]), rows)
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


def _ellipsoids(results: dict) -> str:
    rows = [
        [
            f"{shape} at {height}",
            ways,
            kind,
            _number(row["trimmed"] * 1e6),
            _number(row["error_ratio"]),
            _ratio(row["time"]),
        ]
        for shape, heights in results["shapes"].items()
        for height, entry in heights.items()
        for ways, kinds in entry.items()
        for kind, row in kinds.items()
    ]
    return (
        "## Sphere and ellipsoid lamps [ellipsoids]\n\n"
        f"A floor under a sphere of radius 0.3, or an ellipsoid with the semi-axes 1.2, 0.3 and "
        f"0.15, seen beside the lamp; {results['spp']} spp. Built-in is `sphere` + `area`, uniform "
        "in solid angle, or a mesh of 20 480 triangles + `area`. Trimmed squared error in "
        "millionths, how many times lower it is than built-in's, and time over built-in's.\n\n"
        + table("lamp | samples | kind | error | times lower | time", rows)
    )


SECTIONS = {
    "calls": _calls,
    "render_time": _render_time,
    "error": _error,
    "choice": _choice,
    "lamps": _lamps,
    "first_frame": _first_frame,
    "growth": _growth,
    "ellipsoids": _ellipsoids,
}
