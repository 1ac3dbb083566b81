"""Built-in lamps converted, strategies chosen by lamp, and lamps turned back into built-in ones."""

import mitsuba as mi
import numpy as np
import pytest
from commands import SCENE, write_scene
from mi_ellipse.rendering.rewrite import Conversion
from mi_ellipse.rendering.scene import load_scene, parse_scene

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

DOWN = '<transform name="to_world">{}<rotate x="1" angle="180"/><translate z="2"/></transform>'

# Written by hand, as Blender writes an elliptical area lamp, and by reference
BUILT_IN = f"""
<emitter type="area" id="shining"><rgb name="radiance" value="2, 1, 1"/></emitter>
<shape type="disk" id="ceiling">
    {DOWN.format('<scale x="0.4" y="0.9"/>')}
    <emitter type="area"><float name="sampling_weight" value="2"/></emitter>
</shape>
<shape type="disk">{DOWN.format('<translate x="2"/>')}<ref id="shining"/></shape>
<shape type="sphere" id="bulb"><point name="center" x="-1" y="0" z="1"/>
    <float name="radius" value="0.2"/><emitter type="area"/></shape>
<shape type="sphere" id="lining"><boolean name="flip_normals" value="true"/>
    <float name="radius" value="9"/><emitter type="area"/></shape>
<shape type="sphere" id="mirrored">
    <transform name="to_world"><scale x="-9" y="9" z="9"/></transform>
    <emitter type="area"/></shape>
<shape type="rectangle" id="window">{DOWN.format("")}<emitter type="area"/></shape>
"""

OWN = f"""
<shape type="ellipse" id="ceiling">
    <float name="semi_axis_x" value="0.5"/><float name="semi_axis_y" value="1.5"/>
    {DOWN.format('<scale x="2" y="0.5"/>')}
    <emitter type="ellipticalarea"><string name="sampling" value="concentric"/></emitter>
</shape>
<shape type="disk"><transform name="to_world"><translate x="-2" z="0.5"/></transform>
    <emitter type="ellipticalarea" id="sun"><rgb name="radiance" value="3"/></emitter></shape>
<shape type="sphere"><point name="center" x="2" y="0" z="1"/>
    <float name="radius" value="0.2"/><emitter type="ellipticalarea"/></shape>
"""


def picture(scene, spp=1024, seed=1):
    return mi.render(scene, spp=spp, seed=seed).numpy()


def choices(scene):
    """The strategy of each emitter, in the order of the scene; None for Mitsuba's own."""
    return [getattr(getattr(e, "lamp", None), "sampling", None) for e in scene.emitters()]


def test_disks_and_spheres_are_converted_and_nothing_else(scene_file):
    parsed = parse_scene(write_scene(scene_file, BUILT_IN))
    conversion = parsed.conversion()
    assert conversion == Conversion(("ceiling", "shining", "bulb"), ("lining", "mirrored"))
    assert "3 lamps" in str(conversion)
    assert "ceiling, shining, bulb" in str(conversion)
    assert "lining, mirrored" in str(conversion)

    before = scene_file.read_text()
    scene = load_scene(scene_file, convert_lamps=True)
    kinds = {type(e).__name__: 0 for e in scene.emitters()}
    for emitter in scene.emitters():
        kinds[type(emitter).__name__] += 1
    assert kinds == {"EllipticalArea": 3, "Emitter": 3}
    assert scene_file.read_text() == before


def test_a_lamp_without_id_is_named_by_its_place(scene_file):
    write_scene(scene_file, '<shape type="disk">\n<emitter type="area"/></shape>')
    (name,) = parse_scene(scene_file).conversion().converted
    assert "scene.xml (line" in name


def test_a_converted_scene_has_the_picture_of_the_old_one(scene_file):
    write_scene(scene_file, BUILT_IN)
    old = mi.load_file(str(scene_file))
    pictures = [
        picture(old),
        picture(old, seed=2),
        picture(load_scene(scene_file, convert_lamps=True)),
    ]
    one, two, converted = (p.reshape(6, 2, 4, 4, 3).mean(axis=(1, 3)) for p in pictures)
    # The bound is five standard deviations of a block, from all 72 blocks of two seeds, and both
    # pictures scatter: a block beyond it has a probability below 1e-3.
    deviation = np.std((two - one) / one) / np.sqrt(2)
    assert 0 < deviation < 0.01
    np.testing.assert_allclose(converted / one, 1, atol=5 * np.sqrt(2) * deviation)


def test_built_in_is_the_scene_with_area_and_disk(scene_file):
    """The same numbers go through the same code of Mitsuba: pixels differ by rounding alone."""
    write_scene(scene_file, OWN)
    text = scene_file.read_text().replace('type="ellipticalarea"', 'type="area"')
    text = text.replace('<string name="sampling" value="concentric"/>', "")
    text = text.replace('<scale x="2" y="0.5"/>', '<scale x="1" y="0.75"/>')
    text = text.replace('<float name="semi_axis_x" value="0.5"/>', "")
    text = text.replace('<float name="semi_axis_y" value="1.5"/>', "")
    by_hand = scene_file.with_name("by_hand.xml")
    by_hand.write_text(text.replace('"ellipse"', '"disk"'))
    expected = picture(mi.load_file(str(by_hand)), 4)
    np.testing.assert_allclose(
        picture(load_scene(scene_file, sampling="built-in"), 4), expected, rtol=1e-4, atol=1e-6
    )


