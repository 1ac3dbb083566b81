"""Grouped lamps in the scalar variant, against the same in arrays and against ungrouped ones."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scipy.stats
from lamp_groups import LIGHT_ONLY, PATH, load, ring, solids, two, weighted

from oracles.pictures import SIGNIFICANCE, render

CASES = {
    "two": (two, LIGHT_ONLY),
    "two with MIS": (lambda: two("projected_solid_angle", "area"), PATH),
    "weighted": (weighted, LIGHT_ONLY),
    "tree": (lambda: ring(9), LIGHT_ONLY),
    "solids": (solids, LIGHT_ONLY),
}
every_case = pytest.mark.parametrize("case", CASES, ids=[name.replace(" ", "-") for name in CASES])


@every_case
def test_same_picture_as_ungrouped(case):
    """Welch's test of the mean of each channel, 1e-5 a case. It sees errors of a tenth."""
    lamps, integrator = CASES[case]
    mi.set_variant("scalar_rgb")
    got = render(load(lamps(), True, 4, below=True, integrator=integrator), 4, 32)
    mi.set_variant("llvm_ad_rgb")
    expected = render(load(lamps(), False, 4, below=True, integrator=integrator), 256, 32)
    got, expected = (pictures.mean((1, 2), dtype=float) for pictures in (got, expected))
    result = scipy.stats.ttest_ind(got, expected, equal_var=False)
    low, high = result.confidence_interval(1 - SIGNIFICANCE / 3)
    # A lamp that answers without its part of the weights is off by that much.
    print((high - low) / 2 / expected.mean(0), (got.mean(0) / expected.mean(0) - 1))
    assert ((high - low) / 2 < 0.1 * expected.mean(0)).all()
    assert (result.pvalue > SIGNIFICANCE / 3).all()


def draw(scene, point, number):
    """Distance and density of a draw, its weight, and the density again, in rows."""
    it = dr.zeros(mi.SurfaceInteraction3f, 1)
    it.p, it.n = mi.Point3f(*point), mi.Normal3f(0, 0, 1)
    ds, weight = scene.sample_emitter_direction(it, mi.Point2f(*number), test_visibility=False)
    again = scene.pdf_emitter_direction(it, ds)
    return np.array([ds.dist, ds.pdf, *weight, again]).reshape(6, -1)


@every_case
def test_draws_are_those_of_arrays(case):
    """The same random numbers give the same answers, up to the rounding of single precision."""
    lamps, _ = CASES[case]
    rng = np.random.default_rng(5)
    points = np.float32(rng.uniform([-2, -2, 0], [2, 2, 0.3], (128, 3))).tolist()
    numbers = rng.random((128, 2), dtype=np.float32).tolist()
    mi.set_variant("scalar_rgb")
    scene = load(lamps(), True)
    got = np.concatenate([draw(scene, *row) for row in zip(points, numbers, strict=True)], axis=1)
    mi.set_variant("llvm_ad_rgb")
    expected = draw(load(lamps(), True), np.transpose(points), np.transpose(numbers))
    assert (expected[1] > 0).mean() > 0.5
    # One draw of a hundred may be at the border of two lamps, or near a rim.
    close = np.isclose(got, expected, rtol=2e-3).all(0)
    assert close.mean() > 0.98
