"""Results: written to files, read back from them, and read where the folder is elsewhere."""

import dataclasses
import json
import math
import shutil

import numpy as np
import pytest
from comparisons import read, run
from mi_ellipse.study import results

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.fixture
def compared(small_scene, tmp_path):
    """A comparison as `compare` returns it, with the scene beside its folder."""
    return run(small_scene, tmp_path / "out")


def assert_same(found, expected):
    """All fields are equal, but the scene may be named by another path."""
    for field in dataclasses.fields(expected):
        if field.compare and field.name != "scene_file":
            assert getattr(found, field.name) == getattr(expected, field.name), field.name
    assert found.scene_file.resolve() == expected.scene_file.resolve()


def test_results_are_read_back_to_the_last_digit(compared):
    assert_same(results.read(compared.folder), compared)


def test_what_is_read_back_gives_the_same_files_and_pictures(compared):
    texts = [file.read_bytes() for file in results.write(compared)]
    again = results.read(compared.folder)
    assert [file.read_bytes() for file in results.write(again)] == texts
    one = again.measurements[-1]
    np.testing.assert_array_equal(again.image(one), read(one.pictures[0].file))
    np.testing.assert_array_equal(again.reference_image(), read(compared.reference.file))
    assert (again.exposure, again.warnings()) == (compared.exposure, compared.warnings())


def test_paths_do_not_depend_on_where_the_folder_lies(compared, small_scene, tmp_path):
    assert str(tmp_path) not in (compared.folder / "results.json").read_text()
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    shutil.move(small_scene, moved / small_scene.name)
    shutil.move(compared.folder, moved / "renamed")
    found = results.read(moved / "renamed")
    assert found.scene_file.resolve() == (moved / "scene.xml").resolve()
    one = found.measurements[0]
    assert one.pictures[0].file.parent == moved / "renamed" / "pictures"
    assert found.image(one).any()


def test_a_single_seed_is_read_back_without_standard_errors(small_scene, tmp_path):
    compared = run(small_scene, tmp_path / "out", seeds=1, spp=(2,))
    found = results.read(tmp_path / "out")
    for measurement, expected in zip(found.measurements, compared.measurements, strict=True):
        for metric, error in expected.errors.items():
            assert measurement.errors[metric].mean == error.mean
            assert math.isnan(measurement.errors[metric].standard_error)
        for metric, efficiency in expected.efficiency.items():
            assert measurement.efficiency[metric].value == efficiency.value
            assert math.isnan(measurement.efficiency[metric].low)
            assert math.isnan(measurement.efficiency[metric].high)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[:-100], "results.json is damaged: "),
        (lambda text: text.replace('"tracing"', '"x"'), "damaged: its checksum is wrong; run"),
        (lambda text: text.replace('"total": 0', '"total": 1', 1), "its checksum is wrong"),
        (lambda text: text.replace('"format": 3', '"format": 1'), "format 1, .* reads 3; run"),
        (lambda text: "{}", "format None"),
        (lambda text: "[]", "holds no document"),
    ],
)
def test_files_that_do_not_fit_are_refused(compared, change, message):
    file = compared.folder / "results.json"
    file.write_text(change(file.read_text()))
    with pytest.raises(ValueError, match=message) as caught:
        results.read(compared.folder)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"no finished comparison \(results.json is missing\)"):
        results.read(tmp_path)


def test_intervals_are_in_the_table(compared):
    rows = (compared.folder / "results.csv").read_text().splitlines()
    columns = rows[0].split(",")
    for row, one in zip(rows[1:], compared.measurements, strict=True):
        cells = dict(zip(columns, row.split(","), strict=True))
        for metric, efficiency in one.efficiency.items():
            assert float(cells[f"efficiency_{metric}"]) == efficiency.value
            assert float(cells[f"efficiency_{metric}_low"]) == efficiency.low
            assert float(cells[f"efficiency_{metric}_high"]) == efficiency.high


def test_results_in_json_know_no_nan(small_scene, tmp_path):
    run(small_scene, tmp_path / "out", seeds=1, spp=(2,))

    def refuse(constant):
        pytest.fail(f"{constant} is no JSON")

    document = json.loads((tmp_path / "out" / "results.json").read_text(), parse_constant=refuse)
    assert "standard_error" not in document["measurements"][0]["errors"]["mse"]
