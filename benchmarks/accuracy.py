"""Variance, accuracy and cost of every sampling strategy over classes of random lights.

    python -m benchmarks.accuracy [--lights 192] [--samples 16384] [--rounds 9]

prints the table and writes `docs/data/accuracy.json` and `docs/images/cost_variance.{svg,png}`.

The estimate under test is the unoccluded irradiance of one light at one point, one sample:
``w = max(0, n·ω) / p(ω)``. Solid angle and irradiance are compared with double-precision closed
forms (or, below a horizon, a contour integral) that share no code with the package.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import drjit as dr
import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")

from mi_ellipse.geometry import ellipse as planar  # noqa: E402
from mi_ellipse.sampling import STRATEGIES  # noqa: E402

from oracles.lights import CLASSES, SEED, STRADDLING, STRADDLING_CLASSES, Lights, make_lights  # noqa: E402

from .harness import machine  # noqa: E402

DOCS = Path(__file__).resolve().parent.parent / "docs"

ONE_SIDED = "projected_solid_angle_one_sided"
UNIFORM = "solid_angle"
CONTENDERS = {name: entry.make() for name, entry in STRATEGIES.items()}

# Their weights have no bound, and a peak that no set of draws resolves: their second moment is
# integrated over directions drawn by `solid_angle` instead, ∫ f²/p dω, where it is smooth.
HEAVY_TAILED = {"area", "rejection", "tangent_disk"}


# ---- Accuracy ----------------------------------------------------------------------------------


class Draws:
    """One fine set of draws for every light of a class, side by side."""

    def __init__(self, lights: Lights, samples: int):
        n = lights.solid_angle.size
        self.lights, self.samples = lights, samples
        to_world = mi.Matrix4d(
            [[mi.Float64(lights.to_world[row, k]) for k in range(4)] for row in range(4)]
        )
        index = dr.arange(mi.UInt32, n * samples)
        light, sample = index // samples, index % samples
        self.ellipse = dr.gather(planar.Ellipse, planar.from_transform(to_world), light)
        self.normal = dr.gather(mi.Normal3f, mi.Normal3f(lights.normal.astype(np.float32)), light)
        self.view = self.ellipse.seen_from(mi.Point3f(0))
        # Hammersley's points
        self.u = mi.Point2f(
            (mi.Float(sample) + 0.5) / samples,
            mi.Float(dr.brev(sample)) * 2.0**-32 + 0.5 / samples,
        )

    def per_light(self, op: dr.ReduceOp, value) -> np.ndarray:
        """Reduce over the draws of each light."""
        return dr.block_reduce(op, mi.Float64(value), self.samples).numpy()

    def cosine(self, direction: mi.Vector3f) -> mi.Float:
        """Cosine at the surface of a direction in the light's frame, negative below it."""
        return dr.dot(direction, self.ellipse.to_light(self.normal))


def weight_moments(strategy, draws: Draws, heavy_tailed: bool) -> dict[str, np.ndarray]:
    """What a strategy's weights do on each light; the first axis is the visible side.

    Returns
    -------
    dict
        ``variance``: relative variance; ``largest``: largest weight over mean; ``bias``: mean over
        irradiance, less one; ``wasted``: fraction of draws without contribution; ``uniformity``:
        least and largest density times solid angle, over the whole light.
    """
    mean_of, least_of, most_of = (
        lambda value, op=op: draws.per_light(op, value)
        for op in (dr.ReduceOp.Add, dr.ReduceOp.Min, dr.ReduceOp.Max)
    )
    record = strategy.prepare(draws.view, draws.normal)
    direction, pdf, valid = strategy.sample(record, draws.u)
    cosine = dr.select(valid & (pdf > 0), draws.cosine(direction), 0)

    even = CONTENDERS[UNIFORM]
    even_record = even.prepare(draws.view, draws.normal)
    even_direction, even_pdf, _ = even.sample(even_record, draws.u)
    even_cosine = draws.cosine(even_direction)
    pdf_there = strategy.pdf(record, even_direction)
    dr.eval(cosine, pdf, even_cosine, even_pdf, pdf_there)  # Once for all reductions below

    solid_angle = draws.lights.solid_angle
    result = {"uniformity": np.stack([least_of(pdf_there), most_of(pdf_there)]) * solid_angle}
    sides = {key: [] for key in ("variance", "largest", "bias", "wasted")}
    for side, irradiance in zip((1, -1), draws.lights.irradiance, strict=True):
        f = dr.maximum(side * cosine, 0)
        w = dr.select(f > 0, f / pdf, 0)
        even_f = dr.maximum(side * even_cosine, 0)
        there = dr.select(even_f > 0, even_f / pdf_there, 0)
        mean = mean_of(w) / draws.samples
        if heavy_tailed:
            mean_square = mean_of(mi.Float64(even_f) * there / even_pdf) / draws.samples
            expected = irradiance
        else:
            mean_square = mean_of(dr.square(mi.Float64(w))) / draws.samples
            expected = mean
        with np.errstate(divide="ignore", invalid="ignore"):
            sides["variance"].append(mean_square / expected**2 - 1)
            largest = most_of(w)
            if heavy_tailed:
                largest = np.maximum(largest, most_of(there))
            sides["largest"].append(largest / irradiance)
            sides["bias"].append(mean / irradiance - 1)
        sides["wasted"].append(1 - mean_of(dr.select(w > 0, 1, 0)) / draws.samples)
    return result | {key: np.stack(value) for key, value in sides.items()}


