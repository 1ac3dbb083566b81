"""A folder heals itself: what is damaged or lost is made again, by name, and nothing else is."""

import csv
import shutil

import mitsuba as mi
import numpy as np
import pytest
from comparisons import contents, read, run
from conftest import SMALL_SCENE
from mi_ellipse.study import drawing, results, tidying
from mi_ellipse.study.reference import Half
from mi_ellipse.study.report import write_report

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

PICTURES = {
    f"pictures/{name}_2spp_seed{seed}.exr" for name in ("area", "solid_angle") for seed in (1, 2)
}
DERIVED = {f"reference/{name}.exr" for name in ("reference", "half_1", "half_2")}
COMPUTED = {"slow_metrics.json", "made_from.json", "results.json", "results.csv"}
HALVES = {"reference/half_1.npz", "reference/half_2.npz"}


def truncate(file):
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def empty(file):
    file.write_bytes(b"")


def alter(file):
    """Change bytes in the middle; the file stays as long as it is."""
    data = bytearray(file.read_bytes())
    for place in range(len(data) // 2, len(data) // 2 + 20):
        data[place] ^= 0x55
    file.write_bytes(data)


def replace(file):
    file.write_text("This is something else.")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished comparison that stays as it is, with its scene beside it."""
    mi.set_variant("llvm_ad_rgb")
    folder = tmp_path_factory.mktemp("healing")
    (folder / "scene.xml").write_text(SMALL_SCENE)
    write_report(compare(folder))
    return folder


def compare(folder, said=None):
    return run(folder / "scene.xml", folder / "out", said, spp=(2,))


@pytest.fixture
def folder(whole, tmp_path):
    """A copy of the finished comparison, to be damaged."""
    shutil.copytree(whole, tmp_path / "copy")
    return tmp_path / "copy"


def numbers(folder):
    """The table without its words."""
    with open(folder / "out" / "results.csv", newline="") as file:
        return [
            [float(value) for name, value in row.items() if name not in ("kind", "sampling")]
            for row in csv.DictReader(file)
        ]


@pytest.mark.parametrize("damage", [truncate, empty, alter, replace])
def test_every_damaged_file_is_named_and_made_again(folder, whole, damage):
    names = PICTURES | DERIVED | COMPUTED | HALVES
    assert names <= set(contents(folder / "out"))
    for name in names:
        damage(folder / "out" / name)
    said = []
    compare(folder, said)
    for name in PICTURES | HALVES:
        assert f"{name} was damaged and is rendered again" in said
    assert "slow_metrics.json was damaged and is computed again" in said
    assert results.read(folder / "out").strategies == ("area", "solid_angle")
    assert "made_from.json was damaged and is made again" in said
    # The threads of a render add samples in changing order, and so round differently.
    for name in PICTURES | DERIVED:
        np.testing.assert_allclose(
            read(folder / "out" / name), read(whole / "out" / name), rtol=1e-5, atol=1e-6
        )
    np.testing.assert_allclose(numbers(folder), numbers(whole), rtol=1e-4)
    said.clear()
    compare(folder, said)
    assert not [sentence for sentence in said if "again" in sentence]


@pytest.mark.parametrize(
    ("name", "damage", "state"),
    [
        ("reference/reference.exr", alter, "damaged"),
        ("reference/half_1.exr", truncate, "damaged"),
        ("reference/half_2.exr", lambda file: file.unlink(), "missing"),
    ],
)
def test_halves_rebuild_the_pictures_of_the_reference(
    folder, whole, count_renders, name, damage, state
):
    damage(folder / "out" / name)
    said = []
    compare(folder, said)
    assert f"{name} was {state} and is written again" in said
    assert count_renders.made == []
    np.testing.assert_array_equal(read(folder / "out" / name), read(whole / "out" / name))


def test_damaged_times_are_taken_again_and_pictures_kept(folder, whole, count_renders):
    alter(folder / "out" / "times.json")
    before = {name: contents(folder / "out")[name] for name in PICTURES}
    said = []
    compare(folder, said)
    assert said[0] == "times.json was damaged: times are taken again"
    assert said[1] == "Pictures at equal samples: 4 of 4 reused"
    assert {name: contents(folder / "out")[name] for name in PICTURES} == before
    assert len([one for one in count_renders.made if one[0] == 2]) >= 2 * 3


def test_one_lost_half_is_rendered_and_the_other_one_kept(folder, whole, count_renders):
    kept = (folder / "out" / "reference" / "half_2.npz").read_bytes()
    alter(folder / "out" / "reference" / "half_1.npz")
    said = []
    compare(folder, said)
    assert "reference/half_1.npz was damaged and is rendered again" in said
    assert [spp for spp, _ in count_renders.made] == [8]  # half of the reference's 16
    assert (folder / "out" / "reference" / "half_2.npz").read_bytes() == kept
    np.testing.assert_allclose(
        read(folder / "out" / "reference" / "half_1.exr"),
        read(whole / "out" / "reference" / "half_1.exr"),
        rtol=1e-5, atol=1e-6,
    )  # fmt: skip


def test_no_altered_byte_of_a_half_is_used_in_silence(folder):
    file = folder / "out" / "reference" / "half_1.npz"
    good, whole = file.read_bytes(), Half.read(file)
    choose = np.random.default_rng(1)
    for place in choose.integers(len(good), size=200):
        altered = bytearray(good)
        altered[place] ^= 1 << int(choose.integers(8))
        file.write_bytes(altered)
        try:
            half = Half.read(file)
        except ValueError:
            continue
        assert (half.settings, half.spp, half.passes) == (whole.settings, whole.spp, whole.passes)
        np.testing.assert_array_equal(half.total, whole.total)


def test_lost_pictures_are_named(folder, count_renders):
    (folder / "out" / "pictures" / "area_2spp_seed2.exr").unlink()
    said = []
    compare(folder, said)
    assert "pictures/area_2spp_seed2.exr was missing and is rendered again" in said
    assert count_renders.made == [(2, 2)]  # Its time is known.


def test_a_damaged_picture_stops_the_report_with_its_name(folder):
    file = folder / "out" / "pictures" / "area_2spp_seed1.exr"
    alter(file)
    message = f"{file}: the OpenEXR file is damaged.*; run `mi-ellipse compare` with the same"
    with pytest.raises(ValueError, match=message):
        write_report(results.read(folder / "out"))
    file.unlink()
    with pytest.raises(ValueError, match=f"{file} is missing; run `mi-ellipse compare`"):
        write_report(results.read(folder / "out"))


# ---- What earlier runs left ----


def test_what_other_runs_made_is_put_away_and_used_again(folder, count_renders):
    (folder / "out" / "pictures" / "mine.exr").write_text("mine")
    (folder / "out" / "figures" / "notes.pdf").write_text("mine")
    before = set(contents(folder / "out"))
    said = []
    drawing.write_figures(run(folder / "scene.xml", folder / "out", said, spp=(3,), seeds=1))
    assert any("were moved to earlier/pictures" in sentence for sentence in said)
    after = contents(folder / "out")
    stale = ("pictures/area_2spp", "pictures/all_2spp", "figures/pictures_equal_samples_2spp")
    assert not [name for name in after if name.startswith(stale)]
    # Nothing is lost, and the user's own files stay where they are.
    assert before <= {name.removeprefix("earlier/") for name in after}
    assert {"pictures/mine.exr", "figures/notes.pdf"} <= set(after)

    count_renders.made.clear()
    said.clear()
    compare(folder, said)
    assert said[0] == "Pictures at equal samples: 4 of 4 reused"
    assert not any(spp == 2 for spp, _ in count_renders.made)
    assert set(contents(folder / "out")) >= PICTURES


@pytest.mark.parametrize(
    ("name", "ours"),
    [
        ("pictures/.area_2spp_seed1.123.exr", True),
        ("figures/.time.4711.svg", True),
        (".results.99.csv", True),
        ("reference/.half_1.5.npz", True),
        ("pictures/.mine.123.exr", False),
        ("pictures/.area_2spp_seed1.exr", False),
        (".gitignore", False),
    ],
)
def test_half_written_files_of_a_killed_run_are_removed(tmp_path, name, ours):
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("half")
    tidying.remove_remains(tmp_path)
    assert file.exists() is not ours
