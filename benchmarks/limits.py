"""The limits that were set for speed, noise and accuracy, beside what `docs/data` says of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import groupby, product
from operator import attrgetter

from .measured import Limit, Measured, Verdict, around, at, quotient
from .text import data, number, table

UNIFORM, PROJECTED, ONE_SIDED = CHOICE = (
    "solid_angle",
    "projected_solid_angle",
    "projected_solid_angle_one_sided",
)
BOTH_STRATEGIES = CHOICE[:2]
BUILT_IN = "disk + area"
DIRECT, MIS = SAMPLES = ("light samples", "MIS")

# Milliseconds a lamp of the first version of this package, on one machine and in one hour
FIRST_TRACING = {UNIFORM: 1.66, PROJECTED: 6.06, BUILT_IN: 0.21}

Measure = Callable[[], Measured]


def worst(most: bool, places: Iterable[Measure]) -> Measured:
    """The largest of some values if the limit is the most that is allowed, else the least."""
    pick = max if most else min
    return pick((place() for place in places), key=lambda measured: measured.value)


def over(place: tuple[str, ...], other: tuple[str, ...]) -> Measured:
    """One value of the data over another."""
    return quotient(at(*place), at(*other))


# ---- Time of a render ----

RENDERS = "Time of a render, over built-in"
BARE_SCENES = ("bare floor and ball", "lamp")
FOG = "spheres_fog"
SCENE_LIMITS = {UNIFORM: 1.05, PROJECTED: 1.10}
BARE_LIMITS = {UNIFORM: 1.10, PROJECTED: 1.30}
DRAWS = (
    "A draw finds the cone of the lamp before it draws, and built-in does not. It shows where a"
    " render does little else."
)
FOG_DRAWS = (
    "`volpath` draws a light sample at every scattering and at every surface, and computes little"
    " else. A draw of the cone alone, without any map, would take longer than the limit leaves."
)
PROJECTED_DRAWS = (
    "Above the cone, which `solid_angle` finds too, a draw matches slices to the cosine and solves"
    " for the direction in its slice."
)


def render_times() -> Iterator[Limit]:
    """Every scene of `render_time`."""
    for scene, strategy in product(data("render_time"), BOTH_STRATEGIES):
        bounds = BARE_LIMITS if scene in BARE_SCENES else SCENE_LIMITS
        reason = DRAWS if strategy == UNIFORM else PROJECTED_DRAWS
        if scene == FOG:
            reason = FOG_DRAWS + (f" {PROJECTED_DRAWS}" if strategy == PROJECTED else "")
        place = partial(at, "render_time", scene, "ratios", strategy)
        yield Limit(RENDERS, f"{scene}, `{strategy}`", True, bounds[strategy], place, reason)


# ---- Noise near a lamp ----

NEAR = "Error × time near a lamp: times lower than built-in"
NEAR_REASON = "What is left comes from the area of the pixel, the shadows, and BSDF samples."
ABOVE_FLOOR = {"0.25": 60, "0.6": 12}  # Light samples, of `projected_solid_angle`
WITH_FLOOR = {"0.25": 18, "0.6": 4}  # Light samples, of `solid_angle`
WITH_MIS = {"0.25": 4.2, "0.6": 3.6}
LEAST_OF_BEST = 0.95


def gain(height: str, samples: str, strategy: str, above_floor: bool = False) -> Measured:
    """Times lower trimmed error × time; above what no sampling of the lamp removes, or in all."""
    entry = data("error")["heights"][height]
    floor = entry["floor"] if above_floor else 0.0
    base, own = (
        around(row["trimmed"] - floor, row["standard_error"])
        for row in (entry[samples][BUILT_IN], entry[samples][strategy])
    )
    time = at("error", "heights", height, samples, strategy, "time")
    return quotient(quotient(base, own), time)


def gain_in(scene: str, strategy: str) -> Measured:
    """Times lower trimmed error × time than built-in in a scene; the interval is that of times."""
    entry = data("choice")[scene][strategy]
    time = at("choice", scene, strategy, "time")
    return quotient(Measured(entry["gain"]["trimmed"] * time.value), time)


def share_of_best() -> Measured:
    """Least share of the best of three strategies, over all scenes, of the strategy to take."""
    shares = {
        name: min(
            entry[name]["gain"]["trimmed"] / max(of["gain"]["trimmed"] for of in entry.values())
            for entry in data("choice").values()
        )
        for name in ("area", *BOTH_STRATEGIES)
    }
    return Measured(max(shares.values()))


def near_a_lamp() -> Iterator[Limit]:
    """Gains of single lamps."""
    for height, bound in ABOVE_FLOOR.items():
        place = partial(gain, height, DIRECT, PROJECTED, True)
        what = f"lamp at {height}, light samples above the pixel's floor, `{PROJECTED}`"
        yield Limit(NEAR, what, False, bound, place, NEAR_REASON)
    for height, bound in WITH_FLOOR.items():
        what = f"lamp at {height}, light samples, `{UNIFORM}`"
        yield Limit(NEAR, what, False, bound, partial(gain, height, DIRECT, UNIFORM), NEAR_REASON)
    for (height, bound), strategy in product(WITH_MIS.items(), BOTH_STRATEGIES):
        what = f"lamp at {height}, MIS, `{strategy}`"
        yield Limit(NEAR, what, False, bound, partial(gain, height, MIS, strategy), NEAR_REASON)
    scenes = [partial(gain_in, scene, UNIFORM) for scene in data("choice")]
    yield Limit(
        NEAR,
        f"the worst of the scenes of `choice`, `{UNIFORM}`",
        False,
        LEAST_OF_BEST,
        partial(worst, False, scenes),
        "Where a lamp is far and faces the surface, a draw by direction gains nothing.",
    )
    yield Limit(
        NEAR,
        "one strategy for all scenes, over the best of three",
        False,
        LEAST_OF_BEST,
        share_of_best,
        "Which strategy is the best depends on the scene, not on the point alone. So there is no"
        " automatic choice.",
    )


# ---- One draw ----

COSTS = "Cost of a draw, in draws by area"
COST_LIMITS = {UNIFORM: 5, PROJECTED: 14, ONE_SIDED: 10}
VARIANCE = "Relative variance of one sample"
EVEN = "Density over uniform"
ABOVE = "far", "near", "needle", "in plane"
FILLS, STRADDLING = "fills hemisphere", "straddling"
NEEDLES = (
    "Across the slices of a needle that is near, the cosine has a peak that is narrower than the"
    " peak of what is drawn (`HIGHEST_PEAK`)."
)
LARGE = (
    "The density of the slices is a profile times a factor, and the factor is known at three places"
    " of a side. Over a light that fills so much of the view, that is coarse."
)
SIDES = "The emitter does not know which side of the surface is seen, so both get draws."


def accuracy(strategy: str, light: str, key: str) -> Measure:
    """A value of the benchmark `accuracy`."""
    return partial(at, "accuracy", "rows", strategy, light, key)


def deviation(strategy: str) -> Measured:
    """Largest deviation of density × solid angle from one, over all classes of lights."""
    ends = [row["uniformity"] for row in data("accuracy")["rows"][strategy].values()]
    return Measured(max(max(1 - low, high - 1) for low, high in ends))


def one_draw() -> Iterator[Limit]:
    """Cost and uniformity of the strategies."""
    for name, bound in COST_LIMITS.items():
        place = partial(at, "accuracy", "cost", name, "sample")
        yield Limit(COSTS, f"`{name}`", True, bound, place, DRAWS)
    what = f"largest deviation, `{UNIFORM}`"
    reason = "The density follows from a closed form with one warp."
    yield Limit(EVEN, what, True, 0.05, partial(deviation, UNIFORM), reason)


def variances() -> Iterator[Limit]:
    """Variance and weights of the strategies that follow the cosine."""
    of_classes = dict.fromkeys((*ABOVE, STRADDLING), 0.01) | {FILLS: 0.06}
    for light, bound in of_classes.items():
        place = accuracy(ONE_SIDED, light, "variance_mean")
        reason = LARGE if light == FILLS else NEEDLES
        yield Limit(VARIANCE, f"`{ONE_SIDED}`, {light}", True, bound, place, reason)
    weights = [accuracy(ONE_SIDED, light, "largest_weight") for light in of_classes]
    what = f"`{ONE_SIDED}`, largest weight over the mean, those lights"
    yield Limit(VARIANCE, what, True, 10, partial(worst, True, weights), LARGE)
    for light in (*ABOVE, FILLS, "very near", "near needle"):
        what = f"`{PROJECTED}`, 95 % of the lights, {light}"
        reason = NEEDLES if "needle" in light else LARGE
        yield Limit(VARIANCE, what, True, 0.05, accuracy(PROJECTED, light, "variance_95"), reason)
    halved = partial(
        over,
        ("accuracy", "rows", PROJECTED, STRADDLING, "variance_mean"),
        ("accuracy", "rows", UNIFORM, STRADDLING, "variance_mean"),
    )
    what = f"`{PROJECTED}` over `{UNIFORM}`, {STRADDLING}"
    yield Limit(VARIANCE, what, True, 0.5, halved, SIDES)


# ---- First frame and many lamps ----

FIRST = "First frame and many lamps"
HALVED = 0.5
PREPARED_TWICE = (
    "Draw and density each hold the whole preparation, and that of `projected_solid_angle` has more"
    " than twice the operations. `solid_angle`, which is the cone and its map, takes most of what"
    " the limit leaves."
)
TRACED = (
    "About half of it is Dr.Jit's own work for every operation, and `path` traces its loop twice."
    " `dr.freeze` traces once, and the lamps of a group share one trace."
)
ONE_BODY = "A group traces one body for all members, and that body holds the choice as well."
KERNEL_LIMITS = {"operations": 1.01, "callables": 1}


def tracing(strategy: str) -> Measured:
    """Time to trace 100 lamps over that of built-in lamps, over the same of the first version."""
    first = FIRST_TRACING[strategy] / FIRST_TRACING[BUILT_IN]
    return Measured(at("lamps", strategy, "100", "tracing_ratio").value / first)


def tracing_grouped(strategy: str) -> Measured:
    """The same for grouped lamps."""
    first = FIRST_TRACING[strategy] / FIRST_TRACING[BUILT_IN]
    place = "groups", "tracing", "100"
    grouped, built_in = (
        at(*place, kind, "tracing_ms").value for kind in (f"{strategy}, grouped", BUILT_IN)
    )
    return Measured(grouped / built_in / first)


def first_frame() -> Iterator[Limit]:
    """Import, compilation and kernels."""
    place = partial(at, "first_frame", "imports", "mi_ellipse")
    reason = "NumPy and the modules of the package itself take it."
    yield Limit(FIRST, "`import mi_ellipse`, seconds", True, 0.3, place, reason)
    for name in BOTH_STRATEGIES:
        place = partial(at, "first_frame", "kinds", name, "ratios", "compile")
        what = f"compilation over built-in, `{name}`"
        yield Limit(FIRST, what, True, 1.3, place, PREPARED_TWICE)
    for name, (key, bound) in product(BOTH_STRATEGIES, KERNEL_LIMITS.items()):
        place = partial(over, ("lamps", name, "1000", key), ("lamps", name, "10", key))
        what = f"{key} of 1 000 lamps over 10, `{name}`"
        yield Limit(FIRST, what, True, bound, place, "A lamp adds data and no code.")
    for name in BOTH_STRATEGIES:
        place = partial(at, "lamps", name, "1000", "execution_ratio")
        what = f"kernel of 1 000 lamps over built-in, `{name}`"
        yield Limit(FIRST, what, True, 1.2, place, DRAWS)


def traces() -> Iterator[Limit]:
    """Tracing of many lamps, and the making of a group."""
    kinds = {"": tracing, ", grouped": tracing_grouped}
    for name, (label, measure) in product(BOTH_STRATEGIES, kinds.items()):
        what = f"tracing of 100 lamps over the first version, `{name}`{label}"
        yield Limit(FIRST, what, True, HALVED, partial(measure, name), TRACED)
    place = "groups", "tracing"
    for count, shown in {"10": "10", "100": "100", "1000": "1 000"}.items():
        ratios = [
            partial(
                over,
                (*place, count, f"{name}, grouped", "tracing_ms"),
                (*place, count, name, "tracing_ms"),
            )
            for name in BOTH_STRATEGIES
        ]
        what = f"tracing of {shown} lamps, grouped over ungrouped"
        yield Limit(FIRST, what, True, 1, partial(worst, True, ratios), ONE_BODY)
    rows = [(*place, "1000", f"{name}, grouped") for name in BOTH_STRATEGIES]
    made = [partial(over, (*row, "group_s"), (*row, "load_s")) for row in rows]
    what = "making a group of 1 000 lamps, over loading them"
    yield Limit(FIRST, what, True, 1, partial(worst, True, made), "The tree is built in NumPy.")


# ---- Groups ----

GROUPS = "Grouped lamps: error × time, times lower than ungrouped"
GROUP_TIMES = "Grouped lamps: time of a render over ungrouped"
BUNNY = "The bunny: error × time, times lower than built-in"
FACING, TILTED, BUNNY_CASE = "2 lamps that face the floor", "2 tilted lamps", "bunny"
SIXTEEN, HUNDRED, THOUSAND = (f"{count} tilted lamps" for count in (16, 100, 1000))
GAIN_LIMITS: tuple[tuple[str, str, tuple[str, ...], float], ...] = (
    (FACING, DIRECT, (UNIFORM,), 12),
    (FACING, DIRECT, (PROJECTED,), 18),
    (FACING, MIS, (UNIFORM,), 9),
    (FACING, MIS, (PROJECTED,), 9),
    (TILTED, DIRECT, (UNIFORM,), 3.6),
    (TILTED, DIRECT, (PROJECTED,), 4),
    (TILTED, MIS, BOTH_STRATEGIES, 3),
    (BUNNY_CASE, DIRECT, BOTH_STRATEGIES, 3.2),
    (SIXTEEN, DIRECT, BOTH_STRATEGIES, 10),
    (SIXTEEN, MIS, BOTH_STRATEGIES, 8),
    (HUNDRED, DIRECT, BOTH_STRATEGIES, 11),
    (HUNDRED, MIS, BOTH_STRATEGIES, 5.5),
)
TIME_LIMITS = {FACING: 1.12, TILTED: 1.12, BUNNY_CASE: 1.12, SIXTEEN: 1.3, HUNDRED: 1.4}
EQUAL_LAMPS = "4 equal lamps far away"
CHOOSING = (
    "A group estimates what its lamps give at every point before it draws, and at every BSDF sample"
    " that meets one. Over a bare floor there is little else to compute."
)
BSDF_NOISE = (
    "The noise of the BSDF samples is left, and the time of the choice. With light samples alone"
    " the error is lower."
)
COSINE_LEFT = (
    "What is left are the shadows, which the choice does not know, and the cosine at the surface,"
    " which `solid_angle` does not follow."
)
PICKED = (
    "Mitsuba picks the lamp of a light sample at random, and that noise stays. A group removes it."
)


def net(case: str, samples: str, strategy: str, base: str = "ungrouped") -> Measured:
    """Times lower error × time with a group."""
    place = "groups", "cases", case, samples, f"{strategy}, grouped", f"over {base}"
    return over((*place, "error"), (*place, "time"))


def more_lamps(samples: str, strategy: str) -> Measured:
    """What a group gains with 1 000 lamps, over what it gains with 100."""
    return quotient(*(net(case, samples, strategy) for case in (THOUSAND, HUNDRED)))


def groups() -> Iterator[Limit]:
    """What a group gains, and what it takes."""
    for case, samples, strategies, bound in GAIN_LIMITS:
        places = [partial(net, case, samples, strategy) for strategy in strategies]
        named = f", `{strategies[0]}`" if len(strategies) == 1 else ""
        what = f"{case}, {samples}{named}"
        reason = BSDF_NOISE if samples == MIS else CHOOSING
        yield Limit(GROUPS, what, False, bound, partial(worst, False, places), reason)
    for samples in SAMPLES:
        places = [partial(more_lamps, samples, strategy) for strategy in BOTH_STRATEGIES]
        what = f"1 000 lamps over 100, {samples}"
        yield Limit(GROUPS, what, False, 1, partial(worst, False, places), CHOOSING)
    pairs = list(product(SAMPLES, BOTH_STRATEGIES))
    places = [partial(net, EQUAL_LAMPS, *pair) for pair in pairs]
    what = f"{EQUAL_LAMPS}, the worst case"
    yield Limit(GROUPS, what, False, 0.95, partial(worst, False, places), CHOOSING)
    for case, bound in TIME_LIMITS.items():
        place = "groups", "cases", case
        places = [
            partial(at, *place, samples, f"{strategy}, grouped", "over ungrouped", "time")
            for samples, strategy in pairs
        ]
        yield Limit(GROUP_TIMES, case, True, bound, partial(worst, True, places), CHOOSING)


def bunny() -> Iterator[Limit]:
    """The target of the study: half the time with MIS, a tenth with light samples."""
    for strategy in BOTH_STRATEGIES:
        what = f"lamps picked by Mitsuba, MIS, `{strategy}`"
        yield Limit(BUNNY, what, False, 2, partial(gain_in, "bunny", strategy), PICKED)
    for (samples, bound), strategy in product({MIS: 2, DIRECT: 10}.items(), BOTH_STRATEGIES):
        what = f"grouped, {samples}, `{strategy}`"
        place = partial(net, BUNNY_CASE, samples, strategy, "built-in")
        yield Limit(BUNNY, what, False, bound, place, COSINE_LEFT)
    for strategy in BOTH_STRATEGIES:
        what = f"grouped, MIS, at 256 samples of the study, `{strategy}`"
        yield Limit(BUNNY, what, False, 2, partial(gain_in_study, "bunny", strategy), COSINE_LEFT)


def gain_in_study(case: str, strategy: str) -> Measured:
    """Times lower trimmed error × time than built-in at the most samples of a comparison."""
    *_, most = data("study")[case]["strategies"][strategy].values()
    gain = most["efficiency"]
    return Measured(gain["value"], gain["low"], gain["high"])


# ---- Beside Cycles, solids and clusters ----

CYCLES = "Grouped lamps: times less variance than the light tree of Cycles"
SOLIDS = "Spheres and ellipsoids: error, times lower than built-in"
SOLID_TIMES = "Spheres and ellipsoids: time of a render with MIS, over built-in"
CLUSTER = "Throughput"
TREE = (
    "From nine lamps on, a tree leads to two lamps, and its nodes know less than the"
    " estimate of a lamp. With MIS, BSDF samples take a part of the noise from Cycles as well."
)
SOLID_LIMITS = (
    ("sphere", "0.35", DIRECT, PROJECTED, 22),
    ("sphere", "1.0", DIRECT, PROJECTED, 20),
    ("sphere", "0.35", MIS, PROJECTED, 5),
    ("sphere", "1.0", MIS, PROJECTED, 13),
    ("ellipsoid", "0.4", MIS, UNIFORM, 15),
    ("ellipsoid", "1.0", MIS, UNIFORM, 80),
    ("ellipsoid", "0.4", MIS, PROJECTED, 35),
    ("ellipsoid", "1.0", MIS, PROJECTED, 300),
)
SOLID_TIME_LIMITS = {"sphere": (1.15, (PROJECTED,)), "ellipsoid": (1.0, BOTH_STRATEGIES)}


def beside_cycles(count: str, samples: str, strategy: str) -> Measured:
    """Variance of Cycles' light tree over that of grouped lamps."""
    rows = data("cycles_lamps")["counts"][count][samples]["rows"]
    return quotient(
        *(
            around(rows[kind]["variance"], rows[kind]["standard_error"])
            for kind in ("Cycles, light tree", f"{strategy}, grouped")
        )
    )


