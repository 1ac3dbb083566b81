"""Progress bars."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


@contextmanager
def passes_bar(console: Console, passes: int) -> Iterator[Callable[[int, int], None]]:
    """
    Show a bar with the remaining time, or elapsed time alone where a single pass tells no more.

    Nothing is known about a pass before it ends.
    """
    columns: list[ProgressColumn] = [
        SpinnerColumn(),
        TextColumn("Rendering"),
        TimeElapsedColumn(),
    ]
    if passes > 1:
        columns += [BarColumn(), MofNCompleteColumn(), TextColumn("passes,"), TimeRemainingColumn()]
        columns += [TextColumn("left")]
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        # An interrupt ends the process at once and must not leave a terminal without a cursor.
        console.show_cursor(True)
        task = bar.add_task("", total=passes if passes > 1 else None)
        yield lambda done, total: bar.update(task, completed=done)


@contextmanager
def step_bars(console: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar with the remaining time for each step of a longer work."""
    columns = [
        TextColumn("{task.description:<13}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %,"),
        TimeRemainingColumn(),
        TextColumn("left"),
    ]
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        console.show_cursor(True)
        tasks: dict[str, TaskID] = {}

        def report(step: str, done: int, total: int) -> None:
            if step not in tasks:
                tasks[step] = bars.add_task(step, total=total)
            bars.update(tasks[step], completed=done, total=total)

        yield report
