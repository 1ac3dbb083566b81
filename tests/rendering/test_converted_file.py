"""Scene files written anew with their lamps converted, read again by Mitsuba's own loader."""

import re

import mi_ellipse  # noqa: F401
import mitsuba as mi
import numpy as np
import pytest
from commands import SCENE, invoke
from mi_ellipse.rendering.converted_file import write_converted
from mi_ellipse.rendering.scene import parse_scene

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

DISK = '<shape type="disk" id="{}"><emitter type="area"/></shape>'

# Two dashes in a comment, and a ">" in an attribute, are what strict parsers refuse or stumble on.
LAMPS = f"""
    <default name="mesh" value="cube"/>
    <default name="power" value="2"/>
    <path value="textures"/>
    <!-- an old lamp -- <emitter type="area"/> -->
    <shape type='disk' id="a > b"><emitter
        id="x"
        type = 'area' ><rgb name="radiance" value="$power"/></emitter></shape>
    {DISK.format("b")}
    <emitter type="area" id="referred"/>
    <shape type="disk"><ref id="referred"/></shape>
    <shape type="rectangle"><emitter type="area"/></shape>
    <shape type="ply"><string name="filename" value="meshes/$mesh.ply"/>
        <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
            <string name="filename" value="grey.exr"/></texture></bsdf></shape>
    <include filename="parts/plain.xml"/>
    <include filename="parts/lamps.xml"/>
    <include filename="parts/emitter.xml"/>
"""
FILES = {
    "plain.xml": '<scene version="3.0.0"><shape type="cube"/></scene>',
    "empty.xml": '<scene version="3.0.0"></scene>',
    "lamps.xml": f"""<?xml version="1.0"?>
        <!-- lamps --><scene version="3.0.0">
            <include filename="empty.xml"/><include filename="deep/plain.xml"/>
            {DISK.format("c")}</scene>""",
    "emitter.xml": DISK.format("d").replace("<shape", '<shape version="3.0.0"'),
    "deep/plain.xml": '<scene version="3.0.0"><shape type="sphere"/></scene>',
}


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A scene in a folder `old` with files of all kinds; the current directory is its parent."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "old"
    for name in ("meshes", "textures", "parts/deep"):
        (folder / name).mkdir(parents=True)
    mi.load_dict({"type": "cube"}).write_ply(str(folder / "meshes" / "cube.ply"))
    mi.Bitmap(np.full((2, 2, 3), 0.5, np.float32)).write(str(folder / "textures" / "grey.exr"))
    for name, text in FILES.items():
        (folder / "parts" / name).write_text(text)
    (folder / "scene.xml").write_text("\ufeff" + SCENE.format(lamps=LAMPS), encoding="utf-8")
    return folder / "scene.xml"


def kinds(scene):
    return sorted(type(emitter).__name__ for emitter in scene.emitters())


@pytest.mark.parametrize("place", ["old/new.xml", "new.xml", "a & b/$c/new.xml"])
def test_the_new_file_is_the_same_scene_with_other_emitters(scene, tmp_path, place):
    new = tmp_path / place
    new.parent.mkdir(parents=True, exist_ok=True)
    # A file of the same name at the new place must not be taken instead.
    for name in ("plain.xml", "lamps.xml"):
        if new.parent != scene.parent:
            (new.parent / "parts").mkdir(exist_ok=True)
            (new.parent / "parts" / name).write_text("no scene")
    before = scene.read_bytes()
    conversion = write_converted(scene, new)
    assert conversion.converted == ("a > b", "b", "referred", "c", "d")
    assert scene.read_bytes() == before

    old_scene, new_scene = mi.load_file(str(scene)), mi.load_file(str(new))
    assert kinds(old_scene) == ["Emitter"] * 6
    assert kinds(new_scene) == ["EllipticalArea"] * 5 + ["Emitter"]
    # All else is as it was, in the words of Mitsuba's own writer.
    texts = [mi.parser.write_string(parse_scene(file).state) for file in (scene, new)]
    assert texts[0].replace('"area"', '"ellipticalarea"') == texts[1].replace(
        '"area"', '"ellipticalarea"'
    )


def test_comments_layout_and_defaults_stay(scene):
    write_converted(scene, scene.with_name("new.xml"))
    old, new = scene.read_text("utf-8"), scene.with_name("new.xml").read_text("utf-8")
    start, end = old.index("<include"), new.index("<include")
    reverted = re.sub(r"(<emitter[^>]*)ellipticalarea", r"\1area", new[:end])
    assert reverted == old[:start]
    radiance = mi.load_file(str(scene.with_name("new.xml")), power="5").emitters()[0]
    assert "5" in str(mi.traverse(radiance)["radiance.value"])


def test_the_command_says_which_lamps_and_spares_files(scene):
    result = invoke("convert", scene, "-o", "new.xml")
    assert result.exit_code == 0, result.output
    assert "new.xml: 5 lamps converted" in result.stdout
    assert "a > b, b, referred, c, d" in result.stdout

    for arguments, words in {
        ("-o", "new.xml"): "exists already",
        ("-o", scene): "file of the scene itself",
        ("-o", scene.parent / "parts" / "lamps.xml", "--overwrite"): "file of the scene itself",
        ("-o", "nowhere/new.xml"): "cannot write nowhere/new.xml",
    }.items():
        result = invoke("convert", scene, *arguments)
        assert result.exit_code == 1
        assert words in result.stderr
        assert result.stderr.count("\n") == 1
    assert invoke("convert", scene, "-o", "new.xml", "--overwrite").exit_code == 0


@pytest.mark.parametrize(
    ("lamps", "words"),
    [
        (
            '<default name="kind" value="area"/><shape type="disk"><emitter type="$kind"/></shape>',
            'parameter "$kind"; give that the value "ellipticalarea"',
        ),
        (
            '<include filename="parts/moved.xml"/>',
            "cannot be converted as a file",
        ),
    ],
)
def test_what_cannot_be_converted_writes_nothing(scene, lamps, words):
    # The folder that this included scene adds would hold for the whole scene once it is copied.
    (scene.parent / "parts" / "moved.xml").write_text(
        f'<scene version="3.0.0"><path value="../other"/>{DISK.format("e")}</scene>'
    )
    (scene.parent / "other").mkdir()
    for name in ("meshes", "other"):
        mi.load_dict({"type": "cube"}).write_ply(str(scene.parent / name / "box.ply"))
    mesh = (
        '<path value="meshes"/><shape type="ply"><string name="filename" value="box.ply"/></shape>'
    )
    scene.write_text(SCENE.format(lamps=mesh + lamps))
    with pytest.raises(ValueError, match=re.escape(words)):
        write_converted(scene, "new.xml")
    assert sorted(file.name for file in scene.parent.parent.iterdir()) == ["old"]
