"""Scene files, as they are parsed and loaded."""

import mitsuba as mi
import numpy as np
import pytest
from commands import write_scene
from mi_ellipse.rendering.scene import instantiate, load_scene, parse_scene
from mi_ellipse.sampling import STRATEGIES

pytestmark = pytest.mark.usefixtures("llvm_ad_rgb")


@pytest.mark.parametrize("name", sorted(STRATEGIES))
def test_sampling_is_the_parameter_of_the_scene(scene_file, name):
    chosen = mi.render(load_scene(scene_file, sampling=name), spp=4).numpy()
    written = mi.render(load_scene(scene_file, {"sampling": name}), spp=4).numpy()
    np.testing.assert_allclose(chosen, written, rtol=1e-5)


def test_a_parsed_scene_is_loaded_with_one_strategy_after_another(scene_file):
    parsed = parse_scene(scene_file, {"sampling": "concentric"})
    for name in ("area", "solid_angle", None):
        scene = instantiate(parsed, name)
        assert f"sampling = {name or 'concentric'}," in str(scene)


def test_the_file_resolver_stays_as_it_was(scene_file):
    before = mi.file_resolver()
    load_scene(scene_file)
    with pytest.raises(ValueError, match="nonsense"):
        load_scene(scene_file, sampling="nonsense")
    assert mi.file_resolver() is before


def test_files_of_a_scene(scene_file):
    folder = scene_file.parent
    (folder / "meshes").mkdir()
    (folder / "meshes" / "a.ply").touch()
    (folder / "more.xml").write_text(
        '<scene version="3.0.0"><shape type="ply">'
        '<string name="filename" value="meshes/a.ply"/></shape></scene>'
    )
    write_scene(scene_file, '<include filename="more.xml"/>')
    parsed = parse_scene("scene.xml")
    assert [file.resolve() for file in parsed.scene_files] == [
        scene_file.resolve(),
        (folder / "more.xml").resolve(),
    ]
    ((location, file),) = parsed.named_files()
    assert "more.xml (line 1" in location
    assert file == (folder / "meshes" / "a.ply").resolve()