def solid(shape: str, height: str, samples: str, strategy: str) -> Measured:
    """Trimmed error of built-in over that of a strategy."""
    rows = data("ellipsoids")["shapes"][shape][height][samples]
    return quotient(
        *(
            around(rows[kind]["trimmed"], rows[kind]["standard_error"])
            for kind in ("built-in", strategy)
        )
    )


def elsewhere() -> Iterator[Limit]:
    """Cycles, solids and clusters."""
    for count, samples in product(("16", "100"), SAMPLES):
        places = [partial(beside_cycles, count, samples, name) for name in BOTH_STRATEGIES]
        what = f"{count} lamps, {samples}"
        yield Limit(CYCLES, what, False, 5, partial(worst, False, places), TREE)
    for shape, height, samples, strategy, bound in SOLID_LIMITS:
        error = partial(solid, shape, height, samples, strategy)
        what = f"{shape} at {height}, {samples}, `{strategy}`"
        yield Limit(SOLIDS, what, False, bound, error, NEAR_REASON)
    for shape, (most, strategies) in SOLID_TIME_LIMITS.items():
        heights = data("ellipsoids")["shapes"][shape]
        for height, strategy in product(heights, strategies):
            time = partial(at, "ellipsoids", "shapes", shape, height, MIS, strategy, "time")
            yield Limit(SOLID_TIMES, f"{shape} at {height}, `{strategy}`", True, most, time, DRAWS)
    what = "two workers of one thread, over one"
    gained = partial(at, "cluster", "throughput", "2 workers over 1 worker")
    reason = "Two threads of one process do not reach twice the throughput of one either."
    yield Limit(CLUSTER, what, False, 1.8, gained, reason)


