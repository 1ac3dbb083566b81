"""The scenes of the project that have several lamps: grouped and not, the same picture."""

from pathlib import Path

import mi_ellipse
import mitsuba as mi
import pytest

from oracles.pictures import assert_same_expectation, render

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

SCENES = Path(__file__).parents[2] / "scenes"
SEVERAL = [
    file.stem
    for file in sorted(SCENES.glob("*.xml"))
    if file.read_text().count('type="ellipticalarea"') > 1
]


def test_there_are_such_scenes():
    assert {"bulbs", "bunny", "panel"} <= set(SEVERAL)


@pytest.mark.parametrize("name", SEVERAL)
def test_same_picture_as_ungrouped(name):
    """Welch's test of each block, 1e-5 a scene."""
    pictures = []
    for grouped in (True, False):
        scene = mi.load_file(str(SCENES / f"{name}.xml"), resx=16, resy=16)
        if grouped:
            assert len(mi_ellipse.group_lamps(scene)) > 1
        pictures.append(render(scene, 512))
    # A lamp that answers without its part of the choice is off by half.
    assert_same_expectation(*pictures, within=0.1)
