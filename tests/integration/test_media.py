"""The light in, around and at the boundary of media, and with surfaces on the ellipse."""

import mitsuba as mi
import numpy as np
import pytest
from conftest import floor_and, lamp
from mi_ellipse.sampling import STRATEGIES

from oracles.ellipse import rotation, translation
from oracles.pictures import assert_same_expectation, render

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

DOWN = rotation([1, 0, 0], 180)
LAMP = translation(0, 0, 1) @ rotation([0, 1, 0], 25) @ DOWN @ np.diag([0.6, 0.3, 1, 1])


def fog(density=0.4, **options):
    return {
        "type": "homogeneous",
        "albedo": {"type": "rgb", "value": [0.9, 0.7, 0.5]},
        "sigma_t": density,
    } | options


def in_fog(sampling):
    """Everything within a box of fog, with a phase function that is not uniform."""
    medium = fog(phase={"type": "hg", "g": 0.5})
    box = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().scale(2.9),
        "bsdf": {"type": "null"},
        "interior": medium,
    }
    return {"lamp": lamp(LAMP, sampling), "box": box}


def around_a_medium(sampling):
    """The lamp covers a ball of fog, outside which there is nothing."""
    ball = {
        "type": "sphere",
        "center": [0, 0, 0.4],
        "radius": 0.4,
        "bsdf": {"type": "null"},
        "interior": fog(5.0),
    }
    return {"lamp": lamp(LAMP, sampling), "ball": ball}


def boundary(sampling):
    """Fog above, none below: the lamp itself divides the two, as the lid of an open ball."""
    matrix = translation(0, 0, 1) @ DOWN @ np.diag([0.6, 0.6, 1, 1])
    above = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([0, 0, 1.9]).scale([2.9, 2.9, 0.9]),
        "bsdf": {"type": "null"},
        "interior": {"type": "ref", "id": "fog"},
    }
    return {
        "fog": fog(1.0),
        "above": above,
        "lamp": lamp(matrix, sampling, interior={"type": "ref", "id": "fog"}),
    }


SITUATIONS = {"in fog": in_fog, "around a medium": around_a_medium, "boundary": boundary}

# Pairwise: situation, integrator, strategy
PAIRWISE = [
    ("in fog", "volpath", "solid_angle"),
    ("in fog", "volpathmis", "projected_solid_angle"),
    ("in fog", "prbvolpath", "rejection"),
    ("in fog", "volpath", "area"),
    ("around a medium", "volpath", "projected_solid_angle"),
    ("around a medium", "volpathmis", "rejection"),
    ("around a medium", "prbvolpath", "solid_angle"),
    ("around a medium", "volpathmis", "area"),
    ("boundary", "volpath", "rejection"),
    ("boundary", "volpathmis", "solid_angle"),
    ("boundary", "prbvolpath", "projected_solid_angle"),
    ("boundary", "prbvolpath", "area"),
    ("in fog", "volpath", "tangent_disk"),
    ("boundary", "volpath", "concentric"),
]


def pictures(situation, integrator, sampling, spp=256):
    lamps = SITUATIONS[situation](sampling)
    integrator = {"type": integrator, "max_depth": 4, "rr_depth": 100}
    return render(mi.load_dict(floor_and(lamps, 8, integrator=integrator)), spp)


@pytest.mark.parametrize(
    ("situation", "integrator", "name"), PAIRWISE, ids=["-".join(row) for row in PAIRWISE]
)
def test_same_picture_as_built_in(situation, integrator, name):
    assert name in STRATEGIES
    got = pictures(situation, integrator, name)
    expected = pictures(situation, integrator, None)
    assert_same_expectation(got, expected, within=0.3)


def test_fog_changes_the_picture():
    """Without this, the comparisons above would say nothing about media."""
    clear = {"lamp": lamp(LAMP, "solid_angle")}
    integrator = {"type": "volpath", "max_depth": 4}
    clear = np.array(mi.render(mi.load_dict(floor_and(clear, 8, integrator=integrator)), spp=256))
    foggy = pictures("in fog", "volpath", "solid_angle").mean(0)
    assert np.abs(foggy - clear).mean() > 0.2 * clear.mean()


BSDFS = {
    "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.9, 0.2, 0.1]}},
    "two-sided conductor": {
        "type": "twosided",
        "bsdf": {"type": "roughconductor", "alpha": 0.3},
    },
    "null": {"type": "null"},
    "thin glass": {"type": "thindielectric"},
    "mask": {
        "type": "mask",
        "opacity": 0.5,
        "bsdf": {"type": "diffuse"},
    },
}


@pytest.mark.parametrize("bsdf", BSDFS)
def test_surface_of_the_lamp(bsdf):
    """It is lit, mirrors or lets through, whatever it emits."""

    def scene(sampling):
        lamps = {
            "lamp": lamp(LAMP, sampling, bsdf=BSDFS[bsdf]),
            "second": {"type": "point", "position": [0, -1, 2.5], "intensity": 3.0},
        }
        return mi.load_dict(floor_and(lamps, 8, depth=4))

    got, expected = (render(scene(s), 256) for s in ("solid_angle", None))
    assert_same_expectation(got, expected, within=0.1)
