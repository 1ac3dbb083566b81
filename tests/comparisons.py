"""Comparisons on a tiny scene, made once for many tests, and what those tests need."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest
from conftest import SMALL_SCENE, SMALL_SIZE
from mi_ellipse import cli
from mi_ellipse.files.lock import LOCK
from mi_ellipse.rendering import passes
from mi_ellipse.study import Comparison, compare
from mi_ellipse.study.reference import Reference, render_reference
from typer.testing import CliRunner

STRATEGIES = ("area", "solid_angle")
SPP = (2, 8)
SEEDS = 2


def run(
    scene_file: Path, folder: Path, said: list[str] | None = None, **changes: object
) -> Comparison:
    """Compare, with some settings changed; `said` takes the sentences for the user."""
    settings = {"strategies": STRATEGIES, "spp": SPP, "reference_spp": 16, "seeds": SEEDS}
    say = (said if said is not None else []).append
    return compare(scene_file, folder, **(settings | changes), say=say)


def reference_of(
    scene_file: Path, folder: Path, spp: int, said: list[str] | None = None, **options: object
) -> Reference:
    """Render a reference, four samples per pixel in each pass unless the options say otherwise."""
    width, height = SMALL_SIZE
    return render_reference(
        folder,
        scene_file,
        {},
        spp,
        lambda done, total: None,
        (said if said is not None else []).append,
        **{"samples_per_pass": width * height * 4, **options},
    )


def arguments_of(scene_file: Path, folder: Path) -> Sequence[str]:
    """Return the command that makes `finished`."""
    return [
        "compare", str(scene_file), "--sampling", ",".join(STRATEGIES), "--spp", "8,2",
        "--reference-spp", "64", "--seeds", str(SEEDS), "-o", str(folder), "-D", "radiance=2",
        "--inset", "1,2,6,5",
    ]  # fmt: skip


def read(file: Path) -> np.ndarray:
    """Pixels of a picture, as Mitsuba reads them."""
    return np.array(mi.Bitmap(str(file)))


def contents(folder: Path) -> dict[str, bytes]:
    """What the files of a folder hold, apart from the lock."""
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file() and file.name != LOCK
    }


@pytest.fixture
def small_scene(tmp_path):
    """The file of a scene that renders in no time."""
    file = tmp_path / "scene.xml"
    file.write_text(SMALL_SCENE)
    return file


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """A comparison made by the command: its folder, its scene and what it printed."""
    folder = tmp_path_factory.mktemp("comparison")
    (folder / "scene.xml").write_text(SMALL_SCENE)
    result = CliRunner().invoke(cli.app, arguments_of(folder / "scene.xml", folder / "out"))
    assert result.exit_code == 0, result.output
    return SimpleNamespace(folder=folder / "out", scene_file=folder / "scene.xml", result=result)


@pytest.fixture
def count_renders(monkeypatch):
    """The (spp, seed) of every render from now on; `stop_after` ones, the next is interrupted."""
    calls = SimpleNamespace(made=[], stop_after=None)
    original = passes.render

    def counting(scene, spp=None, seed=0, *arguments):
        if calls.stop_after is not None and len(calls.made) >= calls.stop_after:
            raise KeyboardInterrupt
        calls.made.append((spp, seed))
        return original(scene, spp, seed, *arguments)

    monkeypatch.setattr(passes, "render", counting)
    return calls
