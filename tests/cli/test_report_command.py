"""`mi-ellipse report` end to end: figures and report again, without rendering."""

import hashlib

import pytest
from commands import files, invoke
from conftest import SMALL_SCENE
from mi_ellipse.rendering import passes
from mi_ellipse.study import results

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.fixture
def folder(tmp_path):
    """A finished comparison."""
    (tmp_path / "scene.xml").write_text(SMALL_SCENE)
    result = invoke(
        "compare", tmp_path / "scene.xml", "--sampling", "area,solid_angle", "--spp", "2,4",
        "--reference-spp", 16, "--seeds", 2, "-o", tmp_path / "out", "--inset", "1,2,6,5",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    return tmp_path / "out"


def test_report_is_made_again_without_rendering(folder, monkeypatch):
    before = files(folder / "figures")
    grid = folder / "figures" / "pictures_equal_samples_4spp.png"
    first = hashlib.sha256(grid.read_bytes()).hexdigest()
    for file in (folder / "figures").iterdir():
        file.unlink()
    (folder / "report.html").unlink()

    monkeypatch.setattr(passes, "render", lambda *_: pytest.fail("rendered"))
    result = invoke("report", folder, "--inset", "1,2,6,5")
    assert result.exit_code == 0, result.output
    assert result.stdout == f"{folder / 'report.html'}, {folder / 'figures'}\n"
    assert "WARNING: The reference's own" in " ".join(result.stderr.split())
    assert files(folder / "figures") == before
    assert hashlib.sha256(grid.read_bytes()).hexdigest() == first
    assert "solid_angle" in (folder / "report.html").read_text(encoding="utf-8")

    assert invoke("report", folder, "--inset", "3,4,6,5").exit_code == 0
    assert hashlib.sha256(grid.read_bytes()).hexdigest() != first


def test_numbers_are_printed_with_their_spread(folder):
    result = invoke("report", folder)
    words = result.stderr.split()
    assert "over area's" in result.stderr
    for one in results.read(folder).measurements:
        efficiency = one.efficiency["mse_trimmed"]
        assert f"{one.errors['mse_trimmed'].mean:.3g}" in words
        for spread, value, digits in (
            (one.seconds, one.seconds.median, 3),
            (one.ratio, one.ratio.median, 2),
            (efficiency, efficiency.value, 2),
        ):
            row = f"{value:.{digits}f} [{spread.low:.{digits}f}, {spread.high:.{digits}f}]"
            assert row in " ".join(words)


def test_a_folder_without_a_comparison_is_refused_in_one_line(tmp_path):
    result = invoke("report", tmp_path)
    assert result.exit_code == 1
    assert result.stderr.startswith("mi-ellipse: ")
    assert result.stderr.count("\n") == 1
    assert str(tmp_path) in result.stderr
