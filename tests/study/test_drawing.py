"""Figures: where the enlarged regions and the labels of the lines lie, and what is refused."""

import dataclasses
import warnings
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import PIL.Image
import pytest
from comparisons import run
from matplotlib.text import Text
from mi_ellipse.files import images
from mi_ellipse.sampling import STRATEGIES
from mi_ellipse.study import drawing, results
from mi_ellipse.study.drawing import curves, style
from mi_ellipse.study.drawing.insets import check_inside
from mi_ellipse.study.results import EQUAL_SAMPLES

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


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (1, 40), (5, 4)])
def test_insets_of_tiny_pictures_lie_inside(shape):
    reference = np.full((*shape, 3), 0.5)
    comparison = SimpleNamespace(
        strategies=("area",),
        exposure=0.0,
        reference_image=lambda: reference,
        series=lambda name: [name],
        image=lambda name: reference * 1.1,
    )
    check_inside(drawing.choose_insets(comparison), reference.shape)


# ---- What is written in figures ----


def texts(figure):
    return [one.get_text() for one in figure.findobj(Text)]


@pytest.mark.parametrize("name", ["time", "mse_against_samples", "flip_against_time"])
def test_curves_have_the_name_of_the_scene_and_slopes_from_three_counts_on(finished, name):
    comparison = results.read(finished.folder)
    words = texts(curves.draw_curve(comparison, name))
    assert "scene" in words  # the file is scene.xml
    assert not any("slope" in word for word in words)

    # A third count, with the measurements of the second one
    more = [
        dataclasses.replace(one, spp=32, first_spp=32)
        for one in comparison.measurements
        if one.first_spp == 8
    ]
    longer = dataclasses.replace(
        comparison, spp=(2, 8, 32), measurements=(*comparison.measurements, *more)
    )
    words = texts(curves.draw_curve(longer, name))
    assert sum("slope" in word for word in words) == len(comparison.strategies)


def test_grids_have_the_name_of_the_scene_and_the_captions(finished):
    comparison = results.read(finished.folder)
    words = texts(drawing.picture_grid(comparison, EQUAL_SAMPLES, 2, [(1, 2, 6, 5)]))
    assert "scene" in words
    for one in comparison.measurements:
        if (one.kind, one.spp) == (EQUAL_SAMPLES, 2):
            mantissa, exponent = f"{one.errors['mse_trimmed'].mean:.2e}".split("e")
            raised = str(int(exponent)).replace("-", "⁻")
            for digit, high in zip("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹", strict=True):
                raised = raised.replace(digit, high)
            assert any(word.startswith(f"{mantissa}·10{raised}\n") for word in words)


def test_pixels_of_enlarged_regions_are_squares_of_their_own_colour(finished, tmp_path):
    """In the PNG, 300 pixels an inch."""
    comparison = results.read(finished.folder)
    x, y, width, height = 4, 3, 6, 5
    figure = drawing.picture_grid(comparison, EQUAL_SAMPLES, 2, [(x, y, width, height)])
    figure.savefig(tmp_path / "grid.png", dpi=300)
    shown = images.to_srgb(comparison.reference_image() * 2.0**comparison.exposure)
    found = np.array(PIL.Image.open(tmp_path / "grid.png"))[..., :3] / 255
    # The reference's region is in the third row of the first column, whose width it has.
    side = 1.7 * 300 / width
    top = found.shape[0] - 0.02 * 300 - 2 * height * side - 0.05 * 300
    for row in range(height):
        for column in range(width):
            place = round(top + (row + 0.5) * side), round((column + 0.5) * side)
            np.testing.assert_allclose(found[place], shown[y + row, x + column], atol=1 / 255)


def test_a_name_is_drawn_whatever_its_letters(finished, tmp_path):
    """The small font of figures lacks Greek; the large one has it."""
    comparison = results.read(finished.folder)
    named = dataclasses.replace(comparison, scene_file=comparison.scene_file.with_stem("Ωmega"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # such as that of a missing glyph
        figure = curves.draw_curve(named, "time")
        with mpl.rc_context(style.text()):
            figure.savefig(tmp_path / "time.pdf")
    assert "Ωmega" in texts(figure)


def test_drawing_tells_its_progress(finished):
    comparison = results.read(finished.folder)
    steps = []
    drawing.write_figures(comparison, [(1, 2, 6, 5)], lambda *step: steps.append(step))
    files = len(list((finished.folder / "figures").iterdir()))
    assert steps == [("figures", done, files) for done in range(1, files + 1)]


# ---- Labels ----


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
