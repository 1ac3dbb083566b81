"""Writes the page `docs/benchmarks.md` and its plot from the figures in `docs/data`."""

from __future__ import annotations

import json
from pathlib import Path

import matplotlib.pyplot as plt
from mi_ellipse.sampling import STRATEGIES

from .lamps import SPP as LAMPS_SPP
from .limits import FIRST_TRACING as FIRST
from .render_time import SCENES
from .scenes import BUILT_IN, MESH
from .text import table

COLOURS = {name: entry.colour for name, entry in STRATEGIES.items()}

DOCS = Path(__file__).parent.parent / "docs"

# Measured once: 100 lamps, three processes each in turns, the shortest of 36 renders.
FIRST_TRACING = (
    "The first version of this benchmark (commit 15e61bc) had 1.95 ms a lamp with `solid_angle` and"
    " 5.33 ms with `projected_solid_angle`, of 100 lamps. Its code and the code of today, in turns"
    " on one machine:\n\n"
    "| tracing, ms a lamp | first version | today |\n| --- | --- | --- |\n"
    f"| solid_angle | {FIRST['solid_angle']} | 1.13 |\n"
    f"| projected_solid_angle | {FIRST['projected_solid_angle']} | 2.15 |\n"
    f"| disk + area | {FIRST[BUILT_IN]} | 0.21 |"
)

