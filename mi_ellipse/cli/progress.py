"""Progress: bars on a terminal, and lines now and then elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

# Without a terminal: seconds between two lines, at least; and at most, unless less than this part
# of the work was done meanwhile
SECONDS_BETWEEN_LINES = 10, 300
PART_BETWEEN_LINES = 0.1


class Lines:
    """
    Say how far a work is, in plain lines for a log.

    Parameters
    ----------
    say
        Takes a line.
    name
        Of the work.
    done
        Part of it that was done before, from 0 to 1.
    """

    def __init__(self, say: Callable[[str], None], name: str, done: float = 0.0):
        self._say = say
        self._name = name
        self._start = self._last = time.monotonic(), done

    def update(self, done: float) -> None:
        """Take the part that is done, and say it if there is something new; the end says itself."""
        if done >= 1:
            return
        now = time.monotonic()
        passed, progressed = now - self._last[0], done - self._last[1]
        shortest, longest = SECONDS_BETWEEN_LINES
        if passed < shortest or (passed < longest and progressed < PART_BETWEEN_LINES):
            return
        self._last = now, done
        speed = (done - self._start[1]) / (now - self._start[0])
        left = f", {_clock((1 - done) / speed)} left" if speed > 0 else ""
        self._say(f"{self._name}: {100 * done:.0f} %{left}")


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}"


@contextmanager
def passes_bar(
    console: Console, passes: int, finished: int = 0
) -> Iterator[Callable[[int, int], None]]:
    """
    Show a bar with the remaining time, or elapsed time alone where a single pass tells no more.

    Nothing is known about a pass before it ends. `finished` passes were done before.
    """
    lines = Lines(_plainly(console), "Rendering", finished / passes)
    columns: list[ProgressColumn] = [
        SpinnerColumn(),
        TextColumn("Rendering"),
        TimeElapsedColumn(),
    ]
    if passes > 1:
        columns += [BarColumn(), TextColumn("{task.percentage:3.0f} %,"), TimeRemainingColumn()]
        columns += [TextColumn("left")]
    hidden = not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        # An interrupt can end the process at once and must not leave a terminal without a cursor.
        console.show_cursor(True)
        task = bar.add_task("", total=passes if passes > 1 else None, completed=finished)

        def report(done: int, total: int) -> None:
            bar.update(task, completed=done)
            if hidden:
                lines.update(done / total)

        yield report


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
    hidden = not console.is_terminal
    with Progress(*columns, console=console, disable=hidden) as bars:
        console.show_cursor(True)
        tasks: dict[str, TaskID] = {}
        lines: dict[str, Lines] = {}

        def report(step: str, done: int, total: int) -> None:
            if step not in tasks:
                tasks[step] = bars.add_task(step, total=total)
                lines[step] = Lines(_plainly(console), step.capitalize(), done / total)
            bars.update(tasks[step], completed=done, total=total)
            if hidden:
                lines[step].update(done / total)

        yield report


def _plainly(console: Console) -> Callable[[str], None]:
    return lambda text: console.print(text, markup=False, highlight=False, soft_wrap=True)
