"""Names of what is compared: a strategy, and whether lamps choose among themselves."""

from __future__ import annotations

from ..rendering.rewrite import BUILT_IN

UNGROUPED = "+ungrouped"


def split(name: str) -> tuple[str, bool]:
    """
    Return the strategy in a name, as a job takes it, and whether lamps choose among themselves.

    A name gives single lamps their own strategies, by their ids, with ``+`` where a job has a
    comma: ``ceiling=projected_solid_angle+solid_angle``.
    """
    strategy = name.removesuffix(UNGROUPED)
    if "=" in strategy:
        strategy = strategy.replace("+", ",")
    return strategy, not name.endswith(UNGROUPED)


def ungrouped(name: str) -> str:
    """Return the name of a strategy where Mitsuba chooses the lamp, as it does for its own."""
    return name if name == BUILT_IN else name.removesuffix(UNGROUPED) + UNGROUPED
