"""How a light gets into a scene: references, nesting, XML parameters, instances, wrong shapes."""

import itertools

import mitsuba as mi
import numpy as np
import pytest
from conftest import floor_and, lamp
from mi_ellipse.system.messages import innermost_cause

from oracles.ellipse import rotation, translation

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")

LAMP = translation(0, 0, 1) @ rotation([1, 0, 0], 180) @ np.diag([0.8, 0.4, 1, 1])
RED = {"type": "rgb", "value": [3, 1, 0.5]}


def picture(scene, spp=16):
    return np.array(mi.render(mi.load_dict(scene), spp=spp, seed=3))


@pytest.fixture
def expected(llvm_ad_rgb):
    """The lamp given in place."""
    return picture(floor_and({"lamp": lamp(LAMP, "solid_angle", RED)}))


def test_lamp_by_reference(expected):
    light = {"type": "ellipticalarea", "sampling": "solid_angle", "radiance": RED}
    shape = lamp(LAMP, "solid_angle") | {"emitter": {"type": "ref", "id": "light"}}
    got = picture(floor_and({"light": light, "lamp": shape}))
    np.testing.assert_allclose(got, expected, rtol=1e-5)


def test_radiance_by_reference():
    image = np.random.default_rng(1).random((4, 4, 3)).astype(np.float32)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True}
    expected = picture(floor_and({"lamp": lamp(LAMP, "solid_angle", texture)}))
    shape = lamp(LAMP, "solid_angle", {"type": "ref", "id": "texture"})
    got = picture(floor_and({"texture": texture, "lamp": shape}))
    np.testing.assert_allclose(got, expected, rtol=1e-5)


def test_light_that_exists_already(expected):
    """Objects among the values of a dictionary."""
    light = mi.load_dict({"type": "ellipticalarea", "sampling": "solid_angle", "radiance": RED})
    shape = mi.load_dict(lamp(LAMP, "solid_angle") | {"emitter": light})
    got = picture(floor_and({"lamp": shape}))
    np.testing.assert_allclose(got, expected, rtol=1e-5)


XML = """
<scene version="3.0.0">
    <default name="length" value="0.8"/>
    <default name="strategy" value="solid_angle"/>
    <default name="light" value="ellipticalarea"/>
    <default name="height" value="1"/>
    <default name="spp" value="16"/>
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="45"/>
        <transform name="to_world">
            <lookat origin="0, -4, 4" target="0, 0, 0" up="0, 0, 1"/>
        </transform>
        <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="16"/> <integer name="height" value="16"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <bsdf type="diffuse" id="grey"/>
    <emitter type="$light" id="light">
        <rgb name="radiance" value="3, 1, 0.5"/>
        <string name="sampling" value="$strategy"/>
    </emitter>
    <shape type="ellipse" id="lamp">
        <float name="semi_axis_x" value="$length"/>
        <float name="semi_axis_y" value="0.4"/>
        <transform name="to_world">
            <rotate x="1" angle="180"/>
            <translate z="$height"/>
        </transform>
        <ref id="light"/>
        <ref id="grey"/>
    </shape>
    <shape type="rectangle">
        <transform name="to_world"><scale value="3"/></transform>
        <ref id="grey"/>
    </shape>
</scene>
"""


def test_xml_with_references_and_defaults(expected):
    got = np.array(mi.render(mi.load_string(XML), spp=16, seed=3))
    np.testing.assert_allclose(got, expected, rtol=1e-4)


def test_xml_parameters_from_outside():
    scene = mi.load_string(XML, length="1.5", strategy="rejection", height="0.5")
    assert scene.shapes()[0].surface_area()[0] == pytest.approx(np.pi * 1.5 * 0.4, rel=1e-6)
    assert "sampling = rejection" in str(scene.emitters()[0])
    matrix = translation(0, 0, 0.5) @ rotation([1, 0, 0], 180) @ np.diag([1.5, 0.4, 1, 1])
    got = np.array(mi.render(scene, spp=16, seed=3))
    same = picture(floor_and({"lamp": lamp(matrix, "rejection", RED)}))
    np.testing.assert_allclose(got, same, rtol=1e-4)