# ---- Tables ----

PARTS = (
    render_times,
    near_a_lamp,
    one_draw,
    variances,
    first_frame,
    traces,
    groups,
    bunny,
    elsewhere,
)


def limits() -> list[Limit]:
    """All limits that `docs/data` has a value for."""
    return [limit for part in PARTS for limit in part()]


def kept(of: Iterable[Limit] | None = None) -> str:
    """A table for each subject: limit, measured value, and whether it holds."""
    parts = []
    for subject, group in groupby(limits() if of is None else of, key=attrgetter("subject")):
        rows = []
        for limit in group:
            measured = limit.measure()
            rows.append([limit.what, limit.asked, measured, limit.verdict(measured).value])
        parts.append(f"### {subject}\n\n" + table("what | limit | measured | holds", rows))
    return "\n".join(parts)


def missed(of: Iterable[Limit] | None = None) -> str:
    """How many limits hold. Those that do not, with a bound that holds, and the reason."""
    verdicts, rows = [], []
    for limit in limits() if of is None else of:
        measured = limit.measure()
        verdicts.append(limit.verdict(measured))
        if verdicts[-1] is Verdict.MISSED:
            bound = limit.say(limit.bound_that_holds(measured))
            rows.append([limit.subject, limit.what, limit.asked, bound, limit.reason])
    holding, within, others = (verdicts.count(verdict) for verdict in Verdict)
    counts = f"Of {len(verdicts)} limits {holding} hold, and {within} more within the error."
    if not rows:
        return counts + "\n"
    head = "of | what | limit | bound in its place | reason"
    return f"{counts} The other {others} do not hold:\n\n" + table(head, rows)


