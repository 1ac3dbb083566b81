"""The errors of a picture, against values worked out by hand."""

import numpy as np
import pytest
from comparisons import read, run
from mi_ellipse.study import drawing, metrics, results
from mi_ellipse.study.report import write_report

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

SHAPE = (20, 50, 3)  # 3000 values, of which the worst 3 are left out when trimmed


@pytest.fixture
def reference():
    return np.random.default_rng(1).uniform(0.5, 1.5, SHAPE)


def test_errors_of_a_constant_offset(reference):
    errors = metrics.errors(reference + 0.1, reference)
    assert errors["mse"] == pytest.approx(0.01)
    assert errors["rmse"] == pytest.approx(0.1)
    assert errors["mse_trimmed"] == pytest.approx(0.01)
    relative = [0.01 / (r**2 + 0.01 * reference.mean() ** 2) for r in reference.ravel()]
    assert errors["relative_mse"] == pytest.approx(sum(relative) / 3000)
    assert errors["relative_mse_trimmed"] == pytest.approx(sum(sorted(relative)[:-3]) / 2997)


def test_trimming_leaves_out_the_worst_values_only(reference):
    image = reference + 0.1
    image[3, 4] += 100.0  # three values
    errors = metrics.errors(image, reference)
    assert errors["mse"] > 9
    assert errors["mse_trimmed"] == pytest.approx(0.01)
    assert errors["rmse_trimmed"] == pytest.approx(0.1)
    image[7, 8, 0] += 100.0  # the fourth
    assert metrics.errors(image, reference)["mse_trimmed"] > 3


def test_relative_error_does_not_change_with_brightness(reference):
    reference[:5] = 0  # where only ε keeps it finite
    image = reference + 0.01
    dark = metrics.errors(1e-3 * image, 1e-3 * reference)
    bright = metrics.errors(image, reference)
    assert dark["relative_mse"] == pytest.approx(bright["relative_mse"])
    assert dark["mse"] == pytest.approx(1e-6 * bright["mse"])


def test_single_precision_pictures_are_compared_in_double():
    reference = np.full(SHAPE, 1e-30, dtype=np.float32)
    assert metrics.errors(2 * reference, reference)["mse"] == pytest.approx(1e-60)


def test_reference_errors_are_those_of_the_mean_of_the_halves():
    truth = np.ones((200, 200, 3))
    first, second = truth + 0.02 * np.random.default_rng(2).normal(size=(2, *truth.shape))
    estimated = metrics.reference_errors(first, second)
    actual = metrics.errors((first + second) / 2, truth)
    for name in (one.name for one in metrics.METRICS.values() if one.squared):
        assert estimated[name] == pytest.approx(actual[name], rel=0.03)
    assert estimated["mse"] == pytest.approx(0.0002, rel=0.03)


def test_flip(reference):
    assert metrics.flip(reference, reference) == 0
    small, large = (metrics.flip(reference * (1 + x), reference) for x in (0.05, 0.5))
    assert 0 < small < large < 1
    assert metrics.flip(-reference, reference) == metrics.flip(0 * reference, reference)


def test_pictures_of_different_shapes_are_refused(reference):
    with pytest.raises(ValueError, match=r"image: its shape is \(20, 50, 1\), and that of the ref"):
        metrics.errors(reference[..., :1], reference)


# ---- The registry ----


def test_tables_have_the_metrics_in_this_order():
    assert list(metrics.METRICS) == [
        "mse", "mse_trimmed", "rmse", "rmse_trimmed", "relative_mse", "relative_mse_trimmed",
        "flip",
    ]  # fmt: skip


def test_squared_metrics_are_those_that_fall_like_a_variance(reference):
    noise = np.random.default_rng(4).normal(size=reference.shape)
    for metric in metrics.METRICS.values():
        if metric.by_difference:
            one, two = (
                metric.function(metrics.Pair(reference + scale * noise, reference))
                for scale in (0.01, 0.02)
            )
            assert two / one == pytest.approx(4 if metric.squared else 2)


def test_a_metric_is_added_in_one_place(small_scene, tmp_path):
    """It is in the tables, in the results, in a figure and in the report."""
    before = dict(metrics.METRICS)

    @metrics.register("mae", "mean <error>", False, "The mean of it.", drawn=True, efficiency=True)
    def _(pair):
        return float(np.abs(pair.difference).mean())

    try:
        comparison = run(small_scene, tmp_path / "out")
        figures = drawing.write_figures(comparison)
        page = write_report(comparison, figures=figures).read_text(encoding="utf-8")
    finally:
        metrics.METRICS.clear()
        metrics.METRICS.update(before)

    for one in results.read(tmp_path / "out").measurements:
        images = [read(picture.file).astype(float) for picture in one.pictures]
        reference = comparison.reference_image()
        expected = [np.abs(image - reference).mean() for image in images]
        assert one.values["mae"] == pytest.approx(expected)
        assert one.errors["mae"].mean == pytest.approx(np.mean(expected))
        assert "mae" in one.efficiency
    assert comparison.reference.errors["mae"] > 0
    header = (tmp_path / "out" / "results.csv").read_text().splitlines()[0].split(",")
    assert {"mae", "mae_standard_error", "mae_of_reference", "efficiency_mae_low"} <= set(header)
    assert figures.curves["mae_against_time"].exists()
    assert "mean &lt;error&gt;" in page
    assert "The mean of it." in page
