"""Keep in a folder what its comparison is made from, and tell what has changed since."""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import mitsuba as mi

from ..files import images, sealed
from ..rendering.scene import parse_scene
from .checks import Request
from .gallery import settings
from .reference import Half

FILE = "made_from.json"
DIGEST = "scene_digest"


@dataclass(frozen=True)
class Origin:
    """What two pictures must have in common to be compared, in words that show a change."""

    settings: dict[str, str]  # see `gallery.settings`
    parameters: dict[str, str]
    scene: list[str]  # lines of the scene as Mitsuba writes it: without comments, with includes
    files: dict[str, str]  # digests of the meshes, textures, … by their names

    @classmethod
    def of(cls, request: Request) -> Origin:
        """Return the origin of a comparison, in the current variant."""
        parsed = parse_scene(request.scene_file, request.parameters)
        files = {
            file.name: hashlib.sha256(file.read_bytes()).hexdigest()
            for _, file in parsed.named_files()
        }
        lines = str(mi.parser.write_string(parsed.state)).splitlines()
        shared = settings(request.scene_file, request.parameters, request.changes)
        return cls(shared, dict(request.parameters), lines, files)

    def changes(self, before: Origin) -> list[str]:
        """Return what is another than it was, in words."""
        if self.settings == before.settings:
            return []
        found = _changes_of_values("parameter ", before.parameters, self.parameters)
        found += _changes_of_lines(before.scene, self.scene)
        found += [
            f"the file {name} is another one"
            for name in sorted(self.files)
            if before.files.get(name, self.files[name]) != self.files[name]
        ]
        others = _changes_of_settings(before.settings | {DIGEST: ""}, self.settings | {DIGEST: ""})
        return found + others


def claim(folder: Path, now: Origin) -> list[str]:
    """
    Make sure that all in a folder has this origin, and note it in the folder.

    Returns
    -------
    list of str
        Names of files that were damaged and are made again.

    Raises
    ------
    ValueError
        If the scene, a parameter, the variant or a version has changed since; nothing is written.
    """
    file = folder / FILE
    damaged, before = [], None
    try:
        before = Origin(**sealed.read_json(file))
    except FileNotFoundError:
        pass
    except ValueError:
        damaged.append(FILE)

    changes = now.changes(before) if before else _changes_of_pictures(folder, now)
    changes = changes or _changes_of_halves(folder, now)
    if changes:
        raise ValueError(
            f"the scene has changed since {folder} was made: {'; '.join(changes)}. Nothing was"
            " written. Name another output folder, or remove this one to begin anew"
        )
    if before is None:
        sealed.write_json(file, asdict(now))
    return damaged


def _changes_of_pictures(folder: Path, now: Origin) -> list[str]:
    """Return what the pictures of a folder say of the scene's changes, where nothing else does."""
    for file in sorted(folder.glob("pictures/*_seed*.exr")):
        try:
            found = images.read_metadata(file)
            parameters = json.loads(found["parameters"])
        except (ValueError, OSError, KeyError):
            continue  # A damaged picture is rendered again.
        changes = _changes_of_values("parameter ", parameters, now.parameters)
        if differing := _changes_of_settings(found, now.settings):
            return changes or differing
    return []


def _changes_of_halves(folder: Path, now: Origin) -> list[str]:
    """Return what the halves of a reference say of changes; they are never made from two scenes."""
    for file in sorted(folder.glob("reference/half_?.npz")):
        try:
            found = json.loads(Half.read(file).settings)
        except ValueError:
            continue  # A damaged half is rendered again.
        if changes := _changes_of_settings(found, now.settings):
            return changes
    return []


# ---- Words ----


def _changes_of_values(what: str, before: Mapping[str, str], after: Mapping[str, str]) -> list[str]:
    absent = "not given"
    return [
        f"{what}{name} was {before.get(name, absent)} and is {after.get(name, absent)}"
        for name in sorted({*before, *after})
        if before.get(name) != after.get(name)
    ]


def _changes_of_lines(before: list[str], after: list[str]) -> list[str]:
    """Return the first line that differs, and how many more there are."""
    lines = list(difflib.unified_diff(before, after, n=0, lineterm=""))[2:]
    removed, added = ([line[1:].strip() for line in lines if line[0] == sign] for sign in "-+")
    if not removed and not added:
        return []
    first = [f"{removed[0]} was removed"] if removed else []
    first += [f"{added[0]} was added"] if added else []
    if removed and added:
        first = [f"{removed[0]} became {added[0]}"]
    more = max(len(removed), len(added)) - 1
    return [first[0] + (f", and {more} more lines" if more else "")]


def _changes_of_settings(before: Mapping[str, str], after: Mapping[str, str]) -> list[str]:
    """Return what differs among settings; of the scene they know a digest alone."""
    changes = []
    if before.get(DIGEST) != after[DIGEST]:
        changes.append("its file, a file that it names or a parameter is another one")
    names = [name for name in after if name != DIGEST]
    return changes + _changes_of_values(
        "", {name: before[name] for name in names if name in before}, {n: after[n] for n in names}
    )
