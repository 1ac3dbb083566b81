"""The gallery shows every scene, and its commands run."""

import re
import shlex
from pathlib import Path

import pytest
from commands import invoke

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
SCENES = sorted(path.stem for path in (ROOT / "scenes").glob("*.xml"))
ROW = re.compile(
    r"^\| !\[[^\]]+\]\((?P<picture>[^)]+)\) \| \*\*[^*]+\*\* .+"
    r" `mi-ellipse (?P<command>render scenes/(?P<scene>\w+)\.xml [^`]+)`"
    r" .*\]\(.+\.(?:md|ipynb).*\|$",
    re.MULTILINE,
)


def rows():
    return {row["scene"]: row for row in ROW.finditer(PAGE)}


def test_every_scene_has_a_row():
    assert sorted(rows()) == SCENES
    for scene, row in rows().items():
        assert row["picture"] == f"images/scenes/{scene}.png"
        assert (ROOT / "docs" / row["picture"]).stat().st_size > 10_000


@pytest.mark.parametrize("scene", SCENES)
def test_command_runs(scene, tmp_path):
    """With one sample, and a twentieth of the width and height."""
    arguments = shlex.split(rows()[scene]["command"])
    for option, smaller in (("--spp", "1"), ("--resolution", "16x12")):
        arguments[arguments.index(option) + 1] = smaller
    arguments[1] = str(ROOT / arguments[1])
    result = invoke(*arguments, "-o", tmp_path / f"{scene}.exr")
    assert result.exit_code == 0, result.output
    assert (tmp_path / f"{scene}.png").stat().st_size > 0
