"""Print what a comparison found, in short."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from ..study.results import Comparison, Measurement

METRIC = "mse_trimmed"
ANY_WIDTH = 10_000  # characters, more than a table needs


def print_summary(comparison: Comparison, console: Console) -> None:
    """Print a row for each strategy: its error, its times and its efficiency with their spreads."""
    first = comparison.strategies[0]
    group: tuple[str, int] | None = None
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("strategy", "spp", "trimmed MSE", "seconds", f"over {first}'s", "efficiency"):
        left = name == "strategy"
        table.add_column(name, justify="left" if left else "right", no_wrap=True)
    for one in comparison.measurements:
        if group != (one.kind, one.first_spp):
            group = one.kind, one.first_spp
            table.add_row(f"{one.kind}, {first} at {one.first_spp} spp", style="italic")
        table.add_row(*_cells(one))
    # Lines longer than a narrow terminal are better than broken cells.
    needed = console.measure(table, options=console.options.update(width=ANY_WIDTH)).maximum
    wide = Console(
        file=console.file,
        width=max(console.width, needed),
        force_terminal=console.is_terminal,
    )
    wide.print(table)
    console.print(
        "In brackets: the shortest and the longest time; the 95 % interval of the efficiency. Rows"
        f" of {first} compare it with itself.",
        style="dim",
    )


def _cells(one: Measurement) -> list[str]:
    seconds, ratio, efficiency = one.seconds, one.ratio, one.efficiency[METRIC]
    return [
        f"  {one.sampling}",
        str(one.spp),
        f"{one.errors[METRIC].mean:.3g}",
        _with_ends(seconds.median, seconds.low, seconds.high, 3),
        _with_ends(ratio.median, ratio.low, ratio.high, 2),
        _with_ends(efficiency.value, efficiency.low, efficiency.high, 2),
    ]


def _with_ends(value: float, low: float, high: float, digits: int) -> str:
    """Return a value with its ends in brackets, which `rich` shall not take for a style."""
    if not low < high:  # NaN from a single seed
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} \\[{low:.{digits}f}, {high:.{digits}f}]"
