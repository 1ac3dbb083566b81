"""What is asked for is checked before anything is rendered or written."""

import subprocess
import sys
import threading

import mitsuba as mi
import pytest
from commands import invoke
from comparisons import contents, run
from conftest import SMALL_SCENE
from mi_ellipse.files.lock import only_one
from mi_ellipse.rendering import passes, provenance

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.fixture
def no_render(monkeypatch):
    """Any render fails the test."""
    monkeypatch.setattr(passes, "render", lambda *_: pytest.fail("rendered"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"strategies": ("area", "nonsense")}, '"nonsense"'),
        ({"strategies": ()}, "needs a strategy"),
        ({"spp": (0, 2)}, "spp=0: .* from 1"),
        ({"seeds": 0}, "seeds=0: .* at least 1"),
        ({"reference_spp": 1}, "reference_spp=1: "),
        ({"insets": [(20, 2, 5, 5)]}, "20,2,5,5 is not inside the picture of 24 × 16"),
        ({"insets": [(1, 2, 5, 5)] * 5}, "5 insets"),
    ],
)
def test_impossible_requests_leave_no_trace(small_scene, tmp_path, no_render, changes, message):
    with pytest.raises(ValueError, match=message):
        run(small_scene, tmp_path / "out", **changes)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"ellipticalarea"', '"area"', "no.*ellipticalarea"),
        ('"rectangle">', '"obj"><string name="filename" value="gone.obj"/>', "gone.obj"),
        # The sampler rounds 5 and 8 up to 9.
        ("<film ", '<sampler type="stratified"/><film ', "spp=5 and spp=8: .* 9 samples"),
    ],
)
def test_impossible_scenes_leave_no_trace(small_scene, tmp_path, no_render, old, new, message):
    small_scene.write_text(SMALL_SCENE.replace(old, new))
    with pytest.raises((ValueError, OSError), match=message):
        run(small_scene, tmp_path / "out", spp=(5, 8))
    assert not (tmp_path / "out").exists()


def test_a_file_in_the_place_of_the_folder_is_refused(small_scene, tmp_path, no_render):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(ValueError, match="out is a file: the output needs a folder"):
        run(small_scene, tmp_path / "out")
    assert (tmp_path / "out").read_text() == "mine"


# ---- A folder that was made from something else ----


@pytest.fixture
def made(small_scene, tmp_path):
    """A folder with a finished comparison of one count and one seed."""
    run(small_scene, tmp_path / "out", spp=(2,), seeds=1)
    return tmp_path / "out"


@pytest.mark.parametrize("note", ["there", "missing", "damaged"])
@pytest.mark.parametrize("change", ["parameter", "scene", "variant", "version"])
def test_a_changed_scene_is_refused_and_nothing_is_written(
    small_scene, made, no_render, monkeypatch, change, note
):
    parameters, words = {}, []
    if change == "parameter":
        parameters["radiance"] = "2"
        words = ["parameter radiance was not given and is 2"]
    elif change == "scene":
        small_scene.write_text(SMALL_SCENE.replace('z="1"', 'z="1.5"'))
        words = ['<translate z="1"/> became <translate z="1.5"/>'] if note == "there" else []
    elif change == "variant":
        mi.set_variant("llvm_ad_spectral")
        words = ["variant was llvm_ad_rgb and is llvm_ad_spectral"]
    else:
        versions = provenance.versions() | {"mitsuba_version": "3.10"}
        monkeypatch.setattr(provenance, "versions", lambda: versions)
        words = [f"mitsuba_version was {mi.__version__} and is 3.10"]
    if note == "missing":
        (made / "made_from.json").unlink()
    elif note == "damaged":
        (made / "made_from.json").write_text((made / "made_from.json").read_text()[:-20])

    before = contents(made)
    with pytest.raises(ValueError, match="the scene has changed since") as caught:
        run(small_scene, made, spp=(2,), seeds=1, parameters=parameters)
    assert contents(made) == before
    assert "Name another output folder, or remove this one" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(made) in str(caught.value)
    for word in words:
        assert word in str(caught.value)


SQUARE = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
-9 -9 0
9 -9 0
0 {} 0
3 0 1 2
"""


def test_a_changed_mesh_is_named(small_scene, tmp_path):
    (tmp_path / "floor.ply").write_text(SQUARE.format(9))
    mesh = '<shape type="ply"><string name="filename" value="floor.ply"/>'
    small_scene.write_text(SMALL_SCENE.replace('<shape type="rectangle">', mesh))
    run(small_scene, tmp_path / "out", spp=(2,), seeds=1)
    (tmp_path / "floor.ply").write_text(SQUARE.format(8))
    with pytest.raises(ValueError, match=r"made: the file floor\.ply is another one\. Nothing"):
        run(small_scene, tmp_path / "out", spp=(2,), seeds=1)


def test_a_damaged_note_is_named_and_made_again(small_scene, made):
    note = made / "made_from.json"
    whole = note.read_text()
    note.write_text(whole[:-20])
    said = []
    run(small_scene, made, said, spp=(2,), seeds=1)
    assert said[0] == "made_from.json was damaged and is made again"
    assert note.read_text() == whole


# ---- One at a time ----

HOLD = """
import pathlib, sys, time
from mi_ellipse.files.lock import only_one
with only_one(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_folder_in_use_is_refused_by_both_commands(small_scene, made):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(made)], stdout=subprocess.PIPE, text=True
    )
    options = ["--sampling", "area", "--spp", "2", "--reference-spp", "16", "-o", made]
    try:
        assert process.stdout.readline() == "held\n"
        before = contents(made)
        for command in (["compare", small_scene, *options], ["report", made]):
            result = invoke(*command)
            assert result.exit_code == 1
            assert f"{made} is in use by another" in result.stderr.replace("\n", " ")
        assert contents(made) == before
    finally:
        process.kill()
        process.communicate()
    assert invoke("report", made).exit_code == 0


def test_the_folder_is_held_until_its_figures_are_drawn(small_scene, tmp_path):
    held = []

    def attempt():
        with pytest.raises(ValueError, match="is in use"), only_one(tmp_path / "out"):
            pass
        held.append(True)

    def finish(_comparison):
        thread = threading.Thread(target=attempt)
        thread.start()
        thread.join()

    run(small_scene, tmp_path / "out", spp=(2,), seeds=1, finish=finish)
    assert held
