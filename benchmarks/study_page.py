"""Tables and sentences of `docs/study.md` whose numbers were measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial

from .study import ALL, BUILT_IN, CASES, OURS, UNGROUPED
from .text import data, number, span, table

# Guillén et al. 2017, root of the MSE in fog; its unit is not known.
PUBLISHED = {"16": (5.6, 4.9, 4.65), "32": (5.23, 4.4, 4.1), "128": (4.47, 3.86, 3.42)}

ONE_LAMP = ("fog", "dragon")  # Nothing to choose


def interval(of: Mapping[str, float], digits: int = 3) -> str:
    """A value with the ends of its 95 % interval."""
    return "{} [{}, {}]".format(*(number(of[key], digits) for key in ("value", "low", "high")))


def widest(values: Iterable[Mapping[str, float]]) -> str:
    """How far the intervals of some values reach at most, in percent."""
    reach = max(max(of["high"] / of["value"], of["value"] / of["low"]) - 1 for of in values)
    return f"{number(100 * reach)} %"


def shown(name: str, several: bool = True) -> str:
    """How a table calls a strategy."""
    if name == BUILT_IN:
        return "built-in"
    strategy = name.removesuffix(UNGROUPED)
    return f"`{strategy}`" + (", grouped" if several and strategy == name else "")


# ---- Scenes ----


def command(case: str) -> str:
    """What makes a comparison, as a block of code."""
    return f"\n    {data('study')[case]['command']}\n\n"


def errors(case: str) -> str:
    """How many times lower the errors are than built-in's, by strategy and samples."""
    measured = data("study")[case]
    strategies, counts = measured["strategies"], list(measured["strategies"][BUILT_IN])
    rows = [
        [
            shown(name, case not in ONE_LAMP),
            *(number(entries[count]["lower"]["value"], 3) for count in counts),
            number(entries[counts[-1]]["typical_lower"]["value"], 3),
            "{median:.2f}".format(**entries[counts[-1]]["time"]),
            interval(entries[counts[-1]]["efficiency"]),
        ]
        for name, entries in strategies.items()
        if name != BUILT_IN
    ]
    reach = widest(entry["lower"] for own in strategies.values() for entry in own.values())
    heads = " | ".join(f"{count} spp" for count in counts)
    sentences = [
        f"{measured['seeds']} seeds; the 95 % intervals of the errors reach {reach} to either side",
        f"at most. The last three columns are those at {counts[-1]} samples. The reference has",
        f"{measured['reference_spp']} samples.\n",
    ]
    rows = table(f"lamps | {heads} | typical pixel | time | gain", rows)
    return rows + "\n" + " ".join(sentences)


def fog_published() -> str:
    """Root of the MSE over that of built-in, beside the published ratios."""
    strategies = data("study")["fog"]["strategies"]
    columns = ("rejection", "solid_angle", "projected_solid_angle")
    rows = []
    for count, (area, *others) in PUBLISHED.items():
        row = [count]
        for name, published in zip(columns, [*others, None], strict=True):
            own = 1 / strategies[name][count]["rmse_lower"]["value"]
            row.append(f"{own:.3f}" + (f" ({published / area:.2f})" if published else ""))
        rows.append(row)
    heads = " | ".join(f"`{name}`" for name in columns)
    return table(f"samples per pixel | {heads}", rows)


# ---- What the choice of the lamp hid ----


def parts() -> str:
    """How many times lower the bunny's errors are than built-in's, by lights and samples."""
    measured, rows, values = data("study")["parts"], [], []
    for lights, by_samples in measured["lights"].items():
        for samples, own in by_samples.items():
            several = ALL[0] + UNGROUPED in own
            marks = {UNGROUPED: ", ungrouped", "": ", grouped"} if several else {"": ""}
            for mark, how in marks.items():
                of = [own[name + mark]["lower"] for name in ALL]
                values += of
                cells = (number(one["value"], 3) for one in of)
                rows.append([f"{lights}, {samples}{how}", *cells])
    heads = " | ".join(f"`{name}`" for name in ALL)
    return (
        table(f"lights, samples | {heads}", rows)
        + f"\n{measured['spp']} samples per pixel, {measured['seeds']} seeds; the 95 % intervals"
        f" reach {widest(values)} to either side at most.\n"
    )


def over_area(lights: str, samples: str, strategy: str, mark: str = "") -> float:
    """How many times lower the error of a strategy is than that of `area`, lamps chosen alike."""
    own = data("study")["parts"]["lights"][lights][samples]
    return own["area" + mark]["trimmed"] / own[strategy + mark]["trimmed"]


def hidden() -> str:
    """What a strategy gains on `area`: Mitsuba picks the lamp, lamps choose, or there is one."""
    rows = [
        [
            f"`{strategy}`, {samples}",
            number(over_area("two circles", samples, strategy, UNGROUPED), 3),
            number(over_area("two circles", samples, strategy), 3),
            number(over_area("one circle", samples, strategy), 3),
        ]
        for strategy in OURS
        for samples in ("light samples", "MIS")
    ]
    return table("over `area` | Mitsuba picks the lamp | lamps choose | one lamp", rows)


# ---- Claims ----


def target() -> str:
    """Whether 256 samples of built-in are reached in half of its time."""
    own = data("study")["bunny"]["strategies"]
    sentences = []
    for name in (*(one + UNGROUPED for one in OURS), *OURS):
        of = own[name]["256"]["efficiency"]
        if of["low"] > 2:
            verdict = "reaches it"
        else:
            verdict = "does not reach it" if of["high"] < 2 else "is at it, within the error"
        sentences.append(f"* {shown(name)}: {interval(of)}. It {verdict}.")
    return "\n".join(sentences) + "\n"


def ranges() -> str:
    """Times of whole renders over built-in's, from the benchmark of paired times."""
    times = data("render_time").values()
    return table(
        "strategy | time of a render over built-in, over all scenes",
        [[f"`{name}`", span(one["ratios"][name]["median"] for one in times)] for name in OURS],
    )


BLOCKS: dict[str, Callable[[], str]] = {
    **{f"study_{case.name}": partial(errors, case.name) for case in CASES},
    **{f"study_command_{case.name}": partial(command, case.name) for case in CASES},
    "study_fog_published": fog_published,
    "study_parts": parts,
    "study_hidden": hidden,
    "study_target": target,
    "study_times": ranges,
}
