"""The pictures of a comparison: what is reused, what is replaced, what an interruption leaves."""

import mitsuba as mi
import pytest
from comparisons import run
from conftest import SMALL_SCENE
from mi_ellipse.rendering import provenance
from mi_ellipse.study.gallery import Gallery, Task

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


def test_second_run_reuses_everything(finished, count_renders):
    before = (finished.folder / "results.csv").read_bytes()
    said = []
    run(finished.scene_file, finished.folder, said, reference_spp=64, parameters={"radiance": "2"})
    assert count_renders.made == []
    assert said[0] == "Pictures at equal samples: 8 of 8 reused"
    assert said[-1] == "Reference: reused, 64 spp"
    assert (finished.folder / "results.csv").read_bytes() == before


def test_other_seeds_and_counts_are_missing(finished):
    gallery = Gallery(finished.folder / "pictures", finished.scene_file, {"radiance": "2"})
    tasks = [Task(2, "area", 8), Task(3, "area", 8), Task(2, "area", 4)]
    stock = gallery.take_stock(tasks)
    assert list(stock.pictures) == tasks[:1]
    assert stock.missing == stock.wanted == tasks[1:]


@pytest.mark.parametrize("change", ["parameters", "scene", "variant", "code"])
def test_other_settings_do_not_fit(finished, tmp_path, monkeypatch, change):
    parameters, scene_file = {"radiance": "2"}, finished.scene_file
    if change == "parameters":
        parameters["radiance"] = "3"
    elif change == "scene":
        scene_file = tmp_path / "scene.xml"
        scene_file.write_text(SMALL_SCENE.replace("0,-4,3", "0,-5,3"))
    elif change == "variant":
        mi.set_variant("llvm_ad_spectral")
    else:
        monkeypatch.setattr(provenance, "picture_digest", lambda: "other")
    gallery = Gallery(finished.folder / "pictures", scene_file, parameters)
    task = Task(1, "area", 8)
    assert gallery.take_stock([task]).outdated == [task]


def test_comments_and_the_name_of_the_file_do_not_matter(finished, tmp_path):
    scene_file = tmp_path / "other.xml"
    scene_file.write_text(SMALL_SCENE.replace("<sensor", "<!-- a comment --> <sensor"))
    gallery = Gallery(finished.folder / "pictures", scene_file, {"radiance": "2"})
    assert gallery.take_stock([Task(1, "area", 8)]).pictures


def test_pictures_of_other_code_are_replaced(small_scene, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    run(small_scene, folder, spp=(2,), seeds=1)
    monkeypatch.setattr(provenance, "picture_digest", lambda: "other")
    said = []
    run(small_scene, folder, said, spp=(2,), seeds=1)
    assert "Pictures at equal samples: 2 were made with other settings and are replaced" in said
    metadata = mi.Bitmap(str(folder / "pictures" / "area_2spp_seed1.exr")).metadata()
    assert metadata["picture_digest"] == "other"


def test_pictures_go_on_after_an_interruption(small_scene, tmp_path, count_renders):
    """Finished turns keep their times, and an interrupted one its pictures."""
    # A turn: two counts of the first strategy, of the other and of the first again; a warm-up each
    # where the scene is loaded.
    count_renders.stop_after = 9 + 3
    with pytest.raises(KeyboardInterrupt):
        run(small_scene, tmp_path / "out")
    kept = sorted(file.name for file in (tmp_path / "out" / "pictures").iterdir())
    first_turn = [
        f"{name}_{spp}spp_seed1.exr" for name in ("area", "solid_angle") for spp in (2, 8)
    ]
    assert kept == sorted([*first_turn, "area_2spp_seed2.exr", "area_8spp_seed2.exr"])

    count_renders.stop_after, count_renders.made = None, []
    said = []
    run(small_scene, tmp_path / "out", said)
    assert said[0] == "Pictures at equal samples: 6 of 8 reused"
    equal_samples = [one for one in count_renders.made[:9] if one[1] == 2]
    assert len(equal_samples) == 9  # the second turn alone


def test_pictures_of_either_choice_of_lamps_are_kept_apart(small_scene, tmp_path):
    names = ("solid_angle", "solid_angle+ungrouped")
    comparison = run(small_scene, tmp_path, strategies=names, spp=(2,), seeds=1)
    assert comparison.strategies == names
    for name, word in zip(names, ("yes", "no"), strict=True):
        file = tmp_path / "pictures" / f"{name}_2spp_seed1.exr"
        metadata = mi.Bitmap(str(file)).metadata()
        assert (metadata["sampling"], metadata["grouping"]) == ("solid_angle", word)
    # A picture made the other way does not count, whatever its name is.
    grouped, other = (tmp_path / "pictures" / f"{name}_2spp_seed1.exr" for name in names)
    grouped.write_bytes(other.read_bytes())
    gallery = Gallery(tmp_path / "pictures", small_scene, {})
    tasks = [Task(1, name, 2) for name in names]
    stock = gallery.take_stock(tasks)
    assert (stock.outdated, list(stock.pictures)) == (tasks[:1], tasks[1:])