@pytest.mark.parametrize("mode", ["llvm_ad_rgb", "llvm_ad_spectral"])
@pytest.mark.parametrize(
    ("form", "power"),
    [
        ('<float name="{}" value="{}"/>', [3]),
        ('<rgb name="{}" value="{}, {}, {}"/>', [3, 2, 1]),
        ('<spectrum name="{}" value="{}"/>', [3]),
        ('<spectrum name="{}" value="400:{}, 700:{}"/>', [3, 2]),
    ],
)
def test_built_in_has_the_power_of_the_lamp(scene_file, mode, form, power):
    """Its area is π · 0.5 · 1.5 · 2 · 0.5, and that of the sphere 4π · 0.04."""
    mi.set_variant(mode)
    shapes = {"ellipse": np.pi * 0.75, "sphere": 4 * np.pi * 0.04}
    texts = []
    for name in ("power", "radiance"):
        text = OWN[: OWN.index('<shape type="disk"')] + OWN[OWN.index('<shape type="sphere"') :]
        for shape, area in shapes.items():
            values = np.array(power) / (1 if name == "power" else np.pi * area)
            start = text.index('"ellipticalarea"', text.index(f'"{shape}"'))
            end = start + text[start:].index(">")
            closed = text[end - 1] == "/"
            emission = form.format(name, *values)
            new = f'"ellipticalarea">{emission}' + ("</emitter>" if closed else "")
            text = text[:start] + new + text[end + 1 :]
        texts.append(text)
    pictures = [
        picture(load_scene(write_scene(scene_file, text), sampling="built-in"), 4) for text in texts
    ]
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-4, atol=1e-6)
    assert pictures[0].max() > 0.01


def test_conversion_and_built_in_undo_each_other(scene_file):
    write_scene(scene_file, BUILT_IN)
    scene = load_scene(scene_file, sampling="built-in", convert_lamps=True)
    assert choices(scene) == [None] * 6
    expected = picture(mi.load_file(str(scene_file)), 4)
    np.testing.assert_allclose(picture(scene, 4), expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("sampling", "expected"),
    [
        ("area", ["area", "area", "area"]),
        ("ceiling=area", ["area", "solid_angle", "solid_angle"]),
        ("ceiling=area,projected_solid_angle", ["area", *2 * ["projected_solid_angle"]]),
        (" rejection , sun = area", ["rejection", "area", "rejection"]),
        ("sun=built-in", ["concentric", None, "solid_angle"]),
    ],
)
def test_choice_by_lamp(scene_file, sampling, expected):
    planar = OWN[: OWN.index('<shape type="sphere"')]
    write_scene(scene_file, planar + '<shape type="disk"><emitter type="ellipticalarea"/></shape>')
    assert choices(load_scene(scene_file, sampling=sampling)) == expected


POWERED = """<shape type="disk" id="lamp"><emitter type="ellipticalarea">
    <spectrum type="d65" name="power"/></emitter></shape>"""
ELLIPSOID = '<shape type="ellipsoid" id="egg"><emitter type="ellipticalarea"/></shape>'


@pytest.mark.parametrize(
    ("lamps", "sampling", "words"),
    [
        (OWN, "nowhere=area", ['"nowhere"', "known are: ceiling, sun"]),
        (OWN, "area,solid_angle", ['"area" and "solid_angle"', "ID=NAME"]),
        (OWN, "sun=area,sun=area", ['"sun" is named twice']),
        (OWN, "sun=solid", ['"solid"', "known are: area, "]),
        (ELLIPSOID, "built-in", ["egg", '"ellipsoid"', "no such shape"]),
        (ELLIPSOID.replace('id="egg"', ""), "egg=area", ["none of its lamps has an id"]),
        (POWERED, "built-in", ["lamp: ", "power that a plugin gives", "<rgb>"]),
        (BUILT_IN, "area", ['no "ellipticalarea"', "--convert-lamps", "ceiling, shining, bulb"]),
    ],
)
def test_errors_of_the_choice(scene_file, lamps, sampling, words):
    write_scene(scene_file, lamps)
    with pytest.raises(ValueError, match="sampl") as error:
        load_scene(scene_file, sampling=sampling)
    assert all(word in str(error.value) for word in words), error.value


def test_an_ellipsoid_beside_can_stay_while_others_are_built_in(scene_file):
    write_scene(scene_file, OWN + ELLIPSOID)
    scene = load_scene(scene_file, sampling="egg=area,built-in")
    assert choices(scene) == [None, None, None, "area"]


def test_files_of_a_path_element_are_found(tmp_path):
    """Mitsuba's own loader keeps the folders that a scene adds; so does this one."""
    (tmp_path / "meshes").mkdir()
    mi.load_dict({"type": "cube"}).write_ply(str(tmp_path / "meshes" / "cube.ply"))
    mesh = '<shape type="ply"><string name="filename" value="cube.ply"/></shape>'
    file = tmp_path / "scene.xml"
    file.write_text(SCENE.format(lamps='<path value="meshes"/>' + mesh))
    assert len(load_scene(file).shapes()) == 2
    assert parse_scene(file).named_files()[0][1] == tmp_path / "meshes" / "cube.ply"
