"""Figures: where the enlarged regions and the labels of the lines lie, and what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest
from comparisons import run
from mi_ellipse.sampling import STRATEGIES
from mi_ellipse.study import drawing
from mi_ellipse.study.drawing import curves, style

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


def test_insets_lie_where_the_strategies_differ():
    reference = np.full((60, 80, 3), 0.8)
    good, bad = reference.copy(), reference.copy()
    bad[10:20, 30:40] += 0.1
    bad[40:50, 60:70] += 0.05
    good[:, :10] += 0.2  # both are wrong here
    bad[:, :10] += 0.2
    comparison = SimpleNamespace(
        strategies=("good", "bad"),
        exposure=0.0,
        reference_image=lambda: reference,
        series=lambda name: [name],
        image=lambda name: {"good": good, "bad": bad}[name],
    )
    assert drawing.choose_insets(comparison) == [(30, 10, 10, 10), (60, 40, 10, 10)]


@pytest.mark.parametrize(
    ("insets", "message"),
    [
        ([(20, 2, 5, 5)], "20,2,5,5 is not inside the picture of 24 × 16"),
        ([(1, 2, 5, 0)], "not inside"),
        ([(1, 2, 5, 5)] * 5, "5 insets"),
    ],
)
def test_impossible_insets_are_refused(finished, insets, message):
    comparison = run(
        finished.scene_file, finished.folder, reference_spp=64, parameters={"radiance": "2"}
    )
    with pytest.raises(ValueError, match=message):
        drawing.write_figures(comparison, insets)


def test_labels_are_spread_no_further_than_needed():
    apart = np.array([0.1, 0.5, 0.9])
    np.testing.assert_allclose(curves._spread(apart, 0.1, 0, 1), apart)
    together = curves._spread(np.array([0.5, 0.5, 0.5]), 0.1, 0, 1)
    np.testing.assert_allclose(together, [0.4, 0.5, 0.6])
    low = curves._spread(np.array([0.0, 0.0, 0.5]), 0.1, 0, 1)
    np.testing.assert_allclose(low, [0, 0.1, 0.5])
    high = curves._spread(np.array([0.2, 1.0, 1.0]), 0.1, 0, 1)
    np.testing.assert_allclose(high, [0.2, 0.9, 1.0])


def test_ungrouped_lamps_have_a_label_and_a_colour_of_their_own():
    assert style.label_of("solid_angle+ungrouped") == "solid angle, ungrouped"
    colours = [style.style_of(name)[0] for name in STRATEGIES]
    colours += [style.style_of(f"{name}+ungrouped")[0] for name in STRATEGIES]
    assert len(set(colours)) == 2 * len(STRATEGIES)
