"""Names of what is compared: a strategy, and whether lamps choose among themselves."""

from __future__ import annotations

UNGROUPED = "+ungrouped"


def split(name: str) -> tuple[str, bool]:
    """Return the strategy in a name, and whether lamps choose among themselves."""
    return name.removesuffix(UNGROUPED), not name.endswith(UNGROUPED)


def ungrouped(name: str) -> str:
    """Return the name of a strategy where Mitsuba chooses the lamp."""
    return name.removesuffix(UNGROUPED) + UNGROUPED
