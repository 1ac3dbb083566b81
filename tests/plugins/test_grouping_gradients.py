"""Gradients through grouped lamps: of a radiance and of a place, forward."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from lamp_groups import PATH, load, ring, two

from oracles.pictures import assert_same_expectation, render

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

PRB = {"type": "prb", "max_depth": 3}
PROJECTIVE = {"type": "prb_projective", "max_depth": 2, "sppi": 1024, "guiding": "none"}
SEEDS = range(1, 7)  # Mitsuba takes another seed for 0


def nine():
    return ring(9)


def forward(scene, name, dependence, seed):
    """Derivative of the picture with respect to a number that a parameter depends on."""
    parameters = mi.traverse(scene)
    t = mi.Float(0)
    dr.enable_grad(t)
    parameters[name] = dependence(parameters[name], t)
    parameters.update()
    picture = mi.render(scene, parameters, spp=256, seed=seed + 1000, seed_grad=seed)
    dr.forward(t)
    return np.array(dr.grad(picture))


# ---- Radiance ----


def by_radiance(lamps, integrator, name, seed=1):
    """Of a picture of grouped lamps with respect to a factor of one lamp's radiance."""
    scene = load(lamps, True, below=True, integrator=integrator)
    return forward(
        scene, f"{name}.emitter.radiance.value", lambda value, t: mi.Color3f(value) * (1 + t), seed
    )


CASES = [(two, PATH), (two, PRB), (nine, PRB)]
each_case = pytest.mark.parametrize(
    ("lamps", "integrator"), CASES, ids=["two-path", "two-prb", "tree-prb"]
)


@each_case
def test_gradients_of_all_radiances_give_the_picture(lamps, integrator):
    """A picture is linear in the radiances, if the draws are the same and the choice is detached.

    So radiances times derivatives add up to the picture of the same random numbers (Euler).
    """
    lamps = lamps()
    got = sum(by_radiance(lamps, integrator, name) for name in lamps)
    scene = load(lamps, True, below=True, integrator=integrator)
    expected = np.array(mi.render(scene, spp=256, seed=1))
    assert expected.min() > 0
    # Sums of some thousand samples in single precision, in another order
    np.testing.assert_allclose(got, expected, rtol=1e-4)


@each_case
def test_gradient_of_a_radiance_is_the_picture_of_that_lamp(lamps, integrator):
    """Welch's test of each block against an ungrouped scene whose other lamps are dark."""
    lamps = lamps()
    name = list(lamps)[1]
    got = np.array([by_radiance(lamps, integrator, name, seed) for seed in SEEDS])
    for other in lamps.keys() - {name}:
        lamps[other]["emitter"]["radiance"] = 0.0
    expected = render(load(lamps, False, below=True, integrator=integrator), 4096)
    # Without its part of the choice a lamp is off by a fourth at least.
    assert_same_expectation(got, expected, within=0.1)


# ---- Place ----


def by_place(lamps, grouped, below, name, seed):
    """Of a picture with respect to a shift of a lamp along the floor."""
    scene = load(lamps, grouped, below=below, integrator=PROJECTIVE)

    def shifted(to_world, t):
        return mi.Transform4f().translate([t, 0, 0]) @ to_world

    return forward(scene, f"{name}.to_world", shifted, seed)


@pytest.mark.parametrize(
    ("lamps", "below", "within"),
    [(two, True, 0.5), (nine, False, 0.1)],
    ids=["two-light-on-the-floor", "tree-seen-from-above"],
)
def test_gradient_of_a_place_is_that_of_ungrouped_lamps(lamps, below, within):
    """Welch's test of each block. The light on the floor is noisy: boundaries are rarely hit."""
    lamps = lamps()
    name = next(iter(lamps))
    got, expected = (
        np.array([by_place(lamps, grouped, below, name, seed + 50 * grouped) for seed in SEEDS])
        for grouped in (True, False)
    )
    assert_same_expectation(got, expected, within)
