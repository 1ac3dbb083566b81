"""Figures in the pages: blocks of README and docs that are written from `docs/data`.

A page holds a block between ``<!-- figures: NAME -->`` and ``<!-- end of figures -->``, NAME being
a key of `BLOCKS`. ``python -m benchmarks figures`` writes them anew.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial

from mi_ellipse.sampling import DEFAULT, STRATEGIES

from . import limits, study_page
from .measured import at, quotient
from .text import ROOT, data, number, span, table

PAGES = (
    "README.md",
    "docs/clusters.md",
    "docs/existing_scenes.md",
    "docs/limits.md",
    "docs/many_lamps.md",
    "docs/strategies.md",
    "docs/study.md",
)
BLOCK = re.compile(r"(<!-- figures: (\w+) -->\n).*?(<!-- end of figures -->)", re.DOTALL)

BARE = "bare floor and ball"
HEIGHTS = ("0.25", "0.6")
DIRECT, BOTH = "light samples", "MIS"
CHOICE = ("solid_angle", "projected_solid_angle")
ONE_SIDED = "projected_solid_angle_one_sided"


def write() -> None:
    """Write every block of every page."""
    for name in PAGES:
        page = ROOT / name
        page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


def filled(text: str) -> str:
    """Return a page with its blocks as the data have them; an unknown block is a KeyError."""
    return BLOCK.sub(lambda found: found[1] + BLOCKS[found[2]]() + found[3], text)


# ---- README ----


def readme_strategies() -> str:
    """What each strategy is for, costs and buys."""
    errors, times = data("error")["heights"], data("render_time")[BARE]["ratios"]
    rows = []
    for name in (DEFAULT, "projected_solid_angle", ONE_SIDED, "area", "rejection"):
        measured = name in errors[HEIGHTS[0]][BOTH]
        # No whole render was timed with `rejection`; its time is that of the errors.
        own = times.get(name) or (errors[HEIGHTS[1]][BOTH][name]["time"] if measured else None)
        shown = f"`{name}`" + (" (default)" if name == DEFAULT else "")
        gains = [
            " and ".join(
                number(errors[height][samples][name]["gain_trimmed"]) for height in HEIGHTS
            )
            if measured
            else ""
            for samples in (DIRECT, BOTH)
        ]
        time = f"{own['median']:.2f}" if own else ""
        rows.append([shown, STRATEGIES[name].sentence, time, *gains])
    return table("`sampling` | what it draws | time | light samples | with MIS", rows)


def readme_bounds() -> str:
    """What an exact sampler would reach, and what a render takes in other scenes."""
    heights = data("error")["heights"]
    exact = [
        number(
            heights[height][DIRECT]["disk + area"]["trimmed"] / heights[height]["exact"]["trimmed"]
        )
        for height in HEIGHTS
    ]
    times = [entry["ratios"] for scene, entry in data("render_time").items() if scene != BARE]
    ranges = [span(ratios[name]["median"] for ratios in times) for name in CHOICE]
    lamps = [data("lamps")[name]["100"]["tracing_ms"] / 1000 for name in CHOICE]
    return (
        "An exact sampler of the projected solid angle, if it took no longer than `disk` + `area`,"
        f" would reach {exact[0]} and {exact[1]} with light samples. In other scenes, a render"
        f" takes {ranges[0]} times as long with `{CHOICE[0]}`, and {ranges[1]} times with"
        f" `{CHOICE[1]}`. To trace 100 lamps takes {lamps[0]:.2f} and {lamps[1]:.2f} s a render.\n"
    )


def readme_choice() -> str:
    """Time to equal noise of `projected_solid_angle` over that of the default, by scene."""
    rows = []
    for scene, entry in data("choice").items():
        gains = [entry[name]["gain"]["trimmed"] for name in CHOICE]
        best = CHOICE[gains.index(max(gains))]
        rows.append([scene, *(f"{gain:.2f}" for gain in gains), f"`{best}`"])
    heads = " | ".join(f"`{name}`" for name in CHOICE)
    return table(f"scene | {heads} | choose", rows)


# ---- docs/strategies.md ----

VARIANCES = {
    "far": ("far", "variance_mean"),
    "near": ("near", "variance_mean"),
    "very near": ("very near", "variance_mean"),
    "needle": ("needle", "variance_mean"),
    "in its plane": ("in plane", "variance_mean"),
    "fills": ("fills hemisphere", "variance_mean"),
    "straddling": ("straddling", "variance_mean"),
    "either side": ("straddling", "either_side_mean"),
}
WEIGHTS = {
    "largest weight: near": ("near", "largest_weight"),
    "fills": ("fills hemisphere", "largest_weight"),
    "straddling": ("straddling", "largest_weight"),
    "wasted: near": ("near", "wasted"),
    "straddling ": ("straddling", "wasted"),
}
RANGES = {"density × Ω: near": "near", "needle": "needle"}


def _ordered() -> list[str]:
    """The strategies: what to choose first, then what to compare with."""
    first = [DEFAULT, "projected_solid_angle", ONE_SIDED, "area"]
    return first + [name for name in STRATEGIES if name not in first]


def names() -> str:
    """What the registry says of each strategy."""
    rows = [
        [f"`{name}`" + (" (default)" if name == DEFAULT else ""), STRATEGIES[name].sentence]
        for name in _ordered()
    ]
    return table("`sampling` | what it draws", rows)


def variance() -> str:
    """Cost of each strategy, and its mean relative variance over the classes of lights."""
    rows = []
    for name in _ordered():
        cost, of_class = data("accuracy")["cost"][name], data("accuracy")["rows"][name]
        values = [of_class[row].get(key) for row, key in VARIANCES.values()]
        shown = ["biased" if value is None else number(value) for value in values]
        rows.append([f"`{name}`", f"{cost['sample']:.1f}", f"{cost['density']:.1f}", *shown])
    return table(" | ".join(["strategy", "cost", "density", *VARIANCES]), rows)


def weights() -> str:
    """Largest weight over the mean, share of wasted draws, and range of density × solid angle."""
    rows = []
    for name in _ordered():
        of_class = data("accuracy")["rows"][name]
        shown = [number(of_class[row][key]) for row, key in WEIGHTS.values()]
        ranges = [
            " to ".join(number(value, 4) for value in of_class[row]["uniformity"])
            for row in RANGES.values()
        ]
        rows.append([f"`{name}`", *shown, *ranges])
    return table(" | ".join(["strategy", *WEIGHTS, *RANGES]), rows)


def machine(name: str) -> str:
    """Where a benchmark ran."""
    document = json.loads((ROOT / "docs" / "data" / f"{name}.json").read_text(encoding="utf-8"))
    return f"Machine: {document['machine']}.\n"


def plain_gains() -> str:
    """Gains with MIS when the worst values count, too."""
    heights = data("error")["heights"]
    rows = [
        [height, *(number(heights[height][BOTH][name]["gain_plain"]) for name in CHOICE)]
        for height in HEIGHTS
    ]
    return table(f"lamp at | {' | '.join(f'`{name}`' for name in CHOICE)}", rows)


def times_for_equal_noise() -> str:
    """Time of `projected_solid_angle` for the noise of the default, and the worst of either."""
    choice, near = data("choice"), data("error")["heights"][HEIGHTS[0]][DIRECT]
    gains = {
        scene: {name: entry[name]["gain"]["trimmed"] for name in ("area", *CHOICE)}
        for scene, entry in choice.items()
    }
    times = {f"lamp {HEIGHTS[0]} above a floor, light samples alone": ratio_of_gains(near)}
    times |= {scene: own[CHOICE[0]] / own[CHOICE[1]] for scene, own in gains.items()}
    worst = {
        name: min(own[name] / max(own.values()) for own in gains.values())
        for name in ("area", *CHOICE)
    }
    against = min(own[CHOICE[0]] for own in gains.values())
    rows = [[scene, f"{time:.2f}"] for scene, time in sorted(times.items(), key=lambda one: one[1])]
    sentences = [
        f"At worst, `{CHOICE[0]}` has {worst[CHOICE[0]]:.2f} of the efficiency of the best one for",
        f"a scene, `{CHOICE[1]}` has {worst[CHOICE[1]]:.2f} and `area` has {worst['area']:.2f}.",
        f"Against `disk` + `area`, `{CHOICE[0]}` has {against:.2f} at worst.",
    ]
    return table("scene | time for the same noise", rows) + "\n" + " ".join(sentences) + "\n"


def ratio_of_gains(measured: dict) -> float:
    """Error times time of `projected_solid_angle` over that of the default."""
    return measured[CHOICE[0]]["gain_trimmed"] / measured[CHOICE[1]]["gain_trimmed"]


# ---- docs/study.md, beside what `study_page` has ----


def bulbs() -> str:
    """Errors and times of the scene of spheres and ellipsoids."""
    rows = []
    for kind, entry in data("bulbs")["kinds"].items():
        cells = []
        for samples in (DIRECT, BOTH):
            of = entry[samples]
            cells += [number(1e6 * of["trimmed"], 3), number(of["error_ratio"], 3)]
        time = "{median:.2f} [{low:.2f}, {high:.2f}]".format(**entry["time"])
        rows.append([kind, *cells, time])
    return table("lamps | light samples | times lower | MIS | times lower | time", rows)


# ---- docs/existing_scenes.md ----

REGIONS = ("wall", "plates", "floor")  # of the scenes that have them
INTERVAL = "{median:.2f} [{low:.2f}, {high:.2f}]"


def existing() -> str:
    """Scenes that people know: how many times lower errors are with converted lamps, and time."""
    measured, parts = data("existing"), []
    for name, entry in measured["scenes"].items():
        kinds, (width, height) = entry["kinds"], entry["size"]
        built_in = kinds["built-in"]
        shown = ["trimmed", "plain", *(region for region in REGIONS if region in built_in)]
        rows = []
        for kind, of in kinds.items():
            gains = ["1" if of is built_in else INTERVAL.format(**of[k]["ratio"]) for k in shown]
            error, time = number(of["trimmed"]["error"], 3), INTERVAL.format(**of["time"])
            rows.append([kind, error, *gains, time])
        parts.append(
            f"*{name}*, {width} × {height} pixels with {entry['spp']} samples each,"
            f" {measured['seeds']} seeds and {measured['pairs']} pairs:\n\n"
            + table(" | ".join(["lamps", "trimmed MSE", *shown, "time"]), rows)
        )
    return "\n".join([*parts, machine("existing")])


def existing_gain() -> str:
    """What the default choice of lamps gains in the first of these scenes, at equal time."""
    grouped = "existing", "scenes", "Veach MIS", "kinds", "solid_angle, grouped"
    time = at(*grouped, "time")
    wall, whole = (quotient(at(*grouped, key, "ratio"), time) for key in ("wall", "trimmed"))
    return (
        f"At equal time, `solid_angle` with grouped lamps has {number(wall.value)} times less"
        f" variance on the wall, and {number(whole.value)} times less in the whole picture"
        f" ([{number(whole.low)}, {number(whole.high)}], trimmed).\n"
    )


# ---- docs/many_lamps.md ----


def groups() -> str:
    """What grouped lamps buy and cost, by scene, integrator and strategy."""
    measured, rows = data("groups"), []
    for name, case in measured["cases"].items():
        for samples in (DIRECT, BOTH):
            for strategy in CHOICE:
                entry = case[samples][f"{strategy}, grouped"]
                own, exact = entry["over ungrouped"], entry.get("exact choice")
                error = "{median:.3g} [{low:.3g}, {high:.3g}]".format(**own["error"])
                time = "{median:.2f} [{low:.2f}, {high:.2f}]".format(**own["time"])
                bound = number(exact["median"], 3) if exact else ""
                net = [number(entry[key]["net"], 3) for key in ("over ungrouped", "over built-in")]
                rows.append([name, samples, f"`{strategy}`", error, bound, time, *net])
    return (
        f"Pictures of {measured['size']}² pixels with {measured['spp']} samples each,"
        f" {measured['seeds']} seeds; times of {measured['pairs']} turns in {measured['rounds']}"
        " round(s) of new processes.\n\n"
        + table(
            "scene | samples | strategy | error | exact choice | time | gain | over built-in", rows
        )
    )


def groups_tracing() -> str:
    """Milliseconds a lamp to trace a render, and seconds to the first frame."""
    rows = [
        [count, kind, f"{row['tracing_ms'] / int(count):.2f}", f"{row['first_frame_s']:.2f}"]
        for count, kinds in data("groups")["tracing"].items()
        for kind, row in kinds.items()
    ]
    return table("lamps | kind | tracing, ms a lamp | first frame, s", rows)


# ---- docs/clusters.md ----

NETWORK = 125.0  # MB/s: 1 Gbit/s
LENGTHS = (1, 5, 20, 60)  # seconds of a job
PICTURES = {"640 × 480": 640 * 480, "1920 × 1080": 1920 * 1080, "3840 × 2160": 3840 * 2160}
BYTES_PER_PIXEL = 3 * 4


def cluster() -> str:
    """Throughput of workers and threads, and the cost of a job."""
    measured = data("cluster")
    seconds, cost = measured["seconds_a_job"], measured["overhead"]
    gains = {
        name: "{median:.2f} [{low:.2f}, {high:.2f}]".format(**gain)
        for name, gain in measured["throughput"].items()
    }
    columns = {
        "1 worker": ("1", gains["1 worker over 1 thread"]),
        "2 workers": (gains["2 workers over 1 worker"], gains["2 workers over 2 threads"]),
        "1 thread": ("1", "1"),
        "2 threads": (gains["2 threads over 1 thread"], "1"),
    }
    rows = [[name, f"{seconds[name]:.2f}", *values] for name, values in columns.items()]
    sentences = [
        f"Jobs of {measured['spp']} samples a pixel, 640 × 480 pixels. Medians and 95 % intervals",
        f"of {measured['turns']} turns of {measured['jobs']} jobs. A worker has one thread;",
        "threads are those of one process without a cluster.\n\n"
        + table("place | seconds a job | throughput over one | over as many threads", rows)
        + f"\nA job costs {number(cost['job_ms'])} ms beside its render where many are on their",
        f"way. One alone costs {number(cost['latency_ms'])} ms from end to end. Pictures travel",
        f"from a worker at {number(measured['transfer']['mb_s'])} MB/s, on this machine.\n",
    ]
    return " ".join(sentences)


def cluster_scaling() -> str:
    """Workers that one command keeps busy, by the size of a picture and the length of a job."""
    measured, rows = data("cluster"), []
    rates = {"this machine": measured["transfer"]["mb_s"], "1 Gbit/s": NETWORK}
    for name, pixels in PICTURES.items():
        megabytes = pixels * BYTES_PER_PIXEL / 1e6
        for place, rate in rates.items():
            job, picture = measured["overhead"]["job_ms"], 1e3 * megabytes / rate
            workers = [number(1e3 * length / (job + picture)) for length in LENGTHS]
            limit = "transfer" if picture > job else "jobs"
            rows.append([name, f"{megabytes:.1f} MB", place, *workers, limit])
    lengths = " | ".join(f"jobs of {length} s" for length in LENGTHS)
    return table(f"picture | size | rate | {lengths} | limited by", rows)


BLOCKS: dict[str, Callable[[], str]] = {
    "bulbs": bulbs,
    "cluster": cluster,
    "cluster_scaling": cluster_scaling,
    "existing": existing,
    "existing_gain": existing_gain,
    "far_lamps": limits.far_lamps,
    "groups": groups,
    "groups_tracing": groups_tracing,
    "limits": limits.kept,
    "limits_missed": limits.missed,
    "limits_tested": limits.tested,
    "strategies": readme_strategies,
    "bounds": readme_bounds,
    "choice": readme_choice,
    "names": names,
    "variance": variance,
    "weights": weights,
    "machine_of_accuracy": partial(machine, "accuracy"),
    "machine_of_study": partial(machine, "study"),
    "plain_gains": plain_gains,
    "times_for_equal_noise": times_for_equal_noise,
} | study_page.BLOCKS
