"""Parcels: a scene and its files, unpacked where nothing else of it is."""

import dataclasses

import mitsuba as mi
import numpy as np
import pytest
from conftest import SMALL_SCENE
from mi_ellipse.rendering.job import RenderJob
from mi_ellipse.rendering.parcel import pack, unpack
from mi_ellipse.rendering.provenance import scene_digest

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

MESH = '<shape type="ply"><string name="filename" value="{}"/></shape>'


@pytest.fixture
def folder(tmp_path):
    """A folder for a scene; the same mesh lies in it, twice below it, and above it."""
    folder = tmp_path / "scene"
    (folder / "parts").mkdir(parents=True)
    mesh = mi.load_dict({"type": "cube", "to_world": mi.ScalarTransform4f().scale(0.3)})
    mesh.write_ply(str(folder / "cube.ply"))
    for copy in (folder / "parts" / "a.ply", folder / "parts" / "b.ply", tmp_path / "c.ply"):
        copy.write_bytes((folder / "cube.ply").read_bytes())
    return folder


def write(folder, *things, name="scene.xml"):
    """Write a scene with more things in it."""
    (folder / name).write_text(SMALL_SCENE.replace("</scene>", "\n".join([*things, "</scene>"])))
    return folder / name


def picture(scene, parameters):
    """Some samples of a scene."""
    return RenderJob(scene, parameters, spp=4).run().image


def packed_picture(packed, tmp_path, monkeypatch):
    """The same of a parcel, with nothing near it."""
    far = tmp_path / "far" / "away"
    far.mkdir(parents=True)
    monkeypatch.chdir(far)
    unpack(packed.files, far)
    return picture(far / packed.scene, packed.parameters)


def check(scene, parameters, tmp_path, monkeypatch):
    """Compare a scene and its parcel, whose files are gone, bit for bit; return the parcel."""
    packed = pack(scene, parameters)
    expected = picture(scene, parameters)
    scene.parent.rename(scene.parent.with_name("gone"))
    image = packed_picture(packed, tmp_path, monkeypatch)
    np.testing.assert_array_equal(image, expected)
    return packed


def test_files_beside_below_and_elsewhere_travel_once(folder, tmp_path, monkeypatch):
    names = ("cube.ply", "parts/a.ply", "../c.ply", str(tmp_path / "c.ply"))
    scene = write(folder, *(MESH.format(name) for name in names))
    digest = scene_digest(scene)
    packed = check(scene, {}, tmp_path, monkeypatch)
    assert sorted(name[64:] for name in packed.files) == [".ply", ".xml"]
    assert packed.scene_digest == digest
    assert packed.origins[packed.scene] == scene


def test_included_files_and_spectra(folder, tmp_path, monkeypatch):
    (folder / "parts" / "outer.xml").write_text(
        '<scene version="3.0.0"><include filename="inner.xml"/></scene>'
    )
    mesh = MESH.format("parts/a.ply")
    (folder / "parts" / "inner.xml").write_text(
        f'<scene version="3.0.0"><!-- <include filename="x"/> -->{mesh}</scene>'
    )
    (folder / "grey.spd").write_text("400 0.2\n500 0.6\n700 0.3\n")
    bsdf = '<bsdf type="diffuse"><spectrum name="reflectance" filename="grey.spd"/></bsdf>'
    scene = write(
        folder,
        '<include filename="parts/outer.xml"/>',
        f'<shape type="sphere"><float name="radius" value="0.2"/>{bsdf}</shape>',
    )
    packed = check(scene, {}, tmp_path, monkeypatch)
    assert sorted(name[64:] for name in packed.files) == [".ply", ".spd", ".xml", ".xml", ".xml"]


def test_parameters_of_file_names_stay_here_and_others_travel(folder, tmp_path, monkeypatch):
    scene = write(
        folder,
        '<default name="mesh" value="cube"/><default name="mesh_folder" value="."/>',
        MESH.format("$mesh_folder/$mesh.ply"),
    )
    parameters = {"radiance": "3", "mesh": "a", "mesh_folder": "parts"}
    packed = check(scene, parameters, tmp_path, monkeypatch)
    assert packed.parameters == {"radiance": "3"}
    assert packed.origins[next(n for n in packed.files if n.endswith(".ply"))].name == "a.ply"


def test_folders_that_a_scene_adds_are_searched(folder, tmp_path, monkeypatch):
    (folder / "parts" / "inner.xml").write_text(
        f'<scene version="3.0.0">{MESH.format("b.ply")}</scene>'
    )
    scene = write(folder, '<path value="parts"/>', '<include filename="inner.xml"/>')
    check(scene, {}, tmp_path, monkeypatch)


def test_lines_stay_where_they_were(folder):
    scene = write(folder, "<!-- ä -->", "<shape", "type='ply' >", MESH[18:].format("cube.ply"))
    packed = pack(scene, {})
    (mesh,) = packed.files.keys() - {packed.scene}
    expected = scene.read_bytes().replace(b'"cube.ply"', f'"{mesh}"'.encode())
    assert packed.files[packed.scene] == expected


def test_a_missing_file_is_named(folder):
    scene = write(folder, MESH.format("gone.ply"))
    with pytest.raises(FileNotFoundError, match=r'scene.xml \(line \d+.*"gone.ply" is not found'):
        pack(scene, {})


def test_what_cannot_be_packed_is_refused(folder, monkeypatch):
    """A parcel that does not say what the scene says is an error, and no other picture."""
    from mi_ellipse.rendering import parcel

    scene = write(folder, MESH.format("cube.ply"))
    edited = parcel._edited
    monkeypatch.setattr(parcel, "_edited", lambda *a: edited(*a).replace(b"0,-4,3", b"0,-4,4"))
    with pytest.raises(ValueError, match=r"scene.xml cannot be packed for another machine"):
        pack(scene, {})


def test_a_parcel_of_another_content_has_another_name(folder):
    scene = write(folder, MESH.format("cube.ply"))
    first = pack(scene, {})
    assert dataclasses.asdict(pack(scene, {})) == dataclasses.asdict(first)
    write(folder, MESH.format("cube.ply"), "<!-- another -->")
    assert pack(scene, {}).scene != first.scene