# ---- Far lamps ----


def far_lamps() -> str:
    """What a branch to draws by area could save, from the times of whole renders and of draws."""
    uniform, area = (at("render_time", FOG, "ratios", kind) for kind in (UNIFORM, "area"))
    limit = SCENE_LIMITS[UNIFORM]
    saved = uniform.value - area.value
    best = number(100 * saved / uniform.value)
    draw = quotient(
        *(at("calls", "sample_direction", kind, "nanoseconds") for kind in ("area", UNIFORM))
    )
    if uniform.value <= limit:
        needed = f"That is below {limit} without such a branch."
    elif area.value >= limit:
        needed = f"No share of draws by area would reach {limit}."
    else:
        share = 100 * (uniform.value - limit) / saved
        needed = (
            f"To reach {limit}, {number(share)} % of the light samples would have to be drawn by"
            " area, at a branch that costs nothing."
        )
    return (
        f"A render of the fog takes {uniform} times as long as built-in with `{UNIFORM}`, and"
        f" {area} with `area`. {needed}\n\n"
        f"Where every lamp is that far away, a draw would take {number(draw.value)} of its time. A"
        f" render with as many light samples as the fog would take {best} % less time at best.\n"
    )


# ---- Limits that tests hold ----

# What, limit, and the file and name of the test
STRATEGY_TESTS = "tests/sampling/test_strategies.py"
TESTED = (
    (
        "solid angle of extreme planar lights",
        "relative error of ten times what rounding the input costs, or 1e-6",
        "tests/geometry/test_cone.py",
        "test_solid_angle_at_the_extremes",
    ),
    (
        "solid angle of extreme ellipsoids",
        "relative error of 1e-6",
        "tests/geometry/test_ellipsoid.py",
        "test_solid_angle_at_the_extremes",
    ),
    (
        "density of a draw by `solid_angle`, computed again",
        "99.9 % within 1e-3, and within 1e-4 where the light is wider than 1e-3",
        STRATEGY_TESTS,
        "test_density_is_that_of_the_draw",
    ),
    (
        "density of `solid_angle` at the extremes",
        "within 5 % of uniform",
        STRATEGY_TESTS,
        "test_uniform_in_solid_angle_at_the_extremes",
    ),
    (
        "irradiance, strategies by solid angle",
        "bias of 1e-4 beyond the statistical error",
        STRATEGY_TESTS,
        "test_irradiance_is_unbiased",
    ),
    (
        "a render in passes",
        "traced once",
        "tests/rendering/test_passes.py",
        "test_passes_average_to_renders_of_mitsuba_and_are_recorded_once",
    ),
    (
        "a group",
        "at most one callable more with 64 lamps than with 9",
        "tests/plugins/test_grouping.py",
        "test_kernels_do_not_grow_with_the_number_of_lamps",
    ),
    (
        "a group with strata, in pictures of a floor with a ball",
        "no more error than ungrouped",
        "tests/plugins/test_grouping_stratification.py",
        "test_error_with_strata_is_not_larger_than_ungrouped",
    ),
    (
        "a reference of 4 096 samples on a cluster, a worker killed",
        "the local one bit for bit",
        "tests/rendering/test_cluster.py",
        "test_a_reference_is_the_local_one_bit_for_bit_when_a_worker_dies",
    ),
    (
        "a comparison, killed ten times",
        "the results of one that was left alone",
        "tests/study/test_kill.py",
        "test_ten_kills_change_nothing",
    ),
)


def tested() -> str:
    """The limits that a test holds at every change."""
    rows = [[what, limit, f"`{file}`, `{name}`"] for what, limit, file, name in TESTED]
    return table("what | limit | test", rows)