def test_xml_parameter_of_a_wrong_value_is_reported():
    with pytest.raises(RuntimeError) as error:
        mi.load_string(XML, strategy="solid")
    assert 'sampling="solid" is unknown' in innermost_cause(error.value)
    with pytest.raises(RuntimeError) as error:
        mi.load_string(XML, length="-1")
    assert "semi_axis_x=-1" in innermost_cause(error.value)


def test_instances_are_refused_as_for_the_built_in():
    """Mitsuba has no emitters in shape groups."""
    messages = []
    for sampling in (None, "solid_angle"):
        scene = {
            "group": {"type": "shapegroup", "lamp": lamp(LAMP, sampling)},
            "instance": {"type": "instance", "group": {"type": "ref", "id": "group"}},
        }
        with pytest.raises(RuntimeError) as error:
            picture(floor_and(scene))
        messages.append(innermost_cause(error.value))
    assert "Instancing of emitters is not supported" in messages[0]
    assert messages[0] == messages[1]


def test_light_among_instances():
    """A scene with instances has lights beside them, and an ellipse without light within."""

    def scene(sampling):
        dull = {"type": "disk" if sampling is None else "ellipse"}
        dull["to_world"] = mi.ScalarTransform4f().translate([0, 0, 0.3]).scale(0.3)
        move = mi.ScalarTransform4f().translate([0.5, 0, 0])
        group = {"type": "ref", "id": "group"}
        return floor_and(
            {
                "group": {"type": "shapegroup", "dull": dull},
                "first": {"type": "instance", "group": group},
                "second": {"type": "instance", "group": group, "to_world": move},
                "lamp": lamp(LAMP, sampling, RED),
            }
        )

    # The same draws: `area` of a disk is the map of `disk`.
    np.testing.assert_allclose(picture(scene("area")), picture(scene(None)), rtol=1e-3, atol=1e-6)


def test_one_light_on_two_shapes():
    """Refused, as for the built-in pair."""

    def scene(light, shape):
        shapes = {
            name: {
                "type": shape,
                "to_world": mi.ScalarTransform4f().translate([x, 0, 1]).rotate([1, 0, 0], 180),
                "emitter": {"type": "ref", "id": "light"},
            }
            for name, x in (("left", -1), ("right", 1))
        }
        return {"type": "scene", "light": {"type": light}} | shapes

    for light, shape in itertools.product(("area", "ellipticalarea"), ("disk", "ellipse")):
        with pytest.raises(RuntimeError) as error:
            mi.load_dict(scene(light, shape))
        assert "only be attached to a single shape" in innermost_cause(error.value)


@pytest.mark.parametrize("shape", ["cylinder", "rectangle", "cube"])
def test_wrong_shape_names_plugin_and_remedy(shape):
    """At first use; and another scene renders afterwards."""
    wrong = {
        "type": shape,
        "to_world": mi.ScalarTransform4f().translate([0, 0, 1]).scale(0.3),
        "emitter": {"type": "ellipticalarea"},
    }
    scene = mi.load_dict(floor_and({"lamp": wrong}, 4))
    with pytest.raises(Exception) as error:  # noqa: PT011
        np.array(mi.render(scene, spp=1))
    message = innermost_cause(error.value)
    assert message.startswith("ellipticalarea: the emitter is attached to a ")
    assert message.endswith('type "ellipse", "ellipsoid", "disk" or "sphere"')
    assert picture(floor_and({"lamp": lamp(LAMP, "solid_angle")}, 4)).max() > 0


def test_light_without_a_shape_is_no_light_as_for_the_built_in():
    """Mitsuba leaves both out; the command line of this package refuses such a file."""
    for light in ("area", "ellipticalarea"):
        scene = mi.load_dict(floor_and({"light": {"type": light}}, 4))
        assert scene.emitters() == []
        assert np.array(mi.render(scene, spp=1)).max() == 0


def test_light_without_a_shape_leaves_others_alone(expected):
    """It may get its shape later."""
    unattached = mi.load_dict({"type": "ellipticalarea"})
    for integrator in (None, {"type": "ptracer", "max_depth": 2}):
        good = floor_and({"lamp": lamp(LAMP, "solid_angle", RED)}, integrator=integrator)
        assert picture(good).max() > 0
    np.testing.assert_allclose(
        picture(floor_and({"lamp": lamp(LAMP, "solid_angle", RED)})), expected, rtol=1e-5
    )
    assert mi.load_dict(lamp(LAMP, "solid_angle") | {"emitter": unattached}).is_emitter()
