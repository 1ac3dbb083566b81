"""Put away what earlier runs left in the folder of a comparison; nothing is deleted but remains."""

from __future__ import annotations

import os
import re
from collections.abc import Collection
from pathlib import Path

from .metrics import METRICS

# Beside the folders of pictures and figures; it has the same two.
EARLIER = "earlier"

_CURVES = "|".join(["time", *(f"{name}_against_(samples|time)" for name in METRICS)])

# Names that comparisons give. Other files are the user's own and stay where they are.
NAMES = {
    "pictures": re.compile(r"([^.].*_\d+spp_seed\d+|all_\d+spp)\.(exr|png)"),
    "figures": re.compile(rf"(pictures_equal_(samples|time)_\d+spp|{_CURVES})\.(png|pdf|svg)"),
}
REST = re.compile(
    r"results\.(csv|json)|report\.html|made_from\.json|slow_metrics\.json|times\.json"
    r"|half_[12]\.(npz|exr)|reference\.(exr|png)"
)

# Of `atomic.replacement`
_TEMPORARY = re.compile(r"\.(?P<stem>.+)\.\d+(?P<suffix>\.[a-z]+)")


def put_away(folder: Path, kept: Collection[Path]) -> int:
    """
    Move the pictures or figures of a folder that are not `kept` to those of earlier runs.

    Parameters
    ----------
    folder
        ``pictures`` or ``figures`` of a comparison.
    kept
        Files that belong to its results.

    Returns
    -------
    int
        How many files were moved. An older one of the same name is replaced.
    """
    names = {file.name for file in kept}
    moved = [
        file
        for file in sorted(folder.iterdir())
        if NAMES[folder.name].fullmatch(file.name) and file.name not in names
    ]
    for file in moved:
        place = _earlier(file)
        place.parent.mkdir(parents=True, exist_ok=True)
        os.replace(file, place)
    return len(moved)


def fetch(file: Path) -> None:
    """Move a file of earlier runs back to its place, if it is not there."""
    if not file.exists() and _earlier(file).is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        os.replace(_earlier(file), file)


def remove_remains(folder: Path) -> None:
    """Delete half-written files that a killed run left in the folder of a comparison."""
    for file in [*folder.glob(".*"), *folder.glob("*/.*")]:
        found = _TEMPORARY.fullmatch(file.name)
        if found and _is_ours(found["stem"] + found["suffix"]):
            file.unlink()


def _is_ours(name: str) -> bool:
    return any(pattern.fullmatch(name) for pattern in (*NAMES.values(), REST))


def _earlier(file: Path) -> Path:
    return file.parent.parent / EARLIER / file.parent.name / file.name