HEAD = """# What it costs and what it buys

Times are ratios against Mitsuba's own `disk` + `area`, called *built-in* here. Both were measured
in one run, side by side: absolute times drift on a shared machine, ratios hold. Where a value is in
seconds or MiB, the value of built-in stands beside it.

*[low, high]* is the 95 % interval of the median over pairs of renders side by side. Each part names
its machine and the number of pairs.

The control is built-in against itself in a process of its own. It is called `disk + area again`, or
`disk + area` in [render_time], [error] and [growth]. The control misses 1 by some amount. This
amount is what luck with a process and its neighbours is worth, beyond the intervals.

`python -m benchmarks` measures this page and the accuracy of the strategies anew. It writes
`docs/data` and this page, and takes some three hours on two cores with `--pairs 12`.
`python -m benchmarks NAME` measures one part: the name is in brackets behind each heading. Both
need `pip install '.[test]'`. The page [strategies](strategies.md) shows what `accuracy` measures.
The page [limits](limits.md) says which limits these figures keep.

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
            pairs = f"; {data['pairs']} pairs" if "pairs" in data else ""
            parts.append(section(data[name]) + f"\nMachine: {data['machine']}{pairs}.\n")
    if {"render_time", "error"} <= measured.keys():
        _plot(measured["render_time"], measured["error"])
    (DOCS / "benchmarks.md").write_text("\n".join(parts), encoding="utf-8")


def _ratio(ratio: dict) -> str:
    return "{median:.3f} [{low:.3f}, {high:.3f}]".format(**ratio)


def _number(value: float) -> str:
    """Three significant digits, or a whole number from 1000 on."""
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def _calls(results: dict) -> str:
    draws, densities = results["sample_direction"], results["pdf_direction"]
    rows = [
        [kind]
        + [f"{max(of[kind]['nanoseconds'], 0):.2f}" for of in (draws, densities)]
        + [
            f"{max(of[kind]['nanoseconds'], 0) / draws['area']['nanoseconds']:.2f}"
            for of in (draws, densities)
        ]
        + [_ratio(draws[kind]["ratio"])]
        for kind in draws
    ]
    return (
        "## A draw and a density alone [calls]\n\n"
        "The kernels do nothing but call `sample_direction` or `pdf_direction` of an emitter, from"
        " points on and above the floor under a lamp. The columns give:\n\n"
        "* nanoseconds a call, on both cores together, less those of the same kernel without the"
        " call;\n"
        "* the same in units of a draw by `area`;\n"
        "* the ratio of a draw to one of built-in. The density of built-in costs so little that it"
        " can come out as 0, so it is no unit.\n\n"
        + table(
            "lamp | draw, ns | density, ns | draw, of `area` | density, of a draw by `area`"
            " | draw, of built-in",
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
        "The table gives the time of a whole render, tracing included. Each scene is in a process"
        " of its own, because Dr.Jit compiles the lights of all living scenes of a process into"
        " every render. A quarter of the pairs each is from new processes.\n\n"
        f"Samples per pixel: {counts}.\n\n" + table("scene | lamp | time", rows)
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
        "A lamp hangs above a floor with a ball, its centre at two heights. Its semi-axes are 1.5"
        " and 0.4, and it is tilted by 30° about the longer one. The pictures have"
        f" {results['size']}² pixels with {results['spp']} samples each, `independent`.\n\n"
        "* *MSE* is the mean squared error.\n"
        "* *Trimmed* is the MSE without the worst 0.1 % of the values, with its standard error."
        " Area sampling has no finite variance near the lamp, so its plain mean is a lottery.\n"
        "* *Gain* is how many times lower error × time is than that of built-in: from plain errors,"
        " from trimmed errors, and from trimmed errors above the floor.\n"
        "* *Above the floor* leaves out the part that no sampling of the lamp removes, that of the"
        f" pixel's area: {floors}. It is an estimate, because trimmed errors do not quite add up.\n"
        "* The *exact sampler* takes light samples in proportion to radiance times cosine. It"
        " chooses one of 32 draws by its weight, with the light in closed form. It counts as if it"
        " took the time of built-in. What remains of its error comes from the pixel's area and the"
        " shadows.\n\n"
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
        "The table tells how many times lower trimmed error × time is than with `disk + area`, in"
        " the integrator of each scene (`path` or `volpath`, with MIS). The share of the best of"
        " the three is in brackets.\n\n" + table(" | ".join(["scene", *kinds]), rows)
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
        "* *Operations* and *callables* are those of the kernel.\n"
        "* *Load* and *first frame* are the seconds to load the scene and until its first frame.\n"
        "* *Tracing, ms a lamp* is the time to trace a render over the number of lamps. Every"
        " `mi.render` traces; `dr.freeze`, and `mi-ellipse render` in several passes, trace once.\n"
        "* *Tracing* and *execution* of the kernel are ratios to `disk + area`, at"
        f" {LAMPS_SPP} samples per pixel.\n"
        "* *Peak MiB* is the memory of the process.\n\n"
        "Values are medians of five processes. Milliseconds double with a busy neighbour.\n\n"
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
        "The table gives the seconds of each step, and its share, in a new process without cached"
        " kernels, at 64² pixels and 1 sample per pixel. Before that, `import mitsuba` takes"
        f" {imports['mitsuba']:.2f} s, and `import mi_ellipse` {imports['mi_ellipse']:.2f} s more."
        " Loading takes longer with the first lamp of a process, because the plugins are defined"
        " then.\n\n"
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
        "The scene is the bare floor and ball. The table gives the seconds of a render with"
        " `disk + area`, tracing included, the ratio of the others to it, and the memory of each"
        " process. The tracing of a render in Python is the same for every size; `dr.freeze` does"
        " it once.\n\n" + table(" | ".join(["image", "disk + area, s", *kinds, "peak MiB"]), rows)
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
        colour = STRATEGIES[kind].colour if kind in STRATEGIES else "black"
        style = {"color": colour, "label": kind}
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
        gains.plot(places, values, "o", ms=5, color=STRATEGIES[kind].colour, label=kind)
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
        "A lamp hangs above a floor, its centre at two heights: a sphere of radius 0.3, or an"
        " ellipsoid with the semi-axes 1.2, 0.3 and 0.15. The picture shows the floor beside it,"
        f" {results['size']}² pixels with {results['spp']} samples each.\n\n"
        "* *Built-in* is `sphere` + `area`, which is uniform in solid angle, or a mesh of 20 480"
        " triangles + `area`.\n"
        "* *Error* is the trimmed MSE in millionths, and *times lower* is that of built-in over"
        " it.\n"
        "* *Time* is that of a whole render over that of built-in.\n\n"
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