def density_agreement(strategy, draws: Draws) -> np.ndarray:
    """Error of the density recomputed from the single-precision world direction of a draw."""
    record = strategy.prepare(draws.view, draws.normal)
    direction, pdf, valid = strategy.sample(record, draws.u)
    world = draws.ellipse.to_world(direction)
    dr.eval(world)
    again = strategy.pdf(record, draws.ellipse.to_light(world))
    return dr.select(valid, dr.abs(again / pdf - 1), 0).numpy()


def _rounded(value):
    """Four significant digits: what the measurement is worth."""
    if np.ndim(value):
        return [_rounded(v) for v in value]
    return float(f"{float(value):.4g}")


def summarise(parts: list[dict]) -> dict:
    """Statistics over the lights of one row of the table, from the parts that it pools."""
    pooled = {key: np.concatenate([p[key] for p in parts], axis=-1) for key in parts[0]}
    straddling = bool(np.isfinite(pooled["bias"][1]).any())
    variance = pooled["variance"]
    summary = {
        "variance_mean": variance[0].mean(),
        "variance_95": np.quantile(variance[0], 0.95),
        "largest_weight": pooled["largest"][0].max(),
        "bias": np.abs(pooled["bias"][0]).max(),
        "wasted": pooled["wasted"][0].mean(),
        "uniformity": [pooled["uniformity"][0].min(), pooled["uniformity"][1].max()],
        "agreement_99": np.quantile(pooled["agreement"], 0.99),
        "agreement_max": pooled["agreement"].max(),
    }
    if straddling and np.isfinite(variance).all():
        either = variance.mean(axis=0)
        summary |= {
            "either_side_mean": either.mean(),
            "either_side_95": np.quantile(variance, 0.95),
            "either_side_largest_weight": pooled["largest"].max(),
        }
    return {key: _rounded(value) for key, value in summary.items()}


