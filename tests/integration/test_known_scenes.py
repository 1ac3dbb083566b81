"""Scenes that people know: their lamps are taken over, and the light stays the same.

`scenes/public/README.md` tells how to get them. Where they are missing, these tests are skipped.
"""

import dataclasses
from collections import Counter

import pytest
from mi_ellipse.rendering.scene import parse_scene

from benchmarks import existing
from benchmarks.existing import BUILT_IN, KNOWN, SHOWN
from oracles.pictures import assert_same_expectation, render

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

# What the files hold, counted by hand: spheres or disks that shine, and rectangles that shine
LAMPS = {"Veach MIS": (3, 0), "Modern Hall": (5, 8)}


@pytest.fixture(params=KNOWN)
def name(request):
    """Of a scene that is there."""
    file = KNOWN[request.param].file
    if not file.exists():
        pytest.skip(f"no {file.relative_to(file.parents[3])}: see scenes/public/README.md")
    return request.param


def test_exactly_its_spheres_and_disks_are_converted(name):
    converted, others = LAMPS[name]
    known = KNOWN[name]
    before = known.file.read_bytes()
    conversion = parse_scene(known.file, known.parameters).conversion()
    assert len(conversion.converted) == converted
    assert not conversion.left
    kinds = Counter(type(emitter).__name__ for emitter in known.load(SHOWN).emitters())
    assert kinds == Counter(EllipticalArea=converted, Emitter=others)
    assert known.file.read_bytes() == before


def test_the_converted_scene_has_the_picture_of_the_file(name):
    """Welch's test of each block, 1e-5 for each of the two areas of a scene."""
    small = dataclasses.replace(
        KNOWN[name], parameters=KNOWN[name].parameters | {"resx": "32", "resy": "20"}
    )
    spp = {"Veach MIS": 2048, "Modern Hall": 256}[name]
    pictures = [render(small.load(kind), spp) for kind in (BUILT_IN, SHOWN)]
    assert_same_expectation(*pictures, within=0.15)
    # In the left quarter of "Veach MIS" nothing is as bright as a lamp, so that the test sees more.
    # A group of three lamps that answers without its part of the choice is off by two thirds.
    assert_same_expectation(*(each[:, :, :8] for each in pictures), within=0.1)


def test_without_the_scenes_the_benchmark_measures_nothing_and_says_why(
    monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr(existing, "PUBLIC", tmp_path)
    assert existing.run() is None
    assert "scenes/public/README.md" in capsys.readouterr().out