def measure_accuracy(lights: int, samples: int) -> dict:
    """Rows of the table: per strategy and class, then the straddling lights of each class."""
    rows = {name: {} for name in CONTENDERS}
    for straddling in (False, True):
        parts = {name: {} for name in CONTENDERS}
        for class_name in CLASSES:
            population = make_lights(class_name, lights, straddling)
            fine, coarse = Draws(population, samples), Draws(population, samples // 16)
            for name, strategy in CONTENDERS.items():
                parts[name][class_name] = weight_moments(strategy, fine, name in HEAVY_TAILED) | {
                    "agreement": density_agreement(strategy, coarse)
                }
        for name, of_class in parts.items():
            if straddling:
                rows[name][STRADDLING] = summarise([of_class[c] for c in STRADDLING_CLASSES])
            rows[name] |= {
                f"{STRADDLING}, {c}" if straddling else c: summarise([part])
                for c, part in of_class.items()
            }
    return rows


# ---- Cost --------------------------------------------------------------------------------------

SAMPLES_TIMED = 10_000_000
# Steps of additive recurrences for the inputs of a kernel, powers of the plastic number's kin of
# dimension 8: they cost one multiplication each, so that little else than the strategy is timed.
STEPS = [1.0850702 ** -(k + 1) for k in range(8)]


def _varying_inputs():
    """Reference points about the light, normals and random numbers, different in every sample."""
    index = dr.arange(mi.UInt32, SAMPLES_TIMED)
    r = [mi.Float((index * mi.UInt32(int(s * 2**32) | 1)) >> 8) * 2.0**-24 for s in STEPS]
    reference = mi.Point3f(4 * r[0] - 2, 4 * r[1] - 2, 2 * r[2] - 1)
    normal = dr.normalize(mi.Normal3f(r[3] - 0.5, r[4] - 0.5, r[5] + 0.1))
    return reference, normal, mi.Point2f(r[6], r[7])


def _unit_kernel(light, reference, normal, u):
    """One unit of cost: a point on the light through the concentric disk, direction, density."""
    p = mi.warp.square_to_uniform_disk_concentric(u)
    to_light = light.point(p.x, p.y) - reference
    distance2 = dr.squared_norm(to_light)
    direction = to_light * dr.rsqrt(distance2)
    pdf = distance2 / (light.area * dr.abs(dr.dot(direction, mi.Vector3f(light.normal))))
    return dr.maximum(dr.dot(direction, normal), 0) / pdf


def _sample_kernel(strategy, light, reference, normal, u):
    record = strategy.prepare(light.seen_from(reference), normal)
    direction, pdf, valid = strategy.sample(record, u)
    weight = dr.maximum(dr.dot(direction, light.to_light(normal)), 0) / pdf
    return dr.select(valid & (pdf > 0), weight, 0)


def _density_kernel(strategy, light, reference, normal, u):
    direction = light.to_light(mi.warp.square_to_uniform_sphere(u))
    return strategy.pdf(strategy.prepare(light.seen_from(reference), normal), direction)


def measure_cost(rounds: int) -> tuple[dict, float]:
    """Median cost of each strategy in units, and the nanoseconds per sample of a unit.

    The kernels take turns, each beside a unit kernel; the ratio is that of neighbours.
    """
    light = planar.from_transform(
        mi.ScalarTransform4d().translate([0.3, 0, 2]).rotate([1, 2, 3], 40).scale([1.5, 0.4, 1])
    )
    dr.make_opaque(light)

    def nanoseconds(kernel, *args):
        dr.kernel_history_clear()
        dr.eval(dr.sum(kernel(*args, light, *_varying_inputs()), mode="symbolic"))
        dr.sync_thread()
        times = [k["execution_time"] for k in dr.kernel_history([dr.KernelType.JIT])]
        return 1e6 * sum(times) / SAMPLES_TIMED

    kernels = [
        (name, kind, kernel, strategy)
        for name, strategy in CONTENDERS.items()
        for kind, kernel in (("sample", _sample_kernel), ("density", _density_kernel))
    ]
    ratios = {(name, kind): [] for name, kind, *_ in kernels}
    units = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for _, _, kernel, strategy in kernels:  # Compile
            nanoseconds(kernel, strategy)
        for _ in range(rounds):
            for name, kind, kernel, strategy in kernels:
                units.append(nanoseconds(_unit_kernel))
                ratios[name, kind].append(nanoseconds(kernel, strategy) / units[-1])
    cost = {
        name: {kind: _rounded(np.median(ratios[name, kind])) for kind in ("sample", "density")}
        for name in CONTENDERS
    }
    return cost, _rounded(np.median(units))


# ---- Output ------------------------------------------------------------------------------------


def print_table(result: dict) -> None:
    """The table, one block a class; the lights of the requirement first."""
    print(f"{result['lights']} lights a class, {result['samples']} draws a light")
    print(f"\ncost in units of {result['unit_ns']} ns: prepare and sample, prepare and density")
    for name, cost in result["cost"].items():
        print(f"  {name:34}{cost['sample']:8.1f}{cost['density']:8.1f}")
    columns = ("mean", "95 %", "either", "95 %", "largest", "wasted", "least", "most p·Ω")
    head = "".join(f"{c:>10}" for c in (*columns, "agree 99%", "max", "bias"))
    for class_name in result["rows"][UNIFORM]:
        print(f"\n{class_name:36}{head}")
        for name, rows in result["rows"].items():
            row = rows[class_name]
            either = [row.get(f"either_side_{k}", float("nan")) for k in ("mean", "95")]
            values = [row["variance_mean"], row["variance_95"], *either, row["largest_weight"]]
            values += [row["wasted"], *row["uniformity"], row["agreement_99"]]
            values += [row["agreement_max"], row["bias"]]
            print(f"  {name:34}" + "".join(f"{'-' if v != v else f'{v:.3g}':>10}" for v in values))


PANELS = [
    ("far", "variance_mean", "far"),
    ("near", "variance_mean", "near"),
    ("very near", "variance_mean", "very near"),
    ("fills hemisphere", "variance_mean", "fills the hemisphere"),
    ("needle", "variance_mean", "needle"),
    ("in plane", "variance_mean", "in the light's plane"),
    (STRADDLING, "variance_mean", "straddling the horizon,\nnormal's side seen"),
    (STRADDLING, "either_side_mean", "straddling the horizon,\neither side seen"),
]


def _label_positions(values: np.ndarray, gap: float) -> np.ndarray:
    """Logarithms moved apart to at least a gap, keeping their order and their mean."""
    order = np.argsort(values)
    y = np.log10(values[order])
    for _ in range(200):
        overlap = np.maximum(gap - np.diff(y), 0)
        y[:-1] -= overlap / 2
        y[1:] += overlap / 2
    placed = np.empty_like(y)
    placed[order] = y
    return 10**placed


def plot(result: dict, path: Path) -> None:
    """Cost against mean relative variance, one panel a class."""
    plt.rcParams |= {"font.family": "DejaVu Sans", "font.size": 8, "svg.fonttype": "none"}
    figure, axes = plt.subplots(2, 4, figsize=(12, 6.2), sharex=True)
    for ax, (class_name, key, title) in zip(axes.flat, PANELS, strict=True):
        names = [n for n in result["rows"] if key in result["rows"][n][class_name]]
        y = np.array([result["rows"][n][class_name][key] for n in names])
        low, high = np.log10(y.min()), np.log10(y.max())
        margin = max(0.12 * (high - low), 0.75 - 0.5 * (high - low), 0.15)
        label_y = _label_positions(y, 0.055 * (high - low + 2 * margin))
        for name, value, at in zip(names, y, label_y, strict=True):
            x, colour = result["cost"][name]["sample"], STRATEGIES[name].colour
            ax.plot(x, value, "o", ms=6, color=colour, mec="white", mew=0.7, zorder=3)
            ax.plot([x, 34], [value, at], lw=0.5, color=colour, alpha=0.6, zorder=1)
            label = name.replace("projected_solid_angle", "projected")
            ax.text(36, at, label, color=colour, va="center", size=7)
        ax.set(xscale="log", yscale="log", xlim=(0.8, 30), title=title)
        ax.set_ylim(10 ** (low - margin), 10 ** (high + margin))
        ax.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
        ax.minorticks_off()
        ax.grid(color="#dddddd", lw=0.5)
        ax.spines[["top", "right"]].set_visible(False)
    for ax in axes[-1]:
        ax.set_xlabel("cost of a sample (area sampling = 1)")
    for ax in axes[:, 0]:
        ax.set_ylabel("relative variance")
    figure.tight_layout(w_pad=1)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path.with_suffix(".svg"))
    figure.savefig(path.with_suffix(".png"), dpi=160)


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, and keep the figures and the plot; `arguments` as on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lights", type=int, default=192, help="per class")
    parser.add_argument("--samples", type=int, default=16384, help="draws per light, a power of 2")
    parser.add_argument("--rounds", type=int, default=9, help="repeats of the timing")
    options = parser.parse_args(arguments)
    cost, unit = measure_cost(options.rounds)
    result = {
        "machine": machine(),
        "seed": SEED,
        "lights": options.lights,
        "samples": options.samples,
        "unit_ns": unit,
        "cost": cost,
        "rows": measure_accuracy(options.lights, options.samples),
    }
    print_table(result)
    (DOCS / "data").mkdir(parents=True, exist_ok=True)
    (DOCS / "data" / "accuracy.json").write_text(json.dumps(result, indent=1) + "\n")
    plot(result, DOCS / "images" / "cost_variance")


if __name__ == "__main__":
    main()
